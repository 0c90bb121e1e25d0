"""A defect of a sensor is in record, report and figure, and damaged series of health are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from compiler import long_without_compiler
from corruptors import frozen, with_defect

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import sensor_health, summarize
from uvms_ocp.robot.signals import Readings, SensorSpecs, State
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.viz.health_figures import figure_health

START = 2.0  # [s]


@pytest.fixture(scope="module")
def record() -> Record:
    """Record the beginning of Case 1 with an altimeter that freezes."""
    scenario = case1(noise=True, seed=1, duration=4.0, dt=0.02)
    return replace(scenario, sensors=FrozenAltimeter(specs=scenario.specs)).run()


@dataclass(frozen=True, kw_only=True)
class FrozenAltimeter:
    """Maker of the toolkit's sensors with an altimeter that freezes."""

    specs: SensorSpecs

    def __call__(self, scenario: Scenario) -> Callable[[State, float], Readings]:
        corrupt = frozen("altimeter_range")
        suite = SensorSuite(
            scenario.robot, scenario.environment.seafloor, self.specs, scenario.seed
        )

        def read(state: State, t: float) -> Readings:
            readings = suite.read(state, t)
            if t < START:
                return readings
            return with_defect(readings, "altimeter_range", corrupt, t)

        return read


@long_without_compiler
def test_record_report_and_figure_name_the_channel_and_say_why(
    record: Record, tmp_path: Path
) -> None:
    column = record.run_meta.channels.index("altimeter_range")
    detected_at = record["t"][np.argmax(record["health"][:, column] > 0)]
    assert START < detected_at < START + 0.7
    assert not np.delete(record["health"], column, axis=1).any()
    texts = [alarm.text for alarm in record.run_meta.alarms]
    altimeter_texts = [text for text in texts if text.startswith("altimeter_range")]
    assert altimeter_texts[0].startswith("altimeter_range suspect: the same value ")
    assert altimeter_texts[1].startswith("altimeter_range lost: the same value ")
    rows = {row["channel"]: row for row in sensor_health(record)}
    assert rows == {row["channel"]: row for row in summarize(record)["sensor_health"]}
    row = rows.pop("altimeter_range")
    assert row["first_s"] == detected_at
    assert row["lost_s"] > 0.5
    assert row["why"].startswith("the same value ")
    assert all(row["first_s"] is None and not row["why"] for row in rows.values())
    assert figure_health(record) is not None
    record.save(tmp_path / "record.npz")
    loaded = Record.load(tmp_path / "record.npz")
    np.testing.assert_array_equal(loaded["health"], record["health"])
    assert loaded.run_meta.channels == record.run_meta.channels


@long_without_compiler
def test_a_record_without_health_has_none(record: Record) -> None:
    series = {name: values for name, values in record.series.items() if name != "health"}
    old = Record(series=series, meta=record.run_meta.model_copy(update={"channels": ()}))
    assert sensor_health(old) == []
    assert figure_health(old) is None


@long_without_compiler
@pytest.mark.parametrize(
    "spoil",
    [
        lambda health: health[:, 1:],
        lambda health: health[:, 0],
        lambda health: health + 3,
        lambda health: health - 1,
        lambda health: health.astype(float),
    ],
)
def test_wrong_series_of_health_are_refused_in_one_line(
    record: Record, tmp_path: Path, spoil
) -> None:
    wrong = replace(record, series={**record.series, "health": spoil(record["health"])})
    wrong.save(tmp_path / "record.npz")
    with pytest.raises(InvalidInput, match="health") as error:
        Record.load(tmp_path / "record.npz")
    assert "\n" not in str(error.value)

"""Records with fewer rows than ticks lose no peak, no sum and no reading that is the newest."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tiny_robots import TINY, robot_of, scenario_of

from uvms_ocp.campaign.run_metrics import run_metrics
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.run_recordings import run_recording
from uvms_ocp.record.record import Record
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.record.row_rates import EXTREMES, MEANS, WORST, thinned_rows
from uvms_ocp.record.series_checks import MEASURED
from uvms_ocp.record.tables import SERIES, column_names
from uvms_ocp.report.comparison import transition_series
from uvms_ocp.report.metrics import max_velocity_step
from uvms_ocp.report.phase_resources import figures_between, resources
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.recorded_estimate import estimate_recording
from uvms_ocp.scenario.scenario import Scenario

RATE = 10.0  # [Hz]


@pytest.mark.parametrize("every", [1, 2, 7, 100])
@pytest.mark.parametrize("capacity", [1, 3, 64])
def test_what_is_kept_of_any_row_is_that_of_its_ticks(
    every: int, capacity: int, tmp_path: Path
) -> None:
    """Whatever the block, in memory and on the disk."""
    rng = np.random.default_rng(every)
    reading = rng.standard_normal((200, 2))
    reading[rng.random(200) < 0.7] = np.nan
    series = {
        "t": 0.01 * np.arange(200),
        "v": rng.standard_normal((200, 3)),
        "saturated": rng.random(200) < 0.2,
        "phase": np.repeat([0, 1, 2], (57, 80, 63)),
        "measured_depth": reading,
        "command": rng.standard_normal((200, 3)),
    }
    recorded = []
    for folder in (None, tmp_path / "rows"):
        recorder = Recorder(capacity, folder, every=every)
        for k in range(200):
            recorder.append({name: values[k] for name, values in series.items()})
        recorder.series()  # and once more, when there is nothing new
        recorded.append(recorder.series())
    in_memory, written = recorded
    assert in_memory.keys() == written.keys()
    for name, values in in_memory.items():
        np.testing.assert_array_equal(written[name], values, err_msg=name)
    if every == 1:
        assert in_memory.keys() == series.keys()
        return
    last = np.round(in_memory["t"] / 0.01).astype(int)
    assert {0, 56, 136, 199, *range(0, 200, every)} <= set(last)
    spans = [slice(first, end + 1) for first, end in zip([0, *(last[:-1] + 1)], last, strict=True)]
    for name, statistic in (
        ("v_least", np.min),
        ("v_most", np.max),
        ("v_mean", lambda x, axis: np.abs(x).mean(axis=axis)),
    ):
        np.testing.assert_allclose(
            in_memory[name], [statistic(series["v"][span], axis=0) for span in spans], rtol=1e-12
        )
    np.testing.assert_allclose(
        in_memory["saturated_mean"] @ np.diff(last, prepend=-1), series["saturated"].sum()
    )
    np.testing.assert_array_equal(
        in_memory["saturated"], [series["saturated"][span].any() for span in spans]
    )
    np.testing.assert_array_equal(in_memory["command"], series["command"][last])
    newest = [np.flatnonzero(np.isfinite(reading[span, -1])) for span in spans]
    expected = [
        reading[span][rows[-1]] if rows.size else np.full(2, np.nan)
        for span, rows in zip(spans, newest, strict=True)
    ]
    np.testing.assert_array_equal(in_memory["measured_depth"], expected)


def test_series_that_are_reduced_are_described_and_so_are_those_that_come_of_it() -> None:
    for name in (*EXTREMES, *MEANS, *WORST):
        assert name in SERIES
    rows = {name: np.zeros((3, 2)) for name in (*EXTREMES, *MEANS)}
    for name in thinned_rows(rows, np.array([0, 2])).keys() - rows.keys():
        whole = name.rpartition("_")[0]
        assert SERIES[name].units == SERIES[whole].units
        assert SERIES[name].meaning.endswith(SERIES[whole].meaning)


@pytest.fixture(scope="module")
def record_pair() -> tuple[Record, Record]:
    scenario = case1(noise=True, duration=12.0, dt=0.02, current=(0.2, 0.1, 0.0))
    return scenario.run(), dataclasses.replace(scenario, record_rate=RATE).run()


def test_no_peak_and_no_sum_is_lost_between_rows(record_pair: tuple[Record, Record]) -> None:
    whole, thinned = record_pair
    assert len(thinned) == pytest.approx(len(whole) / 5, abs=5)
    ours, theirs = (figures_between(record, 0.0, record["t"][-1]) for record in record_pair)
    for name, figure in theirs.items():
        assert ours[name] == pytest.approx(
            figure, rel=1e-2 if name.startswith(("path", "joint_path")) else 1e-9, abs=1e-12
        ), name
    report = summarize(thinned)
    expected = summarize(whole)
    for name in (
        "largest_tilt_rad",
        "min_altimeter_m",
        "passed_rates",
        "pressed_stops",
        "tool_position_error_m",
        "energy_j",
        "events",
    ):
        assert report.get(name) == expected.get(name), name
    assert max_velocity_step(thinned) is None
    assert report["energy_of_quick_thrust_j"] is None
    for name in {*MEASURED} & whole.series.keys():
        thinned_readings = thinned[name]
        all_readings = whole[name]
        assert set(thinned_readings[np.isfinite(thinned_readings[:, -1]), -1]) <= set(
            all_readings[np.isfinite(all_readings[:, -1]), -1]
        )


@pytest.mark.slow
def test_paths_and_times_at_limits_of_every_phase_are_those_of_all_ticks_however_few_the_rows() -> (
    None
):
    scenario = case1(noise=True, duration=60.0, dt=0.02, current=(0.9, 0.3, 0.0), seed=3)
    whole = resources(record := scenario.run())
    assert record.run_meta.completed
    assert max(row["saturation_time_s"] for row in whole) > 0.05
    for ours, theirs in zip(
        resources(dataclasses.replace(scenario, record_rate=1.0).run()), whole, strict=True
    ):
        # A mean covers the ticks up to its row, a sum over ticks those from its row on: one tick
        # lies between them.
        assert ours["joint_path_rad"] == pytest.approx(theirs["joint_path_rad"], rel=1e-3)
        assert ours["saturation_time_s"] == pytest.approx(
            theirs["saturation_time_s"], abs=1.01 * scenario.dt
        )


def test_a_campaign_has_the_peaks_of_all_ticks_and_no_count_of_rows_for_one_of_ticks(
    record_pair: tuple[Record, Record],
) -> None:
    whole, thinned = record_pair
    scenario = case1()
    ours, theirs = (run_metrics(scenario, record) for record in record_pair)
    for name in ("min_altimeter_m", "tilt_rad", "failed_ticks", "peak_thrust_n"):
        assert ours[name] == theirs[name], name
    assert whole.run_meta.statuses[0] == "solved"
    inexact = whole.run_meta.statuses.index("inexact")
    failing = dataclasses.replace(
        thinned, series=dict(thinned.series) | {"status": np.full_like(thinned["status"], inexact)}
    )
    assert (
        run_metrics(scenario, failing)["failed_ticks"] is summarize(failing)["failed_ticks"] is None
    )


def test_a_summary_has_the_largest_times_of_all_ticks_and_no_drift_between_rows(
    record_pair: tuple[Record, Record],
) -> None:
    whole, thinned = record_pair
    report = summarize(thinned)
    assert report["tick_us"]["max"] == pytest.approx(1e6 * thinned["tick_time_most"].max())
    assert report["controller_us"]["max"] == pytest.approx(
        1e6 * thinned["controller_time_most"].max()
    )
    assert report["vehicle_drift_in_last_phase_m"] is None
    assert summarize(whole)["vehicle_drift_in_last_phase_m"] > 0.0


def test_what_compares_ticks_refuses_a_record_of_fewer_rows(
    record_pair: tuple[Record, Record],
) -> None:
    for refuses in (
        transition_series,
        lambda record: run_recording(record, "few"),
        lambda record: estimate_recording(record, case1().robot),
    ):
        with pytest.raises(InvalidInput, match="fewer rows than ticks; record it with every tick"):
            refuses(record_pair[1])


def test_a_record_of_fewer_rows_is_saved_and_read_as_any(
    record_pair: tuple[Record, Record], tmp_path: Path
) -> None:
    _, thinned = record_pair
    thinned.save(tmp_path / "few.npz")
    loaded = Record.load(tmp_path / "few.npz")
    assert list(loaded.series) == list(thinned.series)
    assert loaded.run_meta.dt == pytest.approx(1.0 / RATE)
    assert column_names("v_most", thinned["v"].shape[1], thinned.meta)[0] == "v_most.surge"


def _tiny(**options: float) -> Scenario:
    return dataclasses.replace(
        scenario_of(robot_of(TINY["one wet link"]), "kinematic", duration=4.0), **options
    )


def test_a_rate_above_that_of_ticks_is_theirs_and_one_without_end_is_refused() -> None:
    assert len(_tiny(record_rate=1e6).run()) == len(_tiny().run())
    for rate in (0.0, 0.01, np.inf):
        with pytest.raises(InvalidInput, match="record_rate"):
            _tiny(record_rate=rate)

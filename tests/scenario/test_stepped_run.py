"""A run that is stepped by hand is the run, to the last bit, and can be looked into on the way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.scenario.cases.bluerov import reach
from uvms_ocp.scenario.cases.case1 import Thresholds, case1
from uvms_ocp.scenario.scenario import Scenario

MEASURED = {"controller_time", "solve_time", "tick_time"}
"""Series that two runs never share: the time that things took."""
EARLY = Thresholds(way_point=50.0, misalignment=4.0, landing_altitude=50.0)
"""Phases that end soon."""


def _scenario(**options: Any) -> Scenario:
    return case1(thresholds=EARLY, duration=1.5, **options)


def _require_same(stepped: Record, run: Record) -> None:
    assert list(stepped.series) == list(run.series)
    for name in run.series.keys() - MEASURED:
        np.testing.assert_array_equal(stepped[name], run[name], err_msg=name)
    assert stepped.run_meta.model_copy(update={"wall_s": 0.0}) == run.run_meta.model_copy(
        update={"wall_s": 0.0}
    )


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize(
    "options",
    [
        {"plant": "kinematic"},
        {"noise": True, "seed": 3},
        {"noise": True, "faults": ("linear_velocity:lost@0.5", "thruster2:dead@0.3")},
    ],
    ids=["kinematic", "noise", "faults"],
)
def test_steps_by_hand_end_with_the_record_of_the_run(options: dict[str, Any]) -> None:
    scenario = _scenario(**options)
    stepped = scenario.simulation()
    assert stepped.command is stepped.estimate is stepped.readings is None
    stepped.run(until=0.2)
    assert stepped.t == pytest.approx(0.2)
    for _ in range(7):
        command = stepped.step()
        assert stepped.command is command
    so_far = stepped.record
    assert so_far["t"][-1] == stepped.t
    assert so_far.run_meta.stopped == "stopped"
    np.testing.assert_array_equal(so_far["command"][-1], command.v)
    np.testing.assert_array_equal(so_far["q_estimated"][-1], stepped.estimate.q)
    record = stepped.run()
    np.testing.assert_array_equal(record["q"][: len(so_far)], so_far["q"])
    assert not np.array_equal(stepped.state.q, record["q"][-1]), "it has moved since the last row"
    _require_same(record, scenario.run())


@long_without_compiler
def test_a_finished_run_takes_no_step() -> None:
    stepped = reach(plant="kinematic").simulation()
    record = stepped.run()
    assert record.run_meta.completed
    assert stepped.finished
    assert len(stepped.run()) == len(record)
    with pytest.raises(InvalidInput, match="is finished at t = "):
        stepped.step()


def test_what_cannot_be_is_refused_in_one_line() -> None:
    stepped = _scenario(plant="kinematic").simulation()
    with pytest.raises(InvalidInput, match="take a step first"):
        _ = stepped.record
    stepped.run(until=0.1)
    with pytest.raises(InvalidInput, match="has passed"):
        stepped.run(until=0.05)

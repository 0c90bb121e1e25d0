"""Whole runs with faults: the same until the onset, told in the record, refused where they cannot
be.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.preflight.checks import quantity_stds
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.faults import parse_faults

ONSET = 0.5
DYNAMIC = [
    "position:bias=5,0,0",
    "joint3_position:stuck=0.2",
    "attitude:nan",
    "thruster3:dead",
    "joint2:jam",
    "current:step=1,0,0",
    "payload:mass=2",
]
KINEMATIC = ["position:bias=5,0,0", "joint6_position:bias=0.05"]
SECRETS = ("tick_time", "solve_time", "controller_time")


@pytest.fixture(scope="module", params=["dynamic", "kinematic"], name="sound")
def _sound(request: pytest.FixtureRequest) -> tuple[Scenario, Record]:
    scenario = case1(noise=True, plant=request.param, dt=0.02, duration=1.2)
    return scenario, scenario.run()


@pytest.mark.slow
@long_without_compiler
def test_runs_are_the_same_to_the_last_bit_until_the_onset(sound: tuple[Scenario, Record]) -> None:
    scenario, before = sound
    for text in DYNAMIC if scenario.plant == "dynamic" else KINEMATIC:
        record = replace(scenario, faults=parse_faults([f"{text}@{ONSET}"])).run()
        rows = round(ONSET / scenario.dt)
        for name in set(before.series) - set(SECRETS):
            np.testing.assert_array_equal(
                record[name][:rows], before[name][:rows], err_msg=f"{text} {name}"
            )
        assert not np.array_equal(record["q"], before["q"]), text
        assert [fault.text for fault in record.run_meta.faults] == [f"{text}@{ONSET}"]


@long_without_compiler
def test_the_same_faults_and_seed_give_the_same_run() -> None:
    faults = ("linear_velocity:spikes=1,0.5@0.2", "thruster3:stuck@0.3")
    first, second = (
        case1(noise=True, dt=0.02, duration=1.0, faults=faults).run() for _ in range(2)
    )
    np.testing.assert_array_equal(first["q"], second["q"])


@long_without_compiler
def test_the_record_and_the_report_tell_what_went_wrong(tmp_path: Path) -> None:
    scenario = case1(
        plant="kinematic",
        dt=0.02,
        duration=0.2,
        faults=("altimeter:frozen@0.1", "joint2:jam@0.05-0.1"),
    )
    scenario.run().save(tmp_path / "record.npz")
    record = Record.load(tmp_path / "record.npz")
    frozen, jammed = record.run_meta.faults
    assert (frozen.text, frozen.target, frozen.kind, frozen.t, frozen.end) == (
        "altimeter_range:frozen@0.1",
        "altimeter_range",
        "frozen",
        0.1,
        None,
    )
    assert (jammed.t, jammed.end) == (0.05, 0.1)
    assert summarize(record)["faults"] == [frozen.model_dump(), jammed.model_dump()]


@long_without_compiler
def test_a_run_without_faults_tells_none() -> None:
    assert summarize(case1(plant="kinematic", dt=0.02, duration=0.1).run())["faults"] == []


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        ("thruster9:dead", {}, "the robot has 8 thrusters"),
        ("thruster3:dead", {"plant": "kinematic"}, "the kinematic plant has no thrusters"),
        ("joint_velocities:frozen", {"noise": True}, "there is no sensor joint_velocities"),
        ("position:bias=1,2", {}, "2 values; give 1 or 3"),
    ],
)
def test_a_scenario_refuses_what_cannot_fail(
    text: str, options: dict[str, object], told: str
) -> None:
    with pytest.raises(InvalidInput, match=told):
        case1(faults=(text,), **options)


def test_a_scenario_names_what_was_meant() -> None:
    with pytest.raises(NameNotFound, match="Did you mean 'altimeter'"):
        case1(faults="altimetre:frozen@8")


def test_what_sensors_allow_is_told_of_a_run_that_ends_with_a_joint_beyond_its_limits() -> None:
    scenario = case1(noise=True)
    q = scenario.start.copy()
    q[scenario.robot.joint_q] = scenario.robot.limits.position_upper + 0.01
    spreads = quantity_stds(scenario.setup(), q)
    assert spreads
    assert all(0.0 < spread < 1.0 for spread in spreads.values())


@long_without_compiler
def test_an_encoder_that_sticks_takes_no_joint_past_its_limits() -> None:
    scenario = case1(noise=True, dt=0.02, duration=4.0, faults=("joint3_position:stuck=0.3@0.1",))
    q = scenario.run()["q"][:, scenario.robot.joint_q]
    limits = scenario.robot.limits
    assert (q <= limits.position_upper + 2e-3).all()
    assert (q >= limits.position_lower - 2e-3).all()

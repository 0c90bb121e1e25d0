"""Whatever becomes of an encoder, the arm does not fall: with sensors of joint rates it stays within
its velocity limits, without them brakes lock it before it is much beyond.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp import DONE, Above, Phase, Transition, load_robot, pose_at
from uvms_ocp.robot import SensorSpec
from uvms_ocp.scenario.options import abort_phase, activate, mission_of, run_options
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import (
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    MinimumAltitude,
    VehiclePose,
)

# [s]
ONSET = 3.0
END = 16.0
RATES = SensorSpec(rate=200.0, sigma=2e-3)
ROBOTS = ("girona_maris7_full", "bluerov2_alpha5")
FAULTS = (
    "joint2_position:bias=-0.5",
    "joint3_position:bias=0.3",
    "joint2_position:drift=0.016",
    "joint3_position:drift=-0.2",
    "joint2_position:stuck=0.3",
    "joint_positions:frozen",
    "joint_positions:spikes=0.05,0.5",
    "joint_positions:late=0.1",
    "payload:mass=2,0.0005 joint3_position:bias=0.3",
)
THROWN = {(ROBOTS[1], FAULTS[-1], dt) for dt in (0.02, 0.05)}
"""A small arm is thrown by 2 kg before any reading tells of it: 1.6 and 3.9 times its limit after a
tick, and 6.0 and 4.5 until brakes lock it, as its encoder and its rate then seem to disagree.
"""
QUICK = {(ROBOTS[0], "joint3_position:bias=0.3", 0.02)}


def hover(
    name: str,
    dt: float,
    faults: str,
    rates: SensorSpec | None = RATES,
    *,
    during: str = f"{ONSET:g}",
    end: float = END,
    ahead: float = 0.0,
) -> Scenario:
    """A robot that keeps its place and its arm at home until the end [s]; rates: sensor of its joint
    rates. during: times of the faults, as after their @. ahead [m]: its place, from where it starts.
    """
    robot = load_robot(name)
    tasks = [
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        VehiclePose(goal=pose_at((ahead, 0.0, -15.0))),
        JointTracking(joints=robot.joint_names, goal=robot.home),
    ]
    over = Transition(to=DONE, when=(Above(quantity="mission.time", limit=end - 1.0),))
    hold = Phase(
        name="hold", activations=activate(*(task.name for task in tasks)), transitions=(over,)
    )
    struck = tuple(f"{fault}@{during}" for fault in faults.split())
    options = {"robot": robot, "noise": True, "seed": 0, "dt": dt, "duration": end}
    run = run_options(options | {"faults": struck}, seabed=-18.0)
    scenario = run.scenario(
        name="hover",
        mission=mission_of(robot, tasks, (hold,), abort=abort_phase("JL", "MAC", "HA", "MP")),
        start=run.start(pose_at((0.0, 0.0, -15.0))),
        markers={},
    )
    return replace(scenario, sensors=replace(scenario.specs, joint_velocities=rates))


def runs() -> list[object]:
    """Robots by faults by control periods [s]; most are slow."""
    runs = list[object]()
    for case in product(ROBOTS, FAULTS, (0.005, 0.02, 0.05)):
        marks = [] if case in QUICK else [pytest.mark.slow]
        if case in THROWN:
            marks.append(pytest.mark.xfail(reason="known: thrown before it is locked", strict=True))
        runs.append(pytest.param(*case, marks=marks))
    return runs


@long_without_compiler
@pytest.mark.parametrize(("name", "faults", "dt"), runs())
def test_no_fault_of_an_encoder_makes_the_arm_whip(name: str, faults: str, dt: float) -> None:
    """A jump of 0.3 rad was followed by rates of 5 times their limit, 2.5 rad from home; with a
    payload 21 times.
    """
    scenario = hover(name, dt, faults)
    record = scenario.run()
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    soon = (record["t"] >= ONSET) & (record["t"] <= ONSET + 0.5)
    assert rates[soon].max() <= 1.2
    assert rates[~soon].max() <= 1.02


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("bias", [-0.5, 0.3])
@pytest.mark.parametrize("dt", [0.02, 0.05])
def test_an_encoder_that_jumps_and_is_believed_makes_no_arm_fall(
    name: str, bias: float, dt: float
) -> None:
    """Nothing else tells its posture: a jump of 0.5 rad at 20 Hz was followed by 21 times the velocity
    limit, stop to stop, then by 1.3 times as brakes let go. It is taken to its place by what it reads.
    """
    scenario = hover(name, dt, f"joint2_position:bias={bias}", rates=None)
    record = scenario.run()
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    assert rates.max() <= 1.02
    home = record["q"][0, 7:]
    assert np.abs(record["q"][:, 7:] - home).max() <= abs(bias) + 0.1


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(
    ("name", "dt", "fault"),
    [
        (ROBOTS[0], 0.02, "joint3_position:drift=-0.2"),
        (ROBOTS[0], 0.05, "joint3_position:drift=-0.2"),  # 1.6 times as brakes let it go
        (ROBOTS[1], 0.05, "joint2_position:drift=0.2"),
        (ROBOTS[0], 0.05, "payload:mass=3,0.0005"),
        (ROBOTS[0], 0.01, "joint3_position:drift=-0.2"),
        (ROBOTS[0], 0.01, "joint3_position:drift=0.2"),
        (ROBOTS[0], 0.01, "joint3_position:drift=0.1"),
    ],
)
def test_brakes_lock_an_arm_that_falls_though_nothing_is_doubted(
    name: str, dt: float, fault: str
) -> None:
    """An encoder that drifts without a sensor of its rate took its joint along to 4.7 and 5.7 times
    the velocity limit, and a load that nobody knew of to 2.1 times. A quick loop shook it, at 2.1 times, for
    as long as its encoder drifted.
    """
    scenario = hover(name, dt, fault, rates=None)
    record = scenario.run()
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    assert rates.max() <= 1.02


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(
    ("name", "dt", "faults", "during"),
    [
        (ROBOTS[0], 0.02, "joint2_position:drift=-0.5 joint5_position:spikes=0.3,0.5", "3-7"),
        (ROBOTS[0], 0.05, "joint2_position:drift=1.0 joint5_position:spikes=0.3,0.5", "3-5"),
        (ROBOTS[1], 0.02, "joint2_position:drift=1.0 joint3_position:spikes=0.3,0.5", "3-5"),
    ],
)
def test_an_arm_that_was_locked_as_its_readings_ran_away_stays_when_it_is_let_go(
    name: str, dt: float, faults: str, during: str
) -> None:
    """What the readings seemed to tell of a fall was borne at the release: 2.4 and 2.0 times the
    velocity limit.
    """
    scenario = hover(name, dt, faults, rates=None, during=during, end=50.0)
    record = scenario.run()
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    assert rates.max() <= 0.5
    home = record["q"][0, 7:]
    assert np.abs(record["q"][:, 7:] - home).max() <= 0.1

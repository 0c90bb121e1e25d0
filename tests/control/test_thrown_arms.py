"""A thruster that fails turns the vehicle, which throws its arm: brakes lock it before it is beyond
its velocity limits, and until the vehicle is where it should be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp import DONE, Below, Phase, Transition, load_robot, pose_at
from uvms_ocp.scenario.cases import obstacle_field
from uvms_ocp.scenario.options import abort_phase, activate, mission_of, run_options
from uvms_ocp.tasks import (
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    MinimumAltitude,
    ToolPosition,
    VehiclePose,
)

ONSET = 6.0  # [s]


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("dt", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("fault", ["thruster3:reversed", "thruster1:reversed", "thruster1:dead"])
def test_a_thruster_that_fails_throws_no_arm(fault: str, dt: float) -> None:
    """A reversed one made joints 5 times as fast as they may be, for 2.5 s."""
    robot = load_robot("bluerov2_alpha5")
    scenario = obstacle_field(
        robot=robot, noise=True, seed=0, dt=dt, duration=14.0, faults=(f"{fault}@{ONSET:g}",)
    )
    record = scenario.run()
    rates = np.abs(record["v"][:, robot.joint_v]) / robot.limits.velocity[robot.joint_v]
    soon = (record["t"] >= ONSET) & (record["t"] <= ONSET + 0.5)
    assert rates[soon].max() <= 1.2
    assert rates[~soon].max() <= 1.02


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("dt", [0.02, 0.05])
@pytest.mark.parametrize("name", ["bluerov2_alpha5", "girona_maris7_full"])
def test_the_abort_of_a_vehicle_that_stalls_with_its_arm_stretched_out_throws_no_arm(
    name: str, dt: float
) -> None:
    """Rates were seen of 3.9 times their limit for 1.9 s as one climbed."""
    robot = load_robot(name)
    here = pose_at((0.0, 0.0, -12.0))
    tasks = [
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        VehiclePose(goal=here),
        ToolPosition(goal=pose_at((4.0, 1.0, -12.0))),
        JointTracking(joints=robot.joint_names, goal=robot.home),
    ]
    reached = Transition(to=DONE, when=(Below(quantity="TP.position_error", limit=0.01),))
    phase = Phase(
        name="A", activations=activate(*(task.name for task in tasks)), transitions=(reached,)
    )
    abort = replace(abort_phase("JL", "MAC", "HA", "MP"), stall_after=5.0)
    run = run_options(
        {"robot": robot, "noise": True, "seed": 0, "dt": dt, "duration": 25.0}, seabed=-18.0
    )
    mission = mission_of(robot, tasks, (phase,), abort=abort)
    record = run.scenario(name="stall", mission=mission, start=run.start(here), markers={}).run()
    assert record.run_meta.events[0].reason.startswith("stall: ")
    rates = np.abs(record["v"][:, robot.joint_v]) / robot.limits.velocity[robot.joint_v]
    assert rates.max() <= 1.02

"""A thruster that fails turns the vehicle, which throws its arm: brakes lock it before it is beyond
its velocity limits, and until the vehicle is where it should be.
"""

from __future__ import annotations

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.scenario.cases import obstacle_field

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

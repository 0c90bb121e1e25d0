"""Alarms name the joint that an axis of the arm belongs to, also of a planar joint, which has three."""

from __future__ import annotations

import pytest
from odd_robots import pair_of, reach_of

from uvms_ocp.control import DynamicController


def test_every_axis_of_an_arm_has_the_name_of_its_joint() -> None:
    robot = pair_of("planar").odd
    first, planar, last = robot.joint_names
    assert robot.joint_of_axis == (first, planar, planar, planar, last)
    assert len(robot.joint_of_axis) == robot.n_joints


@pytest.mark.sampled
@pytest.mark.parametrize("axis", range(5))
def test_brakes_and_jams_of_an_axis_are_told_by_the_name_of_its_joint(axis: int) -> None:
    """That of the last axis was looked for beyond the last name."""
    robot = pair_of("planar").odd
    controller = reach_of(robot).controller()
    assert isinstance(controller, DynamicController)
    assert controller.monitor is not None
    alarms = controller.kinematic.watchdog.alarms
    name = robot.joint_of_axis[axis]
    controller.memory.overspeed.joint = axis
    controller._report(1.0)
    assert alarms[-1][1].startswith(f"{name} about to be faster")
    controller.memory.detection.joints.found[axis] = True
    controller.monitor.update(2.0)
    assert f"({name})" in alarms[-1][1]

"""The attitude at rest of vehicles whose thrusters leave axes free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.static_balance import static_residual, up_at_rest, without_trim
from uvms_ocp.robot.thrusters import unactuated_axes


def flat(robot: Robot) -> Robot:
    """With its level thrusters alone: neither roll nor pitch, nor heave."""
    level = tuple(
        thruster for thruster in robot.description.thrusters if thruster.direction[2] == 0.0
    )
    return replace(robot, description=checked_copy(robot.description, thrusters=level))


def moments(robot: Robot, roll: float, pitch: float, joints: np.ndarray) -> np.ndarray:
    """(k,) [N m] of weight and buoyancy on the rotations that no thruster drives."""
    q = robot.configuration(rpy=(roll, pitch, 0.7), joints=joints)
    free = [axis for axis in unactuated_axes(robot) if axis >= 3]
    return -robot_dynamics(robot).bias_force(q, np.zeros(robot.n_v))[free]


ROBOTS = {"roll": "girona_maris7", "roll and pitch": "girona_maris7_full"}


@pytest.mark.sampled
@pytest.mark.parametrize("free", ROBOTS)
def test_a_vehicle_comes_to_rest_where_weight_and_buoyancy_no_longer_turn_it(free: str) -> None:
    robot = without_trim(load_robot(ROBOTS[free]))
    robot = robot if free == "roll" else flat(robot)
    inwards = np.sign(robot.limits.position_upper + robot.limits.position_lower - 2.0 * robot.home)
    q = robot.configuration(joints=robot.home + 0.6 * inwards)
    up = up_at_rest(robot, q)
    roll = np.arctan2(up[1], up[2])
    pitch = -np.arcsin(up[0])
    assert np.linalg.norm(up) == pytest.approx(1.0)
    assert max(abs(roll), abs(pitch)) > 0.03
    assert len(moments(robot, roll, pitch, q[7:])) == len(free.split(" and "))
    assert np.abs(moments(robot, 0.0, 0.0, q[7:])).max() > 1.0
    assert np.abs(moments(robot, roll, pitch, q[7:])).max() < 1e-4
    assert (
        moments(robot, roll + 0.01, pitch, q[7:])[0]
        < 0.0
        < moments(robot, roll - 0.01, pitch, q[7:])[0]
    )


def test_a_vehicle_that_holds_every_axis_rests_level_however_it_is_trimmed() -> None:
    robot = without_trim(load_robot("girona_maris7_full"))
    assert up_at_rest(robot, robot.configuration()).tolist() == [0.0, 0.0, 1.0]


def test_an_attitude_that_is_none_is_refused() -> None:
    robot = load_robot("bluerov2_alpha5")
    q = np.array(robot.configuration())
    q[3:7] *= 0.5
    with pytest.raises(InvalidInput, match="whose norm is not 1"):
        static_residual(robot, q)
    shapes = CollisionModel(robot, self_collision=True)
    with pytest.raises(InvalidInput, match="whose norm is not 1"):
        shapes.values(q)

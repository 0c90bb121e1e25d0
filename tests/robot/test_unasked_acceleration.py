"""Acceleration of a vehicle that nobody asked for."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.robot.unasked_acceleration import unasked_acceleration


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["bluerov2_alpha5", "girona_maris7_full", "torpedo_auv"])
def test_weight_in_any_attitude_and_any_one_thruster_accelerate_no_axis_more(name: str) -> None:
    robot = load_robot(name)
    bound = unasked_acceleration(robot)
    dynamics = robot_dynamics(robot)
    lower, upper = thrust_limits(robot)
    matrix = thruster_matrix(robot)
    rest = np.zeros(robot.n_v)
    rng = np.random.default_rng(0)
    largest = np.zeros(6)
    for _ in range(200):
        q = robot.configuration(rpy=tuple(rng.uniform(-np.pi, np.pi, 3)))
        M = dynamics.mass_matrix(q)[:6, :6]
        weight = dynamics.inverse_dynamics(q, rest, rest)[:6]
        for k in range(len(upper)):
            for thrust in (lower[k], upper[k]):
                acceleration = np.linalg.solve(M, matrix[:, k] * thrust - weight)
                largest = np.maximum(largest, np.abs(acceleration))
    assert (largest <= bound + 1e-9).all()
    turning = bound[3:] > 0.1
    assert (largest[3:][turning] > 0.3 * bound[3:][turning]).all()

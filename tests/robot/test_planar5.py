"""The planar system of [Gao2022] eqs. (11)-(15): the Lagrangian of eq. (13), differentiated by
CasADi.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot

N_STATES = 1000

# The paper measures angles clockwise from y: phi = pi/2 - alpha, theta_urdf = -theta.
SIGNS = np.array([1.0, 1.0, -1.0, -1.0, -1.0])
OFFSET = np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("planar5")


@pytest.fixture(scope="module")
def dynamics(robot: Robot) -> Dynamics:
    return robot_dynamics(robot)


def lagrangian(robot: Robot, q: ca.SX, q_dot: ca.SX) -> ca.SX:
    """Kinetic energy of [Gao2022] eq. (13), its constants f1..f10 from the URDF."""
    (m0, c0, J0), (m1, c1, J1), (m2, c2, J2) = map(_body, list(robot.model.inertias)[3:])
    L0, L1 = (robot.model.jointPlacements[i].translation[0] for i in (4, 5))
    f1 = (m0 + m1 + m2) / 2
    f2 = _rotation(J0, m0, c0, m1 + m2, L0)
    f3 = _rotation(J1, m1, c1, m2, L1)
    f4 = _rotation(J2, m2, c2, 0, 0)
    f5 = m0 * c0 + (m1 + m2) * L0
    f6 = m1 * c1 + m2 * L1
    f7 = m2 * c2
    f8 = L0 * f6
    f9 = L0 * f7
    f10 = L1 * f7
    _, _, alpha, theta1, theta2 = ca.vertsplit(q)
    x_dot, y_dot, w0, theta1_dot, theta2_dot = ca.vertsplit(q_dot)
    a1 = alpha + theta1
    a2 = alpha + theta1 + theta2
    w1 = w0 + theta1_dot
    w2 = w0 + theta1_dot + theta2_dot

    def along(angle: ca.SX) -> ca.SX:
        return x_dot * ca.cos(angle) - y_dot * ca.sin(angle)

    translation = f1 * (x_dot**2 + y_dot**2) + f2 * w0**2 + f3 * w1**2 + f4 * w2**2
    coupling = f5 * w0 * along(alpha) + f6 * w1 * along(a1) + f7 * w2 * along(a2)
    arm = (
        f8 * w0 * w1 * ca.cos(theta1)
        + f9 * w0 * w2 * ca.cos(theta1 + theta2)
        + f10 * w1 * w2 * ca.cos(theta2)
    )
    return translation + coupling + arm


def _body(inertia: pin.Inertia) -> tuple[float, float, float]:
    return inertia.mass, inertia.lever[0], inertia.inertia[2, 2]


def _rotation(J: float, mass: float, centre: float, carried: float, length: float) -> float:
    return (J + mass * centre**2 + carried * length**2) / 2


@pytest.fixture(scope="module")
def euler_lagrange(robot: Robot) -> ca.Function:
    """Function ``q, q_dot -> D(q), H(q, q_dot) q_dot`` of [Gao2022] eqs. (14)-(15), in the paper's
    angles.
    """
    q = ca.SX.sym("q", 5)
    q_dot = ca.SX.sym("q_dot", 5)
    L = lagrangian(robot, q, q_dot)
    momentum = ca.gradient(L, q_dot)
    force = ca.jtimes(momentum, q, q_dot) - ca.gradient(L, q)
    return ca.Function("paper", [q, q_dot], [ca.jacobian(momentum, q_dot), force])


def states(robot: Robot) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(8)
    return list(zip(rng.uniform(-3, 3, (N_STATES, 5)), rng.normal(size=(N_STATES, 5)), strict=True))


def test_mass_matrix_and_coriolis_force_equal_the_paper_s_lagrangian(
    robot: Robot, dynamics: Dynamics, euler_lagrange: ca.Function
) -> None:
    friction = robot.model.damping
    for q_paper, v_paper in states(robot):
        D, h = euler_lagrange(q_paper, v_paper)
        q = SIGNS * q_paper + OFFSET
        v = SIGNS * v_paper
        M = SIGNS[:, None] * np.asarray(D) * SIGNS
        np.testing.assert_allclose(dynamics.mass_matrix(q), M, atol=1e-10)
        expected = SIGNS * np.asarray(h).ravel() + friction * v
        np.testing.assert_allclose(_in_the_plane(dynamics, q, v), expected, atol=1e-10)


def _in_the_plane(dynamics: Dynamics, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Bias force; gravity is normal to the plane and does no work."""
    np.testing.assert_allclose(dynamics.bias_force(q, np.zeros(5)), 0.0, atol=1e-12)
    return dynamics.bias_force(q, v)

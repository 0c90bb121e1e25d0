"""A vehicle alone against Fossen's closed form in NED, of the published BlueROV2 Heavy.

Coefficients: von Benzon et al., An Open-Source Benchmark Simulator: Control of a BlueROV2
Underwater Robot, J. Mar. Sci. Eng. 2022. The closed form is [Fossen2021] eqs. (3.53), (6.44) ff.,
(8.5) for three planes of symmetry.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot import hydrodynamics
from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.dynamics import Dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics, Water
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

MASS = 13.5
VOLUME = 0.0134
DENSITY = 1000.0
GRAVITY = 9.81
INERTIA = np.array([0.26, 0.23, 0.37])
ADDED = np.array([6.36, 7.12, 18.68, 0.189, 0.135, 0.222])
LINEAR = np.array([13.7, 0.0, 33.0, 0.0, 0.8, 0.0])
QUADRATIC = np.array([141.0, 217.0, 190.0, 1.19, 0.47, 1.5])
Z_B = -0.01  # centre of buoyancy above the centre of gravity, NED

FLIP = np.diag([1.0, -1.0, -1.0])  # NED in NWU, forward-right-down in forward-left-up, and back
FLIP6 = np.kron(np.eye(2), FLIP)
STATES = np.random.default_rng(4).normal(size=(20, 4, 6))


def description() -> RobotDescription:
    return RobotDescription.model_validate(
        {
            "convention": "NED",
            "water_density": DENSITY,
            "links": {
                "hull": {
                    "coefficients": {
                        "added_mass": ADDED.tolist(),
                        "linear_drag": LINEAR.tolist(),
                        "quadratic_drag": QUADRATIC.tolist(),
                        "volume": VOLUME,
                        "centre_of_buoyancy": (0.0, 0.0, Z_B),
                    }
                }
            },
        }
    )


def hull() -> pin.Model:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "float")
    model.appendBodyToJoint(
        joint, pin.Inertia(MASS, np.zeros(3), np.diag(INERTIA)), pin.SE3.Identity()
    )
    model.addFrame(pin.Frame("hull", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return model


@pytest.fixture(scope="module")
def dynamics() -> Dynamics:
    links = links_in_water(description())
    return Dynamics(SymbolicDynamics(model=hull(), links=links, density=DENSITY))


def rigid_coriolis(nu: np.ndarray) -> np.ndarray:
    C = np.zeros((6, 6))
    C[:3, :3] = MASS * pin.skew(nu[3:])
    C[3:, 3:] = -pin.skew(INERTIA * nu[3:])
    return C


def added_coriolis(nu: np.ndarray) -> np.ndarray:
    u, v, w, p, q, r = ADDED * nu
    return np.array(
        [
            [0, 0, 0, 0, w, -v],
            [0, 0, 0, -w, 0, u],
            [0, 0, 0, v, -u, 0],
            [0, w, -v, 0, r, -q],
            [-w, 0, u, -r, 0, p],
            [v, -u, 0, q, -p, 0],
        ]
    )


def restoring(roll: float, pitch: float) -> np.ndarray:
    W = MASS * GRAVITY
    B = DENSITY * GRAVITY * VOLUME
    sr = np.sin(roll)
    cr = np.cos(roll)
    sp = np.sin(pitch)
    cp = np.cos(pitch)
    heavy = W - B
    return np.array(
        [heavy * sp, -heavy * cp * sr, -heavy * cp * cr, -Z_B * B * cp * sr, -Z_B * B * sp, 0.0]
    )


def fossen(rpy: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Wrench in body NED of a vehicle in a uniform constant current (3,) given in NED."""
    c = pin.rpy.rpyToMatrix(rpy).T @ current
    nu_r = nu - np.r_[c, 0, 0, 0]
    nu_r_dot = nu_dot + np.r_[np.cross(nu[3:], c), 0, 0, 0]
    M_RB = np.diag(np.r_[MASS, MASS, MASS, INERTIA])
    rigid = M_RB @ nu_dot + rigid_coriolis(nu) @ nu
    added = ADDED * nu_r_dot + added_coriolis(nu_r) @ nu_r
    drag = (LINEAR + QUADRATIC * np.abs(nu_r)) * nu_r
    return rigid + added + drag + restoring(rpy[0], rpy[1])


@pytest.mark.parametrize("state", STATES)
def test_a_vehicle_alone_equals_the_closed_form(dynamics: Dynamics, state: np.ndarray) -> None:
    rpy = np.clip(state[0, :3], -1.4, 1.4)
    current = state[1, :3]
    nu = state[2]
    nu_dot = state[3]
    R_WB = FLIP @ pin.rpy.rpyToMatrix(rpy) @ FLIP
    q = pin.SE3ToXYZQUAT(pin.SE3(R_WB, state[0, 3:]))
    tau = dynamics.inverse_dynamics(q, FLIP6 @ nu, FLIP6 @ nu_dot, Water(velocity=FLIP @ current))
    np.testing.assert_allclose(
        FLIP6 @ tau, fossen(rpy, nu, nu_dot, current), atol=1e-10, rtol=1e-12
    )


def test_the_mass_matrix_is_the_sum_of_rigid_body_and_added_mass(dynamics: Dynamics) -> None:
    expected = np.diag(np.r_[MASS, MASS, MASS, INERTIA] + ADDED)
    np.testing.assert_allclose(dynamics.mass_matrix(pin.neutral(hull())), expected, atol=1e-12)


@pytest.mark.parametrize("state", STATES)
def test_the_same_terms_serve_arrays_and_expressions(dynamics: Dynamics, state: np.ndarray) -> None:
    """The numeric terms of the link, added to the rigid body by hand, equal the recursion."""
    (link,) = dynamics.symbolic.links
    nu = state[2]
    a = state[3]
    current = state[1, :3]
    R_WB = pin.rpy.rpyToMatrix(state[0, :3])
    u_L = R_WB.T @ current
    w_L = R_WB.T @ np.array([0.0, 0.0, GRAVITY])
    free = a + np.r_[w_L, 0, 0, 0]
    total = rigid_wrench(nu, free) + water_wrench(link, nu, free, u_L, w_L)
    q = pin.SE3ToXYZQUAT(pin.SE3(R_WB, np.zeros(3)))
    tau = dynamics.inverse_dynamics(q, nu, a, Water(velocity=current))
    np.testing.assert_allclose(tau, total, atol=1e-10, rtol=1e-12)


def rigid_wrench(nu: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.r_[MASS * np.ones(3), INERTIA] * a + rigid_coriolis(nu) @ nu


def water_wrench(
    link: LinkHydrodynamics, nu: np.ndarray, a: np.ndarray, u_L: np.ndarray, w_L: np.ndarray
) -> np.ndarray:
    nu_r = hydrodynamics.relative_velocity(nu, u_L)
    nu_r_dot = hydrodynamics.relative_acceleration(a, nu, u_L, w_L)
    return (
        hydrodynamics.added_mass_wrench(link.added_mass, nu_r, nu_r_dot)
        + hydrodynamics.drag_wrench(link.linear_drag, link.quadratic_drag, nu_r, link.by_flow)
        - hydrodynamics.pressure_wrench(DENSITY * link.volume, link.p_LB, w_L)
    )

"""The vehicle of the pool recordings: `bluerov2_alpha5` with the author's mount, ballast, foam and
coefficients.

The arm's motion is prescribed, as its motors held it; no thrust, no tether. Figures: README of the
data.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

_DENSITY = 998.0  # [kg/m3]
_GRAVITY = 9.81  # [m/s2]
_X_BA = pin.SE3(np.eye(3), np.array([0.25, -0.10965, 0.005]))
_ARM_BASE = pin.Inertia(
    0.341, np.array([-0.075, -0.006, -0.003]), np.diag([9.9e-5, 4.33e-3, 4.35e-3])
)
_MASS = 13.17  # [kg]
_DISPLACED = 13.082  # [kg]
CENTRE_OF_BUOYANCY = np.array([0.0074, 0.0, 0.02])
"""(3,) [m] in B, the author's."""
ADDED_INERTIA = 0.12
"""[kg m^2] about each axis (Wu); the author's inertia holds it."""
_INERTIA = np.array([0.228, 0.381, 0.4185]) - ADDED_INERTIA
_ADDED_MASS = np.array([5.5, 12.7, 14.57, ADDED_INERTIA, ADDED_INERTIA, ADDED_INERTIA])
_LINEAR_DRAG = np.array([4.03, 6.22, 5.18, 0.07, 0.07, 0.07])
_QUADRATIC_DRAG = np.array([18.18, 21.66, 36.99, 1.55, 1.55, 1.55])
# Position [m] and weight in water [N]; foam pulls up.
_BALLAST = (
    ((-0.20, 0.165, -0.075), 3.24),  # counter-arm
    ((-0.0975, 0.1275, -0.1325), 1.62),
    ((-0.0975, -0.1275, -0.1325), 1.62),
    ((-0.1887, 0.0439, -0.0595), 0.69),  # DVL
    ((-0.1542, 0.0439, -0.0795), 1.01),  # its bracket
)
_FOAM = (((0.0, 0.11, 0.027), -8.46), ((0.0, -0.11, 0.027), -8.86))
BALLAST_DENSITY = 7850.0
FOAM_DENSITY = 200.0
"""[kg/m^3] assumed; only inertia depends on them."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PoolVehicle:
    """Motion of the vehicle under prescribed joints: roll, pitch and everything they are coupled
    with.

    ``shift`` (3,) [m] moves the vehicle's centre of buoyancy from where the author has it. The
    state is the quaternion xyzw of the vehicle and its velocity in B (10,); position has no effect
    in still water.
    """

    step: ca.Function
    """``x (10,), joints (12, 3), shift (3,), h -> x`` over h [s]; joints: q, v, a at start, middle
    and end.
    """
    righting: ca.Function
    """``joints (4,), shift (3,) -> S (3,)`` [N m] in B: first moment of buoyancy less weight; at
    rest it is up.
    """


def pool_vehicle() -> PoolVehicle:
    """Build the vehicle."""
    dynamics = pool_dynamics()
    return PoolVehicle(step=_step(_acceleration(dynamics)), righting=_righting(dynamics))


def pool_dynamics() -> SymbolicDynamics:
    """Build the dynamics with the author's figures."""
    robot, links = _pool_robot()
    return SymbolicDynamics(model=robot.model, links=links, density=_DENSITY)


def _pool_robot() -> tuple[Robot, tuple[LinkHydrodynamics, ...]]:
    nominal = load_robot("bluerov2_alpha5")
    robot = nominal.with_frame_pose("arm_base", _X_BA)
    robot.model.inertias[1] = _base_inertia()
    arm = tuple(link for link in nominal.hydrodynamics if link.frame != "base_link")
    return robot, (_base_water(), *arm)


def _base_inertia() -> pin.Inertia:
    total = pin.Inertia(_MASS, np.zeros(3), np.diag(_INERTIA)) + _X_BA.act(_ARM_BASE)
    for position, mass, _ in _trim():
        total += pin.Inertia(mass, position, np.zeros((3, 3)))
    return total


def _base_water() -> LinkHydrodynamics:
    volumes = [_DISPLACED / _DENSITY]
    centres = [CENTRE_OF_BUOYANCY]
    for position, _, volume in _trim():
        volumes.append(volume)
        centres.append(position)
    return LinkHydrodynamics(
        frame="base_link",
        added_mass=_ADDED_MASS,
        linear_drag=_LINEAR_DRAG,
        quadratic_drag=_QUADRATIC_DRAG,
        volume=sum(volumes),
        centre_of_buoyancy=np.average(centres, axis=0, weights=volumes),
    )


def _trim() -> list[tuple[np.ndarray, float, float]]:
    """Position, mass and volume of ballast and foam."""
    bodies = []
    for bodies_of_material, density in ((_BALLAST, BALLAST_DENSITY), (_FOAM, FOAM_DENSITY)):
        for position, weight in bodies_of_material:
            volume = weight / _GRAVITY / (density - _DENSITY)
            bodies.append((np.array(position), volume * density, volume))
    return bodies


def _acceleration(dynamics: SymbolicDynamics) -> ca.Function:
    """``x, joints (12,), shift -> x_dot``: six rows of the equations of motion, the joints'
    accelerations given.
    """
    x = ca.SX.sym("x", 10)
    joints = ca.SX.sym("joints", 12)
    shift = ca.SX.sym("shift", 3)
    quaternion = x[:4]
    nu = x[4:]
    q = ca.vertcat(ca.SX(3, 1), quaternion, joints[:4])
    v = ca.vertcat(nu, joints[4:8])
    still = ca.SX(3, len(dynamics.links))
    joint_acceleration = ca.vertcat(ca.SX(6, 1), joints[8:])
    force = dynamics.inverse_dynamics(q, v, joint_acceleration, still, still)
    wrench = _shift_wrench(quaternion, shift) - force[:6]
    nu_dot = ca.solve(dynamics.mass_matrix(q)[:6, :6], wrench)
    return ca.Function(
        "motion", [x, joints, shift], [ca.vertcat(_quaternion_rate(quaternion, nu[3:]), nu_dot)]
    )


def _shift_wrench(quaternion: ca.SX, shift: ca.SX) -> ca.SX:
    """Change of the wrench (6,) on the vehicle when its centre of buoyancy moves."""
    return ca.vertcat(ca.SX(3, 1), ca.cross(shift, _DISPLACED * _GRAVITY * _up(quaternion)))


def _up(quaternion: ca.SX) -> ca.SX:
    x, y, z, w = ca.vertsplit(quaternion)
    return ca.vertcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))


def _quaternion_rate(quaternion: ca.SX, omega: ca.SX) -> ca.SX:
    vector = quaternion[:3]
    scalar = quaternion[3]
    return ca.vertcat(scalar * omega + ca.cross(vector, omega), -ca.dot(vector, omega)) / 2


def _step(motion: ca.Function) -> ca.Function:
    """Classical Runge-Kutta step."""
    x = ca.SX.sym("x", 10)
    joints = ca.SX.sym("joints", 12, 3)
    shift = ca.SX.sym("shift", 3)
    h = ca.SX.sym("h")
    start, middle, end = ca.horzsplit(joints)
    k1 = motion(x, start, shift)
    k2 = motion(x + h / 2 * k1, middle, shift)
    k3 = motion(x + h / 2 * k2, middle, shift)
    k4 = motion(x + h * k3, end, shift)
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    after[:4] /= ca.norm_2(after[:4])
    return ca.Function("step", [x, joints, shift, h], [after])


def _righting(dynamics: SymbolicDynamics) -> ca.Function:
    """The potential is ``-S . up``: its value in three attitudes gives S."""
    joints = ca.SX.sym("joints", 4)
    shift = ca.SX.sym("shift", 3)
    up_x = [0, -np.sqrt(0.5), 0, np.sqrt(0.5)]
    up_y = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    up_z = [0, 0, 0, 1]
    S = [-dynamics.potential_energy(ca.vertcat(0, 0, 0, *up, joints)) for up in (up_x, up_y, up_z)]
    return ca.Function(
        "righting", [joints, shift], [ca.vertcat(*S) + _DISPLACED * _GRAVITY * shift]
    )

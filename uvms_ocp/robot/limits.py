"""Joints of a robot in q and v, limits of joints and of positions, and the stowed posture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.codegen.elementwise import Array, is_symbolic
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import FieldTable
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.types import read_only

_UNLIMITED = 1e12  # Pinocchio writes the largest float where a URDF has no limit

_SLIDING = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")

ASSUMED_VELOCITY = 0.8
ASSUMED_ACCELERATION = 2.0
"""[rad/s] and [rad/s2] of the arm in [Gao2022]."""
# [m] from the axis: what is there moves as far as a joint that slides is taken to, where no limit is
# stated at all; told as assumed
_RADIUS = 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class Joint:
    """The name of a joint, and its slices of q and v."""

    name: str
    """The name in the URDF."""
    idx_q: int
    """First entry in q."""
    idx_v: int
    """First entry in v."""
    n_q: int
    """Entries in q."""
    n_v: int
    """Entries in v."""
    slides: bool
    """True for one that moves along its axis, in m; others turn, in rad."""

    @property
    def q(self) -> slice:
        """The joint's part of q."""
        return slice(self.idx_q, self.idx_q + self.n_q)

    @property
    def v(self) -> slice:
        """The joint's part of v."""
        return slice(self.idx_v, self.idx_v + self.n_v)

    @property
    def endless(self) -> bool:
        """True for one that turns without end, which is (cos, sin) in q."""
        return self.n_v == 1 and self.n_q == 2

    def position(self, q: Array) -> Array:
        """Return its one number [rad or m] at q (n_q,), an array or an expression; of an endless
        one from -pi to pi.

        Raises `InvalidInput` for a joint of several degrees of freedom.
        """
        coordinates = self._coordinates(q)
        if len(coordinates) == 1:
            return coordinates[0]
        cosine, sine = coordinates
        if is_symbolic(*coordinates):
            return ca.atan2(sine, cosine)
        return np.arctan2(sine, cosine)

    def way(self, q: Array, to: Array) -> Array:
        """Return the distance [rad or m] from q (n_q,) to the number `to`: of an endless one the
        shorter way round.

        Raises `InvalidInput` for a joint of several degrees of freedom.
        """
        coordinates = self._coordinates(q)
        if len(coordinates) == 1:
            return to - coordinates[0]
        c, s = coordinates
        if is_symbolic(*coordinates, to):
            maths: Any = ca
            arctan2 = ca.atan2
        else:
            maths = np
            arctan2 = np.arctan2
        sine = maths.sin(to) * c - maths.cos(to) * s
        cosine = maths.cos(to) * c + maths.sin(to) * s
        return arctan2(sine, cosine)

    def _coordinates(self, q: Array) -> list[Array]:
        """Return the entries of q that are this joint's: one, or (cos, sin)."""
        if self.n_v != 1:
            raise InvalidInput(
                f"joint {self.name!r} has {self.n_v} degrees of freedom; name joints of one"
            )
        return [q[i] for i in range(self.idx_q, self.idx_q + self.n_q)]


@checked_dataclass(eq=False, repr=False)
class Limits(FieldTable):
    """Actuator and position limits, infinite where there is none; read-only arrays."""

    position_lower: np.ndarray
    """Lower limits of position (n_joints,) [rad or m]."""
    position_upper: np.ndarray
    """Upper limits of position (n_joints,) [rad or m]."""
    velocity: np.ndarray
    """Limits of speed (n_v,) [m/s, rad/s]."""
    acceleration: np.ndarray
    """Limits of acceleration (n_v,) [m/s2, rad/s2]."""
    effort: np.ndarray
    """Limits of torque or force (n_joints,) [N m or N]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PositionLimit:
    """Positions that stay at or above a bound, and that a robot must therefore be able to stop
    before.
    """

    quantity: str
    """Name of the smallest of the positions, as measured."""
    lower: float
    """[m] the bound."""
    values: ca.Function | Callable[[np.ndarray, np.ndarray | None], np.ndarray]
    """Function of q (n_q,) [m, rad]: the positions (m,) [m]. One that is not CasADi's is told which
    of them, None for all.

    Kernels measure those of a `CollisionModel` by themselves where they can; Python is asked for
    any others.
    """
    n: int = 1
    """Number m of the positions."""
    relative: bool = False
    """The measured quantity is the truth at the present q; `values` tell how it changes from
    there.
    """
    reach: np.ndarray
    """(n_v,) upper bound on the rate of any of the positions per unit of each velocity [m, or
    1].
    """


def joints_of(model: pin.Model, *, free_flyer: bool) -> tuple[Joint, ...]:
    """Return the arm joints of a free-flyer, all joints otherwise."""
    first_index = 2 if free_flyer else 1
    joints = list[Joint]()
    for index in range(first_index, model.njoints):
        model_joint = model.joints[index]
        if model_joint.nv == 0:  # it mimics another one
            continue
        joint = Joint(
            name=model.names[index],
            idx_q=model_joint.idx_q,
            idx_v=model_joint.idx_v,
            n_q=model_joint.nq,
            n_v=model_joint.nv,
            slides=model_joint.shortname() in _SLIDING,
        )
        joints.append(joint)
    return tuple(joints)


def limits_of(model: pin.Model, description: RobotDescription, joints: tuple[Joint, ...]) -> Limits:
    """Return the limits of the URDF (joints) and of the description (vehicle, accelerations)."""
    vehicle_velocity, vehicle_acceleration = _vehicle_limits(description)
    n_vehicle = len(vehicle_velocity)
    limits = Limits(
        position_lower=_position_limit(model.lowerPositionLimit, joints, -np.inf),
        position_upper=_position_limit(model.upperPositionLimit, joints, np.inf),
        velocity=read_only(
            [*vehicle_velocity, *_or_unlimited(model.upperVelocityLimit[n_vehicle:])]
        ),
        acceleration=read_only([*vehicle_acceleration, *_joint_accelerations(description, joints)]),
        effort=read_only(_or_unlimited(model.upperEffortLimit[n_vehicle:])),
    )
    if n_vehicle:
        return _with_assumed(model, joints, limits)
    return limits


def _with_assumed(model: pin.Model, joints: Sequence[Joint], limits: Limits) -> Limits:
    """Assume limits of the joints of a vehicle's arm whose files leave them open: without any they
    whirl, and the vehicle with them, as every motion of the arm is then free.
    """
    velocity = limits.velocity.copy()
    acceleration = limits.acceleration.copy()
    unlimited = open_joints(model, joints)
    for joint in joints:
        if joint.name in unlimited:
            unit = _RADIUS if joint.slides else 1.0
            v = joint.v
            is_open = np.isinf(velocity[v])
            velocity[v] = np.where(is_open, unit * ASSUMED_VELOCITY, velocity[v])
            is_open = np.isinf(acceleration[v])
            acceleration[v] = np.where(is_open, unit * ASSUMED_ACCELERATION, acceleration[v])
    return replace(limits, velocity=read_only(velocity), acceleration=read_only(acceleration))


def open_joints(model: pin.Model, joints: Sequence[Joint]) -> tuple[str, ...]:
    """Return names of the joints that move without a limit of velocity or of effort."""
    held = held_joints(model, joints)
    speed = _or_unlimited(model.upperVelocityLimit)
    effort = _or_unlimited(model.upperEffortLimit)
    names = list[str]()
    for joint in joints:
        if joint.name not in held and np.isinf([speed[joint.v], effort[joint.v]]).any():
            names.append(joint.name)
    return tuple(names)


def held_joints(model: pin.Model, joints: Sequence[Joint]) -> tuple[str, ...]:
    """Return names of the joints whose lower limit is the upper one, so that they never move."""
    lower = model.lowerPositionLimit
    upper = model.upperPositionLimit
    names = list[str]()
    for joint in joints:
        if not joint.endless and (lower[joint.q] == upper[joint.q]).all():
            names.append(joint.name)
    return tuple(names)


def _vehicle_limits(description: RobotDescription) -> tuple[tuple[float, ...], tuple[float, ...]]:
    if description.base == "fixed":
        return (), ()
    if description.vehicle_limits is None:
        return (np.inf,) * 6, (np.inf,) * 6
    return description.vehicle_limits.velocity, description.vehicle_limits.acceleration


def _or_unlimited(limit: np.ndarray) -> np.ndarray:
    # URDF has no word for "unlimited": files write 0 or leave the value out.
    return np.where((limit <= 0.0) | (limit > _UNLIMITED), np.inf, limit)


def _joint_accelerations(description: RobotDescription, joints: tuple[Joint, ...]) -> list[float]:
    accelerations = list[float]()
    for joint in joints:
        entry = description.joints.get(joint.name)
        limit = np.inf
        if entry is not None and entry.acceleration is not None:
            limit = entry.acceleration
        accelerations += [limit] * joint.n_v
    return accelerations


def _position_limit(limit: np.ndarray, joints: tuple[Joint, ...], unlimited: float) -> np.ndarray:
    parts = [np.zeros(0)]
    for joint in joints:
        # A joint with more positions than velocities (cos, sin) turns without end.
        turns_without_end = joint.n_q != joint.n_v
        if turns_without_end:
            parts.append(np.full(joint.n_v, unlimited))
        else:
            parts.append(limit[joint.q])
    values = np.concatenate(parts)
    return read_only(np.where(np.abs(values) > _UNLIMITED, unlimited, values))


def home_of(
    model: pin.Model, description: RobotDescription, joints: tuple[Joint, ...], limits: Limits
) -> np.ndarray:
    """Return the stowed posture (n_joints,) [rad or m], one number per degree of freedom."""
    n_vehicle = model.nv - len(limits.position_lower)
    lower = limits.position_lower
    upper = limits.position_upper
    allows_zero = (lower <= 0.0) & (upper >= 0.0)
    middle = 0.5 * (np.where(allows_zero, 0.0, lower) + np.where(allows_zero, 0.0, upper))
    home = np.where(allows_zero, 0.0, middle)
    for joint in joints:
        entry = description.joints.get(joint.name)
        if entry is not None and entry.home is not None:
            first = joint.idx_v - n_vehicle
            home[first : first + joint.n_v] = entry.home
    return read_only(home)


def from_joint_values(
    model: pin.Model, values: np.ndarray, q: np.ndarray | None = None
) -> np.ndarray:
    """Return q (n_q,) [m, rad] with its joints at `values` (n_joints,) [rad or m]; the rest as in
    `q`, default neutral.

    The one place where numbers for people, one per degree of freedom of a joint, become entries of
    q: an endless joint is (cos, sin) in q, so that neither sizes nor differences of q are those of
    the joints.
    """
    first = model.nv - len(values)
    neutral = pin.neutral(model)
    moved = np.asarray(pin.integrate(model, neutral, np.concatenate([np.zeros(first), values])))
    if q is not None and first:
        moved[:7] = q[:7]
    return moved


def bounded_joints(joints: Sequence[Joint], limits: Limits) -> list[tuple[Joint, float, float]]:
    """Return joints of one degree of freedom with a limit, with their lower and upper position
    [rad or m], one may be inf.
    """
    bounded = list[tuple[Joint, float, float]]()
    for joint in joints:
        if joint.n_q != 1 or joint.n_v != 1:
            continue
        k = joint.idx_v - joints[0].idx_v
        lower = float(limits.position_lower[k])
        upper = float(limits.position_upper[k])
        if np.isfinite([lower, upper]).any():
            bounded.append((joint, lower, upper))
    return bounded

"""Joints of a robot in q and v, limits of joints and of positions, and the stowed posture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

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
_SLIDE = 0.1  # [m] from the axis: what is there moves as far as a joint that slides is taken to


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
        """Its one number [rad or m] at q (n_q,), an array or an expression; of an endless one from
        -pi to pi.

        Raises `InvalidInput` for a joint of several degrees of freedom.
        """
        coordinates = self._own(q)
        if len(coordinates) == 1:
            return coordinates[0]
        return (ca.atan2 if is_symbolic(*coordinates) else np.arctan2)(
            coordinates[1], coordinates[0]
        )

    def way(self, q: Array, to: Array) -> Array:
        """Distance [rad or m] from q (n_q,) to the number `to`: of an endless one the shorter
        way round.

        Raises `InvalidInput` for a joint of several degrees of freedom.
        """
        coordinates = self._own(q)
        if len(coordinates) == 1:
            return to - coordinates[0]
        (c, s) = coordinates
        maths = ca if is_symbolic(*coordinates, to) else np
        turn = maths.arctan2 if maths is np else maths.atan2
        return turn(maths.sin(to) * c - maths.cos(to) * s, maths.cos(to) * c + maths.sin(to) * s)

    def _own(self, q: Array) -> list[Array]:
        if self.n_v != 1:
            raise InvalidInput(
                f"joint {self.name!r} has {self.n_v} degrees of freedom; name joints of one"
            )
        return [q[i] for i in range(self.idx_q, self.idx_q + self.n_q)]


@checked_dataclass(eq=False, repr=False)
class Limits(FieldTable):
    """Actuator and position limits, infinite where there is none; read-only arrays."""

    position_lower: np.ndarray
    """(n_joints,) [rad or m]"""
    position_upper: np.ndarray
    """(n_joints,) [rad or m]"""
    velocity: np.ndarray
    """(n_v,) [m/s, rad/s]"""
    acceleration: np.ndarray
    """(n_v,) [m/s2, rad/s2]"""
    effort: np.ndarray
    """(n_joints,) [N m or N]"""


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
    """M"""
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
    indices = range(2 if free_flyer else 1, model.njoints)
    pairs = ((model.names[i], model.joints[i]) for i in indices if model.joints[i].nv)  # of its own
    return tuple(
        Joint(
            name=name,
            idx_q=joint.idx_q,
            idx_v=joint.idx_v,
            n_q=joint.nq,
            n_v=joint.nv,
            slides=joint.shortname() in _SLIDING,
        )
        for name, joint in pairs
    )


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


# Joints of a vehicle's arm whose files leave open how fast or how strong they are: without any
# limit they whirl, and the vehicle with them, as every motion of the arm is then free.


def held_joints(model: pin.Model, joints: Sequence[Joint]) -> tuple[str, ...]:
    """Names of the joints whose lower limit is the upper one, so that they never move."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    return tuple(
        joint.name
        for joint in joints
        if not joint.endless and (lower[joint.q] == upper[joint.q]).all()
    )


def open_joints(model: pin.Model, joints: Sequence[Joint]) -> tuple[str, ...]:
    """Names of the joints that move without a limit of velocity or of effort."""
    held = held_joints(model, joints)
    bounds = (model.upperVelocityLimit, model.upperEffortLimit)
    speed, effort = map(_or_unlimited, bounds)
    moving = (joint for joint in joints if joint.name not in held)
    return tuple(
        joint.name for joint in moving if np.isinf([speed[joint.v], effort[joint.v]]).any()
    )


def _with_assumed(model: pin.Model, joints: Sequence[Joint], limits: Limits) -> Limits:
    velocity = limits.velocity.copy()
    acceleration = limits.acceleration.copy()
    open_ones = open_joints(model, joints)
    for joint in joints:
        if joint.name in open_ones:
            unit = _SLIDE if joint.slides else 1.0
            for values, assumed in (
                (velocity, ASSUMED_VELOCITY),
                (acceleration, ASSUMED_ACCELERATION),
            ):
                values[joint.v] = np.where(
                    np.isinf(values[joint.v]), unit * assumed, values[joint.v]
                )
    return replace(limits, velocity=read_only(velocity), acceleration=read_only(acceleration))


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
    stated = {
        name: entry.acceleration
        for name, entry in description.joints.items()
        if entry.acceleration is not None
    }
    return [stated.get(joint.name, np.inf) for joint in joints for _ in range(joint.n_v)]


def _position_limit(limit: np.ndarray, joints: tuple[Joint, ...], unlimited: float) -> np.ndarray:
    # A joint with more positions than velocities (cos, sin) turns without end.
    parts = [limit[j.q] if j.n_q == j.n_v else np.full(j.n_v, unlimited) for j in joints]
    values = np.concatenate([np.zeros(0), *parts])
    return read_only(np.where(np.abs(values) > _UNLIMITED, unlimited, values))


def home_of(
    model: pin.Model, description: RobotDescription, joints: tuple[Joint, ...], limits: Limits
) -> np.ndarray:
    """Return the stowed posture (n_joints,) [rad or m], one number per degree of freedom."""
    first = model.nv - len(limits.position_lower)
    lower, upper = limits.position_lower, limits.position_upper
    inside = (lower <= 0.0) & (upper >= 0.0)
    values = np.where(
        inside, 0.0, 0.5 * (np.where(inside, 0.0, lower) + np.where(inside, 0.0, upper))
    )
    for joint in joints:
        entry = description.joints.get(joint.name)
        if entry is not None and entry.home is not None:
            values[joint.idx_v - first : joint.idx_v - first + joint.n_v] = entry.home
    return read_only(values)


# The one place where numbers for people, one per degree of freedom of a joint, become entries of q
# and back: an endless joint is (cos, sin) in q, so that neither sizes nor differences of q are
# those of the joints.


def from_joint_values(
    model: pin.Model, values: np.ndarray, q: np.ndarray | None = None
) -> np.ndarray:
    """Return q (n_q,) [m, rad] with its joints at `values` (n_joints,) [rad or m]; the rest as in
    `q`, default neutral.
    """
    first = model.nv - len(values)
    neutral = pin.neutral(model)
    moved = np.asarray(pin.integrate(model, neutral, np.concatenate([np.zeros(first), values])))
    if q is not None and first:
        moved[:7] = q[:7]
    return moved


def bounded_joints(joints: Sequence[Joint], limits: Limits) -> list[tuple[Joint, float, float]]:
    """Joints of one degree of freedom with a limit, with their lower and upper position [rad or m],
    one may be inf.
    """
    first = joints[0].idx_v if joints else 0
    ranges = (
        (
            joint,
            float(limits.position_lower[joint.idx_v - first]),
            float(limits.position_upper[joint.idx_v - first]),
        )
        for joint in joints
        if joint.n_q == joint.n_v == 1
    )
    return [(joint, low, up) for joint, low, up in ranges if np.isfinite([low, up]).any()]

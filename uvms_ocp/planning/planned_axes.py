"""Coordinates of a planned motion: a plain vector x (n_axes,) in place of a configuration on the
manifold.

x is [p_WB (3) [m], roll, pitch, yaw [rad], joints] for a vehicle with an arm and the joints alone
for a fixed base; axes that are not planned keep their reference value. Roll-pitch-yaw is R = Rz Ry
Rx, [Gao2022] eqs (6)-(9): singular at pitch = +-90 deg, which a planned vehicle motion must not
cross.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Annotated

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_constructor, checked_dataclass
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.robot.robot import Robot
from uvms_ocp.types import Array, Indices, Shape

VEHICLE_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


@checked_dataclass(check=checked_constructor, slots=False, eq=False)
class Coordinates:
    """Planned axes of a robot, and the places of the others; see ``coordinates``."""

    robot: Robot
    reference: Array
    """(n_v,) [m, rad] all axes."""
    planned: Indices
    """(n_axes,) indices of the planned axes among all axes."""

    @property
    def n_axes(self) -> int:
        return self.planned.size

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the planned axes."""
        names = _axis_names(self.robot)
        return tuple(names[i] for i in self.planned)

    def all_axes(self, x: Annotated[Array, Shape(..., "self.n_axes")]) -> Array:
        """(..., n_v) [m, rad] values of all axes from x (..., n_axes) [m, rad]."""
        full = np.broadcast_to(self.reference, (*x.shape[:-1], self.reference.size)).copy()
        full[..., self.planned] = x
        return full

    def configurations(self, x: Annotated[Array, Shape("n", "self.n_axes")]) -> Array:
        """(n, n_q) [m, rad] configurations from x (n, n_axes) [m, rad]."""
        full = self.all_axes(x)
        n = self.robot.n_vehicle
        if n:
            vehicle = np.concatenate([full[:, :3], _quaternions(full[:, 3:6])], axis=1)
        else:
            vehicle = full[:, :0]
        return np.concatenate([vehicle, *_joint_columns(self.robot, full[:, n:].T)], axis=1)

    def x(self, q: ArrayLike) -> Array:
        """(n_axes,) [m, rad] coordinates of a configuration q (n_q,) [m, rad]. Raises
        `InvalidInput` for an invalid one.
        """
        return self.x_beyond_limits(self.robot.check_configuration(q))

    def x_beyond_limits(self, q: Annotated[Array, Shape("self.robot.n_q")]) -> Array:
        """(n_axes,) [m, rad] coordinates of q (n_q,) [m, rad], which may be beyond the limits, as
        motions are that nobody should follow and everybody wants to see.
        """
        return _axis_values(self.robot, q)[self.planned]

    def velocity_map(self, x: Annotated[Array, Shape("n", "self.n_axes")]) -> Array:
        """(n, n_v, n_axes): generalized velocity v = map @ rate of x, at x (n, n_axes) [m, rad]."""
        return self._map(x, self.robot.n_v)[:, :, self.planned]

    def column_map(self, x: Annotated[Array, Shape("n", "self.n_axes")]) -> Array:
        """(n, n_jacobian, n_columns): of all columns of Pinocchio's Jacobian by `columns`, at x (n,
        n_axes) [m, rad].
        """
        return self._map(x, self.robot.model.nvExtended)[:, :, self.columns]

    def _map(self, x: Array, size: int) -> Array:
        full = self.all_axes(x)
        maps = np.broadcast_to(np.eye(size), (full.shape[0], size, size)).copy()
        if self.robot.n_vehicle:
            maps[:, :3, :3], maps[:, 3:6, 3:6] = _body_rate_maps(full[:, 3:6])
        return maps

    def rate_limits(
        self, x: Annotated[Array, Shape("n", "self.n_axes")], *, shared: bool = False
    ) -> Array:
        """(2, n_axes) [m/s, rad/s; per s] largest rates and accelerations by the robot's limits, at
        every x (n, n_axes) [m, rad].

        The limits are along the vehicle's own axes: one that several planned axes share, or that
        turns from one to another, has no number for any of them, and is infinite; ``shared``: what
        it leaves each where the others rest.
        """
        along = np.abs(self.velocity_map(x)).max(axis=0)
        moves = along > 1e-9
        alone = ~(moves & (moves.sum(axis=1) > 1)[:, None]).any(axis=0)
        largest = np.stack([self.robot.limits.velocity, self.robot.limits.acceleration])[:, :, None]
        return np.where(moves & (alone | shared), largest / np.maximum(along, 1e-9), np.inf).min(
            axis=1
        )

    @cached_property
    def columns(self) -> Indices:
        """(n_columns,) columns of Pinocchio's Jacobian, axis by axis: one each, and one for each
        joint that mimics it.
        """
        return np.concatenate(
            [
                np.zeros(0, dtype=np.intp),
                *(np.flatnonzero(self._axes == axis) for axis in self.planned),
            ]
        )

    @cached_property
    def fold(self) -> Array:
        """(n_columns, n_axes) 1 where the column of Pinocchio's Jacobian belongs to the axis, else
        0.
        """
        return np.asarray(self._axes[self.columns, None] == self.planned, dtype=float)

    @property
    def _axes(self) -> Indices:
        """The axis among all of every column of Pinocchio's Jacobian."""
        joints = list(self.robot.model.joints)[1:]
        return np.array(
            [joint.idx_v + i for joint in joints for i in range(joint.nvExtended)], dtype=np.intp
        )

    def follows(self) -> Array:
        """(n_columns, n_columns) 1 where the column's motion is carried by the row's; the vehicle
        turns yaw, pitch, roll.
        """
        model = self.robot.model
        result = np.zeros((model.nvExtended, model.nvExtended))
        for joint in range(1, model.njoints):
            for carrier in list(model.supports[joint])[1:-1]:
                result[model.joints[carrier].idx_vExtended, model.joints[joint].idx_vExtended] = 1.0
        if self.robot.n_vehicle:
            result[:6, 6:] = result[:3, 3:6] = 1.0
            for before, after in ((5, 4), (5, 3), (4, 3)):
                result[before, after] = 1.0
        return result[np.ix_(self.columns, self.columns)]

    @property
    def endless(self) -> Indices:
        """Indices among the planned axes of those that turn without end: roll, yaw and endless
        joints.
        """
        turning = {
            "roll",
            "yaw",
            *(joint_axis(self.robot, name) for name in self.robot.endless_joints),
        }
        return np.array([k for k, name in enumerate(self.names) if name in turning], dtype=np.intp)

    def shortest_turn(
        self,
        x: Annotated[Array, Shape(..., "self.n_axes")],
        near: Annotated[Array, Shape(..., "self.n_axes")],
    ) -> Array:
        """(..., n_axes) [m, rad] the same configurations as x (..., n_axes) [m, rad], at most half
        a turn from near.
        """
        turn = 2.0 * np.pi
        nearest = x.copy()
        ends = self.endless
        nearest[..., ends] -= turn * np.round((x - near)[..., ends] / turn)
        return nearest

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper positions (n_axes,) [m, rad]; vehicle axes have none but pitch, which
        stays within 89 deg.
        """
        free = np.full(self.robot.n_vehicle, np.inf)
        if free.size:
            free[4] = np.deg2rad(89.0)
        lower = np.concatenate([-free, self.robot.limits.position_lower])
        upper = np.concatenate([free, self.robot.limits.position_upper])
        return lower[self.planned], upper[self.planned]


@checked
def coordinates(
    robot: Robot, *, reference: ArrayLike | None = None, axes: Sequence[str] | None = None
) -> Coordinates:
    """Choose the planned axes, by their names among x, y, z, roll, pitch, yaw and the joints;
    default all.

    reference (n_q,) [m, rad]: configuration that axes not planned keep; default: origin,
    ``robot.home``. Raises `NameNotFound` for an axis that the robot does not have, and
    `InvalidInput` for a joint of several axes or a reference that is no valid configuration.
    """
    for joint in (joint for joint in robot.joints if joint.n_v != 1):
        raise InvalidInput(
            f"joint {joint.name!r} has {joint.n_v} axes; planning needs joints of one; --lock"
            " fixes it"
        )
    names = _axis_names(robot)
    if axes is None:
        planned_names = names
    else:
        planned_names = tuple(axes)
    for name in planned_names:
        require_known("axis", name, names)
    if reference is None:
        q = robot.configuration()
    else:
        q = robot.check_configuration(reference)
    planned = np.array([names.index(name) for name in planned_names], dtype=np.intp)
    return Coordinates(robot=robot, reference=_axis_values(robot, q), planned=planned)


def _axis_names(robot: Robot) -> tuple[str, ...]:
    return (
        *(VEHICLE_AXES if robot.n_vehicle else ()),
        *(joint_axis(robot, name) for name in robot.joint_names),
    )


def joint_axis(robot: Robot, joint: str) -> str:
    """Name of the axis of a joint: its own, or another one where an axis of the vehicle is called
    so.
    """
    if robot.n_vehicle and joint in VEHICLE_AXES:
        return f"joint {joint}"
    return joint


def _axis_values(robot: Robot, q: Array) -> Array:
    joints = robot.joint_values(q)
    if not robot.n_vehicle:
        return joints
    return np.concatenate(
        [q[:3], pin.rpy.matrixToRpy(pin.Quaternion(np.array(q[3:7])).toRotationMatrix()), joints]
    )


def _joint_columns(robot: Robot, values: Array) -> Iterator[Array]:
    """The columns (n, 1) of q that each joint has at its values (n_joints, n): of an endless one
    cosine and sine.
    """
    for joint, value in zip(robot.joints, values, strict=True):
        if joint.endless:
            yield np.cos(value)[:, None]
            yield np.sin(value)[:, None]
        else:
            yield value[:, None]


def _quaternions(rpy: Array) -> Array:
    """(n, 4) xyzw of Rz Ry Rx."""
    (cr, cp, cy) = np.cos(rpy / 2.0).T
    (sr, sp, sy) = np.sin(rpy / 2.0).T
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    return np.stack([x, y, z, cr * cp * cy + sr * sp * sy], axis=1)


def _body_rate_maps(rpy: Array) -> tuple[Array, Array]:
    """R_BW (n, 3, 3), and (n, 3, 3) from Euler rates to the angular velocity in B, [Gao2022] eq.
    (9).
    """
    (cr, cp, cy) = np.cos(rpy).T
    (sr, sp, sy) = np.sin(rpy).T
    zero = np.zeros_like(cr)
    one = np.ones_like(cr)
    R_WB = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    rates = np.array([[one, zero, -sp], [zero, cr, cp * sr], [zero, -sr, cp * cr]])
    return R_WB.transpose(2, 1, 0), rates.transpose(2, 0, 1)

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
"""Axes of a vehicle: position in W, and roll-pitch-yaw."""
_LARGEST_PITCH = np.deg2rad(89.0)  # [rad]
_MOVES = 1e-9  # part of an axis in a velocity, below which it has none of it


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
        """Return values (..., n_v) [m, rad] of all axes from x (..., n_axes) [m, rad]."""
        full = np.broadcast_to(self.reference, (*x.shape[:-1], self.reference.size)).copy()
        full[..., self.planned] = x
        return full

    def configurations(self, x: Annotated[Array, Shape("n", "self.n_axes")]) -> Array:
        """Return configurations (n, n_q) [m, rad] from x (n, n_axes) [m, rad]."""
        full = self.all_axes(x)
        n = self.robot.n_vehicle
        if n:
            vehicle = np.concatenate([full[:, :3], _quaternions(full[:, 3:6])], axis=1)
        else:
            vehicle = full[:, :0]
        joints = _joint_columns(self.robot, full[:, n:].T)
        return np.concatenate([vehicle, *joints], axis=1)

    def x(self, q: ArrayLike) -> Array:
        """Return coordinates (n_axes,) [m, rad] of a configuration q (n_q,) [m, rad]. Raises
        `InvalidInput` for an invalid one.
        """
        return self.x_beyond_limits(self.robot.check_configuration(q))

    def x_beyond_limits(self, q: Annotated[Array, Shape("self.robot.n_q")]) -> Array:
        """Return coordinates (n_axes,) [m, rad] of q (n_q,) [m, rad], which may be beyond the
        limits, as motions are that nobody should follow and everybody wants to see.
        """
        return _axis_values(self.robot, q)[self.planned]

    def velocity_map(self, x: Annotated[Array, Shape("n", "self.n_axes")]) -> Array:
        """Return maps (n, n_v, n_axes) from the rate of x to the generalized velocity v, at x (n,
        n_axes) [m, rad].
        """
        return self._map(x, self.robot.n_v)[:, :, self.planned]

    def column_map(self, x: Annotated[Array, Shape("n", "self.n_axes")]) -> Array:
        """Return maps (n, n_jacobian, n_columns) from rates of the axes of `columns` to all columns
        of Pinocchio's Jacobian, at x (n, n_axes) [m, rad].
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
        """Return the largest rates and accelerations (2, n_axes) [m/s, rad/s; per s] by the robot's
        limits, at every x (n, n_axes) [m, rad].

        The limits are along the vehicle's own axes: one that several planned axes share, or that
        turns from one to another, has no number for any of them, and is infinite; ``shared``: what
        it leaves each where the others rest.
        """
        part = np.abs(self.velocity_map(x)).max(axis=0)  # of each axis in each velocity
        moves = part > _MOVES
        is_shared = moves.sum(axis=1) > 1
        stands_alone = ~(moves & is_shared[:, None]).any(axis=0)
        limits = np.stack([self.robot.limits.velocity, self.robot.limits.acceleration])
        largest = limits[:, :, None] / np.maximum(part, _MOVES)
        return np.where(moves & (stands_alone | shared), largest, np.inf).min(axis=1)

    @cached_property
    def columns(self) -> Indices:
        """(n_columns,) columns of Pinocchio's Jacobian, axis by axis: one each, and one for each
        joint that mimics it.
        """
        axes = self._axes
        by_axis = [np.flatnonzero(axes == axis) for axis in self.planned]
        return np.concatenate([np.zeros(0, dtype=np.intp), *by_axis])

    @cached_property
    def fold(self) -> Array:
        """(n_columns, n_axes) 1 where the column of Pinocchio's Jacobian belongs to the axis, else
        0.
        """
        return np.asarray(self._axes[self.columns, None] == self.planned, dtype=float)

    @property
    def _axes(self) -> Indices:
        """The axis among all of every column of Pinocchio's Jacobian."""
        axes = list[int]()
        for joint in list(self.robot.model.joints)[1:]:
            axes += range(joint.idx_v, joint.idx_v + joint.nvExtended)
        return np.array(axes, dtype=np.intp)

    def follows(self) -> Array:
        """Return (n_columns, n_columns) 1 where the column's motion is carried by the row's, else 0;
        the vehicle turns yaw, pitch, roll.
        """
        model = self.robot.model
        result = np.zeros((model.nvExtended, model.nvExtended))
        first_columns = [joint.idx_vExtended for joint in model.joints]
        for joint in range(1, model.njoints):
            for carrier in list(model.supports[joint])[1:-1]:
                result[first_columns[carrier], first_columns[joint]] = 1.0
        if self.robot.n_vehicle:
            result[:6, 6:] = 1.0
            result[:3, 3:6] = 1.0
            for before, after in ((5, 4), (5, 3), (4, 3)):
                result[before, after] = 1.0
        return result[np.ix_(self.columns, self.columns)]

    @property
    def endless(self) -> Indices:
        """Indices among the planned axes of those that turn without end: roll, yaw and endless
        joints.
        """
        endless = {"roll", "yaw"}
        endless.update(joint_axis(self.robot, name) for name in self.robot.endless_joints)
        places = [k for k, name in enumerate(self.names) if name in endless]
        return np.array(places, dtype=np.intp)

    def shortest_turn(
        self,
        x: Annotated[Array, Shape(..., "self.n_axes")],
        near: Annotated[Array, Shape(..., "self.n_axes")],
    ) -> Array:
        """Return the configurations x (..., n_axes) [m, rad] by other numbers, at most half a turn
        from near (..., n_axes) [m, rad].
        """
        turn = 2.0 * np.pi
        nearest = x.copy()
        endless = self.endless
        nearest[..., endless] -= turn * np.round((x - near)[..., endless] / turn)
        return nearest

    def limits(self) -> tuple[Array, Array]:
        """Return lower and upper positions (n_axes,) [m, rad]; vehicle axes have none but pitch,
        which stays within 89 deg.
        """
        of_vehicle = np.full(self.robot.n_vehicle, np.inf)
        if of_vehicle.size:
            of_vehicle[VEHICLE_AXES.index("pitch")] = _LARGEST_PITCH
        lower = np.concatenate([-of_vehicle, self.robot.limits.position_lower])
        upper = np.concatenate([of_vehicle, self.robot.limits.position_upper])
        return lower[self.planned], upper[self.planned]


@checked
def coordinates(
    robot: Robot, *, reference: ArrayLike | None = None, axes: Sequence[str] | None = None
) -> Coordinates:
    """Choose the planned axes, by their names among x, y, z, roll, pitch, yaw and the joints;
    default all.

    reference (n_q,) [m, rad]: configuration that axes not planned keep; default: origin,
    ``robot.home``. Raises `NameNotFound` for an axis that the robot does not have, and
    `InvalidInput` for an axis of a vehicle on a fixed base, a joint of several axes or a reference
    that is no valid configuration.
    """
    for joint in robot.joints:
        if joint.n_v != 1:
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
        if name in VEHICLE_AXES and name not in names:
            raise InvalidInput(
                f"robot {robot.name!r} has a fixed base, and no vehicle with an axis {name!r}; give"
                f" axes of joints only: {', '.join(names)}"
            )
        require_known("axis", name, names)
    if reference is None:
        q = robot.configuration()
    else:
        q = robot.check_configuration(reference)
    planned = np.array([names.index(name) for name in planned_names], dtype=np.intp)
    return Coordinates(robot=robot, reference=_axis_values(robot, q), planned=planned)


def _axis_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of all axes of a robot."""
    vehicle = VEHICLE_AXES if robot.n_vehicle else ()
    joints = [joint_axis(robot, name) for name in robot.joint_names]
    return (*vehicle, *joints)


def joint_axis(robot: Robot, joint: str) -> str:
    """Return the name of the axis of a joint: its own, or another one where an axis of the vehicle
    is called so.
    """
    if robot.n_vehicle and joint in VEHICLE_AXES:
        return f"joint {joint}"
    return joint


def _axis_values(robot: Robot, q: Array) -> Array:
    """Return values (n_v,) [m, rad] of all axes at q (n_q,) [m, rad]."""
    joints = robot.joint_values(q)
    if not robot.n_vehicle:
        return joints
    R_WB = pin.Quaternion(np.array(q[3:7])).toRotationMatrix()
    return np.concatenate([q[:3], pin.rpy.matrixToRpy(R_WB), joints])


def _joint_columns(robot: Robot, values: Array) -> Iterator[Array]:
    """Yield the columns (n, 1) of q that each joint has at its values (n_joints, n): of an endless
    one cosine and sine.
    """
    for joint, value in zip(robot.joints, values, strict=True):
        if joint.endless:
            yield np.cos(value)[:, None]
            yield np.sin(value)[:, None]
        else:
            yield value[:, None]


def _quaternions(rpy: Array) -> Array:
    """Return quaternions (n, 4) xyzw of Rz Ry Rx."""
    cr, cp, cy = np.cos(rpy / 2.0).T
    sr, sp, sy = np.sin(rpy / 2.0).T
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    w = cr * cp * cy + sr * sp * sy
    return np.stack([x, y, z, w], axis=1)


def _body_rate_maps(rpy: Array) -> tuple[Array, Array]:
    """Return R_BW (n, 3, 3), and maps (n, 3, 3) from Euler rates to the angular velocity in B,
    [Gao2022] eq. (9).
    """
    cr, cp, cy = np.cos(rpy).T
    sr, sp, sy = np.sin(rpy).T
    zeros = np.zeros_like(cr)
    ones = np.ones_like(cr)
    R_WB = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    rates = np.array([[ones, zeros, -sp], [zeros, cr, cp * sr], [zeros, -sr, cp * cr]])
    return R_WB.transpose(2, 1, 0), rates.transpose(2, 0, 1)

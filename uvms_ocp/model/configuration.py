"""Building and checking the configuration q of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.limits import Joint, from_joint_values, read_only

if TYPE_CHECKING:
    from uvms_ocp.model.robot import Robot

_LIMIT_TOLERANCE = 1e-9
_UNIT_TOLERANCE = 1e-6


def vehicle_part(
    robot: Robot, position: ArrayLike | None, rpy: ArrayLike | None, quaternion: ArrayLike | None
) -> np.ndarray:
    """Return [p_WB, quaternion] (7,), or (0,) for a fixed base."""
    if not robot.n_vehicle:
        if position is not None or rpy is not None or quaternion is not None:
            raise InvalidInput(f"robot {robot.name!r} has a fixed base; give joints only")
        return np.zeros(0)
    p = np.zeros(3) if position is None else finite("position", position, 3)
    return np.concatenate([p, _orientation(rpy, quaternion)])


def _orientation(rpy: ArrayLike | None, quaternion: ArrayLike | None) -> np.ndarray:
    if rpy is not None and quaternion is not None:
        raise InvalidInput("give either rpy or quaternion, not both")
    if quaternion is not None:
        return finite("quaternion", quaternion, 4)
    angles = np.zeros(3) if rpy is None else finite("rpy", rpy, 3)
    return pin.Quaternion(pin.rpy.rpyToMatrix(angles)).coeffs()


def joint_part(robot: Robot, joints: ArrayLike | Mapping[str, float] | None) -> np.ndarray:
    """Return the joint part of q from values per degree of freedom, or by name on top of ``home``."""
    if joints is None:
        return robot.home
    values = np.zeros(robot.n_v)
    if isinstance(joints, Mapping):
        values[robot.joint_v] = _by_name(robot, joints)
    else:
        values[robot.joint_v] = finite("joints", joints, robot.n_joints)
    return from_joint_values(robot.model, values)[robot.joint_q]


def _by_name(robot: Robot, joints: Mapping[str, float]) -> np.ndarray:
    neutral = pin.neutral(robot.model)
    q = neutral.copy()
    q[robot.joint_q] = robot.home
    values = pin.difference(robot.model, neutral, q)
    for name, value in joints.items():
        values[robot.joint(name).v] = value
    return values[robot.joint_v]


def checked(robot: Robot, q: ArrayLike) -> np.ndarray:
    """Return q (n_q,) read-only. Raises ``InvalidInput`` naming what is wrong with it."""
    array = finite("q", q, robot.n_q)
    if robot.n_vehicle:
        _check_unit("quaternion", array[3:7])
    for joint in robot.joints:
        _check_joint(robot, joint, array[joint.q])
    return read_only(array)


def _check_joint(robot: Robot, joint: Joint, values: np.ndarray) -> None:
    if joint.n_q != joint.n_v:
        _check_unit(f"(cos, sin) of joint {joint.name!r}", values[-2:])
        return
    first = joint.idx_v - robot.n_vehicle
    for i, value in enumerate(values, start=first):
        low, high = robot.limits.position_lower[i], robot.limits.position_upper[i]
        if not low - _LIMIT_TOLERANCE <= value <= high + _LIMIT_TOLERANCE:
            raise InvalidInput(f"joint {joint.name!r}: given {value:.6g}; allowed: {low:.6g} to {high:.6g}")


def _check_unit(what: str, values: np.ndarray) -> None:
    norm = float(np.linalg.norm(values))
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        raise InvalidInput(f"{what} has norm {norm:.6g}; allowed: 1, divide it by its norm")


def finite(what: str, values: ArrayLike, size: int) -> np.ndarray:
    """Return ``values`` as a finite array (size,). Raises ``InvalidInput``."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InvalidInput(f"{what}: given {values!r}; allowed: {size} numbers") from None
    if array.shape != (size,):
        raise InvalidInput(f"{what} has shape {array.shape}; allowed: ({size},)")
    if not np.isfinite(array).all():
        where = np.flatnonzero(~np.isfinite(array)).tolist()
        raise InvalidInput(f"{what} has NaN or infinite entries at {where}; allowed: finite numbers")
    return array

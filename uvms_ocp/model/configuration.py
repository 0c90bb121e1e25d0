"""Building and checking the configuration q of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.arguments.frozen import read_only
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.limits import Joint, Limits, from_joint_values

_LIMIT_TOLERANCE = 1e-9
_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ConfigurationSpace:
    """What the configurations of one robot are made of."""

    name: str
    """Of the robot, for messages."""
    model: pin.Model
    joints: tuple[Joint, ...]
    limits: Limits
    home: np.ndarray
    """(n_q - 7,) or (n_q,) [rad or m] stowed posture, the joint part of q."""

    @property
    def _n_vehicle(self) -> int:
        return int(self.model.nv) - len(self.limits.position_lower)

    @property
    def _joint_q(self) -> slice:
        return slice(self.model.nq - len(self.home), self.model.nq)

    def vehicle_part(
        self, position: ArrayLike | None, rpy: ArrayLike | None, quaternion: ArrayLike | None
    ) -> np.ndarray:
        """[p_WB, quaternion] (7,), or (0,) for a fixed base.

        position (3,) [m]; rpy (3,) [rad] or quaternion (4,) [-] xyzw. Raises `InvalidInput` for both of them, a wrong shape,
        or any of the three with a fixed base.
        """
        if not self._n_vehicle:
            if position is not None or rpy is not None or quaternion is not None:
                raise InvalidInput(f"robot {self.name!r} has a fixed base; give joints only")
            return np.zeros(0)
        p = np.zeros(3) if position is None else finite("position", position, 3)
        return np.concatenate([p, _orientation(rpy, quaternion)])

    def joint_part(self, joints: ArrayLike | Mapping[str, float] | None) -> np.ndarray:
        """The joint part of q from `joints`: one value per degree of freedom (n_joints,) [rad or m], or by name on ``home``.

        Raises `InvalidInput` for a wrong shape and `NameNotFound` for an unknown joint.
        """
        if joints is None:
            return self.home
        first, values = self._n_vehicle, np.zeros(self.model.nv)
        if isinstance(joints, Mapping):
            values[first:] = self._by_name(joints)
        else:
            values[first:] = finite("joints", joints, self.model.nv - first)
        return from_joint_values(self.model, values)[self._joint_q]

    def checked(self, q: ArrayLike) -> np.ndarray:
        """q (n_q,) [m, rad] read-only. Raises `InvalidInput` naming what is wrong with it."""
        array = finite("q", q, self.model.nq)
        if self._n_vehicle:
            _check_unit("quaternion", array[3:7])
        for joint in self.joints:
            self._check_joint(joint, array[joint.q])
        return read_only(array)

    def _by_name(self, joints: Mapping[str, float]) -> np.ndarray:
        neutral = pin.neutral(self.model)
        q = neutral.copy()
        q[self._joint_q] = self.home
        values = pin.difference(self.model, neutral, q)
        own = {joint.name: joint for joint in self.joints}
        for name, value in joints.items():
            if name not in own:
                raise NameNotFound("joint", name, own)
            values[own[name].v] = value
        return np.asarray(values[self._n_vehicle :])

    def _check_joint(self, joint: Joint, values: np.ndarray) -> None:
        if joint.n_q != joint.n_v:
            _check_unit(f"(cos, sin) of joint {joint.name!r}", values[-2:])
            return
        for i, value in enumerate(values, start=joint.idx_v - self._n_vehicle):
            low, high = self.limits.position_lower[i], self.limits.position_upper[i]
            if not low - _LIMIT_TOLERANCE <= value <= high + _LIMIT_TOLERANCE:
                raise InvalidInput(f"joint {joint.name!r}: given {value:.6g}; allowed: {low:.6g} to {high:.6g}")


def _orientation(rpy: ArrayLike | None, quaternion: ArrayLike | None) -> np.ndarray:
    if rpy is not None and quaternion is not None:
        raise InvalidInput("give either rpy or quaternion, not both")
    if quaternion is not None:
        return finite("quaternion", quaternion, 4)
    angles = np.zeros(3) if rpy is None else finite("rpy", rpy, 3)
    return np.asarray(pin.Quaternion(pin.rpy.rpyToMatrix(angles)).coeffs())


def _check_unit(what: str, values: np.ndarray) -> None:
    norm = float(np.linalg.norm(values))
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        raise InvalidInput(f"{what} has norm {norm:.6g}; allowed: 1, divide it by its norm")


def finite(what: str, values: ArrayLike, size: int) -> np.ndarray:
    """``values`` (size,) [any] as numbers; `what` names them. Raises `InvalidInput` for another shape, NaN or infinity."""
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

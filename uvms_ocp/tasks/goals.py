"""Goals of tasks: a constant or a reference, any callable ``t -> (value, rate)``.

Trajectories are references. One that tells its `end` is sampled once, so that no Python runs at a
tick.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.meta_values import LARGEST

VectorReference: TypeAlias = Callable[[float], tuple[np.ndarray, np.ndarray]]
PoseReference: TypeAlias = Callable[[float], tuple[pin.SE3, np.ndarray]]
VectorGoal: TypeAlias = np.ndarray | VectorReference
PoseGoal: TypeAlias = pin.SE3 | PoseReference


@runtime_checkable
class EndingReference(Protocol):
    """A reference that rests in the end: controllers hold it as samples, which run as C."""

    @property
    def end(self) -> float:
        """Time [s] after which it rests."""

    def __call__(self, t: float) -> tuple[Any, np.ndarray]:
        """Return value and rate at t [s]."""


def evaluate_vector(name: str, goal: VectorGoal, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return value (n,) and rate (n,) [its unit / s] of a vector goal at time t [s]; raises
    `InvalidInput` where not finite.
    """
    if callable(goal):
        value, rate = goal(t)
    else:
        value = np.asarray(goal, dtype=float)
        rate = np.zeros(np.shape(goal))
    if not _finite(value, rate):
        raise InvalidInput(
            f"{name}: goal {value} with rate {rate} at t = {t} s; give finite numbers"
        )
    return np.asarray(value, dtype=float), np.asarray(rate, dtype=float)


def evaluate_pose(name: str, goal: PoseGoal, t: float) -> tuple[pin.SE3, np.ndarray]:
    """Return the pose [m] in W of a goal and its rate (6,) [m/s, rad/s] in W, linear first, at time
    t [s].

    Raises `InvalidInput` for a goal that is not finite or no pose.
    """
    if callable(goal):
        pose, rate = goal(t)
    else:
        pose = goal
        rate = np.zeros(6)
    if not isinstance(pose, pin.SE3):
        raise InvalidInput(
            f"{name}: goal of type {type(pose).__name__}; give a pinocchio.SE3 or a function of"
            " time"
        )
    if not _finite(pose.translation, pose.rotation, rate):
        raise InvalidInput(
            f"{name}: goal at t = {t} s is not finite; give finite numbers, at most {LARGEST:g}"
        )
    return pose, np.asarray(rate, dtype=float)


def _finite(*values: np.ndarray) -> bool:
    # One number that is not finite spoils the sum, which is four times faster than to look at each.
    return all(abs(np.add.reduce(value, axis=None)) <= LARGEST for value in values)

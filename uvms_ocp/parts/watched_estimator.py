"""Somebody else's estimator, whose measurements are looked at before anyone relies on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.control.navigation.estimator import Estimator
from uvms_ocp.control.navigation.filter.memory import NUMBER
from uvms_ocp.control.navigation.health.guarded_estimator import Gating
from uvms_ocp.control.navigation.pass_through import PassThrough
from uvms_ocp.control.watched import require_numbers
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.meta_values import NEARLY_ONE
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, Measurement, Readings
from uvms_ocp.sim.loop import StateEstimator

_OURS = (PassThrough, Estimator)


def watched_estimator(made: Any, robot: Robot, name: str) -> StateEstimator:
    """It, watched unless it is the toolkit's own; one that tells of gates of its own still does."""
    if type(made) in _OURS:
        return made
    return (WatchedGates if isinstance(made, Gating) else WatchedEstimator)(made, robot, name)


class WatchedEstimator:
    """A callable ``(Readings, t, command) -> Measurement`` that asks another one."""

    def __init__(self, estimator: Any, robot: Robot, name: str) -> None:
        """name: what messages call it."""
        self._theirs, self._robot, self._whose = estimator, robot, f"the measurement of estimator {name}"
        self._name = name

    def __call__(self, readings: Readings, t: float, command: Command | None = None) -> Measurement:
        """Their measurement at time t [s]. Raises `InvalidInput` for one that no controller can take."""
        told = self._theirs(readings, t, command)
        if not isinstance(told, Measurement):
            raise InvalidInput(f"estimator {self._name} returned {type(told).__name__}; return a Measurement")
        robot = self._robot
        require_numbers(self._whose, "q", told.q, (robot.n_q,))
        require_numbers(self._whose, "v", told.v, (robot.n_v,))
        if told.spread is not None:
            require_numbers(self._whose, "spread", told.spread, (robot.n_v,))
        require_normalized(self._whose, robot, told.q)
        return told


class WatchedGates(WatchedEstimator):
    """One that tells which readings it refuses."""

    def __init__(self, estimator: Any, robot: Robot, name: str) -> None:
        """As of `WatchedEstimator`. Raises `InvalidInput` for outcomes that the monitor cannot share."""
        super().__init__(estimator, robot, name)
        self.outcomes: Array = estimator.outcomes
        """(9, 4) [s, -, -, -] theirs, see `Gating.outcomes`."""
        shape = (len(NUMBER), 4)
        found = np.shape(self.outcomes)
        if found != shape or self.outcomes.dtype != float or not self.outcomes.flags.c_contiguous:
            raise InvalidInput(f"outcomes of estimator {name} of shape {found}; give {shape}, floats row by row")

    def doubt_velocity(self, *, rests: bool = False) -> None:
        """Pass it on."""
        self._theirs.doubt_velocity(rests=rests)


def require_normalized(whose: str, robot: Robot, q: np.ndarray) -> None:
    """Raise `InvalidInput` for q (n_q,) [m, rad] whose quaternion, or pair of cos and sin, is not of norm 1."""
    if not pin.isNormalized(robot.model, q, NEARLY_ONE):
        raise InvalidInput(f"{whose} has q with an attitude or a turning joint not of norm 1; normalize it")

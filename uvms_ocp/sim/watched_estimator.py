"""Check the estimates of a user's estimator before anyone relies on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.control.external import require_numbers
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.filter_memory import N_CHANNELS
from uvms_ocp.estimation.health import guarded_estimator
from uvms_ocp.record.meta_values import UNIT_NORM_TOLERANCE
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    Command,
    Readings,
    StateEstimate,
)
from uvms_ocp.sim.loop import StateEstimator
from uvms_ocp.types import Array

_OURS = (PassThrough, Estimator)


def watched_estimator(
    estimator: Any, robot: Robot, name: str, n_channels: int = N_CHANNELS
) -> StateEstimator:
    """Return an estimator with its estimates checked, unless it is the toolkit's own; one that has
    gates of its own still reports them. n_channels: the toolkit's and a user's own.
    """
    if type(estimator) in _OURS:
        return estimator
    if isinstance(estimator, guarded_estimator.GatedEstimator):
        return WatchedGates(estimator, robot, name, n_channels)
    return WatchedEstimator(estimator, robot, name)


class WatchedEstimator:
    """A user's estimator whose estimates are checked: a callable ``(Readings, t, command) ->
    StateEstimate``.
    """

    def __init__(self, estimator: Any, robot: Robot, name: str) -> None:
        """name: what messages call it."""
        self._wrapped = estimator
        self._robot = robot
        self._whose = f"the measurement of estimator {name}"
        self._name = name

    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        """Return the estimate at time t [s]. Raises `InvalidInput` for one that no controller can
        take.
        """
        estimate = self._wrapped(readings, t, command)
        if not isinstance(estimate, StateEstimate):
            raise InvalidInput(
                f"estimator {self._name} returned {type(estimate).__name__}; return a StateEstimate"
            )
        require_state(self._whose, self._robot, q=estimate.q, v=estimate.v, std=estimate.std)
        return estimate


class WatchedGates(WatchedEstimator):
    """Watched estimator that reports which readings it refuses."""

    def __init__(
        self, estimator: Any, robot: Robot, name: str, n_channels: int = N_CHANNELS
    ) -> None:
        """name: what messages call it. Raises `InvalidInput` for outcomes that the monitor cannot
        share.
        """
        super().__init__(estimator, robot, name)
        self.outcomes: Array = estimator.outcomes
        """(n_channels, 4) [s, -, -, -] theirs, see `GatedEstimator.outcomes`."""
        shape = (n_channels, 4)
        actual_shape = np.shape(self.outcomes)
        if (
            actual_shape != shape
            or self.outcomes.dtype != float
            or not self.outcomes.flags.c_contiguous
        ):
            raise InvalidInput(
                f"outcomes of estimator {name} of shape {actual_shape}; give {shape}, floats row by row"
            )

    def inflate_velocity_variance(self, *, rests: bool = False) -> None:
        """Ask the user's estimator to take its linear velocity for unknown; rests: and for zero, at
        a guess.
        """
        self._wrapped.inflate_velocity_variance(rests=rests)


def require_state(
    whose: str, robot: Robot, *, q: np.ndarray, v: np.ndarray, **others: np.ndarray | None
) -> None:
    """Raise `InvalidInput` unless q (n_q,) [m, rad] is normalized, and v (n_v,) [m/s, rad/s] and
    others there are finite.
    """
    require_numbers(whose, "q", q, (robot.n_q,))
    for name, value in {
        "v": v,
        **{name: value for name, value in others.items() if value is not None},
    }.items():
        require_numbers(whose, name, value, (robot.n_v,))
    if not pin.isNormalized(robot.model, q, UNIT_NORM_TOLERANCE):
        raise InvalidInput(
            f"{whose} has q with an attitude or a turning joint not of norm 1; normalize it"
        )

"""Coordinates that bring a frame of the robot to a pose: the goal of a plan given by its tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.planning.certificate import PairDistances
from uvms_ocp.planning.coordinates import Coordinates

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class ToolGoalOptions:
    """Settings of ``tool_goal``."""

    tolerance: float = 1e-6
    """[m and rad] error that counts as reached."""
    iterations: int = 100
    attempts: int = 20
    """The guess given, then random ones around it."""
    spread: float = 0.5
    """[m or rad] of the random guesses."""
    clearance: float = 0.005
    """[m] that the goal keeps from everything."""
    damping: float = 1e-3
    seed: int = 0


def tool_goal(
    distances: PairDistances, frame: str, X_WF: pin.SE3, guess: ArrayLike, options: ToolGoalOptions | None = None
) -> Array | None:
    """Coordinates x (n_axes,) within limits and clear of collision with the frame at X_WF, or None if none was found.

    Plan without roll and pitch (``coordinates(robot, axes=...)``) to keep the vehicle level.

    Raises:
        FrameNotFound: the robot has no such frame.
        InvalidInput: a guess of the wrong shape or not finite.
    """
    settings, planned = options or ToolGoalOptions(), distances.scene.coordinates
    frame_id, first = planned.robot.frame_id(frame), np.array(guess, dtype=float)
    if first.shape != (planned.n_axes,) or not np.isfinite(first).all():
        raise InvalidInput(f"guess has shape {first.shape}; allowed is ({planned.n_axes},), finite.")
    rng = np.random.default_rng(settings.seed)
    for attempt in range(settings.attempts):
        start = first + (settings.spread * rng.normal(size=first.size) if attempt else 0.0)
        x = _reached(planned, frame_id, X_WF, start, settings)
        if x is not None and distances.distances(x[None]).min(initial=np.inf) > settings.clearance:
            return x
    return None


def _reached(
    planned: Coordinates, frame_id: int, X_WF: pin.SE3, start: Array, options: ToolGoalOptions
) -> Array | None:
    """Damped Gauss-Newton on the logarithm of the pose error, clipped to the limits at every step."""
    (lower, upper), x = planned.limits(), start
    for _ in range(options.iterations):
        x = np.clip(x, lower, upper)
        error, jacobian = _error(planned, frame_id, X_WF, x)
        if np.abs(error).max() <= options.tolerance:
            return x
        normal = jacobian @ jacobian.T + options.damping * min(1.0, float(error @ error)) * np.eye(6)
        x = x + jacobian.T @ np.linalg.solve(normal + 1e-12 * np.eye(6), error)
    return None


def _error(planned: Coordinates, frame_id: int, X_WF: pin.SE3, x: Array) -> tuple[Array, Array]:
    """Twist (6,) that takes the frame to the goal in one second, and the frame's Jacobian (6, n_axes), in the frame."""
    model, data = planned.robot.model, planned.robot.model.createData()
    q = planned.configurations(x[None])[0]
    pin.framesForwardKinematics(model, data, q)
    jacobian = pin.computeFrameJacobian(model, data, q, frame_id, pin.ReferenceFrame.LOCAL)
    error: Array = pin.log6(data.oMf[frame_id].actInv(X_WF)).vector
    return error, jacobian @ planned.velocity_map(x[None])[0]

"""Coordinates that bring a frame of the robot to a pose: the goal of a plan given by its tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.arguments import Count, checked
from uvms_ocp.arrays import Array
from uvms_ocp.collision.conservative_advancement import PairDistances
from uvms_ocp.collision.coordinates import Coordinates
from uvms_ocp.exceptions import InvalidInput


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class ToolGoalOptions:
    """Settings of ``tool_goal``."""

    tolerance: float = 1e-6
    """[m, rad] error that counts as reached."""
    iterations: int = 100
    attempts: int = 80
    """The guess given, then random ones around it, farther and farther."""
    spread: float = 0.5
    """[m or rad] of the first random guesses; the last are five times as far, to come from another side."""
    clearance: float = 0.005
    """[m] that the goal keeps from everything."""
    damping: float = 1e-3
    """[-] With lengths in m: added to the diagonal of the normal matrix, times the squared error where that is less than 1."""
    seed: Count = 0


@checked
def tool_goal(
    distances: PairDistances,
    frame: str,
    goal: pin.SE3 | ArrayLike,
    guess: ArrayLike,
    options: ToolGoalOptions | None = None,
) -> Array | None:
    """Coordinates (n_axes,) [m, rad] within limits and clear of collision with the frame at its goal, or None if none found.

    The goal is a pose X_WF, or a position p_WF (3,) [m] with any orientation; guess (n_axes,) [m, rad]: where the search
    begins. Plan without roll and pitch (``coordinates(robot, axes=...)``) to keep the vehicle level. Raises `FrameNotFound`
    where the robot has no such frame, `InvalidInput` for a guess or goal of the wrong shape or not finite.
    """
    settings, planned = options or ToolGoalOptions(), distances.scene.coordinates
    frame_id, first = planned.robot.frame_id(frame), np.array(guess, dtype=float)
    if first.shape != (planned.n_axes,) or not np.isfinite(first).all():
        raise InvalidInput(f"guess has shape {first.shape}; allowed is ({planned.n_axes},), finite.")
    target = goal if isinstance(goal, pin.SE3) else _checked_position(goal)
    rng = np.random.default_rng(settings.seed)
    for attempt in range(settings.attempts):
        spread = settings.spread * (1.0 + 4.0 * attempt / settings.attempts) if attempt else 0.0
        start = first + spread * rng.normal(size=first.size)
        x = _reached(planned, frame_id, target, start, settings)
        if x is not None and distances.distances(x[None]).min(initial=np.inf) > settings.clearance:
            return x
    return None


def _checked_position(goal: ArrayLike) -> Array:
    position = np.array(goal, dtype=float)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise InvalidInput(f"goal is {position}; allowed is a pose (pin.SE3) or a finite position (3,) [m].")
    return position


def _reached(
    planned: Coordinates, frame_id: int, goal: pin.SE3 | Array, start: Array, options: ToolGoalOptions
) -> Array | None:
    """Damped Gauss-Newton on the logarithm of the error, clipped to the limits at every step."""
    (lower, upper), x = planned.limits(), start
    for _ in range(options.iterations):
        x = np.clip(x, lower, upper)
        error, jacobian = _error(planned, frame_id, goal, x)
        if np.abs(error).max() <= options.tolerance:
            return x
        normal = jacobian @ jacobian.T + options.damping * min(1.0, float(error @ error)) * np.eye(error.size)
        x = x + jacobian.T @ np.linalg.solve(normal + 1e-12 * np.eye(error.size), error)
    return None


def _error(planned: Coordinates, frame_id: int, goal: pin.SE3 | Array, x: Array) -> tuple[Array, Array]:
    """Twist (6,), or velocity (3,), that takes the frame to the goal in one second, and its Jacobian, in the frame."""
    model, data = planned.robot.model, planned.robot.model.createData()
    q = planned.configurations(x[None])[0]
    pin.framesForwardKinematics(model, data, q)
    frame_jacobian = pin.computeFrameJacobian(model, data, q, frame_id, pin.ReferenceFrame.LOCAL)
    jacobian: Array = frame_jacobian @ planned.velocity_map(x[None])[0]
    X_WF = data.oMf[frame_id]
    if isinstance(goal, pin.SE3):
        return pin.log6(X_WF.actInv(goal)).vector, jacobian
    return X_WF.actInv(goal), jacobian[:3]

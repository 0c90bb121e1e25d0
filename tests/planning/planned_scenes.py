"""Obstacles, configurations near home, and differences: what tests of distances and costs share."""

from __future__ import annotations

import coal
import numpy as np

from uvms_ocp.planning.planned_axes import Coordinates
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.trajectories.segment_times import MotionLimits

N = 13
SPHERE = obstacle("ball", coal.Sphere(0.3), [1.6, 0.1, -0.3])
PIPE = obstacle("pipe", coal.Capsule(0.2, 1.0), [1.0, 1.2, 0.0])


def limits_of(robot: Robot) -> MotionLimits:
    return MotionLimits(velocity=robot.limits.velocity, acceleration=robot.limits.acceleration)


def random_x(planned: Coordinates, n: int, spread: float = 0.2) -> np.ndarray:
    lower, upper = planned.limits()
    home = planned.x(planned.robot.configuration())
    return np.clip(home + spread * np.random.default_rng(0).normal(size=(n, N)), lower, upper)


def differences(function, x: np.ndarray, h: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    """(size of x, ...) central differences."""
    steps = h * np.eye(x.size).reshape(x.size, *x.shape)
    return np.array([(function(x + s) - function(x - s)) / (2 * h) for s in steps])

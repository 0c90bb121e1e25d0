"""Fifty seeded scenes: a colliding straight line, and a free path known to a sampling planner.

Scenes are drawn until both hold, from their seed alone, so the set is the same everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np

from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.planned_axes import Coordinates, coordinates
from uvms_ocp.planning.rrt_connect import SamplingOptions, sampled_waypoints
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle, obstacle
from uvms_ocp.types import Array

N_SCENES = 50


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Problem:
    """One scene with its end points and the free path that is known."""

    seed: int
    scene: CollisionScene
    ends: Array
    """(2, n_axes)"""
    depth: float
    """[m] deepest overlap along the straight line."""
    free_path: Array
    """(n, n_axes) way points whose straight legs are free."""


def problem(
    seed: int,
    *,
    robot: Robot | None = None,
    n_obstacles: int = 2,
    shapes: tuple[str, ...] = ("sphere", "capsule"),
) -> Problem:
    """The scene of a seed; shapes are sphere, capsule and box, taken in turn; the robot is
    girona_maris7.
    """
    rng = np.random.default_rng(seed)
    planned = coordinates(robot or load_robot("girona_maris7"))
    while True:
        ends = _ends(rng, planned)
        obstacles = [
            _obstacle(rng, planned, ends, shapes[k % len(shapes)], k) for k in range(n_obstacles)
        ]
        scene = collision_scene(planned, obstacles)
        distances = CoalDistances(scene)
        start, goal = ends
        straight_line = start + np.linspace(0.0, 1.0, 80)[:, None] * (goal - start)
        depth = -float(distances.distances(straight_line).min())
        if distances.distances(ends).min() < 0.005 or depth < 0.03:
            continue
        options = SamplingOptions(seed=seed, max_samples=400)
        path = sampled_waypoints(distances, start, goal, options)
        if path is not None:
            return Problem(seed=seed, scene=scene, ends=ends, depth=depth, free_path=path)


def _ends(rng: np.random.Generator, planned: Coordinates) -> Array:
    lower, upper = planned.limits()
    home = planned.robot.home
    start = np.concatenate(
        [rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.5, 0.5, 1), home]
    )
    step = rng.uniform(-1.0, 1.0, 13) * np.array([1.5, 1.5, 0.7, 0.1, 0.1, 0.8, *[1.2] * 7])
    goal = np.clip(start + step, lower + 0.05, upper - 0.05)
    return np.stack([np.clip(start, lower + 0.005, upper - 0.005), goal])


def _obstacle(
    rng: np.random.Generator, planned: Coordinates, ends: Array, shape: str, index: int
) -> Obstacle:
    """Near the volume that the robot sweeps midway: the hull, or the arm in front of it."""
    midway = ends[0] + rng.uniform(0.3, 0.7) * (ends[1] - ends[0])
    position = (
        midway[:3]
        + rng.normal(size=3) * [0.5, 0.4, 0.4]
        + rng.uniform(0.0, 1.3) * np.array([0.8, 0.0, -0.4])
    )
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return obstacle(
        f"{shape}{index}", _shape(rng, shape), position, rotation * np.linalg.det(rotation)
    )


def _shape(rng: np.random.Generator, shape: str) -> coal.ShapeBase:
    if shape == "sphere":
        return coal.Sphere(rng.uniform(0.1, 0.35))
    if shape == "capsule":
        return coal.Capsule(rng.uniform(0.08, 0.2), rng.uniform(0.3, 1.2))
    return coal.Box(*rng.uniform(0.2, 0.6, 3))

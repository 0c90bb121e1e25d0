"""How near a robot came to the floor, to obstacles and to itself during a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from uvms_ocp.arguments import Positive, Shape, checked
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.obstacles import Obstacle
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import floor_obstacle

_AROUND = 4.0  # [m] of floor beyond the vehicle's track


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class ClosestApproach:
    """The smallest distance over a run; 0 or less is contact."""

    distance: float
    """[m]"""
    row: int
    """Of the configurations given."""
    pair: str
    """Names of the two shapes."""


@checked
def closest_approach(
    robot: Robot,
    environment: Environment,
    q: Annotated[np.ndarray, Shape("n", "robot.n_q")],
    *,
    self_collision: bool = False,
    floor: bool = True,
    spacing: Positive = 0.25,
) -> ClosestApproach:
    """The closest approach of the whole robot to the floor and all obstacles over configurations q (n, n_q) [m, rad].

    floor: count it, which a robot that has landed touches. spacing [m] of the mesh for a floor that is not flat.
    """
    obstacles = [*environment.obstacles, *([_floor_below(environment, q, spacing)] if floor else [])]
    model = CollisionModel(robot, obstacles, self_collision=self_collision)
    distances = np.array([model.values(row) for row in q])
    row, pair = np.unravel_index(int(np.argmin(distances)), distances.shape)
    return ClosestApproach(distance=float(distances[row, pair]), row=int(row), pair=model.pair_names[pair])


def _floor_below(environment: Environment, q: np.ndarray, spacing: float) -> Obstacle:
    """The part of the floor around the track of the vehicle."""
    low, high = q[:, :2].min(axis=0) - _AROUND, q[:, :2].max(axis=0) + _AROUND
    centre, extent = 0.5 * (low + high), float((high - low).max())
    place = (float(centre[0]), float(centre[1]))
    return floor_obstacle(environment.seafloor, centre=place, extent=extent, spacing=spacing)

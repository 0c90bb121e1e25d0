"""How near a robot came to the floor, to obstacles and to itself during a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.robot.kinematics import radius_around_joint
from uvms_ocp.robot.robot import Robot, require_normalized
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import floor_obstacle
from uvms_ocp.types import Positive, Shape

_AROUND = 4.0  # [m] of floor beyond where the robot has been


@checked_dataclass()
class ClosestApproach:
    """The smallest distance over a run; 0 or less is contact."""

    distance: float
    """[m] smallest distance, infinite where there are no two shapes."""
    row: int
    """Row of the configurations given."""
    pair: str
    """Names of the two shapes; empty where there are none."""


def _track(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return the corners (2, 2) [m] in W of a rectangle around all shapes of the robot at configurations
    q (n, n_q) [m, rad].
    """
    shapes = [shape for shape in robot.collision_model.geometryObjects if shape.parentJoint]
    radii = {shape.parentJoint: 0.0 for shape in shapes}
    for shape in shapes:
        radii[shape.parentJoint] = max(radii[shape.parentJoint], radius_around_joint(shape))
    data = robot.model.createData()
    corners = []
    for row in q:
        pin.forwardKinematics(robot.model, data, row)
        for joint, radius in radii.items():
            place = data.oMi[joint].translation[:2]
            corners += [place - radius, place + radius]
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])


@checked
def closest_approach(
    robot: Robot,
    environment: Environment,
    q: Annotated[np.ndarray, Shape("n", "robot.n_q")],
    *,
    self_collision: bool = False,
    floor: bool = True,
    spacing: Positive = 0.25,
    links: Sequence[str] | None = None,
) -> ClosestApproach:
    """Return the closest approach of the whole robot to the floor and all obstacles over
    configurations q (n, n_q) [m, rad].

    floor: count it, which a robot that has landed touches. spacing [m] of the mesh for a floor that
    is not flat. links: names of the shapes that count, as of an arm (`Robot.arm_shapes`), all by
    default. Raises `InvalidInput` for others.
    """
    require_normalized(robot.model, q)
    if not (len(q) and any(shape.parentJoint for shape in robot.collision_model.geometryObjects)):
        return ClosestApproach(distance=np.inf, row=0, pair="")
    obstacles = list(environment.obstacles)
    if floor:
        low, high = _track(robot, q)
        low = low - _AROUND
        high = high + _AROUND
        x, y = (0.5 * (low + high)).tolist()
        extent = float((high - low).max())
        obstacles.append(
            floor_obstacle(environment.seafloor, centre=(x, y), extent=extent, spacing=spacing)
        )
    model = CollisionModel(robot, obstacles, self_collision=self_collision, links=links)
    distances = np.array([model.values(row) for row in q]).reshape(len(q), model.n_pairs)
    if not distances.size:
        return ClosestApproach(distance=np.inf, row=0, pair="")
    row, pair = np.unravel_index(int(np.argmin(distances)), distances.shape)
    return ClosestApproach(
        distance=float(distances[row, pair]), row=int(row), pair=model.pair_names[pair]
    )

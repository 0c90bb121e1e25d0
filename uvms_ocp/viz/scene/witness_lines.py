"""Witness lines: the distance of the robot from each obstacle, and the line between the two points
where they are nearest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot
from uvms_ocp.robot.shapes import pair_distances, shape_pairs
from uvms_ocp.robot.shapes.obstacles import build_obstacle
from uvms_ocp.viz.scene.animation import Frames, rounded
from uvms_ocp.viz.scene.colours import DISTANCE

NEAR = 1.0
"""[m] below which a line is drawn."""
_MOST_DISTANCES = 20_000  # of pairs; a longer or fuller run is looked at less often


def witness_lines(
    record: Record, robot: Robot, frames: Frames, centre: np.ndarray
) -> dict[str, Any] | None:
    """Return JSON values: times ``t`` (n,) [s], and of each obstacle its distances (n,) [m] and
    lines (n, 6) [m] in the page's frame.

    centre (3,) [m] in W is the origin of that frame. `None` without obstacles; a line of six zeros
    is none to draw.
    """
    obstacles = [build_obstacle(item) for item in record.meta.surroundings.obstacles]
    n_links = robot.collision_model.ngeoms
    if not obstacles or not n_links:
        return None
    n = max(2, min(len(frames.t), _MOST_DISTANCES // (n_links * len(obstacles))))
    frame_indices = np.unique(np.linspace(0, len(frames.t) - 1, n).round().astype(int))
    pairs: list[tuple[int, int]] = []
    for k in range(len(obstacles)):
        pairs += [(link, n_links + k) for link in range(n_links)]
    scene = pair_distances.CoalPairs(robot.model, shape_pairs.shapes_among(robot, obstacles), pairs)
    configurations = record["q"][frames.row[frame_indices]]
    shape = (len(obstacles), n_links)
    witnesses = np.array([_nearest(scene, q, shape) for q in configurations])
    witnesses[..., 1:] -= np.tile(centre, 2)
    lines = np.where(witnesses[..., :1] < NEAR, witnesses[..., 1:], 0.0)
    obstacle_values = []
    for k, item in enumerate(record.meta.surroundings.obstacles):
        obstacle_values.append(
            {
                "name": item.name,
                "distance": rounded(witnesses[:, k, 0]),
                "line": lines[:, k].round(4).tolist(),
            }
        )
    return {
        "near": NEAR,
        "colour": DISTANCE,
        "shown": True,
        "t": frames.t[frame_indices].round(3).tolist(),
        "obstacles": obstacle_values,
    }


def _nearest(scene: pair_distances.CoalPairs, q: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return (n_obstacles, 7) [m], distance and both points in W, the robot's first, at q (n_q,)
    [m, rad].

    shape: numbers of obstacles and links.
    """
    places = np.arange(np.prod(shape)).reshape(shape)
    distance = scene.values(q, places.ravel()).reshape(shape)
    nearest = np.argmin(distance, axis=1)
    rows = np.arange(len(places))
    return np.column_stack([distance[rows, nearest], scene.nearest_points(places[rows, nearest])])

"""How near the robot is to each obstacle: the distance, and the line between the two points where they are nearest."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.collision.obstacle_file import build_obstacle
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.coal_pairs import CoalPairs
from uvms_ocp.model.shapes.collision_model import shapes_among
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import Frames, rounded

NEAR = 1.0
"""[m] below which a line is drawn."""
_MOST_LOOKS = 20_000  # distances of pairs; a longer or fuller run is looked at less often


def witness_lines(record: Record, robot: Robot, frames: Frames, centre: np.ndarray) -> dict[str, Any] | None:
    """JSON values: times ``t`` (n,) [s], and of each obstacle its distances (n,) [m] and lines (n, 6) [m] in the page's frame.

    centre (3,) [m] in W is the origin of that frame. `None` without obstacles; a line of six zeros is none to draw.
    """
    obstacles = [build_obstacle(item) for item in record.meta.surroundings.obstacles]
    n_links = robot.collision_model.ngeoms
    if not obstacles or not n_links:
        return None
    n = max(2, min(len(frames.t), _MOST_LOOKS // (n_links * len(obstacles))))
    looks = np.unique(np.linspace(0, len(frames.t) - 1, n).round().astype(int))
    pairs = [(link, n_links + k) for k in range(len(obstacles)) for link in range(n_links)]
    scene = CoalPairs(robot.model, shapes_among(robot, obstacles), pairs)
    found = np.array([_nearest(scene, q, (len(obstacles), n_links)) for q in record["q"][frames.row[looks]]])
    found[..., 1:] -= np.tile(centre, 2)
    lines = np.where(found[..., :1] < NEAR, found[..., 1:], 0.0)
    names = [item.name for item in record.meta.surroundings.obstacles]
    return {
        "near": NEAR,
        "colour": "#ffe066",
        "shown": True,
        "t": frames.t[looks].round(3).tolist(),
        "obstacles": [
            {"name": name, "distance": rounded(found[:, k, 0]), "line": lines[:, k].round(4).tolist()}
            for k, name in enumerate(names)
        ],
    }


def _nearest(scene: CoalPairs, q: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(n_obstacles, 7) [m] distance and both points in W, the robot's first, at q (n_q,) [m, rad].

    shape: numbers of obstacles and links.
    """
    places = np.arange(np.prod(shape)).reshape(shape)
    distance = scene.values(q, places.ravel()).reshape(shape)
    nearest = np.argmin(distance, axis=1)
    rows = np.arange(len(places))
    return np.column_stack([distance[rows, nearest], scene.nearest_points(places[rows, nearest])])

"""Draw goals, obstacles and trails, arrows of forces, and lines of nearest distance to
obstacles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot, thruster_matrix
from uvms_ocp.robot.shapes import hull, pair_distances, shape_pairs
from uvms_ocp.robot.shapes.obstacles import build_obstacle
from uvms_ocp.viz.scene.animation import Frames, rounded
from uvms_ocp.viz.scene.page import Visualizer, geometry as mg
from uvms_ocp.viz.scene.shapes import draw_shape, draw_triad, glow, hex_of, material, shifted, tube
from uvms_ocp.viz.series import floor_heights

# What stays where it is: goals, obstacles and the paths that vehicle and tool leave behind.

_TRAIL_STEP = 0.01  # [m] between points of a trail
_SAME_PLACE = 0.05  # [m]
Colour = tuple[float, float, float]
_OWN_TRAILS: tuple[Colour, ...] = (
    (1.0, 0.82, 0.2),
    (0.95, 0.25, 0.55),
    (0.45, 0.95, 0.6),
    (0.7, 0.6, 1.0),
)
_MARKERS = ((0.95, 0.3, 0.1), (0.2, 0.85, 0.45), (0.95, 0.85, 0.2), (0.6, 0.4, 0.9))
_OBSTACLE = np.array([0.85, 0.45, 0.2, 0.55])

_NEGLIGIBLE = 1e-6  # [N, N m, m/s] nothing that is smaller throughout has an arrow
_USUAL = 80  # [%] of the time in which the largest arrow is shorter than its share
_LONGEST = 1.6  # of its share, to which longer arrows are cut
Arrow = tuple[np.ndarray, np.ndarray]
"""Origin (3,) [m] of an arrow in B, and its vectors (n, 3) [its unit] in B."""
Draw = Callable[[np.ndarray, Robot, Frames, float], Iterator[Arrow]]
"""Takes the series at the frames, and the size of the robot."""

NEAR = 1.0
"""[m] below which a line is drawn."""
_MOST_LOOKS = 20_000  # distances of pairs; a longer or fuller run is looked at less often


def extent(record: Record, frames: Frames) -> np.ndarray:
    """Return points (n, 3) [m] that the camera must see."""
    surroundings = record.meta.surroundings
    links = frames.placements[:, 1:, :3].reshape(-1, 3)
    obstacles = [obstacle.position for obstacle in surroundings.obstacles]
    markers = [marker.position for marker in surroundings.markers]
    return np.vstack([links, np.array(obstacles).reshape(-1, 3), np.array(markers).reshape(-1, 3)])


def middle(record: Record, frames: Frames) -> np.ndarray:
    """Return the middle (3,) [m] of all that moves and all goals, on the floor if there is one."""
    points = extent(record, frames)
    x, y, z = ((points.min(axis=0) + points.max(axis=0)) / 2).tolist()
    floor = record.meta.surroundings.floor_z
    return np.array([x, y, z if floor is None else floor])


def draw_trails(
    node: Visualizer, robot: Robot, frames: Frames, colour: Colour | None = None
) -> list[dict[str, Any]]:
    """Draw tubes along the paths of vehicle and tools; the page reveals them up to the time shown.

    colour (3,) of all, from 0 to 1; left out: one for each.
    """
    paths = {"vehicle": frames.placements[:, 1, :3]} if robot.n_vehicle else {}
    trails = []
    for k, (name, points) in enumerate(
        (*paths.items(), *frames.tools.items()), start=1 - len(paths)
    ):
        rgb = colour or _OWN_TRAILS[min(k, len(_OWN_TRAILS) - 1)]
        radius = 0.011 if k else 0.018
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])  # [m]
        rows = np.unique(travelled // _TRAIL_STEP, return_index=True)[1]
        if len(rows) > 2:
            trail_node = node[name.replace("/", "_")]
            trail_node.set_object(tube(points[rows], radius), glow(rgb, 1.0))
            path = trail_node.path.lower().strip("/").split("/")
            trails.append(
                {
                    "name": name,
                    "path": path,
                    "colour": hex_of(rgb),
                    "t": frames.t[rows].round(3).tolist(),
                }
            )
    return trails


def draw_goals(node: Visualizer, record: Record) -> None:
    """Draw markers as balls, with a rod to the floor where they are above it, and frames as triads;
    numbered as in the record.
    """
    for i, marker in enumerate(record.meta.surroundings.markers):
        rgb = _MARKERS[i % len(_MARKERS)]
        point = np.array(marker.position)
        item_node = node[f"marker {i}"]
        item_node["ball"].set_object(mg.Sphere(0.06), material((*rgb, 0.75)))
        item_node.set_transform(shifted(point))
        floor = floor_heights(record, point[None, :2])
        if floor is not None and point[2] - floor[0] > 0.2:
            height = point[2] - floor[0]
            item_node["plumb"]["rod"].set_object(mg.Box([0.012, 0.012, height]), glow(rgb, 0.5))
            item_node["plumb"].set_transform(shifted(np.array([0.0, 0.0, -height / 2])))
    for i, frame in enumerate(record.meta.surroundings.frames):
        item_node = node[f"frame {i}"]
        draw_triad(item_node, 0.35)
        item_node.set_transform(pin.XYZQUATToSE3(np.array(frame.pose)).homogeneous)


def labels(record: Record, centre: np.ndarray) -> list[dict[str, Any]]:
    """Return names of markers, goal frames and obstacles, and where they stand (3,) [m] from centre
    (3,) [m] in W.

    One name for each place; goals that move have none.
    """
    surroundings = record.meta.surroundings
    shown_labels: list[dict[str, Any]] = []
    places = [(item.name, item.position, "marker") for item in surroundings.markers]
    places += [(item.name, item.pose[:3], "frame") for item in surroundings.frames if not item.way]
    places += [(item.name, item.position, "obstacle") for item in surroundings.obstacles]
    for text, place, kind in places:
        position = (np.array(place) - centre).round(4).tolist()
        offsets = [np.subtract(position, label["position"]) for label in shown_labels]
        if all(np.linalg.norm(offset) > _SAME_PLACE for offset in offsets):
            shown_labels.append({"text": text, "position": position, "kind": kind})
    return shown_labels


def draw_obstacles(node: Visualizer, record: Record) -> None:
    """Draw every obstacle, numbered in the order of the record."""
    for i, data in enumerate(record.meta.surroundings.obstacles):
        item = build_obstacle(data)
        obstacle_node = node[f"{i:03d}"]
        draw_shape(obstacle_node["shape"], item.shape, _OBSTACLE)
        obstacle_node.set_transform(item.X_WO.homogeneous)


# Arrows of what pushes the vehicle, in its own frame: thrust, contact with the floor, the current,
# the disturbance.


@dataclass(frozen=True, kw_only=True, slots=True)
class ArrowKind:
    """Quantity and look of a group of arrows."""

    label: str
    unit: str
    colour: str
    share: float
    """Usual length in sizes of the robot."""
    series: str
    draw: Draw
    """Function that places the arrows."""
    shown: bool = True
    """True where it is shown before anyone asks for it."""


def arrow_groups(record: Record, robot: Robot, frames: Frames, size: float) -> list[dict[str, Any]]:
    """Return JSON values, a group for each kind that the record has; size [m] of the robot, which
    lengths go by; peaks are cut.

    Of each arrow: the point ``at`` (3,) [m] in B where it begins, and ``vectors`` (n, 3) [unit of
    the group] in B at the frames.
    """
    if not robot.n_vehicle:
        return []
    groups = []
    for kind in _KINDS:
        if kind.series not in record.series:
            continue
        arrows = list(kind.draw(record[kind.series][frames.row], robot, frames, size))
        norms = np.array([np.linalg.norm(vectors, axis=1) for _, vectors in arrows])
        if norms.size and norms.max() > _NEGLIGIBLE:
            groups.append(_group(kind, arrows, norms, kind.share * size))
    return groups


def _group(
    kind: ArrowKind, arrows: list[Arrow], norms: np.ndarray, length: float
) -> dict[str, Any]:
    """Return the values of a group; norms (n_arrows, n) [its unit], length [m] of a usual one."""
    usual_norm = max(float(np.percentile(norms.max(axis=0), _USUAL)), _NEGLIGIBLE)
    return {
        "label": kind.label,
        "unit": kind.unit,
        "colour": kind.colour,
        "shown": kind.shown,
        "largest": float(norms.max()),
        "scale": length / usual_norm,
        "longest": length * _LONGEST,
        "arrows": [
            {"at": rounded(positions), "vectors": rounded(vectors)} for positions, vectors in arrows
        ],
    }


def _thrust(thrust: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    for thruster, direction, values in zip(
        robot.description.thrusters, thruster_matrix(robot)[:3].T, thrust.T, strict=False
    ):
        X_BF = robot.model.frames[robot.model.getFrameId(thruster.link)].placement
        yield X_BF.act(np.array(thruster.position)), np.outer(values, direction)


def _contact(pressing: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    up = _in_vehicle(np.tile([0.0, 0.0, 1.0], (len(pressing), 1)), frames)
    for point, values in zip(hull.skid_points(robot), pressing.T, strict=False):
        yield point, values[:, None] * up


def _current(velocity: np.ndarray, robot: Robot, frames: Frames, size: float) -> Iterator[Arrow]:
    yield np.array([0.0, 0.0, 0.75 * size]), _in_vehicle(velocity, frames)


def _disturbance(column: int, values: np.ndarray, *_: object) -> Iterator[Arrow]:
    yield np.zeros(3), values[:, column : column + 3]


def _in_vehicle(vectors: np.ndarray, frames: Frames) -> np.ndarray:
    """Return vectors (n, 3) in W, in the frame of the vehicle at each frame."""
    turns = (pin.XYZQUATToSE3(pose).rotation for pose in frames.placements[:, 1])
    return np.array([R_WB.T @ vector for R_WB, vector in zip(turns, vectors, strict=True)])


_force, _moment = (
    partial(ArrowKind, series="disturbance", draw=partial(_disturbance, first)) for first in (0, 3)
)
_KINDS = (
    ArrowKind(
        label="thrust", unit="N", colour="#b8f23c", share=0.55, series="thrust", draw=_thrust
    ),
    ArrowKind(
        label="contact with the floor",
        unit="N",
        colour="#ff6b5e",
        share=0.5,
        series="contact",
        draw=_contact,
    ),
    ArrowKind(
        label="current", unit="m/s", colour="#63e6ff", share=0.7, series="current", draw=_current
    ),
    _force(label="disturbance, force", unit="N", colour="#ff7ad9", share=0.8),
    _moment(label="disturbance, moment", unit="N m", colour="#c9a0ff", share=0.6, shown=False),
)


# How near the robot is to each obstacle: the distance, and the line between the two points where
# they are nearest.


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
    n = max(2, min(len(frames.t), _MOST_LOOKS // (n_links * len(obstacles))))
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
    return {
        "near": NEAR,
        "colour": "#ffe066",
        "shown": True,
        "t": frames.t[frame_indices].round(3).tolist(),
        "obstacles": [
            {
                "name": item.name,
                "distance": rounded(witnesses[:, k, 0]),
                "line": lines[:, k].round(4).tolist(),
            }
            for k, item in enumerate(record.meta.surroundings.obstacles)
        ],
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

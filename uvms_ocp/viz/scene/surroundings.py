"""What stays where it is: goals, obstacles and the paths that vehicle and tool leave behind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.collision.obstacle_file import build_obstacle
from uvms_ocp.model.robot import Robot
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import Frames
from uvms_ocp.viz.scene.meshcat_parts import Visualizer
from uvms_ocp.viz.scene.meshcat_parts import geometry as mg
from uvms_ocp.viz.scene.shapes import draw_shape, draw_triad, glow, hex_of, material, shifted, tube
from uvms_ocp.viz.series import floor_heights

_TRAIL_STEP = 0.01  # [m] between points of a trail
_SAME_PLACE = 0.05  # [m]
Colour = tuple[float, float, float]
_OWN_TRAILS: tuple[Colour, Colour] = ((1.0, 0.82, 0.2), (0.95, 0.25, 0.55))
_MARKERS = ((0.95, 0.3, 0.1), (0.2, 0.85, 0.45), (0.95, 0.85, 0.2), (0.6, 0.4, 0.9))
_OBSTACLE = np.array([0.85, 0.45, 0.2, 0.55])


def extent(record: Record, frames: Frames) -> np.ndarray:
    """Points (n, 3) [m] that the camera must see."""
    markers = np.array([marker.position for marker in record.meta.surroundings.markers]).reshape(-1, 3)
    obstacles = np.array([item.position for item in record.meta.surroundings.obstacles]).reshape(-1, 3)
    return np.vstack([frames.placements[:, 1:, :3].reshape(-1, 3), obstacles, markers])


def middle(record: Record, frames: Frames) -> np.ndarray:
    """Middle (3,) [m] of all that moves and all goals, on the floor where there is one."""
    points = extent(record, frames)
    x, y, z = ((points.min(axis=0) + points.max(axis=0)) / 2).tolist()
    floor = record.meta.surroundings.floor_z
    return np.array([x, y, z if floor is None else floor])


def draw_trails(
    node: Visualizer, robot: Robot, frames: Frames, colours: tuple[Colour, Colour] = _OWN_TRAILS
) -> list[dict[str, Any]]:
    """Tubes along the paths of vehicle and tool; the page reveals them up to the time shown.

    colours (3,) [-] each, from 0 to 1.
    """
    paths = {"vehicle": (frames.placements[:, 1, :3] if robot.n_vehicle else None, 0.018), "tool": (frames.tool, 0.011)}
    trails = []
    for rgb, (name, (points, radius)) in zip(colours, paths.items(), strict=True):
        kept = None if points is None else _spaced(points)
        if points is not None and kept is not None and len(kept) > 2:
            node[name].set_object(tube(points[kept], radius), glow(rgb, 1.0))
            path = node[name].path.lower().strip("/").split("/")
            trails.append({"name": name, "path": path, "colour": hex_of(rgb), "t": frames.t[kept].round(3).tolist()})
    return trails


def _spaced(points: np.ndarray) -> np.ndarray:
    """Indices of points at least a step apart."""
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.unique(travelled // _TRAIL_STEP, return_index=True)[1]


def draw_goals(node: Visualizer, record: Record) -> None:
    """Markers as balls, with a rod to the floor where they are above it, and frames as triads; numbered as in the record."""
    for i, marker in enumerate(record.meta.surroundings.markers):
        rgb, point, own = _MARKERS[i % len(_MARKERS)], np.array(marker.position), node[f"marker {i}"]
        own["ball"].set_object(mg.Sphere(0.06), material((*rgb, 0.75)))
        own.set_transform(shifted(point))
        floor = floor_heights(record, point[None, :2])
        if floor is not None and point[2] - floor[0] > 0.2:
            _draw_plumb(own["plumb"], point[2] - floor[0], rgb)
    for i, frame in enumerate(record.meta.surroundings.frames):
        own = node[f"frame {i}"]
        draw_triad(own, 0.35)
        own.set_transform(pin.XYZQUATToSE3(np.array(frame.pose)).homogeneous)


def labels(record: Record, centre: np.ndarray) -> list[dict[str, Any]]:
    """Names of markers, goal frames and obstacles, and where they stand (3,) [m] from centre (3,) [m] in W.

    One name for each place.
    """
    around = record.meta.surroundings
    found: list[dict[str, Any]] = []
    named = [(item.name, item.position, "marker") for item in around.markers]
    named += [(item.name, item.pose[:3], "frame") for item in around.frames]
    named += [(item.name, item.position, "obstacle") for item in around.obstacles]
    for text, place, kind in named:
        position = (np.array(place) - centre).round(4).tolist()
        if all(np.linalg.norm(np.subtract(position, other["position"])) > _SAME_PLACE for other in found):
            found.append({"text": text, "position": position, "kind": kind})
    return found


def draw_obstacles(node: Visualizer, record: Record) -> None:
    """Every obstacle, numbered in the order of the record."""
    for i, data in enumerate(record.meta.surroundings.obstacles):
        item, own = build_obstacle(data), node[f"{i:03d}"]
        draw_shape(own["shape"], item.shape, _OBSTACLE)
        own.set_transform(item.X_WO.homogeneous)


def _draw_plumb(node: Visualizer, height: float, rgb: tuple[float, ...]) -> None:
    """A thin rod down to the floor, which gives depth to a marker in mid-water."""
    node["rod"].set_object(mg.Box([0.012, 0.012, height]), glow(rgb, 0.5))
    node.set_transform(shifted(np.array([0.0, 0.0, -height / 2])))

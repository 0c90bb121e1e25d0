"""Draw what stays where it is: goals, obstacles, and the trails that vehicle and tools leave."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot
from uvms_ocp.robot.shapes.obstacles import build_obstacle
from uvms_ocp.viz.scene import colours
from uvms_ocp.viz.scene.animation import Frames
from uvms_ocp.viz.scene.page import Visualizer, geometry as mg
from uvms_ocp.viz.scene.shapes import draw_shape, draw_triad, glow, hex_of, material, shifted, tube
from uvms_ocp.viz.series import floor_heights

_TRAIL_STEP = 0.01  # [m] between points of a trail
_SAME_PLACE = 0.05  # [m] within which one name is written for all that stands there


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
    node: Visualizer, robot: Robot, frames: Frames, colour: colours.Colour | None = None
) -> list[dict[str, Any]]:
    """Draw tubes along the paths of vehicle and tools; the page reveals them up to the time shown.

    colour (3,) of all, from 0 to 1; left out: one for each.
    """
    paths = list[
        tuple[str, np.ndarray, colours.Colour, float]
    ]()  # name, points, colour, radius [m]
    if robot.n_vehicle:
        paths.append(("vehicle", frames.placements[:, 1, :3], colours.VEHICLE_TRAIL, 0.018))
    for k, (name, points) in enumerate(frames.tools.items()):
        tool_colour = colours.TOOL_TRAILS[min(k, len(colours.TOOL_TRAILS) - 1)]
        paths.append((name, points, tool_colour, 0.011))
    trails = []
    for name, points, own_colour, radius in paths:
        rgb = colour or own_colour
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
        rgb = colours.MARKERS[i % len(colours.MARKERS)]
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
        draw_shape(obstacle_node["shape"], item.shape, np.array(colours.OBSTACLE))
        obstacle_node.set_transform(item.X_WO.homogeneous)

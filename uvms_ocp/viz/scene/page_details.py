"""What the page's script needs beside the commands of meshcat: where to look from, names of places, the floor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import Frames, joint_node
from uvms_ocp.viz.scene.surroundings import extent, labels
from uvms_ocp.viz.series import as_known

_FAR = 12.0  # robot sizes; a longer mission opens with the camera on the vehicle
_LONGEST_SHOW = 60.0  # [s] beyond it playback begins sped up
_SHORT_WAY = 0.2  # [m] a shorter horizontal way has no direction
_SPEEDS = (0.25, 1, 2, 5, 10, 20, 50, 100)


def page_details(record: Record, robot: Robot, frames: Frames, centre: np.ndarray) -> dict[str, Any]:
    """JSON values for the page; centre (3,) [m] in W is the origin of its frame."""
    points, of_robot = _thinned(extent(record, frames)) - centre, robot_details(robot)
    far = np.linalg.norm(np.ptp(points, axis=0)) > _FAR * of_robot["size"]
    return {
        "scenario": record.meta.scenario,
        "known": as_known(record).strip(),
        **_playback(float(frames.t[-1])),
        "floor": _lowest_floor(record, centre),
        "relief": _relief(record, centre),
        "labels": labels(record, centre),
        "points": points.tolist(),
        "start_view": "vehicle" if far and robot.n_vehicle else "mission",
        "direction": _viewing_direction(record, frames, forward=0.4),
        "close_direction": _viewing_direction(record, frames, forward=1.2),
        **of_robot,
    }


def robot_details(robot: Robot) -> dict[str, Any]:
    """JSON values about the robot alone."""
    return {
        "robot": robot.name,
        "size": _robot_size(robot),
        "views": ["mission", "vehicle", "tool"] if robot.n_vehicle else ["mission", "tool"],
        "body": ["meshcat", "scene", "robot", joint_node(robot.model, 1)],
        "hand": ["meshcat", "scene", "robot", joint_node(robot.model, robot.model.njoints - 1)],
    }


def _playback(duration: float) -> dict[str, Any]:
    fitting = (speed for speed in _SPEEDS if speed >= 1 and duration / speed <= _LONGEST_SHOW)
    return {"duration": duration, "speed": next(fitting, _SPEEDS[-1]), "speeds": _SPEEDS}


def _lowest_floor(record: Record, centre: np.ndarray) -> float | None:
    """Height [m] of the plane around a floor that is not flat, or of the flat floor, in the frame of the page."""
    relief, plane = record.meta.surroundings.floor, record.meta.surroundings.floor_z
    lowest = plane if relief is None else float(np.min(relief.z))
    return None if lowest is None else float(lowest - centre[2])


def _relief(record: Record, centre: np.ndarray) -> dict[str, Any] | None:
    """The floor that is not flat, in the frame of the page."""
    relief = record.meta.surroundings.floor
    if relief is None:
        return None
    axes = {"x": relief.x, "y": relief.y, "z": relief.z}
    values = {
        axis: (np.array(points) - middle).round(3) for (axis, points), middle in zip(axes.items(), centre, strict=True)
    }
    return {axis: value.tolist() for axis, value in values.items()}


def _thinned(points: np.ndarray, limit: int = 400) -> np.ndarray:
    return points[:: max(1, len(points) // limit)]


def _robot_size(robot: Robot) -> float:
    """Radius [m] of a ball around the robot's shapes, about its first joint."""
    data, shapes = robot.model.createData(), robot.visual_model.createData()
    q = robot.configuration(joints=robot.home) if robot.n_vehicle else np.asarray(robot.home)
    pin.updateGeometryPlacements(robot.model, data, robot.visual_model, shapes, q)
    if not len(shapes.oMg):
        return 0.5
    first = data.oMi[1].translation
    return max(float(np.linalg.norm(X.translation - first)) for X in shapes.oMg) + 0.2


def _viewing_direction(record: Record, frames: Frames, *, forward: float) -> list[float]:
    """From where to look: from the side of the run's horizontal way, `forward` of it and a little above."""
    points = extent(record, frames)
    way = (points[-1] - frames.placements[0, 1, :3])[:2]
    length = float(np.linalg.norm(way))
    ahead = way / length if length > _SHORT_WAY else np.array([1.0, 0.0])
    side = np.array([ahead[1], -ahead[0]])
    return [*(side + forward * ahead).tolist(), 0.4 * float(np.hypot(1.0, forward))]

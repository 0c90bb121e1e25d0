"""What the page's script needs beside the commands of meshcat: phases, labels, cameras, readouts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import Frames, joint_node
from uvms_ocp.viz.scene.surroundings import extent
from uvms_ocp.viz.series import as_known, fault_spans, phase_spans, quantity

_FAR = 12.0  # robot sizes; a longer mission opens with the camera on the vehicle
_LONGEST_SHOW = 60.0  # [s] beyond it playback begins sped up
_SHORT_WAY = 0.2  # [m] a shorter horizontal way has no direction
_SPEEDS = (1, 2, 5, 10, 20, 50, 100)
_READOUTS = (
    ("LA.altitude", "altitude", "m"),
    ("PC.position_error", "to way point", "m"),
    ("AT.misalignment", "misalignment", "rad"),
    ("T.position_error", "tool error", "m"),
    ("plan.clearance", "clearance", "m"),
)


def page_details(record: Record, robot: Robot, frames: Frames, centre: np.ndarray) -> dict[str, Any]:
    """JSON values for the page; centre (3,) [m] in W is the origin of its frame."""
    meta = record.meta
    start = float(record["t"][0])
    duration = float(frames.t[-1])
    points, size = _thinned(extent(record, frames)) - centre, _robot_size(robot)
    far = np.linalg.norm(np.ptp(points, axis=0)) > _FAR * size
    return {
        "scenario": meta.scenario,
        "robot": meta.robot,
        "duration": duration,
        "speed": next((s for s in _SPEEDS if duration / s <= _LONGEST_SHOW), _SPEEDS[-1]),
        "speeds": _SPEEDS,
        "floor": _lowest_floor(record, centre),
        "relief": _relief(record, centre),
        "phases": [
            {"name": s.name, "title": s.title, "index": s.index, "start": s.start - start, "end": s.end - start}
            for s in phase_spans(record)
        ],
        "faults": [
            {"name": s.name, "start": s.start - start, "end": s.end - start, "ended": s.ended}
            for s in fault_spans(record)
        ],
        "labels": [
            {"text": marker.name, "position": (np.array(marker.position) - centre).tolist()}
            for marker in meta.surroundings.markers
        ],
        "points": points.tolist(),
        "size": size,
        "start_view": "vehicle" if far and robot.n_vehicle else "mission",
        "direction": _viewing_direction(record, frames, forward=0.4),
        "close_direction": _viewing_direction(record, frames, forward=1.2),
        "views": ["mission", "vehicle", "tool"] if robot.n_vehicle else ["mission", "tool"],
        "body": ["meshcat", "scene", "robot", joint_node(robot.model, 1)],
        "hand": ["meshcat", "scene", "robot", joint_node(robot.model, robot.model.njoints - 1)],
        "readouts": _readouts(record, frames),
    }


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


def _readouts(record: Record, frames: Frames) -> list[dict[str, Any]]:
    """Measured quantities at the times of the frames, rounded for the page; `None` where not known."""
    shown = []
    for name, label, unit in _READOUTS:
        values = quantity(record, name)
        if values is not None:
            rounded = [float(f"{value:.3g}") if np.isfinite(value) else None for value in values[frames.row]]
            shown.append({"label": label + as_known(record), "unit": unit, "values": rounded})
    return shown if not shown else [{"label": "", "unit": "", "values": frames.t.round(3).tolist()}, *shown]

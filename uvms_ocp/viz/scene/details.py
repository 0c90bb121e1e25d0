"""Data that the page's script needs beside meshcat's commands: views, legend, readouts, time
line.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RecordMeta
from uvms_ocp.record.tables import unit_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Trust
from uvms_ocp.viz.scene import shapes, surroundings
from uvms_ocp.viz.scene.animation import Frames, joint_node, rounded
from uvms_ocp.viz.scene.ghosts import Ghost
from uvms_ocp.viz.series import estimate_suffix
from uvms_ocp.viz.time_spans import fault_spans, intervals_of, phase_spans

_SPEEDS = (0.25, 1, 2, 5, 10, 20, 50, 100)
"""Speeds of playback, times real time."""
_LONGEST_SHOW = 60.0  # [s] beyond it playback begins sped up
_FAR = 12.0  # robot sizes; a longer mission opens with the camera on the vehicle
_MOST_POINTS = 400  # about, that the camera is to see
_SHORT_WAY = 0.2  # [m] a shorter horizontal way has no direction
_SMALLEST = 0.3  # [m] from its first joint to the shapes of a robot that has none
_RIM = 0.2  # [m] around the middles of shapes
_SCENE = ("meshcat", "scene")
"""Path of the scene's node."""


def page_details(
    record: Record, robot: Robot, frames: Frames, centre: np.ndarray
) -> dict[str, Any]:
    """Return JSON values for the page; centre (3,) [m] in W is the origin of its frame."""
    all_points = surroundings.extent(record, frames)
    points = all_points[:: max(1, len(all_points) // _MOST_POINTS)] - centre
    robot_values = robot_details(robot)
    duration = float(frames.t[-1])
    is_far = np.linalg.norm(np.ptp(points, axis=0)) > _FAR * robot_values["size"]
    return {
        "scenario": record.meta.scenario,
        "known": estimate_suffix(record).strip(),
        "duration": duration,
        "speed": _first_speed(duration),
        "speeds": _SPEEDS,
        "floor": _floor_height(record, centre),
        "relief": _relief(record, centre),
        "labels": surroundings.labels(record, centre),
        "points": points.tolist(),
        "start_view": "vehicle" if is_far and robot.n_vehicle else "mission",
        "direction": _viewing_direction(record, frames, forward=0.4),
        "close_direction": _viewing_direction(record, frames, forward=1.2),
        **robot_values,
    }


def robot_details(robot: Robot) -> dict[str, Any]:
    """Return JSON values about the robot alone."""
    return {
        "robot": robot.name,
        "size": _robot_size(robot),
        "views": ["mission", "vehicle", "tool"] if robot.n_vehicle else ["mission", "tool"],
        "body": ["meshcat", "scene", "robot", joint_node(robot.model, 1)],
        "hand": ["meshcat", "scene", "robot", joint_node(robot.model, robot.model.njoints - 1)],
    }


def _first_speed(duration: float) -> float:
    """Return the speed of playback to begin with, times real time, for a run of a duration [s]."""
    for speed in _SPEEDS:
        if speed >= 1 and duration / speed <= _LONGEST_SHOW:
            return speed
    return _SPEEDS[-1]


def _floor_height(record: Record, centre: np.ndarray) -> float | None:
    """Return the height [m] of the flat floor, or of the plane around one that is not flat, in the
    frame of the page; `None` without a floor.
    """
    relief = record.meta.surroundings.floor
    if relief is None:
        height = record.meta.surroundings.floor_z
    else:
        height = float(np.min(relief.z))
    if height is None:
        return None
    return float(height - centre[2])


def _relief(record: Record, centre: np.ndarray) -> dict[str, Any] | None:
    """Return the floor that is not flat, in the frame of the page."""
    relief = record.meta.surroundings.floor
    if relief is None:
        return None
    return {
        "x": (np.array(relief.x) - centre[0]).round(3).tolist(),
        "y": (np.array(relief.y) - centre[1]).round(3).tolist(),
        "z": (np.array(relief.z) - centre[2]).round(3).tolist(),
    }


def _robot_size(robot: Robot) -> float:
    """Return the radius [m] of a ball around the robot's shapes, about its first joint."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.configuration())
    distances = []
    for shape in robot.drawn_shapes:
        centre = data.oMi[shape.parentJoint].act(shape.placement.translation)
        distances.append(float(np.linalg.norm(centre - data.oMi[1].translation)))
    return max(distances, default=_SMALLEST) + _RIM


def _viewing_direction(record: Record, frames: Frames, *, forward: float) -> list[float]:
    """Return the direction to look from: the side of the run's horizontal way, `forward` of it and
    a little above.
    """
    end = surroundings.extent(record, frames)[-1]
    way = (end - frames.placements[0, 1, :3])[:2]
    length = float(np.linalg.norm(way))
    if length > _SHORT_WAY:
        ahead = way / length
    else:
        ahead = np.array([1.0, 0.0])
    side = np.array([ahead[1], -ahead[0]])
    x, y = (side + forward * ahead).tolist()
    return [x, y, 0.4 * float(np.hypot(1.0, forward))]


def legend(
    record: Record, trails: list[dict[str, Any]], ghosts: list[Ghost], *, beam: bool
) -> list[dict[str, Any]]:
    """Return JSON values: rows that show or hide nodes of the scene by their paths; the page adds
    arrows and witness lines.
    """
    rows: list[dict[str, Any]] = []

    def add(label: str, colour: str, path: list[str]) -> None:
        rows.append({"label": label, "colour": colour, "path": path})

    for trail in trails:
        add(f"path of the {trail['name']}", trail["colour"], trail["path"])
    if beam:
        add("altimeter", "#80ffe6", [*_SCENE, "beam"])
    if record.meta.surroundings.frames or record.meta.surroundings.markers:
        add("goals", "#f24d1a", [*_SCENE, "goals"])
    for ghost in ghosts:
        add(ghost.name, shapes.hex_of(ghost.rgb), [*_SCENE, ghost.node])
    return rows


def readouts(record: Record, frames: Frames) -> dict[str, Any]:
    """Return JSON values: ``times`` (n,) [s] of the frames and a row for each quantity; `None`
    where it is not known.
    """
    rows = []
    for k, name in enumerate(record.meta.quantities):
        values = record["quantities"][:, k]
        if np.isfinite(values).any():
            rows.append(readout(name, values[frames.row], record.meta))
    return {"times": frames.t.round(3).tolist(), "readouts": rows}


def readout(name: str, values: np.ndarray, meta: RecordMeta) -> dict[str, Any]:
    """Return JSON values: the row of a quantity with its values (n,) [its unit]."""
    task, _, quantity = name.rpartition(".")
    label = f"{task} {quantity.replace('_', ' ')}".strip()
    return {
        "task": task,
        "label": label,
        "unit": unit_of(name, meta=meta).strip("-"),
        "values": rounded(values),
    }


def time_line(record: Record) -> dict[str, list[dict[str, Any]]]:
    """Return JSON values of phases, faults, health of the sensors and alarms; times [s] since the
    record began.
    """
    begin = float(record["t"][0])
    tasks = {phase.name: list(phase.tasks) for phase in record.meta.phases}
    phases: list[dict[str, Any]] = []
    for phase in phase_spans(record):
        phases.append(
            {
                "name": phase.name,
                "title": phase.title,
                "index": phase.index,
                "tasks": tasks[phase.name],
                "start": phase.start - begin,
                "end": phase.end - begin,
            }
        )
    faults: list[dict[str, Any]] = []
    for fault in fault_spans(record):
        faults.append(
            {
                "name": fault.name,
                "ended": fault.ended,
                "start": fault.start - begin,
                "end": fault.end - begin,
            }
        )
    alarms = getattr(record.meta, "alarms", ())
    return {
        "phases": phases,
        "faults": faults,
        "health": list(_unhealthy_intervals(record)),
        "alarms": [{"t": alarm.t - begin, "text": alarm.text} for alarm in alarms],
    }


def _unhealthy_intervals(record: Record) -> Iterator[dict[str, Any]]:
    """Yield stays of a channel in a state that is not good."""
    if record.meta.kind != "run" or "health" not in record.series:
        return
    t = record["t"] - record["t"][0]
    for channel, codes in zip(record.meta.channels, record["health"].T, strict=True):
        for i, j, code in intervals_of(codes):
            if code:
                yield {
                    "channel": channel,
                    "state": Trust(code).name.lower(),
                    "start": float(t[i]),
                    "end": float(t[j]),
                }

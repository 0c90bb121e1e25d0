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
from uvms_ocp.viz.scene.animation import Frames, Ghost, joint_node, rounded
from uvms_ocp.viz.series import estimate_suffix, fault_spans, intervals_of, phase_spans

# What the page's script needs beside the commands of meshcat: where to look from, names of places,
# the floor.

_FAR = 12.0  # robot sizes; a longer mission opens with the camera on the vehicle
_LONGEST_SHOW = 60.0  # [s] beyond it playback begins sped up
_MOST_POINTS = 400  # about, that the camera is to see
_SHORT_WAY = 0.2  # [m] a shorter horizontal way has no direction
_SPEEDS = (0.25, 1, 2, 5, 10, 20, 50, 100)

_SCENE = ("meshcat", "scene")


def page_details(
    record: Record, robot: Robot, frames: Frames, centre: np.ndarray
) -> dict[str, Any]:
    """Return JSON values for the page; centre (3,) [m] in W is the origin of its frame."""
    points = surroundings.extent(record, frames)
    robot_values = robot_details(robot)
    duration = float(frames.t[-1])
    points = points[:: max(1, len(points) // _MOST_POINTS)] - centre
    fitting = (speed for speed in _SPEEDS if speed >= 1 and duration / speed <= _LONGEST_SHOW)
    is_far = np.linalg.norm(np.ptp(points, axis=0)) > _FAR * robot_values["size"]
    # Height [m] of the plane around a floor that is not flat, or of the flat floor, in the frame of
    # the page.
    relief = record.meta.surroundings.floor
    if relief is None:
        lowest = record.meta.surroundings.floor_z
    else:
        lowest = float(np.min(relief.z))
    return {
        "scenario": record.meta.scenario,
        "known": estimate_suffix(record).strip(),
        "duration": duration,
        "speed": next(fitting, _SPEEDS[-1]),
        "speeds": _SPEEDS,
        "floor": None if lowest is None else float(lowest - centre[2]),
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


def _relief(record: Record, centre: np.ndarray) -> dict[str, Any] | None:
    """Return the floor that is not flat, in the frame of the page."""
    relief = record.meta.surroundings.floor
    if relief is None:
        return None
    axes = zip("xyz", (relief.x, relief.y, relief.z), centre, strict=True)
    return {axis: (np.array(points) - middle).round(3).tolist() for axis, points, middle in axes}


def _robot_size(robot: Robot) -> float:
    """Return the radius [m] of a ball around the robot's shapes, about its first joint."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.configuration())
    centres = [
        data.oMi[shape.parentJoint].act(shape.placement.translation) for shape in robot.drawn_shapes
    ]
    return (
        max(
            (float(np.linalg.norm(centre - data.oMi[1].translation)) for centre in centres),
            default=0.3,
        )
        + 0.2
    )


def _viewing_direction(record: Record, frames: Frames, *, forward: float) -> list[float]:
    """Return the direction to look from: the side of the run's horizontal way, `forward` of it and
    a little above.
    """
    way = (surroundings.extent(record, frames)[-1] - frames.placements[0, 1, :3])[:2]
    length = float(np.linalg.norm(way))
    if length > _SHORT_WAY:
        forward_direction = way / length
    else:
        forward_direction = np.array([1.0, 0.0])
    side = np.array([forward_direction[1], -forward_direction[0]])
    return [*(side + forward * forward_direction).tolist(), 0.4 * float(np.hypot(1.0, forward))]


# What the page can show and hide, by name and colour.


def legend(
    record: Record, trails: list[dict[str, Any]], ghosts: list[Ghost], *, beam: bool
) -> list[dict[str, Any]]:
    """Return JSON values: rows that show or hide nodes of the scene by their paths; the page adds
    arrows and witness lines.
    """
    rows = [
        _row(f"path of the {trail['name']}", trail["colour"], trail["path"]) for trail in trails
    ]
    if beam:
        rows.append(_row("altimeter", "#80ffe6", [*_SCENE, "beam"]))
    if record.meta.surroundings.frames or record.meta.surroundings.markers:
        rows.append(_row("goals", "#f24d1a", [*_SCENE, "goals"]))
    rows += [_row(ghost.name, shapes.hex_of(ghost.rgb), [*_SCENE, ghost.node]) for ghost in ghosts]
    return rows


def _row(label: str, colour: str, path: list[str]) -> dict[str, Any]:
    return {"label": label, "colour": colour, "path": path}


# What the page writes beside the picture: every measured quantity of the record, own ones too.


def readouts(record: Record, frames: Frames) -> dict[str, Any]:
    """Return JSON values: ``times`` (n,) [s] of the frames and a row for each quantity; `None`
    where it is not known.
    """
    quantities = {name: record["quantities"][:, k] for k, name in enumerate(record.meta.quantities)}
    rows = [
        readout(name, values[frames.row], record.meta)
        for name, values in quantities.items()
        if np.isfinite(values).any()
    ]
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


# What stands on the time line of the page: phases, faults, health of the sensors, alarms.


def time_line(record: Record) -> dict[str, list[dict[str, Any]]]:
    """Return JSON values, times [s] since the record began."""
    start = float(record["t"][0])
    tasks = {phase.name: list(phase.tasks) for phase in record.meta.phases}
    return {
        "phases": [
            {"name": s.name, "title": s.title, "index": s.index, "tasks": tasks[s.name]}
            | _from(s.start, s.end, start)
            for s in phase_spans(record)
        ],
        "faults": [
            {"name": s.name, "ended": s.ended} | _from(s.start, s.end, start)
            for s in fault_spans(record)
        ],
        "health": list(_unhealthy_intervals(record)),
        "alarms": [{"t": a.t - start, "text": a.text} for a in getattr(record.meta, "alarms", ())],
    }


def _from(begin: float, end: float, start: float) -> dict[str, float]:
    return {"start": begin - start, "end": end - start}


def _unhealthy_intervals(record: Record) -> Iterator[dict[str, Any]]:
    """Yield stays of a channel in a state that is not good."""
    if record.meta.kind != "run" or "health" not in record.series:
        return
    t = record["t"] - record["t"][0]
    for channel, codes in zip(record.meta.channels, record["health"].T, strict=True):
        for i, j, code in intervals_of(codes):
            if code:
                yield {"channel": channel, "state": Trust(code).name.lower()} | _from(
                    float(t[i]), float(t[j]), 0.0
                )

"""The run in three dimensions: one HTML page that works offline, drawn with meshcat but without its server."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.collision.obstacle_file import ObstacleData
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.obstacles import Obstacle
from uvms_ocp.record import Record
from uvms_ocp.viz.meshcat_parts import AnimationClip, AnimationTrack, Visualizer
from uvms_ocp.viz.meshcat_parts import geometry as mg
from uvms_ocp.viz.series import floor_heights, phase_spans, quantity, require_rows
from uvms_ocp.viz.shapes import Y_TO_Z, draw_shape, draw_triad, material, shifted, tube
from uvms_ocp.viz.viewer import CommandLog, ScenePage, build_page

_MAX_POSES = 40_000  # joints times frames; keeps the page below 10 MB however long the run
_FAR = 12.0  # robot sizes; a longer mission opens with the camera on the vehicle
_LONGEST_SHOW = 60.0  # [s] beyond it playback begins sped up
_SHORT_WAY = 0.2  # [m] a shorter horizontal way has no direction
_SPEEDS = (1, 2, 5, 10, 20, 50, 100)
_TRAIL_STEP = 0.01  # [m] between points of a trail
_VEHICLE_TRAIL, _TOOL_TRAIL = (1.0, 0.82, 0.2), (0.95, 0.25, 0.55)
_MARKERS = ((0.95, 0.3, 0.1), (0.2, 0.85, 0.45), (0.95, 0.85, 0.2), (0.6, 0.4, 0.9))
_OBSTACLE = np.array([0.85, 0.45, 0.2, 0.55])
_BEAM = (0.5, 1.0, 0.9)
_READOUTS = (
    ("LA.altitude", "altitude", "m"),
    ("PC.position_error", "to way point", "m"),
    ("AT.misalignment", "misalignment", "rad"),
    ("T.position_error", "tool error", "m"),
    ("plan.clearance", "clearance", "m"),
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Frames:
    """The record thinned to the frames of the animation."""

    row: np.ndarray  # (n,) rows of the record
    t: np.ndarray  # (n,) [s] since the record began
    placements: np.ndarray  # (n, n_joints_of_the_model, 7) X_W,joint as position and quaternion xyzw
    tool: np.ndarray | None  # (n, 3) [m] p_WT
    altimeter: np.ndarray | None  # (n, 7) X_WS


def write_scene(record: Record, robot: Robot, path: Path | str, fps: float = 25) -> Path:
    """Write the animated scene as one HTML file without outside references; returns its path.

    Raises `InvalidInput` where the record is not of this robot, and `OutputError`.
    """
    return show(record, robot, fps=fps).write(path)


def show(record: Record, robot: Robot, *, fps: float = 25, height: int = 520) -> ScenePage:
    """The same scene as a value that a notebook displays in a frame `height` [px] high."""
    _check(record, robot, fps)
    frames = _frames(record, robot, fps)
    centre = _centre(record, frames)
    log = CommandLog()
    root = log.visualizer()["scene"]
    root.set_transform(shifted(-centre))  # keeps 32-bit floats exact and the lights near
    _draw_robot(root["robot"], robot)
    trails = _draw_trails(root["trails"], robot, frames)
    _draw_goals(root["goals"], record)
    for i, item in enumerate(_obstacles(record)):
        draw_shape(root["obstacles"][f"{i:03d}"]["shape"], item.shape, _OBSTACLE)
        root["obstacles"][f"{i:03d}"].set_transform(item.X_WO.homogeneous)
    clips = {root["robot"][_joint_node(robot.model, j)].path: clip for j, clip in _joint_clips(robot, frames, fps)}
    if frames.altimeter is not None and "altimeter_range" in record.series:
        _draw_beam(root["beam"])
        clips[root["beam"].path] = _beam_clip(frames, record["altimeter_range"][frames.row], fps)
    log.animate(clips)
    details = _details(record, robot, frames, centre) | {"trails": trails}
    return build_page(log, title=_title(record), details=details, height=height)


def _check(record: Record, robot: Robot, fps: float) -> None:
    require_rows(record)
    if not (np.isfinite(fps) and fps > 0):
        raise InvalidInput(f"fps = {fps}; give a finite number > 0")
    if record["q"].shape[1] != robot.n_q:
        given = record["q"].shape[1]
        raise InvalidInput(f"record has {given} configuration values, {robot.name} has {robot.n_q}; give its own robot")


def _frames(record: Record, robot: Robot, fps: float) -> Frames:
    t = record["t"] - record["t"][0]
    n = max(2, min(int(np.ceil(t[-1] * fps)) + 1, _MAX_POSES // robot.model.njoints))
    row = np.unique(np.searchsorted(t, np.linspace(0.0, t[-1], n) - 1e-9))
    data = robot.model.createData()
    placements, tool, altimeter = [], [], []
    for q in record["q"][row]:
        pin.framesForwardKinematics(robot.model, data, q)
        placements.append([pin.SE3ToXYZQUAT(X) for X in data.oMi])
        tool += [pin.SE3ToXYZQUAT(X) for X in _frame_pose(robot, data, "tool")]
        altimeter += [pin.SE3ToXYZQUAT(X) for X in _frame_pose(robot, data, "altimeter")]
    return Frames(
        row=row,
        t=t[row],
        placements=np.array(placements),
        tool=np.array(tool)[:, :3] if tool else None,
        altimeter=np.array(altimeter) if altimeter else None,
    )


def _frame_pose(robot: Robot, data: pin.Data, name: str) -> Iterator[pin.SE3]:
    if robot.has_frame(name):
        yield data.oMf[robot.frame_id(name)]


def _centre(record: Record, frames: Frames) -> np.ndarray:
    """Middle (3,) [m] of all that moves and all goals, on the floor where there is one."""
    points = _extent(record, frames)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return np.array([middle[0], middle[1], record.meta.get("floor_z", middle[2])])


def _extent(record: Record, frames: Frames) -> np.ndarray:
    """Points (n, 3) [m] that the camera must see."""
    markers = np.array([*record.meta.get("markers", {}).values()]).reshape(-1, 3)
    obstacles = np.array([item.X_WO.translation for item in _obstacles(record)]).reshape(-1, 3)
    return np.vstack([frames.placements[:, 1:, :3].reshape(-1, 3), obstacles, markers])


def _title(record: Record) -> str:
    return f"{record.meta.get('scenario', 'run')}: {record.meta.get('robot', '')}"


# Robot


def _joint_node(model: pin.Model, joint: int) -> str:
    return f"{joint:02d} {model.names[joint]}".replace("/", "_")


def _draw_robot(node: Visualizer, robot: Robot) -> None:
    for i, item in enumerate(robot.visual_model.geometryObjects):
        shape = node[_joint_node(robot.model, item.parentJoint)][f"{i:03d} {item.name}".replace("/", "_")]
        if draw_shape(shape["shape"], item.geometry, np.asarray(item.meshColor)):
            shape.set_transform(item.placement.homogeneous)


def _joint_clips(robot: Robot, frames: Frames, fps: float) -> Iterator[tuple[int, AnimationClip]]:
    for joint in range(1, robot.model.njoints):
        yield joint, _clip(_pose_tracks(frames.t * fps, frames.placements[:, joint]), fps)


def _clip(tracks: list[AnimationTrack], fps: float) -> AnimationClip:
    return AnimationClip(tracks={track.name: track for track in tracks}, fps=fps)


def _pose_tracks(time: np.ndarray, poses: np.ndarray) -> list[AnimationTrack]:
    return [
        _track("position", "vector3", time, poses[:, :3]),
        _track("quaternion", "quaternion", time, poses[:, 3:]),
    ]


def _track(name: str, kind: str, time: np.ndarray, values: np.ndarray) -> AnimationTrack:
    """Inner keys of stretches without motion are left out."""
    same = np.all(np.isclose(values[1:], values[:-1], rtol=0, atol=1e-7), axis=1)
    keep = ~np.concatenate([[False], same[:-1] & same[1:], [False]])
    return AnimationTrack(name, kind, frames=time[keep].tolist(), values=values[keep].tolist())


# What the sensors see, where the robot has been, where it goes


def _draw_beam(node: Visualizer) -> None:
    """The altimeter's beam of length 1 along -z of its frame; the clip scales it to the range."""
    node["ray"].set_object(mg.Cylinder(1.0, radiusTop=0.008, radiusBottom=0.05), _glow(_BEAM, 0.28))
    node["ray"].set_transform(shifted(np.array([0.0, 0.0, -0.5])) @ Y_TO_Z)


def _beam_clip(frames: Frames, reach: np.ndarray, fps: float) -> AnimationClip:
    length = np.where(np.isfinite(reach), reach, 1e-3)
    scale = np.column_stack([np.ones((len(length), 2)), length])
    time = frames.t * fps
    tracks = [] if frames.altimeter is None else _pose_tracks(time, frames.altimeter)
    return _clip([*tracks, _track("scale", "vector3", time, scale)], fps)


def _glow(rgb: tuple[float, ...], opacity: float) -> mg.MeshBasicMaterial:
    red, green, blue = (round(255 * x) for x in rgb)
    return mg.MeshBasicMaterial(color=(red << 16) + (green << 8) + blue, opacity=opacity, transparent=opacity < 1)


def _draw_trails(node: Visualizer, robot: Robot, frames: Frames) -> list[dict[str, Any]]:
    """Tubes along the paths of vehicle and tool; the page reveals them up to the time shown."""
    paths = {"vehicle": (frames.placements[:, 1, :3] if robot.n_vehicle else None, _VEHICLE_TRAIL, 0.018)}
    paths["tool"] = (frames.tool, _TOOL_TRAIL, 0.011)
    trails = []
    for name, (points, rgb, radius) in paths.items():
        kept = None if points is None else _spaced(points)
        if points is not None and kept is not None and len(kept) > 2:
            node[name].set_object(tube(points[kept], radius), _glow(rgb, 1.0))
            trails.append({"name": name, "path": ["meshcat", "scene", "trails", name], "t": frames.t[kept].tolist()})
    return trails


def _spaced(points: np.ndarray) -> np.ndarray:
    """Indices of points at least a step apart."""
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.unique(travelled // _TRAIL_STEP, return_index=True)[1]


def _draw_goals(node: Visualizer, record: Record) -> None:
    for i, (name, point) in enumerate(record.meta.get("markers", {}).items()):
        rgb = _MARKERS[i % len(_MARKERS)]
        node[name]["ball"].set_object(mg.Sphere(0.06), material((*rgb, 0.75)))
        node[name].set_transform(shifted(np.asarray(point)))
        floor = floor_heights(record, np.array([point[:2]]))
        if floor is not None and point[2] - floor[0] > 0.2:
            _draw_plumb(node[name]["plumb"], point[2] - floor[0], rgb)
    for name, pose in record.meta.get("frames", {}).items():
        draw_triad(node[f"frame {name}"], 0.35)
        node[f"frame {name}"].set_transform(pin.XYZQUATToSE3(np.asarray(pose, dtype=float)).homogeneous)


def _obstacles(record: Record) -> Iterator[Obstacle]:
    return (ObstacleData.model_validate(values).build() for values in record.meta.get("obstacles", ()))


def _draw_plumb(node: Visualizer, height: float, rgb: tuple[float, ...]) -> None:
    """A thin rod down to the floor, which gives depth to a marker in mid-water."""
    node["rod"].set_object(mg.Box([0.012, 0.012, height]), _glow(rgb, 0.5))
    node.set_transform(shifted(np.array([0.0, 0.0, -height / 2])))


# What the page's script needs besides the meshcat commands


def _details(record: Record, robot: Robot, frames: Frames, centre: np.ndarray) -> dict[str, Any]:
    meta = record.meta
    start = float(record["t"][0])
    duration = float(frames.t[-1])
    points, size = _thinned(_extent(record, frames)) - centre, _robot_size(robot)
    far = np.linalg.norm(np.ptp(points, axis=0)) > _FAR * size
    return {
        "scenario": meta.get("scenario", ""),
        "robot": meta.get("robot", robot.name),
        "duration": duration,
        "speed": next((s for s in _SPEEDS if duration / s <= _LONGEST_SHOW), _SPEEDS[-1]),
        "speeds": _SPEEDS,
        "floor": None if "floor_z" not in meta else float(_lowest_floor(record) - centre[2]),
        "relief": _relief(record, centre),
        "phases": [
            {"name": s.name, "title": s.title, "index": s.index, "start": s.start - start, "end": s.end - start}
            for s in phase_spans(record)
        ],
        "labels": [
            {"text": name, "position": (np.asarray(point) - centre).tolist()}
            for name, point in meta.get("markers", {}).items()
        ],
        "points": points.tolist(),
        "size": size,
        "start_view": "vehicle" if far and robot.n_vehicle else "mission",
        "direction": _viewing_direction(record, frames, forward=0.4),
        "close_direction": _viewing_direction(record, frames, forward=1.2),
        "views": ["mission", "vehicle", "tool"] if robot.n_vehicle else ["mission", "tool"],
        "body": ["meshcat", "scene", "robot", _joint_node(robot.model, 1)],
        "hand": ["meshcat", "scene", "robot", _joint_node(robot.model, robot.model.njoints - 1)],
        "readouts": _readouts(record, frames),
    }


def _lowest_floor(record: Record) -> float:
    """Height [m] of the plane around a floor that is not flat, or of the flat floor."""
    relief = record.meta.get("floor")
    return float(record.meta["floor_z"]) if relief is None else float(np.min(relief["z"]))


def _relief(record: Record, centre: np.ndarray) -> dict[str, Any] | None:
    """The floor that is not flat, in the frame of the page."""
    relief = record.meta.get("floor")
    if relief is None:
        return None
    values = {axis: (np.array(relief[axis]) - centre[k]).round(3) for k, axis in enumerate("xyz")}
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
    points = _extent(record, frames)
    way = (points[-1] - frames.placements[0, 1, :3])[:2]
    length = float(np.linalg.norm(way))
    ahead = way / length if length > _SHORT_WAY else np.array([1.0, 0.0])
    side = np.array([ahead[1], -ahead[0]])
    return [*(side + forward * ahead).tolist(), 0.4 * float(np.hypot(1.0, forward))]


def _readouts(record: Record, frames: Frames) -> list[dict[str, Any]]:
    """Measured quantities at the times of the frames, rounded for the page."""
    shown = []
    for name, label, unit in _READOUTS:
        values = quantity(record, name)
        if values is not None:
            rounded = [float(f"{value:.3g}") for value in np.nan_to_num(values[frames.row])]
            shown.append({"label": label, "unit": unit, "values": rounded})
    return shown if not shown else [{"label": "", "unit": "", "values": frames.t.round(3).tolist()}, *shown]

"""Animate the robot and its altimeter's beam, from a record thinned to frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.roles import ALTIMETER, TOOL
from uvms_ocp.robot.spatial import continuous_quaternions
from uvms_ocp.viz.scene.colours import BEAM
from uvms_ocp.viz.scene.page import AnimationClip, AnimationTrack, Visualizer, geometry as mg
from uvms_ocp.viz.scene.shapes import Y_TO_Z, draw_shape, glow, shifted
from uvms_ocp.viz.series import require_rows
from uvms_ocp.viz.time_spans import phase_spans

_MAX_POSES = 25_000  # joints times frames; keeps the page below 5 MB however long the run
_MISSED = 5e-4  # [m, -] by which straight lines between keys of a track may miss it


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Frames:
    """The record thinned to the frames of the animation."""

    row: np.ndarray
    """Rows (n,) of the record."""
    t: np.ndarray
    """Times (n,) [s] since the record began."""
    placements: np.ndarray
    """Poses X_W,joint (n, n_joints_of_the_model, 7) as position [m] and quaternion xyzw."""
    tools: Mapping[str, np.ndarray]
    """Positions p_WT (n, 3) [m] of each tool, by its name where there are several."""
    altimeter: np.ndarray | None
    """Poses X_WS (n, 7) as position [m] and quaternion xyzw."""


def frames_of(record: Record, robot: Robot, fps: float) -> Frames:
    """Return the frames of an animation of `fps` frames per second [Hz], fewer where the page would
    grow too large.
    """
    t = record["t"] - record["t"][0]
    n = max(2, min(int(np.ceil(t[-1] * fps)) + 1, _MAX_POSES // robot.model.njoints))
    row = np.unique(np.searchsorted(t, np.linspace(0.0, t[-1], n) - 1e-9))
    data = robot.model.createData()
    names = dict.fromkeys(robot.tools)  # each once, in their order
    if robot.has_frame(ALTIMETER):
        names[ALTIMETER] = None
    placements = list[Any]()
    poses_by_frame = {name: list[Any]() for name in names}
    for q in record["q"][row]:
        pin.framesForwardKinematics(robot.model, data, q)
        placements.append([pin.SE3ToXYZQUAT(X) for X in data.oMi])
        for name, poses in poses_by_frame.items():
            poses.append(pin.SE3ToXYZQUAT(data.oMf[robot.frame_id(name)]))
    tools = {}
    for name in robot.tools:
        label = name if len(robot.tools) > 1 else TOOL
        tools[label] = np.array(poses_by_frame[name])[:, :3]
    altimeter = None
    if ALTIMETER in poses_by_frame:
        altimeter = np.array(poses_by_frame[ALTIMETER])
    return Frames(
        row=row,
        t=t[row],
        placements=np.array(placements),
        tools=tools,
        altimeter=altimeter,
    )


def joint_node(model: pin.Model, joint: int) -> str:
    """Return the name of a joint's node."""
    return f"{joint:02d} {model.names[joint]}".replace("/", "_")


def draw_robot(node: Visualizer, robot: Robot, rgba: tuple[float, ...] | None = None) -> None:
    """Draw all shapes, each below the node of the joint that moves it; rgba (4,) in place of their
    own colours.
    """
    for i, item in enumerate(robot.drawn_shapes):
        joint = node[joint_node(robot.model, item.parentJoint)]
        shape = joint[f"{i:03d} {item.name}".replace("/", "_")]
        colour = item.meshColor if rgba is None else rgba
        is_drawn = draw_shape(shape["shape"], item.geometry, np.asarray(colour))
        if is_drawn:
            shape.set_transform(item.placement.homogeneous)


def rounded(values: np.ndarray, digits: int = 3) -> Any:
    """Return lists of lists for the page, of so many significant digits; values (...) [any]; `None`
    for what is not finite.
    """
    if values.ndim:
        return [rounded(value, digits) for value in values]
    if np.isfinite(values):
        return float(f"{values:.{digits}g}")
    return None


def joint_clips(robot: Robot, frames: Frames, fps: float) -> Iterator[tuple[int, AnimationClip]]:
    """Return how each joint of the model, by number, moves at `fps` [Hz]."""
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
    """Return a track without keys that straight lines between the others miss by `_MISSED` at most
    [Douglas and Peucker].
    """
    is_kept = np.isin(np.arange(len(time)), (0, len(time) - 1))
    stretches = [(0, len(time) - 1)]
    while stretches:
        a, b = stretches.pop()
        share = (time[a + 1 : b, None] - time[a]) / (time[b] - time[a])
        missed = np.abs(values[a] + share * (values[b] - values[a]) - values[a + 1 : b]).max(axis=1)
        if missed.max(initial=0.0) > _MISSED:
            k = a + 1 + int(missed.argmax())
            is_kept[k] = True
            stretches = [*stretches, (a, k), (k, b)]
    return AnimationTrack(
        name, kind, frames=time[is_kept].tolist(), values=values[is_kept].tolist()
    )


def goal_clips(record: Record, frames: Frames, fps: float) -> Iterator[tuple[str, AnimationClip]]:
    """Return how each goal that moves does at `fps` [Hz], by the name of its node; one of a phase
    waits there for the next visit.
    """
    for i, frame in enumerate(record.meta.surroundings.frames):
        if not frame.way:
            continue
        if frame.phase is None:
            elapsed = frames.t
        else:
            elapsed = _time_in_phase(record, frame.phase, frames.t)
        motion = np.array(frame.way)
        motion[:, 4:] = continuous_quaternions(motion[:, 4:])  # the short way round
        columns = [np.interp(elapsed, motion[:, 0], column) for column in motion[:, 1:].T]
        poses = np.column_stack(columns)
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
        yield f"frame {i}", _clip(_pose_tracks(frames.t * fps, poses), fps)


def _time_in_phase(record: Record, phase: str, t: np.ndarray) -> np.ndarray:
    """Return for times t (n,) [s] how long [s] the last stay in a phase had lasted; at most as long
    as it did, 0 before the first.
    """
    elapsed = np.zeros(len(t))
    for span in phase_spans(record):
        if span.name == phase:
            has_begun = t >= span.start
            elapsed[has_begun] = np.minimum(t[has_begun], span.end) - span.start
    return elapsed


def draw_beam(node: Visualizer) -> None:
    """Draw the altimeter's beam of length 1 along -z of its frame, which the clip scales."""
    node["ray"].set_object(mg.Cylinder(1.0, radiusTop=0.008, radiusBottom=0.05), glow(BEAM, 0.28))
    node["ray"].set_transform(shifted(np.array([0.0, 0.0, -0.5])) @ Y_TO_Z)


def beam_clip(frames: Frames, reach: np.ndarray, fps: float) -> AnimationClip:
    """Return how the beam of `draw_beam` moves at `fps` [Hz]; reach (n,) [m] is its length at each
    frame.
    """
    length = np.where(np.isfinite(reach), reach, 1e-3)
    scale = np.column_stack([np.ones((len(length), 2)), length])
    time = frames.t * fps
    if frames.altimeter is None:
        tracks = []
    else:
        tracks = _pose_tracks(time, frames.altimeter)
    return _clip([*tracks, _track("scale", "vector3", time, scale)], fps)


def require_fit(record: Record, robot: Robot) -> None:
    """Raise `InvalidInput` where the record is not of that robot, or has nothing to draw."""
    require_rows(record)
    if record["q"].shape[1] != robot.n_q:
        n_values = record["q"].shape[1]
        raise InvalidInput(
            f"record has {n_values} configuration values, {robot.name} has {robot.n_q}; give its"
            " own robot"
        )

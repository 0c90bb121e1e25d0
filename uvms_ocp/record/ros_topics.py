"""Topics of a record in types of ROS 2, which Foxglove knows too, with messages encoded as CDR: poses
as transforms and odometry, states of joints, wrenches, and a log.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

import numpy as np

from uvms_ocp.record import run_meta
from uvms_ocp.record.tables import Series

_TABLE = (files("uvms_ocp.record") / "ros_messages.csv").read_text(encoding="utf-8").splitlines()
ROS_MESSAGES: Mapping[str, str] = {
    row["type"]: row["fields"].replace("; ", "\n") for row in csv.DictReader(_TABLE)
}
"""Fields of the types of ROS 2 that are written."""
CDR_HEAD = np.array([0, 1, 0, 0], dtype="u1")
"""First four bytes of a message: plain CDR, little endian."""
_NEXT_DEFINITION = "=" * 80 + "\nMSG: "

Part = str | np.ndarray
"""Part of messages: a text or an array (m,), the same in all, or an array (n, m) with a row for each."""

WORLD = "world"
VEHICLE = "base_link"
_POSES = {"q": VEHICLE, "q_estimated": f"{VEHICLE}_estimated", "tool": "tool"}
"""Series that begin with a pose in W, and the frame that has it."""
_ODOMETRY = {
    "odometry": ("q", "v", ""),
    "odometry_estimated": ("q_estimated", "v_estimated", "q_std"),
}
"""Topics with their pose, velocity, and standard deviations of the pose."""
_WRENCHES = ("wrench", "unreachable", "disturbance")
"""Series that begin with a wrench on the vehicle, in its frame."""
_POSE = 7  # entries of a pose: position and quaternion
_TWIST = 6  # entries of a twist or wrench: linear and angular
# levels of rcl_interfaces/Log
_INFO = 20
_WARN = 30
_ERROR = 40

_NO_TIME_LIMIT = "{sec: 9223372036, nsec: 854775807}"
_RELIABILITY = "history: 1, depth: 1, reliability: 1, durability: 1"
_DEADLINES = f"deadline: {_NO_TIME_LIMIT}, lifespan: {_NO_TIME_LIMIT}"
_LIVELINESS = f"liveliness: 1, liveliness_lease_duration: {_NO_TIME_LIMIT}"
_NAMESPACES = "avoid_ros_namespace_conventions: false"
_LATCHED = {
    "offered_qos_profiles": f"- {{{_RELIABILITY}, {_DEADLINES}, {_LIVELINESS}, {_NAMESPACES}}}"
}
"""Quality of service of messages that are published once, for those who subscribe later too."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """Messages of one type: one for each tick, or a single one at the start where no part has rows."""

    name: str
    """Name of the topic."""
    kind: str
    """Type, of `ROS_MESSAGES` unless it has a definition of its own."""
    parts: Sequence[Part]
    """Parts of the messages, in order."""
    definition: str = ""
    """Definition of a type that ROS does not have."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """Metadata of the channel in the file."""

    def messages(self, rows: slice) -> np.ndarray:
        """Encode the messages of these rows; the single message of a topic without rows comes with
        the first of them.
        """
        n = int(rows.start == 0)
        parts = list[Part]()
        for part in self.parts:
            if isinstance(part, np.ndarray) and part.ndim > 1:
                part = part[rows]
                n = len(part)
            parts.append(part)
        return cdr_messages(n, parts)


def stamps(t: np.ndarray) -> np.ndarray:
    """Return time stamps (n, 2) [s, ns] of times t (n,) [ns]."""
    return np.stack([t // 10**9, t % 10**9], axis=1).astype("u4")


def topics(series: Series, meta: Any, t: np.ndarray, urdf: str | None) -> Iterator[Topic]:
    """Yield all topics that a record can fill, at t (n,) [ns]; urdf: text of the robot's
    description.
    """
    if urdf is not None:
        yield Topic(
            name="/robot_description", kind="std_msgs/String", parts=(urdf,), metadata=_LATCHED
        )
    floating = run_meta.is_floating(series, meta)
    time_stamps = stamps(t)
    yield from _transform_topics(series, meta, time_stamps, floating=floating)
    if floating:
        yield from _odometry_topics(series, time_stamps)
    yield from _joint_topics(series, meta, time_stamps)
    if floating:
        yield from _wrench_topics(series, time_stamps)


def _transform_topics(
    series: Series, meta: Any, time_stamps: np.ndarray, *, floating: bool
) -> Iterator[Topic]:
    """Yield the poses of vehicle, its estimate and tool at every tick, and those of goals that
    stay.
    """
    poses = dict[str, np.ndarray]()
    for name, frame in _POSES.items():
        if name in series and (floating or name == "tool"):
            poses[frame] = series[name][:, :_POSE]
    if poses:
        yield Topic(name="/tf", kind="tf2_msgs/TFMessage", parts=_transforms(time_stamps, poses))
    frames = meta.surroundings.frames
    if frames:
        goals = {frame.name: np.array(frame.pose) for frame in frames if not frame.way}
        yield Topic(
            name="/tf_static",
            kind="tf2_msgs/TFMessage",
            parts=_transforms(time_stamps[0], goals),
            metadata=_LATCHED,
        )


def _transforms(time_stamps: np.ndarray, poses: Mapping[str, np.ndarray]) -> list[Part]:
    """Return the parts of a message of transforms from the world, one for each frame."""
    parts: list[Part] = [_count(len(poses))]
    for frame, pose in poses.items():
        parts += [time_stamps, WORLD, frame, pose]
    return parts


def _odometry_topics(series: Series, time_stamps: np.ndarray) -> Iterator[Topic]:
    """Yield pose and velocity of the vehicle, true and estimated, with the covariance of its pose
    where an estimator gave it.
    """
    for topic_name, (q, v, std) in _ODOMETRY.items():
        if q not in series or v not in series:
            continue
        pose = series[q][:, :_POSE]
        velocity = series[v][:, :_TWIST]
        if std in series:
            pose_covariance = _covariance(pose, series[std])
        else:
            pose_covariance = np.zeros(_TWIST**2)
        velocity_covariance = np.zeros(_TWIST**2)
        yield Topic(
            name=f"/{topic_name}",
            kind="nav_msgs/Odometry",
            parts=(
                time_stamps,
                WORLD,
                VEHICLE,
                pose,
                pose_covariance,
                velocity,
                velocity_covariance,
            ),
        )


def _covariance(poses: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Return covariances (n, 36) along the axes of W, from standard deviations (n, 6...) of the
    position along W's axes and of the attitude along B's, at poses (n, 7).
    """
    from scipy.spatial.transform import Rotation

    axes = np.tile(np.eye(_TWIST), (len(std), 1, 1))
    axes[:, 3:, 3:] = Rotation.from_quat(poses[:, 3:]).as_matrix()
    return ((axes * std[:, None, :_TWIST] ** 2) @ axes.transpose(0, 2, 1)).reshape(len(std), -1)


def _joint_topics(series: Series, meta: Any, time_stamps: np.ndarray) -> Iterator[Topic]:
    """Yield positions, velocities and torques of the joints; arrays of none where one is not
    recorded.
    """
    if not meta.joints:
        return
    positions = run_meta.joint_positions(series, meta)
    if positions is None:
        return
    n = len(meta.joints)
    parts: list[Part] = [time_stamps, WORLD, _count(n), *meta.joints]
    for array in (positions, series.get("v"), series.get("torque")):
        values = np.empty(0)
        if array is not None:
            values = array[:, -n:]
        parts += [_count(values.shape[-1]), values]
    yield Topic(name="/joint_states", kind="sensor_msgs/JointState", parts=parts)


def _wrench_topics(series: Series, time_stamps: np.ndarray) -> Iterator[Topic]:
    """Yield the wrenches on the vehicle that are recorded."""
    for name in _WRENCHES:
        if name in series:
            yield Topic(
                name=f"/{name}",
                kind="geometry_msgs/WrenchStamped",
                parts=(time_stamps, VEHICLE, series[name][:, :_TWIST]),
            )


def log_messages(meta: Any) -> list[tuple[float, bytes]]:
    """List events, alarms and faults of a run in order of time, each with its time [s]."""
    entries = list[tuple[float, bytes]]()
    for event in getattr(meta, "events", ()):
        text = f"{event.source} to {event.target}: {event.reason}"
        entries.append((event.t, _log_message(event.t, _INFO, text)))
    for alarm in getattr(meta, "alarms", ()):
        entries.append((alarm.t, _log_message(alarm.t, _WARN, alarm.text)))
    for fault in getattr(meta, "faults", ()):
        entries.append((fault.t, _log_message(fault.t, _ERROR, fault.text)))
    return sorted(entries, key=lambda entry: entry[0])


def _log_message(t: float, level: int, text: str) -> bytes:
    """Encode a line of the log at a time t [s]."""
    time_stamp = stamps(np.array([round(1e9 * t)]))
    log_level = np.array([level], dtype="u1")
    node_name = file_name = function_name = ""
    parts = (time_stamp, log_level, node_name, text, file_name, function_name, _count(0))
    return cdr_messages(1, parts).tobytes()


def ros_definition(kind: str) -> str:
    """Return the definition of a type of messages: its fields, then those of all types in it."""
    inner_definitions = dict[str, str]()
    pending = [kind]
    while pending:
        inner_kinds = list[str]()
        for word in re.split(r"[\s\[\]]+", ROS_MESSAGES[pending.pop()]):
            if word in ROS_MESSAGES and word != kind and word not in inner_definitions:
                inner_kinds.append(word)
        for name in inner_kinds:
            inner_definitions[name] = ROS_MESSAGES[name]
        pending += inner_kinds
    texts = [ROS_MESSAGES[kind]]
    texts += [f"{name}\n{text}" for name, text in inner_definitions.items()]
    return f"\n{_NEXT_DEFINITION}".join(texts)


def cdr_messages(n: int, parts: Iterable[Part]) -> np.ndarray:
    """Encode n messages (n, size) [B] of the same parts: behind a head of four bytes, every number is
    aligned to a multiple of its size.
    """
    arrays = list[np.ndarray]()
    for part in parts:
        if isinstance(part, str):
            text = np.frombuffer(part.encode() + b"\0", dtype="u1")
            arrays += [_count(len(text)), text]
        else:
            arrays.append(part)
    blocks = [np.tile(CDR_HEAD, (n, 1))]
    size = 0
    for values in arrays:
        rows = np.broadcast_to(values, (n, np.shape(values)[-1]))
        gap = -size % rows.itemsize if rows.shape[1] else 0
        encoded = np.ascontiguousarray(rows, dtype=rows.dtype.newbyteorder("<")).view("u1")
        blocks += [np.zeros((n, gap), dtype="u1"), encoded]
        size += gap + encoded.shape[1]
    return np.hstack(blocks)


def _count(n: int) -> np.ndarray:
    """Return the length of a sequence, which is written before it."""
    return np.array([n], dtype="u4")

"""What Foxglove draws by itself: poses as transforms, states of joints, wrenches, and what was said."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from uvms_ocp.run_meta import is_floating

Series = Mapping[str, np.ndarray]
WORLD, VEHICLE = "world", "base_link"
_POSES = {"q": VEHICLE, "q_measured": f"{VEHICLE}_estimated", "tool": "tool"}
"""Series that begin with a pose in W, and the frame that has it."""
_WRENCHES = ("wrench", "unreachable", "disturbance")
_POSE, _WRENCH = 7, 6


@dataclass(frozen=True, kw_only=True, slots=True)
class Stream:
    """One topic."""

    topic: str
    at: Callable[[int, Any], Any]
    """The message of a tick [-], of that time stamp."""
    once: bool = False
    """Whether it is told at the first tick alone."""


def stamp(nanoseconds: int) -> Any:
    """A time stamp."""
    from google.protobuf.timestamp_pb2 import Timestamp

    return Timestamp(seconds=nanoseconds // 10**9, nanos=nanoseconds % 10**9)


def streams(series: Series, meta: Any) -> Iterator[Stream]:
    """All topics that a record can fill."""
    floating = is_floating(series, meta)
    poses = {frame: series[name] for name, frame in _POSES.items() if name in series and (floating or name == "tool")}
    if poses:
        yield Stream(topic="/tf", at=partial(_transforms, poses))
    if meta.surroundings.frames:
        goals = {frame.name: np.array([frame.pose]) for frame in meta.surroundings.frames}
        yield Stream(topic="/goals", at=partial(_transforms, goals), once=True)
    if "q" in series and len(meta.joints) and _n_joints(series, floating) == len(meta.joints):
        yield Stream(topic="/joint_states", at=partial(_joints, series, tuple(meta.joints)))
    if floating:
        for name in _WRENCHES:
            if name in series:
                yield Stream(topic=f"/{name}", at=partial(_wrench, wrench_class(), series[name]))


def _n_joints(series: Series, floating: bool) -> int:
    return int(series["q"].shape[1]) - (_POSE if floating else 0)


def _transforms(poses: Mapping[str, np.ndarray], k: int, when: Any) -> Any:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    found = FrameTransforms()
    for frame, rows in poses.items():
        x, y, z, *turn = rows[k, :_POSE].tolist()
        one = FrameTransform(timestamp=when, parent_frame_id=WORLD, child_frame_id=frame)
        one.translation.x, one.translation.y, one.translation.z = x, y, z
        one.rotation.x, one.rotation.y, one.rotation.z, one.rotation.w = turn
        found.transforms.append(one)
    return found


def _joints(series: Series, names: Sequence[str], k: int, when: Any) -> Any:
    from foxglove_schemas_protobuf.JointState_pb2 import JointState
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

    n = len(names)
    told = {"position": "q", "velocity": "v", "effort": "torque"}
    columns = {key: series[name][k, -n:].tolist() for key, name in told.items() if name in series}
    joints = [JointState(name=name, **{key: row[i] for key, row in columns.items()}) for i, name in enumerate(names)]
    return JointStates(timestamp=when, joints=joints)


def _wrench(made: Any, rows: np.ndarray, k: int, when: Any) -> Any:
    found = made(timestamp=when, frame_id=VEHICLE)
    values = rows[k, :_WRENCH].tolist()
    found.force.x, found.force.y, found.force.z, found.torque.x, found.torque.y, found.torque.z = values
    return found


def wrench_class() -> Any:
    """The class of messages with a force [N] and a torque [N m], for which Foxglove has none."""
    from foxglove_schemas_protobuf import Vector3_pb2
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    needed = (Vector3_pb2.DESCRIPTOR.name, timestamp_pb2.DESCRIPTOR.name)
    file = descriptor_pb2.FileDescriptorProto(
        name="uvms_ocp/Wrench.proto", package="uvms_ocp", syntax="proto3", dependency=needed
    )
    message, own = file.message_type.add(name="Wrench"), descriptor_pb2.FieldDescriptorProto
    once = own.Label.Value("LABEL_OPTIONAL")
    kinds = {"timestamp": ".google.protobuf.Timestamp", "force": ".foxglove.Vector3", "torque": ".foxglove.Vector3"}
    for number, (name, kind) in enumerate(kinds.items(), start=1):
        message.field.add(name=name, number=number, type=own.Type.Value("TYPE_MESSAGE"), type_name=kind, label=once)
    message.field.add(name="frame_id", number=4, type=own.Type.Value("TYPE_STRING"), label=once)
    pool = descriptor_pool.Default()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("uvms_ocp.Wrench"))


def log_messages(meta: Any) -> list[tuple[float, Any]]:
    """What was said during a run, in order of time, each with its time [s]."""
    from foxglove_schemas_protobuf.Log_pb2 import Log

    events = [(e.t, Log.INFO, f"{e.source} to {e.target}: {e.reason}") for e in getattr(meta, "events", ())]
    alarms = [(alarm.t, Log.WARNING, alarm.text) for alarm in getattr(meta, "alarms", ())]
    faults = [(fault.t, Log.ERROR, fault.text) for fault in getattr(meta, "faults", ())]
    told = sorted([*events, *alarms, *faults], key=lambda entry: entry[0])
    return [(t, Log(timestamp=stamp(round(1e9 * t)), level=level, message=text)) for t, level, text in told]

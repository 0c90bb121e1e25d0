"""Messages of others become channels: JSON, protobuf and ROS 2, in MCAP files and in rosbag2
folders of both storages.
"""

from __future__ import annotations

import json
import sqlite3
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import recorded
from px4 import write_ulog

from uvms_ocp.errors import InvalidInput, NameNotFound, NotInstalled, UvmsError
from uvms_ocp.identification.channel_mapping import RecordingMapping, read_mapping
from uvms_ocp.identification.logged_message import Message
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.message_columns import TopicColumns, _Rows
from uvms_ocp.identification.message_fields import numbers_at, seconds_at, steps_of
from uvms_ocp.identification.messages import topics_of
from uvms_ocp.identification.recording import Recording
from uvms_ocp.record import mcap_reading as mcap_records

pytest.importorskip("mcap", reason='needs pip install "uvms-ocp[rosbags]"')
GOOD = recorded(t_end=5.0)
T = GOOD.channels["position"].t
STAMPS = np.rint(1e9 * T).astype(int) + 1_700_000_000_000_000_000
LATE = 30_000_000  # [ns] from measured to logged
JOINTS = ("shoulder", "elbow")
ANGLES = np.column_stack([np.sin(T), np.cos(T)])
THRUSTS = np.arange(8.0) + T[:, None]
POSE = {"topic": "/odometry", "time": "header.stamp"}
AXES = ("x", "y", "z")
ROS = RecordingMapping.model_validate(
    {
        "channels": {
            "position": {**POSE, "columns": [f"pose.pose.position.{axis}" for axis in AXES]},
            "attitude": {
                **POSE,
                "columns": [f"pose.pose.orientation.{axis}" for axis in (*AXES, "w")],
            },
            "linear_velocity": {**POSE, "columns": [f"twist.twist.linear.{axis}" for axis in AXES]},
            "joint_positions": {
                "topic": "/joint_states",
                "time": "header.stamp",
                "columns": [f"position[{name}]" for name in JOINTS],
            },
            "thrust": {"topic": "/thrust", "columns": ["data"]},
        }
    }
)


def ros_bag(folder: Path, storage: str) -> Path:
    """A bag of odometry, joints in an order that changes, and thrusts as an array without a
    header.
    """
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason='needs pip install "uvms-ocp[rosbags]"')
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    with rosbag2.Writer(
        folder, version=9, storage_plugin=getattr(rosbag2.StoragePlugin, storage)
    ) as writer:
        kinds = {
            "/odometry": "nav_msgs/msg/Odometry",
            "/joint_states": "sensor_msgs/msg/JointState",
        }
        kinds["/thrust"] = "std_msgs/msg/Float64MultiArray"
        to = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in kinds.items()
        }
        for k, stamp in enumerate(STAMPS.tolist()):
            for topic, message in ros_messages(store, k, stamp).items():
                data = store.serialize_cdr(message, kinds[topic])
                writer.write(to[topic], stamp + (0 if topic == "/thrust" else LATE), data)
    return folder


def ros_messages(store: Any, k: int, stamp: int) -> dict[str, Any]:
    of = {name.rpartition("/")[2]: made for name, made in store.types.items()}
    header = of["Header"](
        stamp=of["Time"](sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="map"
    )
    position, attitude, linear = (
        GOOD.channels[name].values[k].tolist()
        for name in ("position", "attitude", "linear_velocity")
    )
    zeros = np.zeros(36)
    pose = of["Pose"](position=of["Point"](*position), orientation=of["Quaternion"](*attitude))
    twist = of["Twist"](linear=of["Vector3"](*linear), angular=of["Vector3"](0.0, 0.0, 0.0))
    odometry = of["Odometry"](
        header=header,
        child_frame_id="base",
        pose=of["PoseWithCovariance"](pose=pose, covariance=zeros),
        twist=of["TwistWithCovariance"](twist=twist, covariance=zeros),
    )
    order = [k % 2, 1 - k % 2]
    nothing = np.zeros(0)
    joints = of["JointState"](
        header=header,
        name=[JOINTS[i] for i in order],
        position=ANGLES[k, order],
        velocity=nothing,
        effort=nothing,
    )
    layout = of["MultiArrayLayout"](dim=[], data_offset=0)
    return {
        "/odometry": odometry,
        "/joint_states": joints,
        "/thrust": of["Float64MultiArray"](layout=layout, data=THRUSTS[k]),
    }


def require_good(read: Recording, *, position_at: float = 0.0) -> None:
    for name in ("position", "attitude", "linear_velocity"):
        if name in read.channels:
            np.testing.assert_allclose(
                read.channels[name].values, GOOD.channels[name].values, atol=1e-9
            )
            np.testing.assert_allclose(read.channels[name].t, T + position_at, atol=1e-6)
    if "joint_positions" in read.channels:
        np.testing.assert_array_equal(read.channels["joint_positions"].values, ANGLES)
    if "thrust" in read.channels:
        np.testing.assert_array_equal(read.channels["thrust"].values, THRUSTS)


@pytest.mark.sampled
@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_rosbag2_folder_becomes_channels(storage: str, tmp_path: Path) -> None:
    bag = ros_bag(tmp_path / "dive", storage)
    read = mapped_recording(bag, ROS)
    assert read.name == "dive"
    require_good(read)
    assert topics_of(bag) == ("/joint_states", "/odometry", "/thrust")


def test_an_mcap_file_of_ros_messages_needs_no_folder(tmp_path: Path) -> None:
    (file,) = ros_bag(tmp_path / "dive", "MCAP").glob("*.mcap")
    require_good(mapped_recording(file, ROS))


def json_file(path: Path, rows: list[dict[str, Any]]) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("State", "jsonschema", b"{}")
        channel = writer.register_channel("/state", "json", schema)
        for k, row in enumerate(rows):
            writer.add_message(channel, int(STAMPS[k]) + LATE, json.dumps(row).encode(), 0)
        writer.finish()
    return path


def test_json_in_an_mcap_file_becomes_channels_at_their_stamps_or_when_they_were_logged(
    tmp_path: Path,
) -> None:
    states = GOOD.channels["position"].values.tolist(), GOOD.channels["attitude"].values.tolist()
    rows = [
        {
            "t": {"sec": s // 10**9, "nsec": s % 10**9},
            "ms": s / 1e6,
            "p": p,
            "q": dict(zip("xyzw", q, strict=True)),
        }
        for s, p, q in zip(STAMPS.tolist(), *states, strict=True)
    ]
    position = {"topic": "/state", "time": "t", "columns": ["p"]}
    attitude = {
        "topic": "/state",
        "time": "ms",
        "time_unit": "ms",
        "columns": [f"q.{axis}" for axis in "xyzw"],
    }
    path = json_file(tmp_path / "a.mcap", rows)
    require_good(
        mapped_recording(
            path, RecordingMapping(channels={"position": position, "attitude": attitude})
        )
    )
    logged = RecordingMapping(
        channels={
            "position": {"topic": "/state", "columns": ["p.0", "p[1]", "p[2]"]},
            "attitude": attitude,
        }
    )
    read = mapped_recording(path, logged)
    np.testing.assert_allclose(read.channels["position"].t, T + 1e-9 * LATE, atol=1e-6)


def test_protobuf_of_transforms_becomes_channels_by_the_name_of_the_frame(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap_protobuf.writer import Writer

    values = np.hstack([GOOD.channels["position"].values, GOOD.channels["attitude"].values])
    with (tmp_path / "a.mcap").open("wb") as file, Writer(file) as writer:
        for stamp, row in zip(STAMPS.tolist(), values.tolist(), strict=True):
            told = FrameTransforms()
            told.transforms.add(child_frame_id="camera")
            one = FrameTransform(
                timestamp=Timestamp(seconds=stamp // 10**9, nanos=stamp % 10**9),
                child_frame_id="base",
            )
            one.translation.x, one.translation.y, one.translation.z = row[:3]
            one.rotation.x, one.rotation.y, one.rotation.z, one.rotation.w = row[3:]
            told.transforms.append(one)
            writer.write_message("/tf", told, stamp + LATE, stamp)
            other = FrameTransforms()
            other.transforms.add(child_frame_id="camera")  # alone: no sample of the vehicle
            writer.write_message("/tf", other, stamp + LATE, stamp)
    base = {"topic": "/tf", "time": "transforms[base].timestamp"}
    columns = {
        "position": [f"transforms[base].translation.{axis}" for axis in "xyz"],
        "attitude": [f"transforms[base].rotation.{axis}" for axis in "xyzw"],
    }
    mapping = RecordingMapping(
        channels={name: {**base, "columns": paths} for name, paths in columns.items()}
    )
    require_good(mapped_recording(tmp_path / "a.mcap", mapping))


def test_samples_that_a_file_has_out_of_order_are_put_in_order_and_counted(tmp_path: Path) -> None:
    t = np.array([0.0, 0.1, 0.2, 0.05, 0.2, 0.3])
    rows = [{"t": x, "u": 10 * x} for x in t.tolist()]
    mapping = RecordingMapping(
        channels={"thrust": {"topic": "/state", "time": "t", "columns": ["u"]}}
    )
    channel = mapped_recording(json_file(tmp_path / "a.mcap", rows), mapping).channels["thrust"]
    np.testing.assert_allclose(channel.t, [0.0, 0.05, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(channel.values[:, 0], 10 * channel.t)
    assert channel.back == pytest.approx(0.15)
    assert channel.repeated == 1


@pytest.mark.parametrize(
    ("one", "message"),
    [
        ({"topic": "/stat", "columns": ["a"]}, r"unknown topic of a\.mcap '/stat'; known: /state"),
        ({"topic": "/state", "columns": ["b"]}, r"/state: unknown field 'b'; known: a, c, d"),
        ({"topic": "/state", "columns": ["a[3]"]}, "unknown element '3'; known: 0 to 1"),
        ({"topic": "/state", "columns": ["c"]}, "c is no number"),
        ({"topic": "/state", "columns": ["a"], "time": "d"}, "d is no number, it has x"),
        ({"topic": "/state", "columns": ["a[["]}, "names with dots"),
        ({"time": "a", "columns": ["a"]}, "no topic; give one of /state"),
    ],
)
def test_mistakes_in_paths_are_told_in_a_line(
    one: dict[str, Any], message: str, tmp_path: Path
) -> None:
    path = json_file(tmp_path / "a.mcap", [{"a": [1, 2], "c": "text", "d": {"x": 1}}] * 3)
    with pytest.raises((InvalidInput, NameNotFound), match=message) as caught:
        mapped_recording(path, RecordingMapping(channels={"thrust": one}))
    assert "\n" not in str(caught.value)


def test_a_topic_of_a_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,a\n0,1\n1,2\n")
    with pytest.raises(InvalidInput, match="in a table"):
        mapped_recording(
            tmp_path / "a.csv",
            RecordingMapping(channels={"thrust": {"topic": "/a", "columns": ["a"]}}),
        )


@pytest.mark.sampled
@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_damaged_bags_are_told_in_a_line(storage: str, tmp_path: Path) -> None:
    bag = ros_bag(tmp_path / "dive", storage)
    (file,) = (path for path in bag.iterdir() if path.name != "metadata.yaml")
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    with pytest.raises(InvalidInput, match="dive") as caught:
        mapped_recording(bag, ROS)
    assert "\n" not in str(caught.value)
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    with pytest.raises(InvalidInput, match="cannot be read"):
        mapped_recording(bag, ROS)


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_whatever_bytes_are_changed_a_bag_is_read_or_refused(storage: str, tmp_path: Path) -> None:
    bag = ros_bag(tmp_path / "dive", storage)
    rng = np.random.default_rng(7)
    (file,) = (path for path in bag.iterdir() if path.name != "metadata.yaml")
    content = file.read_bytes()
    for _ in range(30):
        damaged = bytearray(content)
        for place in rng.integers(len(content), size=3):
            damaged[place] = rng.integers(256)
        file.write_bytes(bytes(damaged))
        with suppress(UvmsError):
            mapped_recording(bag, ROS)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["dive.db3", "dive.sqlite"])
def test_a_bag_that_makes_up_its_rows_is_refused_whatever_it_is_called(
    tmp_path: Path, name: str
) -> None:
    bag = ros_bag(tmp_path / "dive", "SQLITE3")
    (file,) = bag.glob("*.db3")
    with sqlite3.connect(file) as base:
        base.execute("CREATE VIEW endless AS SELECT 1")
    base.close()
    about = bag / "metadata.yaml"
    about.write_text(about.read_text().replace(file.name, name))
    file.rename(bag / name)
    with pytest.raises(InvalidInput, match="1 views, triggers or made up columns"):
        mapped_recording(bag, ROS)


def test_a_bag_with_made_up_columns_is_refused(tmp_path: Path) -> None:
    bag = ros_bag(tmp_path / "dive", "SQLITE3")
    (file,) = bag.glob("*.db3")
    with sqlite3.connect(file) as base:
        base.execute("CREATE TABLE more (a INTEGER, b AS (a + 1))")
    base.close()
    with pytest.raises(InvalidInput, match="1 views, triggers or made up columns"):
        mapped_recording(bag, ROS)


def test_the_data_base_of_a_bag_is_read_without_its_folder(tmp_path: Path) -> None:
    (file,) = ros_bag(tmp_path / "dive", "SQLITE3").glob("*.db3")
    require_good(mapped_recording(file.rename(tmp_path / "alone.db3"), ROS))


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason='needs pip install "uvms-ocp[rosbags]"')
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    twist, vector = (store.types[f"geometry_msgs/msg/{name}"] for name in ("Twist", "Vector3"))
    velocity = GOOD.channels["linear_velocity"].values
    with rosbag1.Writer(tmp_path / "dive.bag") as writer:
        to = writer.add_connection("/velocity", "geometry_msgs/msg/Twist", typestore=store)
        for stamp, values in zip(STAMPS.tolist(), velocity.tolist(), strict=True):
            message = twist(linear=vector(*values), angular=vector(0.0, 0.0, 0.0))
            writer.write(to, stamp, store.serialize_ros1(message, "geometry_msgs/msg/Twist"))
    one = {"topic": "/velocity", "columns": ["linear.x", "linear.y", "linear.z"]}
    require_good(
        mapped_recording(tmp_path / "dive.bag", RecordingMapping(channels={"linear_velocity": one}))
    )
    with pytest.raises(NameNotFound, match="known: /velocity"):
        mapped_recording(
            tmp_path / "dive.bag",
            RecordingMapping(channels={"linear_velocity": {**one, "topic": "/v"}}),
        )


DVL = "geometry_msgs/Vector3 velocity\nbool valid\n"
"""A message that no library knows."""


def test_a_message_that_a_bag_does_not_define_is_read_by_its_definition(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason='needs pip install "uvms-ocp[rosbags]"')
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    store.register(typesys.get_types_from_msg(DVL, "own_msgs/msg/Dvl"))
    with rosbag2.Writer(
        tmp_path / "dive", version=8, storage_plugin=rosbag2.StoragePlugin.SQLITE3
    ) as writer:
        to = writer.add_connection("/dvl", "own_msgs/msg/Dvl", typestore=store)
        writer.add_connection("/silent", "own_msgs/msg/Dvl", typestore=store)
        for stamp, values in zip(
            STAMPS.tolist(), GOOD.channels["linear_velocity"].values.tolist(), strict=True
        ):
            message = store.types["own_msgs/msg/Dvl"](
                store.types["geometry_msgs/msg/Vector3"](*values), True
            )
            writer.write(to, stamp, store.serialize_cdr(message, "own_msgs/msg/Dvl"))
    (file,) = (tmp_path / "dive").glob("*.db3")
    with sqlite3.connect(file) as base:  # as Humble and before leave it
        base.execute("DROP TABLE message_definitions")
    base.close()
    one = {
        "topic": "/dvl",
        "columns": ["velocity.x", "velocity.y", "velocity.z"],
        "rows": {"valid": 1},
    }
    mapping = {"channels": {"linear_velocity": one}}
    with pytest.raises(
        InvalidInput, match=r"no definition of own_msgs/msg/Dvl in it.*messages: FOLDER"
    ):
        mapped_recording(file, RecordingMapping.model_validate(mapping))
    (tmp_path / "definitions" / "own_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "definitions" / "own_msgs" / "msg" / "Dvl.msg").write_text(DVL)
    (tmp_path / "map.yaml").write_text(json.dumps({**mapping, "messages": "definitions"}))
    given = read_mapping(tmp_path / "map.yaml")
    require_good(mapped_recording(file, given))
    silent = {"linear_velocity": {**one, "topic": "/silent"}}
    with pytest.raises(InvalidInput, match="/silent has no messages; leave the channel out"):
        mapped_recording(
            file,
            RecordingMapping.model_validate(
                {**mapping, "channels": silent, "messages": given.messages}
            ),
        )


def test_a_log_of_mavlink_has_topics_by_the_type_of_its_messages(tmp_path: Path) -> None:
    mavlink = pytest.importorskip(
        "pymavlink.dialects.v20.ardupilotmega", reason='needs pip install "uvms-ocp[mavlink]"'
    )
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with (tmp_path / "dive.tlog").open("wb") as file:
        for stamp, (x, y, z) in zip(
            STAMPS.tolist(), GOOD.channels["position"].values.tolist(), strict=True
        ):
            message = sender.local_position_ned_encode(
                stamp // 1_000_000 % 2**32, x, -y, -z, 0.0, 0.0, 0.0
            )
            file.write((stamp // 1000).to_bytes(8, "big") + message.pack(sender))
    one = {"topic": "LOCAL_POSITION_NED", "columns": ["x", "y", "z"], "world": "NED"}
    read = mapped_recording(tmp_path / "dive.tlog", RecordingMapping(channels={"position": one}))
    np.testing.assert_allclose(
        read.channels["position"].values, GOOD.channels["position"].values, atol=1e-5
    )
    np.testing.assert_allclose(read.channels["position"].t, T, atol=1e-5)
    assert topics_of(tmp_path / "dive.tlog") == ("LOCAL_POSITION_NED",)


def test_messages_of_mavlink_have_the_units_that_their_protocol_says(tmp_path: Path) -> None:
    mavlink = pytest.importorskip(
        "pymavlink.dialects.v20.ardupilotmega", reason='needs pip install "uvms-ocp[mavlink]"'
    )
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with (tmp_path / "dive.tlog").open("wb") as file:
        for k, stamp in enumerate(STAMPS.tolist()):
            sent = sender.global_position_int_encode(100 * k, 0, 0, 0, 0, 10 * k, -20, 30, 0)
            file.write((stamp // 1000).to_bytes(8, "big") + sent.pack(sender))
    one = {"topic": "GLOBAL_POSITION_INT", "time": "time_boot_ms", "columns": ["vx", "vy", "vz"]}
    read = mapped_recording(
        tmp_path / "dive.tlog", RecordingMapping(channels={"linear_velocity": one})
    ).channels["linear_velocity"]
    k = np.arange(len(STAMPS))
    np.testing.assert_allclose(read.t, 0.1 * k, atol=1e-9)
    np.testing.assert_allclose(
        read.values, np.column_stack([0.1 * k, 0.0 * k - 0.2, 0.0 * k + 0.3]), atol=1e-12
    )


def test_a_log_of_px4_has_topics_with_fields_and_arrays_and_one_for_each_instance(
    tmp_path: Path,
) -> None:
    pytest.importorskip("pyulog", reason='needs pip install "uvms-ocp[ulog]"')
    good = GOOD.channels["position"].values
    other = 0.0 * T + 1.0
    fields = {"x": good[:, 0], "y": -good[:, 1], "z": -good[:, 2]}
    outputs = {"output": 1500.0 + 10.0 * np.arange(3) + np.arange(len(T))[:, None]}
    topics = [
        ("vehicle_local_position", T + 7.0, one) for one in (fields, dict.fromkeys("xyz", other))
    ]
    write_ulog(tmp_path / "dive.ulg", [*topics, ("actuator_outputs", T + 7.0, outputs)])
    assert topics_of(tmp_path / "dive.ulg") == (
        "actuator_outputs",
        "vehicle_local_position",
        "vehicle_local_position_1",
    )
    one = {"topic": "vehicle_local_position", "columns": ["x", "y", "z"], "world": "NED"}
    motors = {
        "topic": "actuator_outputs",
        "columns": ["output"],
        "offset": -1500.0,
        "scale": 0.0025,
        "time": "timestamp",
    }
    read = mapped_recording(
        tmp_path / "dive.ulg",
        RecordingMapping(channels={"position": one, "propeller_commands": motors}),
    )
    np.testing.assert_allclose(read.channels["position"].values, good, atol=1e-5)
    np.testing.assert_allclose(read.channels["position"].t, T, atol=1e-5)
    np.testing.assert_allclose(
        read.channels["propeller_commands"].values[1],
        0.0025 * (1.0 + 10.0 * np.arange(3)),
        atol=1e-6,
    )
    np.testing.assert_allclose(read.channels["propeller_commands"].t, T, atol=1e-5)
    second = {**one, "topic": "vehicle_local_position_1"}
    read = mapped_recording(tmp_path / "dive.ulg", RecordingMapping(channels={"position": second}))
    np.testing.assert_allclose(
        read.channels["position"].values, np.tile([1.0, -1.0, -1.0], (len(T), 1))
    )
    write_ulog(
        tmp_path / "cut.ulg", topics, cut=(tmp_path / "dive.ulg").stat().st_size // 2
    )  # as where power was cut
    assert (
        len(
            mapped_recording(tmp_path / "cut.ulg", RecordingMapping(channels={"position": one}))
            .channels["position"]
            .t
        )
        > 9
    )


def test_a_packed_bag_says_how_to_unpack_it(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {compression_mode: FILE}")
    with pytest.raises(InvalidInput, match="packed by file; unpack it"):
        mapped_recording(tmp_path, ROS)


def test_chunks_that_lie_are_refused_as_they_are_in_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = json_file(tmp_path / "a.mcap", [{"a": 1}] * 3)
    monkeypatch.setattr(mcap_records, "LARGEST_CHUNK", 10)
    with pytest.raises(InvalidInput, match="a chunk of"):
        mapped_recording(
            path, RecordingMapping(channels={"thrust": {"topic": "/state", "columns": ["a"]}})
        )


def test_a_missing_extra_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = ros_bag(tmp_path / "dive", "SQLITE3")
    path = json_file(tmp_path / "a.mcap", [{"a": 1}] * 3)
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(NotInstalled, match=r"uvms-ocp\[rosbags\]"):
        mapped_recording(bag, ROS)
    monkeypatch.setitem(sys.modules, "mcap_protobuf", None)
    with pytest.raises(NotInstalled, match=r"uvms-ocp\[mcap\]"):
        topics_of(path)


def test_stamps_of_all_kinds_are_seconds_and_plain_numbers_have_their_unit() -> None:
    for names in (("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos")):
        assert (
            seconds_at({"t": dict(zip(names, (3, 500_000_000), strict=True))}, ("t",), 1e-9) == 3.5
        )
    assert seconds_at({"t": 3_500}, ("t",), 1e-3) == 3.5
    assert numbers_at({"a": {"b": [1, [2, 3]]}}, steps_of("a.b[1]")) == [2.0, 3.0]


@dataclass
class Range:
    """A message of others."""

    value: float
    units: str


def test_a_field_called_units_is_one_like_others() -> None:
    rows = _Rows("range", TopicColumns(topic="/range", columns=("value",), time="", unit=1.0))
    for k in range(3):
        rows.add(Message("/range", k * 10**9, Range(2.0 * k, "m")))
    assert rows.units() == ("", "")

"""A channel is what one sender says: of several, one is chosen, by what tells them apart in a log."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import changed, recorded

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.interleaved_series import distance_of_series, numbers_of_series
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.recording import Channel

N = 40
START = 1_700_000_000_000_000_000  # [ns]
STEP = 50_000_000  # [ns]
FIELDS = ("x", "y", "z")
APART = 5.0  # [m] between what two senders say


def telemetry(path: Path, senders: list[tuple[int, int]]) -> Path:
    """Write positions of senders (system, component), each `APART` from the one before."""
    mavlink = pytest.importorskip(
        "pymavlink.dialects.v20.ardupilotmega", reason='needs pip install "uvms-ocp[mavlink]"'
    )
    links = [mavlink.MAVLink(None, srcSystem=s, srcComponent=c) for s, c in senders]
    with path.open("wb") as file:
        for k in range(N):
            for place, link in enumerate(links):
                logged = (START + STEP * k) // 1000 + 4_000 * place
                x = APART * place + 0.01 * k
                sent = link.local_position_ned_encode(50 * k, x, 0.1 * k, 2.0, 0.0, 0.0, 0.0)
                file.write(logged.to_bytes(8, "big") + sent.pack(link))
    return path


def read(path: Path, rows: Mapping[str, Any], topic: str, fields: tuple[str, ...]) -> Channel:
    """Read positions of some rows."""
    channel = {"topic": topic, "columns": fields, "rows": rows}
    mapping = RecordingMapping.model_validate({"channels": {"position": channel}})
    return mapped_recording(path, mapping).channels["position"]


def rows_in(message: str) -> dict[str, Any]:
    """Return the rows that a message says to write."""
    (text,) = re.findall(r"rows: \{(.*)\}", message)
    pairs = (pair.split(": ") for pair in text.split(", "))
    return {name: int(value) if value.isdecimal() else value for name, value in pairs}


@pytest.mark.parametrize(
    "senders", [[(1, 1), (2, 1)], [(1, 1), (1, 191)], [(1, 1), (2, 1), (2, 9)]]
)
def test_of_systems_and_components_in_telemetry_one_is_chosen(
    senders: list[tuple[int, int]], tmp_path: Path
) -> None:
    path = telemetry(tmp_path / "two.tlog", senders)
    refusal = rf"position: .*comes from {len(senders)} senders: .*\({N} messages\).*choose one"
    with pytest.raises(InvalidInput, match=refusal) as caught:
        read(path, {}, "LOCAL_POSITION_NED", FIELDS)
    advice = rows_in(str(caught.value))
    assert len(read(path, advice, "LOCAL_POSITION_NED", FIELDS).t) == N
    for place, (system, component) in enumerate(senders):
        rows = {"system": system, "component": component}
        channel = read(path, rows, "LOCAL_POSITION_NED", FIELDS)
        expected = APART * place + 0.01 * np.arange(N)
        np.testing.assert_allclose(channel.values[:, 0], expected, atol=1e-5)


def test_a_log_of_one_sender_needs_no_choice(tmp_path: Path) -> None:
    path = telemetry(tmp_path / "one.tlog", [(1, 1)])
    assert len(read(path, {}, "LOCAL_POSITION_NED", FIELDS).t) == N


def test_a_sender_that_there_is_not_is_refused(tmp_path: Path) -> None:
    path = telemetry(tmp_path / "one.tlog", [(1, 1)])
    with pytest.raises(InvalidInput, match=r"no row has .*system.*values that there are"):
        read(path, {"system": 3}, "LOCAL_POSITION_NED", FIELDS)


def test_a_proposed_mapping_says_that_there_are_several_senders(tmp_path: Path) -> None:
    path = telemetry(tmp_path / "two.tlog", [(1, 1), (2, 1)])
    assert "# doubtful: position: LOCAL_POSITION_NED" in propose_mapping(path)
    assert "rows: {system: 1}" in propose_mapping(path)


def _definition(kind: int, name: str, layout: str, columns: str) -> bytes:
    """Write the message that defines a kind of message of dataflash."""
    sizes = {"B": 1, "Q": 8, "f": 4, "N": 16, "n": 4, "Z": 64}
    length = 3 + sum(sizes[letter] for letter in layout)
    content = struct.pack(
        "<BB4s16s64s", kind, length, name.encode(), layout.encode(), columns.encode()
    )
    return b"\xa3\x95\x80" + content


def test_of_instances_of_a_sensor_in_dataflash_one_is_chosen(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink.mavutil", reason='needs pip install "uvms-ocp[mavlink]"')
    parts = [
        _definition(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
        _definition(129, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
        _definition(130, "POS", "QBfff", "TimeUS,I,X,Y,Z"),
        b"\xa3\x95\x81" + struct.pack("<QB16s16s", 0, 130, b"s#mmm", b"F-000"),
    ]
    for k in range(N):
        for instance in (0, 1):
            time = 50_000 * k + 4_000 * instance
            x = APART * instance + 0.01 * k
            parts.append(b"\xa3\x95\x82" + struct.pack("<QBfff", time, instance, x, 0.1 * k, 2.0))
    path = tmp_path / "dive.BIN"
    path.write_bytes(b"".join(parts))
    with pytest.raises(InvalidInput, match=r"\{I: 0\} \(40 messages\).*rows: \{I: 0\}"):
        read(path, {}, "POS", ("X", "Y", "Z"))
    for instance in (0, 1):
        channel = read(path, {"I": instance}, "POS", ("X", "Y", "Z"))
        expected = APART * instance + 0.01 * np.arange(N)
        np.testing.assert_allclose(channel.values[:, 0], expected, atol=1e-5)


def test_of_publishers_in_a_bag_of_ros_1_one_is_chosen(tmp_path: Path) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason='needs pip install "uvms-ocp[rosbags]"')
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    kind = "geometry_msgs/msg/Vector3"
    path = tmp_path / "dive.bag"
    with rosbag1.Writer(path) as writer:
        publishers = [
            writer.add_connection("/position", kind, typestore=store, callerid=name)
            for name in ("/filter", "/sonar")
        ]
        for k in range(N):
            for place, publisher in enumerate(publishers):
                message = store.types[kind](x=APART * place, y=0.1 * k, z=-2.0)
                data = store.serialize_ros1(message, kind)
                writer.write(publisher, START + STEP * k + 4_000_000 * place, data)
    with pytest.raises(InvalidInput, match=r"rows: \{publisher: /filter\}"):
        read(path, {}, "/position", FIELDS)
    channel = read(path, {"publisher": "/sonar"}, "/position", FIELDS)
    assert len(channel.t) == N
    np.testing.assert_allclose(channel.values[:, 0], APART)


def _two_channels(path: Path, metadata: list[dict[str, str]], frames: list[str]) -> Path:
    """Write an MCAP file whose channels have one topic; each has metadata and a frame."""
    writers = pytest.importorskip("mcap.writer", reason='needs pip install "uvms-ocp[mcap]"')
    with path.open("wb") as file:
        writer = writers.Writer(file)
        writer.start()
        schema = writer.register_schema("Position", "jsonschema", b"{}")
        numbers = [
            writer.register_channel("/position", "json", schema, metadata=one) for one in metadata
        ]
        for k in range(N):
            for place, frame in enumerate(frames):
                content = {"header": {"frame_id": frame}, "x": APART * place, "y": 0.1 * k, "z": 0}
                logged = START + STEP * k + 4_000_000 * place
                number = numbers[place % len(numbers)]
                writer.add_message(number, logged, json.dumps(content).encode(), logged)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("metadata", "frames", "rows"),
    [
        ([{"callerid": "/a"}, {"callerid": "/b"}], ["map", "map"], {"publisher": "/b"}),
        ([{}, {"k": "v"}], ["map", "map"], {"connection": 1}),
        ([{}], ["map", "odom"], {"header.frame_id": "odom"}),
        ([{}], ["map", ""], {"header.frame_id": ""}),
    ],
)
def test_of_publishers_connections_and_frames_in_mcap_one_is_chosen(
    metadata: list[dict[str, str]], frames: list[str], rows: dict[str, Any], tmp_path: Path
) -> None:
    path = _two_channels(tmp_path / "dive.mcap", metadata, frames)
    (name,) = rows
    with pytest.raises(InvalidInput, match=rf"2 senders.*rows: \{{{name}: "):
        read(path, {}, "/position", FIELDS)
    channel = read(path, rows, "/position", FIELDS)
    assert len(channel.t) == N
    np.testing.assert_allclose(channel.values[:, 0], APART)


def test_of_senders_that_nothing_names_one_series_is_chosen(tmp_path: Path) -> None:
    """One connection, and one frame, as a bag of ROS 2 has them of two publishers."""
    path = _two_channels(tmp_path / "dive.mcap", [{}], ["map", "map"])
    channel = {"topic": "/position", "columns": FIELDS}
    mapping = RecordingMapping.model_validate({"channels": {"position": channel}})
    (doubt,) = [
        issue.problem
        for issue in check_data_quality(mapped_recording(path, mapping))
        if "two senders" in issue.problem
    ]
    assert re.findall(r"series: \d", doubt) == ["series: 1", "series: 2"]
    for place in range(2):
        channel["series"] = place + 1
        mapping = RecordingMapping.model_validate({"channels": {"position": channel}})
        position = mapped_recording(path, mapping).channels["position"]
        assert len(position.t) == N
        np.testing.assert_allclose(position.values[:, 0], APART * place)
    channel["series"] = 3
    mapping = RecordingMapping.model_validate({"channels": {"position": channel}})
    with pytest.raises(InvalidInput, match=r"position: series: 3 given; allowed: 1 to 2"):
        mapped_recording(path, mapping)


def test_of_one_sender_no_series_can_be_chosen(tmp_path: Path) -> None:
    path = _two_channels(tmp_path / "dive.mcap", [{}], ["map"])
    channel = {"topic": "/position", "columns": FIELDS, "series": 1}
    mapping = RecordingMapping.model_validate({"channels": {"position": channel}})
    with pytest.raises(InvalidInput, match=r"its samples are not two series .*leave it out"):
        mapped_recording(path, mapping)


@pytest.mark.sampled
@pytest.mark.parametrize("every", [2, 5, 20])
def test_a_second_sender_that_sends_seldom_is_seen(every: int) -> None:
    recording = recorded(t_end=60.0)
    position = recording.channels["position"]
    other = position.values + np.where(np.arange(len(position.t)) % every, 0.0, 5.0)[:, None]
    mixed = changed(recording, "position", values=other)
    problems = [issue.problem for issue in check_data_quality(mixed) if issue.channel == "position"]
    assert any("two senders in one channel" in problem for problem in problems), problems


@pytest.mark.parametrize("held", [1, 20])
def test_noise_and_fixes_that_are_held_are_of_one_sender(held: int) -> None:
    rng = np.random.default_rng(held)
    fixes = rng.normal(size=(600 // held, 3))
    assert distance_of_series(np.repeat(fixes, held, axis=0)) is None


@pytest.mark.parametrize("n_series", [1, 2, 3])
def test_series_are_told_apart_as_long_as_they_are_far_apart(n_series: int) -> None:
    """Senders lose samples by lot, and follow the same curve, each at its own place."""
    rng = np.random.default_rng(n_series)
    t = np.sort(rng.uniform(0.0, 60.0, size=900))
    truth = rng.integers(n_series, size=len(t))
    truth[:n_series] = np.arange(n_series)
    curve = np.column_stack([np.sin(0.3 * t), np.cos(0.2 * t), 0.1 * t])
    noise = 0.02 * rng.normal(size=curve.shape)
    far = curve + 4.0 * truth[:, None] * [1.0, 0.0, 0.0] + noise
    numbers = numbers_of_series(far)
    if n_series == 1:
        assert numbers is None
    else:
        np.testing.assert_array_equal(numbers, truth + 1)
    near = curve + 0.3 * np.sin(t)[:, None] * truth[:, None] + noise
    assert numbers_of_series(near) is None

"""Commands that have a topic, or a column of times, for each thruster are one channel: each is held from
its last sample, and the channel begins where all are known.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from proposals import read_as_proposed

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.proposed_parts import topics_of_thrusters
from uvms_ocp.identification.recording import Channel
from uvms_ocp.identification.tables import write_columns

N = 8
START = 1_700_000_000_000_000_000  # [ns]


def sent() -> list[tuple[np.ndarray, np.ndarray]]:
    """Times [s], of each thruster its own, and commands [N]; the last changes three times alone."""
    rng = np.random.default_rng(5)
    parts = []
    for k in range(N - 1):
        times = 0.002 * k + 0.05 * np.arange(200 + 10 * k)
        parts.append((times, rng.normal(scale=20.0, size=len(times)).round(3)))
    parts.append((np.array([0.301, 4.0, 7.5]), np.array([5.0, -12.0, 3.0])))
    return parts


def held_at(t: float, times: np.ndarray, values: np.ndarray) -> float:
    """The last value that was sent until then."""
    return float(values[times <= t][-1])


def require_sent(channel: Channel, order: list[int], *, begin: float = 0.0) -> None:
    """Check that a channel has what was sent to thrusters in an order; begin: [s] of its times."""
    parts = [sent()[k] for k in order]
    first = max(times[0] for times, _ in parts)
    expected_times = np.unique(np.concatenate([times for times, _ in parts]))
    expected_times = expected_times[expected_times >= first]
    np.testing.assert_allclose(channel.t + begin, expected_times, atol=1e-6)
    expected = [[held_at(t, *part) for part in parts] for t in expected_times]
    np.testing.assert_array_equal(channel.values, expected)


def bag(folder: Path, storage: str, topic: str) -> Path:
    """Write a bag of ROS 2 with a topic for each thruster; topic: with its number as {}."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason='needs pip install "uvms-ocp[rosbags]"')
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    kind = "std_msgs/msg/Float64"
    plugin = getattr(rosbag2.StoragePlugin, storage)
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
        for k, (times, values) in enumerate(sent()):
            connection = writer.add_connection(topic.format(k), kind, typestore=store)
            for t, value in zip(times.tolist(), values.tolist(), strict=True):
                data = store.serialize_cdr(store.types[kind](data=value), kind)
                writer.write(connection, START + round(1e9 * t), data)
    return folder


def table(path: Path) -> Path:
    """Write a table with a column of times for each thruster, as long as it has samples."""
    n_rows = max(len(times) for times, _ in sent())
    columns = {}
    for k, (times, values) in enumerate(sent()):
        for name, numbers in ((f"t_{k}", times), (f"thruster_{k}", values)):
            columns[name] = np.full(n_rows, np.nan)
            columns[name][: len(numbers)] = numbers
    write_columns(path, columns)
    return path


def thrust(path: Path, keys: dict[str, Any]) -> Channel:
    mapping = RecordingMapping.model_validate({"channels": {"thrust": keys}})
    return mapped_recording(path, mapping).channels["thrust"]


@pytest.mark.sampled
@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize(
    "topic", ["/thruster_{}/cmd", "/model/rov2/joint/thruster{}_joint/cmd_thrust"]
)
def test_topics_of_a_bag_that_differ_in_a_number_are_proposed_as_one_channel(
    storage: str, topic: str, tmp_path: Path
) -> None:
    path = bag(tmp_path / "dive", storage, topic)
    assert f"{{topic: {topic.format(1)}, columns: [data]}}" in propose_mapping(path)
    read = read_as_proposed(path)
    require_sent(read.channels["thrust"], list(range(N)), begin=0.301)


def test_columns_with_times_of_their_own_are_proposed_as_one_channel(tmp_path: Path) -> None:
    path = table(tmp_path / "dive.csv")
    require_sent(read_as_proposed(path).channels["thrust"], list(range(N)), begin=0.301)


def test_columns_that_are_no_times_stay_thrust(tmp_path: Path) -> None:
    columns = {"time": np.arange(40.0)}
    for k in range(N):
        columns[f"t_{k}"] = 10.0 * np.sin(np.arange(40.0) + k)
    write_columns(tmp_path / "dive.csv", columns)
    read = read_as_proposed(tmp_path / "dive.csv").channels["thrust"]
    np.testing.assert_allclose(read.values[:, 3], columns["t_3"])


def test_parts_are_in_the_order_of_the_mapping_or_have_names(tmp_path: Path) -> None:
    path = table(tmp_path / "dive.csv")
    order = [2, 0, 1]
    parts = [{"time": f"t_{k}", "columns": [f"thruster_{k}"]} for k in order]
    require_sent(thrust(path, {"parts": parts}), order, begin=0.004)
    names = ("port", "aft", "top")
    named = thrust(path, {"parts": dict(zip(names, parts, strict=True))})
    turned = named.of(("aft", "port", "top"), "thrust")
    require_sent(turned, [0, 2, 1], begin=0.004)


def test_units_signs_and_numbers_are_of_each_part(tmp_path: Path) -> None:
    path = table(tmp_path / "dive.csv")
    parts = [
        {"time": "t_0", "columns": ["-thruster_0"]},
        7.0,
        {"time": "t_1", "columns": ["thruster_1"]},
    ]
    read = thrust(path, {"parts": parts, "unit": "kgf", "scale": [1.0, 1.0, 0.5]})
    plain = thrust(path, {"parts": [{"time": "t_0", "columns": ["thruster_0"]}, parts[2]]})
    np.testing.assert_allclose(read.values[:, 0], -9.80665 * plain.values[:, 0])
    np.testing.assert_array_equal(read.values[:, 1], 7.0)
    np.testing.assert_allclose(read.values[:, 2], 0.5 * 9.80665 * plain.values[:, 1])
    assert read.constants == (1,)


@pytest.mark.parametrize(
    ("channel", "keys", "refusal"),
    [
        ("position", {"parts": [{"time": "t_0", "columns": ["a"]}]}, "of wrench, thrust, prop"),
        (
            "thrust",
            {"time": "t_0", "parts": [{"time": "t_0", "columns": ["a"]}]},
            "time given beside",
        ),
        ("thrust", {"parts": [1.0]}, "parts of numbers alone"),
        ("thrust", {"parts": [{"time": "t_0"}]}, "a part without columns"),
        ("thrust", {}, "no columns given"),
        (
            "thrust",
            {"parts": {"a": {"time": "t_0", "columns": ["a", "b"]}}},
            "2 columns of one name",
        ),
    ],
)
def test_parts_without_a_meaning_are_refused(
    channel: str, keys: dict[str, Any], refusal: str, tmp_path: Path
) -> None:
    path = table(tmp_path / "dive.csv")
    mapping = RecordingMapping.model_validate({"channels": {channel: keys}})
    with pytest.raises(InvalidInput, match=refusal):
        mapped_recording(path, mapping)


def test_parts_that_have_no_time_in_common_are_refused(tmp_path: Path) -> None:
    t = np.arange(10.0)
    write_columns(tmp_path / "a.csv", {"t_0": t, "thruster_0": t, "t_1": t + 20.0, "thruster_1": t})
    parts = [{"time": f"t_{k}", "columns": [f"thruster_{k}"]} for k in (0, 1)]
    with pytest.raises(InvalidInput, match="begins at 20 s, after another has ended"):
        thrust(tmp_path / "a.csv", {"parts": parts})


def test_topics_of_what_thrusters_measure_are_no_commands() -> None:
    plain = {
        f"/thruster_{k}/{what}": f"thruster_{k}_{what}" for k in range(6) for what in ("rpm", "cmd")
    }
    stamped = ["header.stamp.sec", "header.stamp.nanosec", "data"]
    parts = topics_of_thrusters(dict.fromkeys(plain, stamped), plain)
    assert [part["topic"] for part in parts] == [f"/thruster_{k}/cmd" for k in range(6)]
    assert parts[0] == {"topic": "/thruster_0/cmd", "time": "header.stamp", "columns": ["data"]}
    feedback = {topic: name for topic, name in plain.items() if name.endswith("rpm")}
    assert topics_of_thrusters(dict.fromkeys(feedback, stamped), feedback) == []


def test_a_proposal_of_parts_says_how_they_are_joined(tmp_path: Path) -> None:
    proposal = propose_mapping(table(tmp_path / "dive.csv"))
    assert "parts: [{time: t_0, columns: [thruster_0]}, " in proposal
    assert "# joined: each is held from its last sample, from where all are known" in proposal

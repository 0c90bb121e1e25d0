"""Records as MCAP: ROS 2 finds poses, odometry, joints, wrenches and what was said, and the same
record comes back.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from same_record import require_same
from scipy.linalg import block_diag

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.mcap import field_names, values_of
from uvms_ocp.record.record import Record
from uvms_ocp.record.ros_topics import ROS_MESSAGES, cdr_messages, ros_definition
from uvms_ocp.record.series_checks import MEASURED
from uvms_ocp.record.tables import unit_of
from uvms_ocp.report.phase_resources import figures_between
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.scenario.cases.case1 import case1

pytest.importorskip("mcap", reason='needs pip install "uvms-ocp[mcap]"')
RECORDS = Path(__file__).parents[1] / "records"
PLANS = [Record.load(RECORDS / f"{name}.npz") for name in ("plan_curve_v0_1", "plan_ocp_v0_1")]


@pytest.fixture(scope="module")
def record() -> Record:
    return case1(noise=True, dt=0.02, duration=0.3, faults=("altimeter:frozen@0.1",)).run()


@pytest.fixture(scope="module")
def topics(record: Record, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    return read(
        record,
        tmp_path_factory.mktemp("mcap") / "run.mcap",
        urdf=robot_folder(record.meta.robot) / "robot.urdf",
    )


def read(record: Record, path: Path, **options: Any) -> dict[str, list[Any]]:
    """All messages by topic: time, type and what a reader of ROS 2 that is none of ours makes of
    them.
    """
    highlevel = pytest.importorskip(
        "rosbags.highlevel", reason='needs pip install "uvms-ocp[rosbags]"'
    )
    record.to_mcap(path, **options)
    messages: dict[str, list[Any]] = defaultdict(list)
    with highlevel.AnyReader([path]) as reader:
        for connection, stamp, data in reader.messages():
            messages[connection.topic].append(
                (stamp, connection.msgtype, reader.deserialize(data, connection.msgtype))
            )
    return messages


def numbers(message: Any, *fields: str) -> list[float]:
    return [getattr(message, name) for name in fields]


def pose_of(position: Any, orientation: Any) -> list[float]:
    return numbers(position, *"xyz") + numbers(orientation, *"xyzw")


def nanoseconds(stamp: Any) -> int:
    return int(stamp.sec * 10**9 + stamp.nanosec)


@pytest.mark.slow
def test_types_are_those_that_ros_2_has(topics: dict[str, list[Any]]) -> None:
    """By the definitions of a library that keeps those of ROS 2."""
    typesys = pytest.importorskip("rosbags.typesys")
    ros_definitions = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE).fielddefs
    typestore = typesys.get_typestore(typesys.Stores.EMPTY)
    for name in ROS_MESSAGES:
        kind = name.replace("/", "/msg/")
        typestore.register(typesys.get_types_from_msg(ros_definition(name), kind))
        assert typestore.fielddefs[kind][1] == ros_definitions[kind][1]
    kinds = {name: rows[0][1] for name, rows in topics.items() if not name.startswith("/series/")}
    assert (
        kinds.items()
        >= {
            "/odometry": "nav_msgs/msg/Odometry",
            "/joint_states": "sensor_msgs/msg/JointState",
            "/tf": "tf2_msgs/msg/TFMessage",
            "/wrench": "geometry_msgs/msg/WrenchStamped",
            "/log": "rcl_interfaces/msg/Log",
        }.items()
    )


def test_the_robot_is_described_by_its_file(
    record: Record, topics: dict[str, list[Any]], tmp_path: Path
) -> None:
    ((when, kind, told),) = topics["/robot_description"]
    assert (when, kind) == (0, "std_msgs/msg/String")
    assert told.data == (robot_folder(record.meta.robot) / "robot.urdf").read_text(encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"^[^\n]*none\.urdf[^\n]*$"):
        record.to_mcap(tmp_path / "a.mcap", urdf=tmp_path / "none.urdf")
    assert not list(tmp_path.iterdir())


def test_poses_are_transforms_at_their_times(record: Record, topics: dict[str, list[Any]]) -> None:
    times = np.rint(1e9 * record["t"]).astype(int).tolist()
    assert [when for when, _, _ in topics["/tf"]] == times
    for (_, _, message), q, estimated, time in zip(
        topics["/tf"], record["q"], record["q_estimated"], times, strict=True
    ):
        for transform, frame, row in zip(
            message.transforms, ("base_link", "base_link_estimated"), (q, estimated), strict=True
        ):
            assert (
                transform.header.frame_id,
                transform.child_frame_id,
                nanoseconds(transform.header.stamp),
            ) == (
                "world",
                frame,
                time,
            )
            assert (
                pose_of(transform.transform.translation, transform.transform.rotation)
                == row[:7].tolist()
            )
    ((_, _, goals),) = topics["/tf_static"]
    assert [goal.child_frame_id for goal in goals.transforms] == [
        frame.name for frame in record.meta.surroundings.frames
    ]


def test_odometry_has_pose_velocity_and_what_the_filter_says_of_its_error(
    record: Record, topics: dict[str, list[Any]]
) -> None:
    for name, suffix in (("/odometry", ""), ("/odometry_estimated", "_estimated")):
        for (_, _, told), q, v in zip(
            topics[name], record[f"q{suffix}"], record[f"v{suffix}"], strict=True
        ):
            assert (told.header.frame_id, told.child_frame_id) == ("world", "base_link")
            assert pose_of(told.pose.pose.position, told.pose.pose.orientation) == q[:7].tolist()
            twist = told.twist.twist
            assert numbers(twist.linear, *"xyz") + numbers(twist.angular, *"xyz") == v[:6].tolist()
    covariance = topics["/odometry_estimated"][-1][2].pose.covariance.reshape(6, 6)
    turn = pin.XYZQUATToSE3(record["q_estimated"][-1, :7]).rotation
    of_turn = turn @ np.diag(record["q_std"][-1, 3:6] ** 2) @ turn.T
    np.testing.assert_allclose(
        covariance,
        block_diag(np.diag(record["q_std"][-1, :3] ** 2), of_turn),
        rtol=1e-9,
        atol=1e-15,
    )


def test_joints_have_states_by_which_a_urdf_moves(
    record: Record, topics: dict[str, list[Any]]
) -> None:
    _, _, last = topics["/joint_states"][-1]
    assert last.name == list(record.meta.joints)
    assert last.position.tolist() == record["q"][-1, 7:].tolist()
    assert last.velocity.tolist() == record["v"][-1, 6:].tolist()
    assert last.effort.tolist() == record["torque"][-1].tolist()


def test_wrenches_are_forces_and_torques_of_the_vehicle(
    record: Record, topics: dict[str, list[Any]]
) -> None:
    for name in ("wrench", "unreachable", "disturbance"):
        for (_, _, told), row in zip(topics[f"/{name}"], record[name], strict=True):
            assert told.header.frame_id == "base_link"
            assert (
                numbers(told.wrench.force, *"xyz") + numbers(told.wrench.torque, *"xyz")
                == row[:6].tolist()
            )


def test_series_have_fields_with_the_names_of_their_columns(
    record: Record, topics: dict[str, list[Any]]
) -> None:
    assert {name.removeprefix("/series/") for name in topics if name.startswith("/series/")} == set(
        record.series
    )
    assert [told.joint3 for _, _, told in topics["/series/q"]] == record["q"][:, 9].tolist()
    errors = [told.T_position_error for _, _, told in topics["/series/quantities"]]
    assert errors == record["T.position_error"].tolist()


def test_what_was_said_is_a_log(record: Record, topics: dict[str, list[Any]]) -> None:
    logged = [
        (nanoseconds(message.stamp), message.level, message.msg) for _, _, message in topics["/log"]
    ]
    entries = [(alarm.t, 30, alarm.text) for alarm in record.run_meta.alarms]
    entries += [(fault.t, 40, fault.text) for fault in record.run_meta.faults]
    assert sorted(logged) == sorted((round(1e9 * t), level, text) for t, level, text in entries)
    assert logged


def test_channels_say_what_their_columns_are(record: Record, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    record.to_mcap(tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    told = {
        channel.metadata["series"]: channel.metadata
        for channel in channels
        if "series" in channel.metadata
    }
    assert told["thrust"]["units"].split("\n") == [unit_of("thrust")] * record["thrust"].shape[1]
    assert told["q"]["units"].split("\n")[2:5] == ["m", "-", "-"]


@pytest.mark.sampled
@pytest.mark.parametrize("plan", PLANS, ids=("curve", "ocp"))
def test_plans_come_back_as_they_were(plan: Record, tmp_path: Path) -> None:
    comes_back(plan, tmp_path)
    topics = read(plan, tmp_path / "again.mcap")
    assert len(topics["/tf"]) == len(topics["/joint_states"]) == len(plan)


def test_a_run_comes_back_as_it_was(record: Record, tmp_path: Path) -> None:
    comes_back(record, tmp_path)


def comes_back(record: Record, folder: Path) -> None:
    record.to_mcap(folder / "record.mcap")
    require_same(Record.from_mcap(folder / "record.mcap"), record)


@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "i8", "u8", "?"])
def test_messages_keep_every_digit_and_type(dtype: str) -> None:
    odd = {
        "f": [np.nan, np.inf, -1e-310, 0.1],
        "i": [-128, 127, 0, 1],
        "u": [0, 2**64 - 1, 1, 2],
        "b": [1, 0, 0, 1],
    }
    array = np.array(odd[np.dtype(dtype).kind], dtype=dtype).reshape(2, 2)
    stored = {"f": "f8", "i": "i8", "u": "u8", "b": "?"}[array.dtype.kind]
    sent = [row.tobytes() for row in cdr_messages(2, (array.astype(stored),))]
    again = values_of(sent, array.dtype.str, 2)
    assert again.dtype == array.dtype
    assert again.tobytes() == array.tobytes()


def test_names_of_fields_are_such_as_messages_may_have_and_differ() -> None:
    assert field_names(["T.position error", "1", "a-b", "a.b", "é"]) == [
        "T_position_error",
        "c1",
        "a_b",
        "a_b_4",
        "c",
    ]


def test_a_file_of_version_1_with_messages_in_protobuf_is_read() -> None:
    record = Record.from_mcap(RECORDS / "run_v1.mcap")
    assert record.run_meta.kind == "run"
    assert {len(values) for values in record.series.values()} == {len(record["t"])}


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n", b"PAR1" * 9], ids=("empty", "head", "other")
)
def test_a_file_of_others_is_refused_in_one_line(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(InvalidInput, match=r"^[^\n]*a\.mcap[^\n]*$"):
        Record.from_mcap(tmp_path / "a.mcap")


def test_chosen_series_come_at_a_chosen_rate(record: Record, tmp_path: Path) -> None:
    path = tmp_path / "chosen.mcap"
    record.to_mcap(path, series=("q", "phase"), rate=25.0)
    part = Record.from_mcap(path)
    rows = [*range(0, len(record), 2), *([len(record) - 1] if len(record) % 2 == 0 else [])]
    assert set(part.series) == {"t", "q", "phase"}
    for name, values in part.series.items():
        np.testing.assert_array_equal(values, record[name][rows])
    with pytest.raises(NameNotFound, match="series 'thurst'"):
        record.to_mcap(path, series=("thurst",))
    for rate in (0.0, -1.0, np.nan):
        with pytest.raises(InvalidInput, match="rate"):
            record.to_mcap(path, rate=rate)


def test_fewer_rows_have_the_figures_of_all_and_every_newest_reading(
    record: Record, tmp_path: Path
) -> None:
    record = Record(series={**record.series, "v": np.ones_like(record["v"])}, meta=record.meta)
    record.to_mcap(tmp_path / "thin.mcap", rate=10.0)
    part = Record.from_mcap(tmp_path / "thin.mcap")
    t = record["t"]
    part_times = part["t"]
    assert part.run_meta.dt == pytest.approx(t[-1] / (len(part) - 1))
    path_lengths = [
        figures_between(any_record, 0.0, t[-1])["joint_path_rad"] for any_record in (record, part)
    ]
    assert path_lengths[1] == pytest.approx(path_lengths[0])
    assert len(summarize(part)["phases"]) == len(summarize(record)["phases"])
    readings = 0
    for name in record.series.keys() & {*MEASURED}:
        for row, (before, end) in enumerate(zip([-1.0, *part_times[:-1]], part_times, strict=True)):
            between = record[name][(t > before) & (t <= end)]
            finite = between[np.isfinite(between[:, -1])]
            readings += len(finite) > 0
            np.testing.assert_array_equal(
                part[name][row],
                finite[-1] if len(finite) else np.full(record[name].shape[1], np.nan),
            )
    assert readings > len(part)
    record.to_mcap(tmp_path / "all.mcap", rate=1e3)
    assert Record.from_mcap(tmp_path / "all.mcap").meta == record.meta


def test_a_part_without_a_series_that_the_summary_needs_is_refused_by_its_name(
    record: Record,
) -> None:
    part = Record(
        series={name: array for name, array in record.series.items() if name != "quantities"},
        meta=record.meta,
    )
    with pytest.raises(
        InvalidInput, match=r"^part of a record: no series 'quantities'; give one with all series$"
    ):
        summarize(part)

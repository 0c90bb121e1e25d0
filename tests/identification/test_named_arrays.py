"""Elements of an array are read by the names beside them, in whatever order a message has them; joints
are joints, and no position of the vehicle.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.message_fields import paths_by_name, steps_of
from uvms_ocp.identification.proposed_mapping import propose_mapping

N = 400
STEP = 50_000_000  # [ns]
ANGLES = {
    name: 0.5 * np.sin(0.02 * np.arange(N) + 2.0 * k)
    for k, name in enumerate(("elbow", "1", "wrist"))
}
FIRST = ("elbow", "1", "wrist")


def joint_states(path: Path, orders: Sequence[Sequence[str]]) -> Path:
    """Write the states of joints; each order of names holds for an equal part of the messages."""
    writers = pytest.importorskip("mcap.writer", reason='needs pip install "uvms-ocp[mcap]"')
    with path.open("wb") as file:
        writer = writers.Writer(file)
        writer.start()
        schema = writer.register_schema("JointState", "jsonschema", b"{}")
        channel = writer.register_channel("/joint_states", "json", schema)
        for k in range(N):
            names = orders[k * len(orders) // N]
            angles = [float(ANGLES[name][k]) for name in names]
            content = {"name": names, "position": angles, "velocity": angles, "effort": []}
            writer.add_message(channel, STEP * k, json.dumps(content).encode(), STEP * k)
        writer.finish()
    return path


def positions(path: Path, columns: Sequence[str]) -> np.ndarray:
    """Read positions of joints."""
    channel = {"topic": "/joint_states", "columns": columns}
    mapping = RecordingMapping.model_validate({"channels": {"joint_positions": channel}})
    return mapped_recording(path, mapping).channels["joint_positions"].values


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        (["position"], FIRST),
        (["position[0]", "position.2"], ("elbow", "wrist")),
        (["position[wrist]", "position[1]"], ("wrist", "1")),
    ],
)
def test_an_array_is_read_by_names_also_where_their_order_changes(
    columns: Sequence[str], names: Sequence[str], tmp_path: Path
) -> None:
    path = joint_states(tmp_path / "arm.mcap", [FIRST, ("wrist", "elbow", "1")])
    expected = np.column_stack([ANGLES[name] for name in names])
    np.testing.assert_array_equal(positions(path, columns), expected)


@pytest.mark.parametrize(
    ("columns", "later"),
    [
        (["position"], ("elbow", "1")),
        (["position"], ("1", "wrist")),
        (["position[0]", "position[1]"], ("1", "wrist")),
    ],
)
def test_places_and_whole_arrays_are_refused_where_other_names_come(
    columns: Sequence[str], later: Sequence[str], tmp_path: Path
) -> None:
    path = joint_states(tmp_path / "arm.mcap", [FIRST, later])
    with pytest.raises(InvalidInput, match=r"joint_positions: .*position.elbow.* at first, then"):
        positions(path, columns)


def test_names_read_messages_that_have_them_and_leave_others_out(tmp_path: Path) -> None:
    path = joint_states(tmp_path / "arm.mcap", [FIRST, ("1", "wrist")])
    read = positions(path, ["position[elbow]"])
    np.testing.assert_array_equal(read[:, 0], ANGLES["elbow"][: N // 2])


@pytest.mark.sampled
@pytest.mark.parametrize("n_joints", [2, 3])
def test_joints_are_proposed_as_joints_by_their_names(n_joints: int, tmp_path: Path) -> None:
    path = joint_states(tmp_path / "arm.mcap", [FIRST[:n_joints]])
    channels = yaml.safe_load(propose_mapping(path))["channels"]
    assert channels.keys() == {"joint_positions", "joint_velocities"}
    expected = [f"position[{name}]" for name in FIRST[:n_joints]]
    assert channels["joint_positions"]["columns"] == expected


def test_columns_of_joints_are_no_position_of_the_vehicle(tmp_path: Path) -> None:
    values = np.column_stack([0.05 * np.arange(N), *ANGLES.values()])
    header = "t,joint_position_0,joint_position_1,joint_position_2"
    np.savetxt(tmp_path / "arm.csv", values, delimiter=",", header=header, comments="")
    channels = yaml.safe_load(propose_mapping(tmp_path / "arm.csv"))["channels"]
    assert channels.keys() == {"joint_positions"}


@pytest.mark.parametrize(
    ("message", "path", "expected"),
    [
        ({"name": ["a", "b"], "u": [1.0, 2.0]}, "u[1]", [("u", "b")]),
        ({"name": ["a", "b"], "u": [1.0, 2.0]}, "u", [("u", "a"), ("u", "b")]),
        ({"name": ["2", "1"], "u": [1.0, 2.0]}, "u[1]", [("u", "1")]),
        ({"name": ["a", "a"], "u": [1.0, 2.0]}, "u[1]", [("u", "1")]),
        ({"name": ["a"], "u": [1.0, 2.0]}, "u", [("u",)]),
        ({"tf": [{"child_frame_id": "a", "x": 1.0}]}, "tf[0].x", [("tf", "a", "x")]),
    ],
)
def test_a_path_means_the_names_that_elements_have(
    message: Any, path: str, expected: list[tuple[str, ...]]
) -> None:
    assert list(paths_by_name(message, steps_of(path))) == expected

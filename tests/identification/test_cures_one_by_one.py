"""A cure turns the channel that is wrong, and none that is sound: whichever one is spoiled, all of the
recording comes back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motions import DOWN, changed, recorded
from proposals import read_as_proposed

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.gravity_checks import G
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.tables import write_columns

Change = Callable[[np.ndarray], np.ndarray]

NAMES = {
    "position": ("x", "y", "z"),
    "attitude": ("qx", "qy", "qz", "qw"),
    "linear_velocity": ("vx", "vy", "vz"),
    "angular_velocity": ("wx", "wy", "wz"),
    "specific_force": ("ax", "ay", "az"),
    "thrust": ("u0", "u1", "u2", "u3"),
}


def dive() -> Recording:
    """Below the surface, with an accelerometer and thrust."""
    moved = recorded(t_end=25.0, rate=10.0)
    attitude = moved.channels["attitude"]
    R = rotations(attitude, attitude.t)
    thrust = np.random.default_rng(3).normal(size=(len(attitude.t), 4))
    channels = {
        **moved.channels,
        "specific_force": Channel(t=attitude.t, values=G * R[:, 2]),
        "thrust": Channel(t=attitude.t, values=thrust),
    }
    return replace(moved, channels=channels)


def written(recording: Recording, path: Path, *, times: float = 1.0, depth: bool = False) -> Path:
    """Write all channels into one table, whose third column may be called a depth."""
    columns = {"t": times * recording.channels["attitude"].t}
    for name, labels in NAMES.items():
        for label, values in zip(labels, recording.channels[name].values.T, strict=True):
            columns["depth" if depth and label == "z" else label] = values
    write_columns(path, columns)
    return path


def require_same(read: Recording, truth: Recording) -> None:
    """Check that all channels have the values of another recording."""
    assert set(read.channels) == set(truth.channels)
    for name, channel in truth.channels.items():
        values = read.channels[name].values
        if name == "attitude":
            values = values * np.sign((values * channel.values).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(values, channel.values, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(read.channels[name].t, channel.t, atol=1e-6, err_msg=name)


SPOILED: dict[str, tuple[str, Change]] = {
    "accelerometer of the other sign": ("specific_force", lambda x: -x),
    "accelerometer along FRD": ("specific_force", lambda x: x @ DOWN),
    "gyro along FRD": ("angular_velocity", lambda x: x @ DOWN),
    "velocity along FRD": ("linear_velocity", lambda x: x @ DOWN),
    "position in NED": ("position", lambda x: x @ DOWN),
    "height of the other sign": ("position", lambda x: x * [1.0, 1.0, -1.0]),
    "attitude in NED and FRD": ("attitude", lambda x: x * [1.0, -1.0, -1.0, 1.0]),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "spoil"), SPOILED.values(), ids=SPOILED)
def test_what_alone_is_wrong_is_turned_alone(name: str, spoil: Change, tmp_path: Path) -> None:
    truth = dive()
    spoiled = changed(truth, name, values=spoil(truth.channels[name].values))
    require_same(read_as_proposed(written(spoiled, tmp_path / "dive.csv")), truth)


@pytest.mark.slow
def test_a_file_that_is_ned_and_frd_throughout_is_turned_as_a_whole(tmp_path: Path) -> None:
    truth = dive()
    spoiled = truth
    for name in ("position", "linear_velocity", "angular_velocity", "specific_force"):
        spoiled = changed(spoiled, name, values=truth.channels[name].values @ DOWN)
    attitude = truth.channels["attitude"].values * [1.0, -1.0, -1.0, 1.0]
    spoiled = changed(spoiled, "attitude", values=attitude)
    require_same(read_as_proposed(written(spoiled, tmp_path / "dive.csv")), truth)


@pytest.mark.slow
@pytest.mark.parametrize(("sign", "moves"), [(1.0, 0.0), (1.0, 1.0), (-1.0, 1.0)])
def test_a_depth_of_either_sign_turns_nothing_else(
    sign: float, moves: float, tmp_path: Path
) -> None:
    truth = dive()
    for name in ("position", "linear_velocity"):
        values = truth.channels[name].values.copy()
        if name == "position":
            values[:, 2] = -12.3 + moves * (values[:, 2] + 2.0)
        truth = changed(truth, name, values=values)
    spoiled = changed(
        truth, "position", values=truth.channels["position"].values * [1.0, 1.0, sign]
    )
    read = read_as_proposed(written(spoiled, tmp_path / "dive.csv", depth=True))
    require_same(read, truth)


@pytest.mark.slow
@pytest.mark.parametrize("times", [1e3, 1e9])
def test_channels_of_one_time_column_have_one_unit(times: float, tmp_path: Path) -> None:
    truth = dive()
    require_same(read_as_proposed(written(truth, tmp_path / "dive.csv", times=times)), truth)


def test_a_time_column_that_is_read_in_two_units_is_doubted(tmp_path: Path) -> None:
    path = written(dive(), tmp_path / "dive.csv", times=1e3)
    channels = {
        name: {"time": "t", "columns": list(labels), "time_unit": "ms"}
        for name, labels in NAMES.items()
    }
    del channels["thrust"]["time_unit"]
    read = mapped_recording(path, RecordingMapping.model_validate({"channels": channels}))
    doubts = [str(doubt) for doubt in check_data_quality(read)]
    assert any("thrust: its times are the column t in s, and" in doubt for doubt in doubts), doubts

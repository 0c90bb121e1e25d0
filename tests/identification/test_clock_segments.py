"""Clocks that begin anew: counters go on, boots come one after the other, and late messages are none."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from motions import recorded
from scipy.ndimage import gaussian_filter1d

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.clock_segments import continued
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.recording_gaps import split_at_gaps
from uvms_ocp.identification.tables import write_columns

T = np.arange(0.0, 100.0, 0.05)


@pytest.mark.parametrize("modulus", [65.536, 4294.967296])
def test_a_counter_that_wraps_goes_on(modulus: float) -> None:
    begin = modulus - 30.0
    counted = np.mod(begin + T, modulus)
    clocks = continued({"position": counted, "attitude": counted[::2]})
    np.testing.assert_allclose(clocks.times["position"], begin + T, atol=1e-6)
    np.testing.assert_allclose(clocks.times["attitude"], begin + T[::2], atol=1e-6)
    assert clocks.wraps >= 1
    assert clocks.boots == 0


@pytest.mark.parametrize("lengths", [(40.0, 60.0), (60.0, 40.0), (30.0, 30.0, 40.0)])
def test_boots_come_one_after_the_other(lengths: tuple[float, ...]) -> None:
    t = np.concatenate([5.0 + np.arange(0.0, length, 0.05) for length in lengths])
    slow = np.concatenate([5.1 + np.arange(0.0, length - 0.2, 0.2) for length in lengths])
    clocks = continued({"position": t, "attitude": slow})
    assert clocks.boots == len(lengths) - 1
    assert (np.diff(clocks.times["position"]) > 0.0).all()
    assert (np.diff(clocks.times["attitude"]) > 0.0).all()
    late = np.interp(clocks.times["attitude"][:5], clocks.times["position"], t) - slow[:5]
    np.testing.assert_allclose(late, 0.0, atol=1e-9)
    # The channels stay together after each boot.
    gaps = np.flatnonzero(np.diff(clocks.times["position"]) > 2.0)
    assert len(gaps) == len(lengths) - 1
    second = clocks.times["attitude"][clocks.times["attitude"] > clocks.times["position"][gaps[0]]]
    begin = clocks.times["position"][gaps[0] + 1]
    assert second[0] - begin == pytest.approx(0.1)


def test_messages_that_are_late_are_no_boot() -> None:
    t = T.copy()
    t[500:540] = T[440:480]
    clocks = continued({"position": t})
    assert clocks.boots == 0
    np.testing.assert_array_equal(clocks.times["position"], t)


def test_two_boots_in_a_file_are_parts_of_their_own_and_said(tmp_path: Path) -> None:
    recording = recorded(t_end=30.0)
    values = recording.channels["position"].values
    t = recording.channels["position"].t
    columns = {"t": np.r_[t, t]}
    for axis, column in zip("xyz", values.T, strict=True):
        columns[axis] = np.r_[column, column + 20.0]
    write_columns(tmp_path / "dive.csv", columns)
    channels = {"position": {"time": "t", "columns": ["x", "y", "z"]}}
    read = mapped_recording(
        tmp_path / "dive.csv", RecordingMapping.model_validate({"channels": channels})
    )
    assert any("boots, or a clock that was set" in str(doubt) for doubt in check_data_quality(read))
    first, second = split_at_gaps([read])
    np.testing.assert_allclose(first.channels["position"].values, values)
    np.testing.assert_allclose(second.channels["position"].values, values + 20.0)


@pytest.mark.sampled
@pytest.mark.parametrize("delay", [2.0, 7.5, -4.0])
def test_a_delay_beyond_the_usual_ones_is_told(delay: float) -> None:
    t = np.arange(0.0, 120.0, 0.05)
    drawn = np.random.default_rng(0).normal(size=(len(t), 3))
    velocities = 4.0 * gaussian_filter1d(drawn, sigma=20, axis=0)
    places = np.cumsum(0.05 * velocities, axis=0) - [0.0, 0.0, 20.0]
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    recording = Recording(
        name="drawn",
        channels={
            "position": Channel(t=t, values=places),
            "attitude": Channel(t=t, values=level),
            "linear_velocity": Channel(t=t + delay, values=velocities),
        },
    )
    text = "; ".join(map(str, check_data_quality(recording)))
    way = "late" if delay > 0.0 else "early"
    told = re.search(rf"linear_velocity: ([\d.]+) s {way} against the rate of the position", text)
    assert told, text
    assert abs(float(told[1]) - abs(delay)) < 0.11


def test_a_column_that_is_sent_every_other_row_is_whole(tmp_path: Path) -> None:
    recording = recorded(t_end=30.0)
    velocity = recording.channels["linear_velocity"]
    position = recording.channels["position"]
    columns = {"t": velocity.t}
    columns |= dict(zip("xyz", position.values.T, strict=True))
    is_sent = np.arange(len(velocity.t)) % 2 == 0
    for name, column in zip(("vx", "vy", "vz"), velocity.values.T, strict=True):
        columns[name] = np.where(is_sent, column, np.nan)
    write_columns(tmp_path / "dive.csv", columns)
    mapping = {
        "position": {"time": "t", "columns": ["x", "y", "z"]},
        "linear_velocity": {"time": "t", "columns": ["vx", "vy", "vz"]},
    }
    read = mapped_recording(
        tmp_path / "dive.csv", RecordingMapping.model_validate({"channels": mapping})
    )
    assert read.issues_in_file == ()
    np.testing.assert_allclose(
        read.channels["linear_velocity"].values, velocity.values[is_sent], atol=1e-12
    )

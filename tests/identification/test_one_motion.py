"""Channels are of one motion, one sender, one order of angles and fine numbers, or it is said; what a
gyro reads is estimated with its errors.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from motions import changed, recorded
from scipy.spatial.transform import Rotation

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.euler_orders import AXES, quaternions_of_angles
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import rotations
from uvms_ocp.identification.series_agreement import offset
from uvms_ocp.identification.tables import write_columns
from uvms_ocp.identification.turning_checks import estimated_gyro_mounting
from uvms_ocp.robot.spatial import continuous_quaternions

NOISE = 0.01  # [m, m/s, rad/s]


def noisy(seed: int = 0, t_end: float = 60.0) -> Recording:
    """Draw a sound recording with noise in all channels but the attitude."""
    recording = recorded(seed=seed, t_end=t_end)
    rng = np.random.default_rng(seed)
    for name in ("position", "linear_velocity", "angular_velocity"):
        values = recording.channels[name].values
        noise = NOISE * rng.normal(size=values.shape)
        recording = changed(recording, name, values=values + noise)
    return recording


def doubts(recording: Recording) -> str:
    """Join all doubts about a recording."""
    return "; ".join(map(str, check_data_quality(recording)))


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(3))
def test_sound_recordings_are_not_doubted(seed: int) -> None:
    assert doubts(noisy(seed)) == ""


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["linear_velocity", "angular_velocity", "position"])
def test_a_channel_of_another_run_is_said(name: str) -> None:
    values = noisy(3).channels[name].values
    text = doubts(changed(noisy(), name, values=values))
    assert "is explained by the other; of another run, vehicle or clock?" in text


def test_what_stands_still_is_of_no_other_motion() -> None:
    recording = noisy()
    rng = np.random.default_rng(1)
    still = np.array([1.0, 2.0, -3.0]) + 0.02 * rng.normal(size=(1200, 3))
    recording = changed(recording, "position", values=still)
    recording = changed(recording, "linear_velocity", values=0.02 * rng.normal(size=(1200, 3)))
    assert "of another run" not in doubts(recording)


@pytest.mark.parametrize("size", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("period", [6.0, 9.0])
def test_an_accelerometer_in_swell_is_of_the_same_run(size: float, period: float) -> None:
    """It feels the accelerations of the swell beside its tilts. size: [m/s2]; period: [s]."""
    t = np.arange(0.0, 120.0, 0.05)
    angles = 0.12 * np.column_stack([np.sin(0.5 * t), np.sin(0.4 * t), 2.0 * np.sin(0.3 * t)])
    attitude = Channel(t=t, values=quaternions_of_angles(angles, "rpy"))
    phase = 2.0 * np.pi * t / period
    felt = np.column_stack([size * np.sin(phase), size * np.cos(1.1 * phase), 9.81 + 0.0 * t])
    force = np.einsum("nji,nj->ni", rotations(attitude, t), felt)
    channels = {"attitude": attitude, "specific_force": Channel(t=t, values=force)}
    assert "of another run" not in doubts(Recording(name="swell", channels=channels))


def test_an_accelerometer_of_another_run_is_said() -> None:
    recording = recorded(t_end=120.0)
    foreign = recorded(t_end=120.0, seed=1).channels["attitude"]
    force = 9.81 * rotations(foreign, foreign.t)[:, 2]
    channels = {
        "attitude": recording.channels["attitude"],
        "specific_force": Channel(t=foreign.t, values=force),
    }
    assert "specific_force: does not tilt as the attitude does" in doubts(
        replace(recording, channels=channels)
    )


@pytest.mark.sampled
@pytest.mark.parametrize("share", [0.5, 0.2])
def test_two_senders_that_the_file_does_not_name_are_said(share: float) -> None:
    recording = noisy()
    rng = np.random.default_rng(2)
    values = recording.channels["position"].values
    is_other = rng.uniform(size=(len(values), 1)) < share
    distance = np.array([3.0, 4.0, 0.0])
    mixed = np.where(is_other, values + distance, values)
    text = doubts(changed(recording, "position", values=mixed))
    assert text.startswith("position: goes to and fro between two series, 5 m apart")


def test_attitudes_of_two_senders_are_apart_by_an_angle() -> None:
    recording = noisy()
    values = recording.channels["attitude"].values.copy()
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, np.deg2rad(40.0)))
    for k in range(0, len(values), 2):
        values[k] = (turn * pin.Quaternion(values[k])).coeffs()
    text = doubts(changed(recording, "attitude", values=values))
    assert text.startswith("attitude: goes to and fro between two series, ")
    angle = float(text.partition("series, ")[2].partition(" deg apart")[0])
    assert abs(angle - 40.0) < 4.0


def test_a_position_that_is_set_anew_is_said() -> None:
    recording = noisy()
    channel = recording.channels["position"]
    values = channel.values + np.where(channel.t[:, None] > 30.0, [3.0, 0.0, 0.0], 0.0)
    text = doubts(changed(recording, "position", values=values))
    assert text.startswith("position: jumps by ")
    assert "m at 30.05 s and goes on from there, 1 times in all" in text


def test_a_fix_that_is_held_for_some_rows_has_one_sender() -> None:
    recording = noisy()
    values = recording.channels["position"].values
    held = values[np.arange(len(values)) // 5 * 5]
    assert "two series" not in doubts(changed(recording, "position", values=held))


@pytest.mark.parametrize(("speed", "held"), [(0.5, 7.0), (0.23, 5.0)])
def test_a_fix_that_is_held_long_is_not_set_anew(speed: float, held: float) -> None:
    t = np.arange(0.0, 120.0, 0.05)
    fixed = held * np.floor(t / held)
    places = speed * np.column_stack([fixed, 9.0 * np.sin(fixed / 9.0), np.cos(fixed / 9.0)])
    recording = Recording(name="held", channels={"position": Channel(t=t, values=places)})
    assert "set anew" not in doubts(recording)
    places[t > 60.0, 0] += 120.0  # farther than it swims while a fix is held
    channels = {"position": Channel(t=t, values=places)}
    assert "goes on from there, 1 times in all: set anew?" in doubts(
        replace(recording, channels=channels)
    )


def test_scale_axes_and_bias_of_a_gyro_come_back() -> None:
    recording = noisy()
    R = pin.rpy.rpyToMatrix(*np.deg2rad([5.0, -4.0, 8.0]))
    bias = np.array([0.02, -0.03, 0.01])
    values = 1.1 * recording.channels["angular_velocity"].values @ R + bias
    mounting = estimated_gyro_mounting(changed(recording, "angular_velocity", values=values))
    assert mounting is not None
    assert abs(mounting.scale - 1.1) < 0.003
    assert np.abs(mounting.turn - pin.log3(R)).max() < np.deg2rad(0.5)
    assert np.abs(mounting.bias - bias).max() < 0.002


def turned_for_a_second(recording: Recording, begin: float) -> Recording:
    """A copy whose attitude is rolled by 0.5 rad for a second."""
    channel = recording.channels["attitude"]
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.5, 0.0, 0.0))
    values = channel.values.copy()
    for k in np.flatnonzero((channel.t > begin) & (channel.t < begin + 1.0)):
        values[k] = (turn * pin.Quaternion(values[k])).coeffs()
    return changed(recording, "attitude", values=values)


def test_an_attitude_that_turns_by_itself_is_said_with_its_time() -> None:
    text = doubts(turned_for_a_second(noisy(), 20.0))
    assert (
        "attitude: turns otherwise than the angular_velocity at 2 moments, first at 19.75 s" in text
    )


@pytest.mark.slow
def test_all_of_a_long_recording_is_looked_at() -> None:
    text = doubts(turned_for_a_second(noisy(t_end=1500.0), 1400.0))
    assert "turns otherwise than the angular_velocity at 2 moments, first at 1400 s" in text


def test_an_order_is_told_of_a_vehicle_that_turns_in_place() -> None:
    from scipy.spatial.transform import Rotation

    recording = noisy()
    rotation = Rotation.from_quat(recording.channels["attitude"].values)
    angles = np.empty((1200, 3))
    angles[:, AXES["rpy 3-1-2"]] = rotation.as_euler("ZXY")
    misread = quaternions_of_angles(angles, "rpy")
    rng = np.random.default_rng(3)
    for name in ("position", "linear_velocity"):
        still = [0.0, 0.0, -2.0] if name == "position" else [0.0, 0.0, 0.0]
        values = still + 0.01 * rng.normal(size=(len(angles), 3))
        recording = changed(recording, name, values=values)
    assert "reads better" not in doubts(recording)
    text = doubts(changed(recording, "attitude", values=misread))
    assert "reads better with format: rpy 3-1-2" in text
    assert "% of the turns by the gyro unexplained in place of " in text


@pytest.mark.sampled
@pytest.mark.parametrize("scale", [0.95, 1.05, 1.15])
def test_a_scale_of_a_gyro_is_said_with_its_cure(scale: float) -> None:
    recording = noisy()
    values = scale * recording.channels["angular_velocity"].values
    text = doubts(changed(recording, "angular_velocity", values=values))
    assert "times the rate at which the attitude turns: give it scale: " in text
    cured = float(text.partition("give it scale: ")[2])
    assert abs(cured * scale - 1.0) < 0.003


@pytest.mark.sampled
@pytest.mark.parametrize("form", ["rpy 3-1-2", "rpy 2-1-3", "rpy 1-2-3", "rpy 1-3-2", "rpy 2-3-1"])
def test_map_reads_angles_in_their_order(tmp_path: Path, form: str) -> None:
    from scipy.spatial.transform import Rotation

    recording = noisy()
    axes = AXES[form]
    angles = np.empty((1200, 3))
    rotation = Rotation.from_quat(recording.channels["attitude"].values)
    angles[:, axes] = rotation.as_euler("".join("XYZ"[axis] for axis in axes))
    columns = {"t": recording.channels["attitude"].t}
    columns |= dict(zip(("roll", "pitch", "yaw"), angles.T, strict=True))
    for name, labels in {
        "position": "x y z",
        "linear_velocity": "vx vy vz",
        "angular_velocity": "wx wy wz",
    }.items():
        columns |= dict(zip(labels.split(), recording.channels[name].values.T, strict=True))
    path = tmp_path / "angles.csv"
    write_columns(path, columns)
    text = propose_mapping(path)
    assert f"format: {form}" in text
    assert "doubtful" not in text
    keys = {"time": "t", "columns": ["roll", "pitch", "yaw"], "format": form}
    mapping = RecordingMapping.model_validate({"channels": {"attitude": keys}})
    read = Rotation.from_quat(mapped_recording(path, mapping).channels["attitude"].values)
    assert (read * rotation.inv()).magnitude().max() < 1e-6


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "step"), [("position", 0.2), ("linear_velocity", 0.1), ("angular_velocity", 0.1)]
)
def test_a_column_of_few_digits_is_said(name: str, step: float) -> None:
    recording = noisy()
    values = recording.channels[name].values.copy()
    values[:, 2] = step * np.round(values[:, 2] / step)
    text = doubts(changed(recording, name, values=values))
    assert f"{name}: z changes in steps of {step:g} " in text


def test_few_digits_are_said_whatever_else_is_wrong() -> None:
    recording = noisy()
    velocity = recording.channels["linear_velocity"]
    kept = (velocity.t < 20.0) | (velocity.t > 24.0)
    recording = changed(
        recording, "linear_velocity", t=velocity.t[kept], values=velocity.values[kept]
    )
    values = recording.channels["position"].values.copy()
    values[:, 2] = 0.2 * np.round(values[:, 2] / 0.2)
    text = doubts(changed(recording, "position", values=values))
    assert "linear_velocity: 1 gaps" in text
    assert "position: z changes in steps of 0.2 m" in text


def test_digits_that_sensors_have_are_enough() -> None:
    recording = noisy()
    channels = {}
    for name, digits in {"position": 2, "linear_velocity": 3, "angular_velocity": 3}.items():
        channel = recording.channels[name]
        channels[name] = replace(channel, values=np.round(channel.values, digits))
    recording = replace(recording, channels={**recording.channels, **channels})
    assert doubts(recording) == ""


def test_an_attitude_that_is_astray_for_a_while_is_said_as_that_and_nothing_else() -> None:
    """By it the velocity points elsewhere, too."""
    recording = noisy()
    channel = recording.channels["attitude"]
    astray = Rotation.from_euler("z", 2.2) * Rotation.from_quat(channel.values.copy())
    is_astray = (channel.t > 20.0) & (channel.t < 40.0)
    values = np.where(is_astray[:, None], astray.as_quat(), channel.values)
    text = doubts(changed(recording, "attitude", values=continuous_quaternions(values)))
    assert text.startswith("attitude: turns otherwise than the angular_velocity at 2 moments")
    assert "points elsewhere" not in text


def test_an_accelerometer_without_gravity_says_nothing_of_the_attitude() -> None:
    recording = recorded(t_end=60.0)
    t = recording.channels["attitude"].t
    force = 0.05 * np.random.default_rng(0).normal(size=(len(t), 3))
    channels = {**recording.channels, "specific_force": Channel(t=t, values=force)}
    text = doubts(replace(recording, channels=channels))
    assert "gravity taken out" in text
    assert "axes or format" not in text


@pytest.mark.sampled
@pytest.mark.parametrize("late", [2.0, -2.5, 5.0, 12.0])
def test_a_velocity_of_swings_that_is_late_by_far_is_told_by_its_components(late: float) -> None:
    """Magnitudes of swings repeat: 1.5 s early was said of 2 s late."""
    recording = noisy()
    velocity = recording.channels["linear_velocity"]
    text = doubts(changed(recording, "linear_velocity", t=velocity.t + late))
    direction = "late" if late > 0.0 else "early"
    assert (
        f"linear_velocity: {abs(late):.2f} s {direction} against the rate of the position" in text
    )


@pytest.mark.parametrize("signs", [(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, -1.0, -1.0)])
@pytest.mark.parametrize(("period", "decay"), [(10.0, 20.0), (25.0, 20.0), (60.0, 60.0)])
def test_swings_that_die_out_in_mirrored_axes_are_not_late(
    signs: tuple[float, float, float], period: float, decay: float
) -> None:
    """Half a period later they were found again, 12 s early, and axes were right by then."""
    t = np.arange(0.0, 120.0, 0.05)
    swings = np.sin(2.0 * np.pi * t[:, None] / period + np.array([0.0, 1.0, 2.0]))
    expected = swings * np.exp(-t / decay)[:, None] * [0.1, 0.1, 1.0]
    noise = 2.0 * NOISE * np.random.default_rng(0).normal(size=expected.shape)
    found = offset(t, expected, t, expected * signs + noise)
    assert abs(found.delay) < 0.175

"""Recordings are read as they were meant, and bad ones are named."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from motions import DOWN, changed, recorded

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.channel_mapping import RecordingMapping, read_mapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import (
    ZeroOrderHold,
    angular_rate,
    rotations,
)
from uvms_ocp.identification.sample_times import even_send_times
from uvms_ocp.identification.tables import (
    read_columns,
    stored_recording,
    write_columns,
    write_recording,
)

GOOD = recorded()
ATTITUDE = GOOD.channels["attitude"].values


def told(recording: Recording) -> str:
    return "; ".join(map(str, check_data_quality(recording)))


def test_nothing_is_doubtful_about_a_good_recording() -> None:
    assert told(GOOD) == ""


def test_a_turned_world_frame_raises_no_doubt() -> None:
    yaw = pin.Quaternion(pin.rpy.rpyToMatrix(0, 0, 2.0))
    turned = [(yaw * pin.Quaternion(x)).coeffs() for x in ATTITUDE]
    signs = np.cumprod([1.0, *(np.sign(np.dot(x, y)) for x, y in pairwise(turned))])
    moved = changed(GOOD, "attitude", values=np.array(turned) * signs[:, None])
    position = GOOD.channels["position"].values @ yaw.toRotationMatrix().T + [7.0, -3.0, 0.0]
    assert told(changed(moved, "position", values=position)) == ""


LINEAR, ANGULAR = (GOOD.channels[f"{kind}_velocity"].values for kind in ("linear", "angular"))
ON_ITS_BACK = np.array(
    [(pin.Quaternion(x) * pin.Quaternion(np.array([1.0, 0, 0, 0]))).coeffs() for x in ATTITUDE]
)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("linear_velocity", LINEAR[:, [1, 0, 2]], r"linear_velocity: its axes fit .* \(y, x, z\)"),
        ("linear_velocity", LINEAR @ DOWN, r"linear_velocity: its axes fit .* \(x, -y, -z\)"),
        (
            "angular_velocity",
            ANGULAR * [1, 1, -1],
            r"angular_velocity: its axes fit .* \(x, y, -z\)",
        ),
        ("angular_velocity", np.degrees(ANGULAR), "angular_velocity: 5[78] times .* in deg/s"),
        ("linear_velocity", 1000 * LINEAR, r"linear_velocity: 1e\+03 times the rate"),
        ("angular_velocity", ANGULAR * [1, 0, 1], "angular_velocity: dead: y"),
        ("position", GOOD.channels["position"].values @ DOWN, "position: z is .* z down"),
        (
            "attitude",
            ATTITUDE[:, [3, 0, 1, 2]],
            "attitude: reads better with format: quaternion wxyz",
        ),
        ("attitude", ON_ITS_BACK, "attitude: the vehicle lies on its back"),
    ],
)
def test_bad_channels_are_named(name: str, values: np.ndarray, text: str) -> None:
    assert re.search(text, told(changed(GOOD, name, values=values))), told(
        changed(GOOD, name, values=values)
    )


def test_a_velocity_in_the_world_frame_is_named() -> None:
    R = rotations(GOOD.channels["attitude"], GOOD.channels["attitude"].t)
    inside = np.einsum("nij,nj->ni", R, GOOD.channels["linear_velocity"].values)
    assert "in W" in told(changed(GOOD, "linear_velocity", values=inside))


@pytest.mark.sampled
@pytest.mark.parametrize("late", [0.3, -0.4])
def test_offsets_of_clocks_are_told_and_corrected_by_a_delay(late: float) -> None:
    name = "linear_velocity"
    shifted = changed(GOOD, name, t=GOOD.channels[name].t + late)
    assert f"{abs(late):.2f} s {'late' if late > 0 else 'early'}" in told(shifted)
    assert told(changed(shifted, name, delay=late)) == ""


def test_gaps_bursts_and_lost_samples_are_told() -> None:
    channel = GOOD.channels["linear_velocity"]
    kept = (channel.t < 10.0) | (channel.t > 12.0)
    assert "1 gaps, the longest 2" in told(
        changed(GOOD, "linear_velocity", t=channel.t[kept], values=channel.values[kept])
    )
    lost = channel.values.copy()
    lost[100:103] = 0.0
    assert "3 of 800 samples are exactly zero" in told(
        changed(GOOD, "linear_velocity", values=lost)
    )
    bursts = np.ceil(channel.t * 2) / 2 + 1e-4 * np.arange(len(channel.t))
    assert "arrives in bursts" in told(changed(GOOD, "linear_velocity", t=bursts))


def test_even_messages_are_told_when_they_were_sent() -> None:
    rng = np.random.default_rng(1)
    sent = 0.02 * np.arange(3000)
    lost = (sent < 20.0) | (sent > 20.3)
    arrived = np.maximum.accumulate(sent[lost] + 0.05 + rng.exponential(0.1, size=lost.sum()))
    late, left = (times - sent[lost] - 0.05 for times in (arrived, even_send_times(arrived, 0.02)))
    assert (left <= late + 1e-12).all()
    assert left.min() > -1e-9
    assert left.mean() < 0.25 * late.mean()


@pytest.mark.sampled
@pytest.mark.parametrize("ending", [".csv", ".csv.gz", ".parquet"])
def test_a_stored_recording_comes_back(ending: str, tmp_path: Path) -> None:
    if ending == ".parquet":
        pytest.importorskip("pyarrow")
    late = changed(GOOD, "linear_velocity", t=GOOD.channels["linear_velocity"].t + 0.013, delay=0.2)
    thrust = Channel(t=np.array([0.0, 1.5]), values=np.arange(16.0).reshape(2, 8))
    recording = Recording(name="kept", channels={**late.channels, "thrust": thrust})
    path = tmp_path / f"kept{ending}"
    write_recording(recording, path)
    again = stored_recording(path)
    assert again.name == "kept"
    assert set(again.channels) == set(recording.channels)
    for name, channel in recording.channels.items():
        np.testing.assert_array_equal(again.channels[name].t, channel.t)
        np.testing.assert_array_equal(again.channels[name].values, channel.values)
        assert again.channels[name].delay == channel.delay


def test_foreign_columns_in_degrees_and_ned_become_ours(tmp_path: Path) -> None:
    t = GOOD.channels["position"].t
    rpy = np.array(
        [pin.rpy.matrixToRpy(DOWN @ pin.Quaternion(x).toRotationMatrix() @ DOWN) for x in ATTITUDE]
    )
    ned = {"stamp": 1e9 * (t + 100.0)}
    ned |= {f"p{k}": x for k, x in enumerate((GOOD.channels["position"].values @ DOWN).T)}
    ned |= {f"a{k}": x for k, x in enumerate(np.degrees(rpy).T)}
    ned |= {f"v{k}": x for k, x in enumerate((GOOD.channels["linear_velocity"].values @ DOWN).T)}
    write_columns(tmp_path / "nav_7.csv", ned)
    (tmp_path / "map.yaml").write_text("""channels:
  position: {file: "nav_{name}.csv", time: stamp, time_unit: ns, columns: [p0, p1, p2], world: NED}
  attitude: {file: "nav_{name}.csv", time: stamp, time_unit: ns, columns: [a0, a1, a2], format: rpy, unit: deg,
    world: NED, body: FRD}
  linear_velocity: {file: "nav_{name}.csv", time: stamp, time_unit: ns, columns: [v0, v1, v2], body: FRD, delay: 0.1}
""")
    read = mapped_recording(tmp_path, read_mapping(tmp_path / "map.yaml"), "7")
    for name in ("position", "linear_velocity"):
        np.testing.assert_allclose(
            read.channels[name].values, GOOD.channels[name].values, atol=1e-9
        )
    np.testing.assert_allclose(
        rotations(read.channels["attitude"], t), rotations(GOOD.channels["attitude"], t), atol=1e-6
    )
    assert read.channels["linear_velocity"].delay == 0.1
    assert read.channels["position"].t[0] == 0.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("channels: {position: {time: t, columns: [x], colums: [y]}}", "did you mean 'columns'"),
        ("channels: {}", "channels"),
        ("channels: [", "not valid YAML"),
    ],
)
def test_wrong_mappings_are_told_in_a_line(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(InvalidInput, match=message):
        read_mapping(tmp_path / "map.yaml")


def test_wrong_files_are_told_in_a_line(tmp_path: Path) -> None:
    good = RecordingMapping(channels={"thrust": {"time": "t", "columns": ["a"]}})
    (tmp_path / "a.csv").write_text("t,b\n0,1\n1,2\n")
    with pytest.raises(NameNotFound, match=r"unknown column of a.csv 'a'; known: t, b"):
        mapped_recording(tmp_path / "a.csv", good)
    (tmp_path / "b.csv").write_text("t,a\n0,one\n")
    with pytest.raises(InvalidInput, match=r"b\.csv: row 1, column 'a': 'one' is no number"):
        mapped_recording(tmp_path / "b.csv", good)
    with pytest.raises(InvalidInput, match="there is no such file"):
        mapped_recording(tmp_path / "c.csv", good)
    (tmp_path / "d.csv.gz").write_bytes(b"\x1f\x8b nothing")
    with pytest.raises(InvalidInput, match="no table of numbers"):
        read_columns(tmp_path / "d.csv.gz", ["t"])
    (tmp_path / "e.csv").write_text("t,r,p,y\n0,0,0,0\n1,10,20,30\n")
    angles = RecordingMapping(
        channels={"attitude": {"time": "t", "columns": ["r", "p", "y"], "format": "rpy"}}
    )
    with pytest.raises(InvalidInput, match="in deg"):
        mapped_recording(tmp_path / "e.csv", angles)


@pytest.mark.parametrize(
    ("t", "values", "message"),
    [
        ([0.0, 0.0], [[1.0], [2.0]], "increasing"),
        ([0.0, 1.0], [[np.nan], [2.0]], "leave out"),
        ([0.0, 1.0], [1.0, 2.0], r"\(n,\) and \(n, k\)"),
    ],
)
def test_channels_that_cannot_be_are_refused(
    t: list[float], values: list[object], message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        Channel(t=np.array(t), values=np.array(values))


def test_recordings_that_cannot_be_are_refused() -> None:
    channel = Channel(t=np.array([0.0, 1.0]), values=np.ones((2, 4)))
    with pytest.raises(NameNotFound, match="Did you mean 'position'"):
        Recording(name="r", channels={"positon": channel})
    with pytest.raises(InvalidInput, match="4 columns given; allowed: 3"):
        Recording(name="r", channels={"position": channel})
    with pytest.raises(InvalidInput, match="no unit quaternions"):
        Recording(name="r", channels={"attitude": channel})
    with pytest.raises(InvalidInput, match="no thrust is recorded, only position"):
        GOOD.channel("thrust")


def test_the_rate_of_an_attitude_is_its_angular_velocity() -> None:
    t, omega = angular_rate(GOOD.channels["attitude"], 0.3)
    known = GOOD.channels["angular_velocity"]
    wanted = np.column_stack([np.interp(t, known.t, column) for column in known.values.T])
    np.testing.assert_allclose(omega[10:-10], wanted[10:-10], atol=0.02)


def test_the_mean_of_a_held_command_is_its_integral_and_its_slope_a_difference() -> None:
    rng = np.random.default_rng(5)
    held = ZeroOrderHold(
        Channel(
            t=np.sort(rng.uniform(0, 10, size=200)), values=rng.normal(size=(200, 2)), delay=0.1
        )
    )
    edges = np.linspace(1.0, 9.0, 41)
    fine = np.linspace(1.0, 9.0, 400_001)
    values = held.at((fine[1:] + fine[:-1]) / 2)
    np.testing.assert_allclose(held.mean(edges), values.reshape(40, -1, 2).mean(axis=1), atol=1e-3)
    step = 1e-7
    slope = (held.mean(edges + step) - held.mean(edges - step)) / (2 * step)
    np.testing.assert_allclose(held.mean_slope(edges), slope, atol=1e-5)


def with_holes(tmp_path: Path, name: str, holes: np.ndarray) -> Recording:
    """A table of a velocity and thrust whose cells are empty in holes (n,) of one of both."""
    n = len(holes)
    rng = np.random.default_rng(0)
    table = {
        "t": 0.1 * np.arange(n),
        **{f"{key}{k}": rng.normal(size=n) for key in ("v", "f") for k in range(3)},
    }
    table |= {f"{name}{k}": np.where(holes, np.nan, table[f"{name}{k}"]) for k in range(3)}
    write_columns(tmp_path / "a.csv", table)
    pairs = (("linear_velocity", "v"), ("thrust", "f"))
    channels = {
        key: {"time": "t", "columns": [f"{column}{k}" for k in range(3)]} for key, column in pairs
    }
    return mapped_recording(tmp_path / "a.csv", RecordingMapping(channels=channels))


@pytest.mark.parametrize(("name", "channel"), [("v", "linear_velocity"), ("f", "thrust")])
def test_rows_with_nan_are_counted_and_of_a_command_it_is_said_what_a_fit_makes_of_them(
    name: str, channel: str, tmp_path: Path
) -> None:
    holes = np.arange(70) % 7 == 3
    recording = with_holes(tmp_path, name, holes)
    assert len(recording.channels[channel].t) == 60
    assert (
        f"{channel}: 10 of 70 rows have NaN ({name}0, {name}1, {name}2) and are left out"
        in told(recording)
    )
    assert ("the command before them" in told(recording)) == (channel == "thrust")


def test_rows_of_other_channels_in_a_table_are_no_lost_ones(tmp_path: Path) -> None:
    assert "NaN" not in told(with_holes(tmp_path, "v", np.arange(70) % 7 != 3))


def test_a_channel_that_is_nan_in_every_row_says_so(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"linear_velocity: NaN in every row \(v0, v1, v2\)"):
        with_holes(tmp_path, "v", np.ones(70, dtype=bool))

"""Rows of an array are samples, whatever its shape, unless times rise along its columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.identification.array_orientation import are_times, oriented
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.tables import column_names, read_columns

RANDOM = np.random.default_rng(1)


def recording_of_places(path: Path, time: str | float, n_thrusters: int) -> Recording:
    """Read thrust from the columns of a `.npy` after the first."""
    columns = [f"#{k + 2}" for k in range(n_thrusters)]
    channels = {"thrust": {"time": time, "columns": columns}}
    return mapped_recording(path, RecordingMapping.model_validate({"channels": channels}))


@pytest.mark.parametrize(("n_rows", "n_columns"), [(12, 14), (12, 12), (14, 12), (50, 8)])
def test_rows_after_a_column_of_times_are_samples(
    n_rows: int, n_columns: int, tmp_path: Path
) -> None:
    block = RANDOM.normal(size=(n_rows, n_columns))
    block[:, 0] = 0.1 * np.arange(n_rows)
    np.save(tmp_path / "a.npy", block)
    recording = recording_of_places(tmp_path / "a.npy", "#1", 3)
    np.testing.assert_array_equal(recording.channels["thrust"].values, block[:, 1:4])
    assert not any("taken for samples" in str(issue) for issue in check_data_quality(recording))


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_columns_below_a_row_of_times_are_samples_and_it_is_said(
    jitter: float, tmp_path: Path
) -> None:
    block = RANDOM.normal(size=(12, 200))
    block[0] = 0.1 * (np.arange(200) + jitter * RANDOM.uniform(-1.0, 1.0, size=200))
    np.save(tmp_path / "a.npy", block)
    recording = recording_of_places(tmp_path / "a.npy", "#1", 3)
    np.testing.assert_array_equal(recording.channels["thrust"].values, block[1:4].T)
    assert "12 rows by 200 columns turned on their side" in " ".join(recording.layout)


def test_without_times_rows_are_samples_and_it_is_doubted(tmp_path: Path) -> None:
    block = RANDOM.normal(size=(60, 80))
    np.save(tmp_path / "a.npy", block)
    recording = recording_of_places(tmp_path / "a.npy", 0.1, 3)
    np.testing.assert_array_equal(recording.channels["thrust"].values, block[:, 1:4])
    doubts = [str(issue) for issue in check_data_quality(recording)]
    assert any("60 rows by 80 columns: rows are taken for samples" in doubt for doubt in doubts)


@pytest.mark.parametrize("n_samples", [8, 40])
def test_times_beside_an_array_tell_which_way_it_lies(n_samples: int, tmp_path: Path) -> None:
    t = 0.1 * np.arange(n_samples)
    wide = RANDOM.normal(size=(n_samples, n_samples + 4))
    turned = RANDOM.normal(size=(3, n_samples))
    np.savez(tmp_path / "a.npz", t=t, wide=wide, turned=turned)
    n_wide = n_samples + 4
    names = [f"wide[{k}]" for k in range(n_wide)] + [f"turned[{k}]" for k in range(3)]
    assert set(column_names(tmp_path / "a.npz")) == {"t", *names}
    np.testing.assert_array_equal(read_columns(tmp_path / "a.npz", names[:n_wide]), wide)
    np.testing.assert_array_equal(read_columns(tmp_path / "a.npz", names[n_wide:]), turned.T)


def test_hdf5_of_matlab_has_its_columns_as_rows_and_that_of_others_has_not(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason='needs pip install "uvms-ocp[files]"')
    block = RANDOM.normal(size=(12, 14))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["other"] = block
        file["matlab"] = block.T
        file["matlab"].attrs["MATLAB_class"] = np.bytes_("double")
    for name in ("other", "matlab"):
        names = [f"{name}[{k}]" for k in range(14)]
        np.testing.assert_array_equal(read_columns(tmp_path / "a.h5", names), block)


def test_a_single_row_is_a_vector() -> None:
    np.testing.assert_array_equal(oriented(np.ones((1, 20)), ()).values, np.ones((20, 1)))


@pytest.mark.parametrize(
    ("series", "expected"),
    [
        (0.1 * np.arange(20), True),
        (np.r_[0.1 * np.arange(20), 60.0 + 0.1 * np.arange(20)], True),
        (np.arange(7.0), False),
        (np.r_[np.arange(10.0), 5.0], False),
        (np.exp(np.arange(20.0)), False),
        (np.r_[np.arange(10.0), np.nan], False),
    ],
)
def test_times_rise_by_even_steps(series: np.ndarray, expected: bool) -> None:
    assert are_times(series) == expected


def test_a_few_times_beside_an_array_tell_its_rows(tmp_path: Path) -> None:
    thrust = np.arange(48.0).reshape(6, 8)  # whose rows rise as times would
    np.savez(tmp_path / "a.npz", t=0.1 * np.arange(6), u=thrust)
    columns = [f"u[{k}]" for k in range(8)]
    mapping = {"channels": {"thrust": {"time": "t", "columns": columns}}}
    recording = mapped_recording(tmp_path / "a.npz", RecordingMapping.model_validate(mapping))
    np.testing.assert_array_equal(recording.channels["thrust"].values, thrust)

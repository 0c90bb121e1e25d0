"""Texts of numbers that were read by nobody are read, or end in a line that says what to do."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Channel
from uvms_ocp.identification.tables import column_names, read_columns

N = 30
T = 0.1 * np.arange(N)
XYZ = np.column_stack([np.sin(T), np.cos(T), -2.0 - T])


def position_in(path: Path, **table: str) -> Channel:
    """Read positions of a table."""
    position = {"time": "time", "columns": ["x", "y", "z"]}
    mapping: dict[str, Any] = {"channels": {"position": position}}
    if table:
        mapping["table"] = table
    return mapped_recording(path, RecordingMapping.model_validate(mapping)).channels["position"]


@pytest.mark.parametrize("digits", [3, 6])
@pytest.mark.parametrize("header", ["time,x,y,z\n", ""])
def test_decimal_commas_in_quotes_are_read_between_commas(
    digits: int, header: str, tmp_path: Path
) -> None:
    values = np.column_stack([T, XYZ])
    lines = []
    for row in values:
        cells = [f"{value:.{digits}f}".replace(".", ",") for value in row]
        lines.append(",".join(f'"{cell}"' for cell in cells))
    path = tmp_path / "dive.csv"
    path.write_text(header + "\n".join(lines) + "\n")
    names = ["time", "x", "y", "z"] if header else ["#1", "#2", "#3", "#4"]
    assert column_names(path) == tuple(names)
    np.testing.assert_allclose(read_columns(path, names), values, atol=0.6 * 10.0**-digits)


def test_groups_of_digits_in_quotes_stay_such(tmp_path: Path) -> None:
    lines = [f'{t:.1f},"1,{k:03d}","2,{k:03d}"' for k, t in enumerate(T)]
    (tmp_path / "dive.csv").write_text("time,x,y\n" + "\n".join(lines) + "\n")
    expected = np.column_stack([1000.0 + np.arange(N), 2000.0 + np.arange(N)])
    np.testing.assert_array_equal(read_columns(tmp_path / "dive.csv", ["x", "y"]), expected)


def stamped(path: Path, times: list[str]) -> Path:
    """Write a table with times as text."""
    lines = []
    for time, (x, y, z) in zip(times, XYZ, strict=True):
        lines.append(f"{time},{x},{y},{z}")
    path.write_text("time,x,y,z\n" + "\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("fraction", [".%f", ",%f"])
def test_a_form_with_a_fraction_reads_whole_seconds(fraction: str, tmp_path: Path) -> None:
    path = stamped(tmp_path / "dive.csv", [f"05/31/2024 23:59:{k:02d}" for k in range(N)])
    read = position_in(path, time=f"%m/%d/%Y %H:%M:%S{fraction}")
    np.testing.assert_array_equal(read.t, np.arange(N))


def test_times_of_another_form_are_told_in_a_line(tmp_path: Path) -> None:
    path = stamped(tmp_path / "dive.csv", [f"05/31/2024 23:59:{k:02d}" for k in range(N)])
    form = "%d/%m/%Y %H:%M:%S"
    with pytest.raises(InvalidInput, match="is no time of the form " + re.escape(repr(form))):
        position_in(path, time=form)


def test_times_that_are_all_the_same_are_told_in_a_line(tmp_path: Path) -> None:
    path = stamped(tmp_path / "dive.csv", ["0.0"] * N)
    with pytest.raises(InvalidInput, match=f"position: all {N} samples have the time 0 s; give"):
        position_in(path)

"""Tables whose header stands again and again, whose times are intervals, or beside which there is a
clock of something else, are read or named.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.recording import Recording

T = np.arange(0.0, 30.0, 0.1)
PLACES = np.column_stack([np.sin(0.3 * T), np.cos(0.2 * T), -5.0 + 0.03 * T])


def read(path: Path, **keys: Any) -> Recording:
    channel = {"time": "time", "columns": ["x", "y", "z"], **keys}
    return mapped_recording(
        path, RecordingMapping.model_validate({"channels": {"position": channel}})
    )


def rows_of(times: np.ndarray) -> list[str]:
    rows = np.column_stack([times, PLACES])
    return [",".join(f"{value:.5f}" for value in row) for row in rows]


@pytest.mark.parametrize("every", [1, 50, 299])
def test_headers_between_rows_are_left_out_and_said(every: int, tmp_path: Path) -> None:
    lines = ["time,x, y,z"]
    for k, row in enumerate(rows_of(T)):
        if k and k % every == 0:
            lines.append("time,x,y,z")
        lines.append(row)
    path = tmp_path / "dive.csv"
    path.write_text("\n".join(lines) + "\n")
    recording = read(path)
    np.testing.assert_allclose(recording.channels["position"].values, PLACES, atol=1e-5)
    doubts = [issue.problem for issue in check_data_quality(recording)]
    said = (
        f"the header stands {(len(T) - 1) // every} more times between rows: recordings one after"
    )
    assert [text for text in doubts if text.startswith("the header")] == [f"{said} the other?"]


def test_intervals_in_the_place_of_times_are_said_with_the_period(tmp_path: Path) -> None:
    path = tmp_path / "dive.csv"
    times = 0.1 + 0.001 * np.random.default_rng(0).normal(size=len(T))
    path.write_text("time,x,y,z\n" + "\n".join(rows_of(times)) + "\n")
    doubts = "; ".join(issue.problem for issue in check_data_quality(read(path)))
    assert "its times are all about 0.1 s: intervals between rows? give time: " in doubts
    cured = read(path, time=0.1)
    assert "intervals between rows" not in "; ".join(map(str, check_data_quality(cured)))


def test_seconds_of_another_clock_are_not_the_time_beside_a_column_of_times(tmp_path: Path) -> None:
    path = tmp_path / "dive.csv"
    rows = [f"{row},1000,500000000" for row in rows_of(T)]
    path.write_text("time,x,y,z,gps_sec,gps_nanosec\n" + "\n".join(rows) + "\n")
    assert "time: time," in propose_mapping(path)
    path.write_text(
        "x,y,z,sec,nanosec\n"
        + "\n".join(
            f"{x:.5f},{y:.5f},{z:.5f},{int(t)},{round(1e9 * (t % 1))}"
            for t, (x, y, z) in zip(T, PLACES, strict=True)
        )
        + "\n"
    )
    assert "time: [sec, nanosec]" in propose_mapping(path)


def test_a_log_of_moos_is_named(tmp_path: Path) -> None:
    path = tmp_path / "dive.alog"
    path.write_text("%% LOG FILE: dive.alog\n%% LOGSTART 1715594400.0\n0.1 NAV_X pNav 0.1\n")
    with pytest.raises(InvalidInput, match="a log of MOOS, which is not read"):
        read(path)


@pytest.mark.parametrize(("cell", "unit"), [("1.433V", "V"), ("0.5 m/s", "m/s"), ("12°", "°")])
def test_a_cell_with_its_unit_is_told_as_such(cell: str, unit: str, tmp_path: Path) -> None:
    path = tmp_path / "dive.csv"
    lines = ["time,x,y,z", *rows_of(T)]
    lines[30] = f"2.9,{cell},0.0,0.0"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(
        InvalidInput, match=rf"column 'x': '{cell}' is a number with '{unit}' behind it"
    ):
        read(path)

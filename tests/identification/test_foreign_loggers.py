"""What loggers write in place of what they did not measure, in units of the sea and as counts, is
read as it means, or asked about.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from motions import recorded
from proposals import read_as_proposed

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.tables import write_columns

GOOD = recorded()
POSITION = GOOD.channels["position"]
FAR = POSITION.values + np.array([0.0, 0.0, -16.0])
"""[m] of a deeper dive."""


def columns_with(position: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of a whole log whose position has these."""
    columns = {"t": POSITION.t, **position}
    for axis, values in zip("xyzw", GOOD.channels["attitude"].values.T, strict=True):
        columns[f"q{axis}"] = values
    for axis, values in zip("xyz", GOOD.channels["linear_velocity"].values.T, strict=True):
        columns[f"v{axis}"] = values
    return columns


def issues_of(name: str, values: np.ndarray) -> str:
    """Texts of all doubts about a channel alone, at the times of the position."""
    channel = Channel(t=POSITION.t, values=values)
    recording = Recording(name="alone", channels={name: channel})
    return "; ".join(map(str, check_data_quality(recording)))


@pytest.mark.parametrize("stands_for_nothing", [0.0, -9999.0])
@pytest.mark.parametrize("every", [3, 10, 20])
def test_fixes_between_rows_of_a_value_that_stands_for_nothing_are_read_alone(
    stands_for_nothing: float, every: int, tmp_path: Path
) -> None:
    is_fix = np.arange(len(FAR)) % every == 2
    written = np.where(is_fix[:, None], FAR, stands_for_nothing)
    columns = columns_with(dict(zip("xyz", written.T, strict=True)))
    write_columns(tmp_path / "dive.csv", columns)
    read = read_as_proposed(tmp_path / "dive.csv").channels["position"]
    np.testing.assert_allclose(read.t, POSITION.t[is_fix], atol=1e-9)
    np.testing.assert_allclose(read.values, FAR[is_fix], atol=1e-9)


def test_a_vehicle_that_passes_its_origin_has_lost_no_fix() -> None:
    passing = POSITION.values - POSITION.values[300]
    assert "exactly zero" not in issues_of("position", passing)


@pytest.mark.parametrize(
    ("unit", "length"), [("ft", 0.3048), ("feet", 0.3048), ("fathoms", 1.8288)]
)
def test_a_depth_in_units_of_the_sea_is_read_in_them(
    unit: str, length: float, tmp_path: Path
) -> None:
    x, y, z = FAR.T
    columns = columns_with({"x": x, "y": y, f"depth_{unit}": -z / length})
    write_columns(tmp_path / "dive.csv", columns)
    read = read_as_proposed(tmp_path / "dive.csv").channels["position"]
    np.testing.assert_allclose(read.values, FAR, atol=1e-9)


def test_counts_of_encoders_are_asked_about_and_not_taken_for_degrees(tmp_path: Path) -> None:
    angles = 0.8 * np.sin(0.5 * POSITION.t[:, None] + [0.0, 1.0, 2.0])
    columns = columns_with(dict(zip("xyz", FAR.T, strict=True)))
    for k, values in enumerate(np.round(angles.T * 4096 / (2 * np.pi)), start=1):
        columns[f"joint_{k}"] = values
    write_columns(tmp_path / "dive.csv", columns)
    texts = map(str, check_data_quality(read_as_proposed(tmp_path / "dive.csv")))
    assert "joint_positions: up to 521 rad or m" in "; ".join(texts)


@pytest.mark.parametrize("name", ["thrust", "propeller_commands"])
def test_commands_whose_rest_is_not_zero_are_asked_for_their_offset(
    name: str, tmp_path: Path
) -> None:
    shares = 0.5 + 0.13 * np.sin(0.5 * POSITION.t[:, None] + np.arange(8.0))
    columns = columns_with(dict(zip("xyz", FAR.T, strict=True)))
    for k, values in enumerate(shares.T, start=1):
        columns[f"{name}_{k}"] = values
    write_columns(tmp_path / "dive.csv", columns)
    texts = "; ".join(map(str, check_data_quality(read_as_proposed(tmp_path / "dive.csv"))))
    assert "never near 0: its offset" in texts or "shares of the largest command?" in texts

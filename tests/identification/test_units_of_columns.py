"""A column whose name says its unit is in that one, whatever the columns beside it are in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from motions import changed, recorded
from proposals import read_as_proposed
from scipy.spatial.transform import Rotation

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.tables import write_columns

GOOD = recorded()


def attitude_and_velocity() -> dict[str, np.ndarray]:
    """Columns that stand beside those of a position."""
    columns = {}
    for k, axis in enumerate("xyzw"):
        columns[f"q{axis}"] = GOOD.channels["attitude"].values[:, k]
    for k, axis in enumerate("xyz"):
        columns[f"v{axis}"] = GOOD.channels["linear_velocity"].values[:, k]
    return columns


FACTORS = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}


@pytest.mark.sampled
@pytest.mark.parametrize(
    "units", [("", "", "cm"), ("mm", "mm", "m"), ("m", "m", "mm"), ("", "", "m"), ("", "", "")]
)
def test_a_depth_has_the_unit_of_its_own_name(units: tuple[str, ...], tmp_path: Path) -> None:
    position = GOOD.channels["position"]
    columns = {"t": position.t}
    upwards = position.values * [1.0, 1.0, -1.0]
    for name, unit, values in zip(("x", "y", "depth"), units, upwards.T, strict=True):
        label = f"{name}_{unit}" if unit else name
        columns[label] = values / FACTORS[unit]
    columns |= attitude_and_velocity()
    write_columns(tmp_path / "dive.csv", columns)
    read = read_as_proposed(tmp_path / "dive.csv")
    np.testing.assert_allclose(read.channels["position"].values, position.values, atol=1e-9)


def test_an_angle_has_the_unit_of_its_own_name(tmp_path: Path) -> None:
    attitude = GOOD.channels["attitude"]
    angles = Rotation.from_quat(attitude.values).as_euler("xyz")
    columns = {"t": attitude.t}
    columns |= {"roll_deg": np.degrees(angles[:, 0]), "pitch_deg": np.degrees(angles[:, 1])}
    columns["yaw_rad"] = angles[:, 2]
    write_columns(tmp_path / "dive.csv", columns)
    read = read_as_proposed(tmp_path / "dive.csv").channels["attitude"].values
    same = np.abs((read * attitude.values).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "factor"),
    [("position", 1e3), ("linear_velocity", 1e3), ("angular_velocity", 57.29578)],
)
def test_a_column_alone_that_no_vehicle_has_is_named_with_its_scale(
    name: str, factor: float
) -> None:
    factors = np.array([1.0, 1.0, factor])
    alone = {
        key: GOOD.channels[key] for key in (name, "attitude") if name != "angular_velocity"
    } or {name: GOOD.channels[name]}
    recording = replace(GOOD, channels=alone)
    spoiled = changed(recording, name, values=factors * alone[name].values)
    text = "; ".join(map(str, check_data_quality(spoiled)))
    assert f"{name}: z alone up to " in text
    scale = np.array(yaml.safe_load(text.partition("give scale: ")[2]))
    np.testing.assert_allclose(scale * factors, 1.0, rtol=1e-6)


def test_a_height_of_the_other_sign_keeps_the_units_beside_it(tmp_path: Path) -> None:
    position = GOOD.channels["position"]
    columns = {"t": position.t}
    for name, values in zip(("x_mm", "y_mm", "z_m"), position.values.T, strict=True):
        columns[name] = 1e3 * values if name != "z_m" else -values
    columns |= attitude_and_velocity()
    write_columns(tmp_path / "dive.csv", columns)
    read = read_as_proposed(tmp_path / "dive.csv")
    np.testing.assert_allclose(read.channels["position"].values, position.values, atol=1e-9)

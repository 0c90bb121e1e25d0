"""A column whose name says its unit is in that one, whatever the columns beside it are in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from motions import recorded

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.tables import write_columns

GOOD = recorded()
FACTORS = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}


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
    for k, axis in enumerate("xyzw"):
        columns[f"q{axis}"] = GOOD.channels["attitude"].values[:, k]
    for k, axis in enumerate("xyz"):
        columns[f"v{axis}"] = GOOD.channels["linear_velocity"].values[:, k]
    write_columns(tmp_path / "dive.csv", columns)
    mapping = RecordingMapping.model_validate(
        yaml.safe_load(propose_mapping(tmp_path / "dive.csv"))
    )
    read = mapped_recording(tmp_path / "dive.csv", mapping)
    np.testing.assert_allclose(read.channels["position"].values, position.values, atol=1e-9)

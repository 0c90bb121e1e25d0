"""A pressure is never read as metres in silence: by its name, its size, or what the velocity says, its
unit and the air in it are told, or it is doubted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from proposals import read_as_proposed
from test_cures_one_by_one import NAMES, dive

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.pressure_units import METRES, PRESSURE_UNITS
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.tables import write_columns

AIR = 1.01325  # [bar]


def log(folder: Path, column: str, unit: str, *, air: float = AIR, without: str = "") -> Path:
    """Write a dive with a pressure in place of its height. air: [bar] in it."""
    recording = dive()
    columns = {"t": recording.channels["attitude"].t}
    for name, labels in NAMES.items():
        for label, values in zip(labels, recording.channels[name].values.T, strict=True):
            if label == "z":
                columns[column] = (air - values / METRES) / PRESSURE_UNITS[unit]
            elif name not in without:
                columns[label] = values
    write_columns(folder / "dive.csv", columns)
    return folder / "dive.csv"


def error(recording: Recording) -> float:
    """Return the largest error [m] of the heights of a dive."""
    heights = recording.channels["position"].values[:, 2]
    return float(np.abs(heights - dive().channels["position"].values[:, 2]).max())


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("column", "unit", "air"),
    [
        ("press_kpa", "kPa", AIR),
        ("pressure_dbar", "dbar", 0.0),
        ("pressure [Pa]", "Pa", AIR),
        ("z", "kPa", AIR),
        ("z", "mbar", AIR),
        ("z", "bar", AIR),
        ("pressure", "psi", AIR),
        ("pressure", "Pa", 0.0),
    ],
)
def test_a_pressure_becomes_a_height(column: str, unit: str, air: float, tmp_path: Path) -> None:
    assert error(read_as_proposed(log(tmp_path, column, unit, air=air))) < 0.05


@pytest.mark.sampled
@pytest.mark.parametrize("column", ["press_kpa", "pressure"])
def test_a_pressure_without_a_velocity_is_told_by_name_or_doubted(
    column: str, tmp_path: Path
) -> None:
    path = log(tmp_path, column, "kPa", without="linear_velocity")
    read = read_as_proposed(path)
    if error(read) > 0.05:
        assert "a pressure in a unit that nothing tells" in propose_mapping(path)


def test_a_gauge_in_pa_that_may_be_mbar_of_the_deep_is_asked_for(tmp_path: Path) -> None:
    path = log(tmp_path, "pressure", "Pa", air=0.0, without="linear_velocity")
    assert "a pressure in a unit that nothing tells" in propose_mapping(path)


def test_thin_air_is_what_a_pressure_begins_with() -> None:
    from uvms_ocp.identification.pressure_units import read_in

    depth = np.r_[np.zeros(20), np.linspace(0.0, 10.0, 200)]
    reading = read_in("mbar", 851.0 + 1e3 * depth / METRES)
    assert reading.air == pytest.approx(851.0)
    assert read_in("kPa", 1e2 * depth / METRES).air == 0.0
    assert read_in("kPa", 150.0 + 1e2 * depth / METRES).air == pytest.approx(101.325)


def test_a_pressure_that_a_mapping_takes_for_metres_is_doubted(tmp_path: Path) -> None:
    path = log(tmp_path, "press_kpa", "kPa", without="linear_velocity")
    channels = {"position": {"time": "t", "columns": ["x", "y", "press_kpa"]}}
    read = mapped_recording(path, RecordingMapping.model_validate({"channels": channels}))
    (doubt,) = [doubt.problem for doubt in check_data_quality(read) if "pressure" in doubt.problem]
    keys = yaml.safe_load("{" + doubt.partition("give ")[2] + "}")
    channels["position"].update(keys)
    cured = mapped_recording(path, RecordingMapping.model_validate({"channels": channels}))
    assert error(cured) < 0.05


def test_a_height_far_above_all_water_is_doubted_whatever_an_accelerometer_proves() -> None:
    recording = dive()
    position = recording.channels["position"]
    high = replace(position, values=position.values + np.array([0.0, 0.0, 120.0]))
    doubts = check_data_quality(
        replace(recording, channels={**recording.channels, "position": high})
    )
    assert any("from where, or in which unit" in str(doubt) for doubt in doubts)

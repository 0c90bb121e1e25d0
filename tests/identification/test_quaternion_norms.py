"""Quaternions whose norm is far from 1 are read, and doubted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from motions import recorded

from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.mapped_recordings import mapped_recording

ATTITUDE = recorded(t_end=20.0).channels["attitude"]


def doubts(path: Path, quaternions: np.ndarray) -> str:
    """Join the doubts about a table of quaternions."""
    table = np.column_stack([ATTITUDE.t, quaternions])
    np.savetxt(path, table, delimiter=",", header="t,qx,qy,qz,qw", comments="")
    attitude = {"time": "t", "columns": ["qx", "qy", "qz", "qw"]}
    mapping = RecordingMapping.model_validate({"channels": {"attitude": attitude}})
    return "; ".join(map(str, check_data_quality(mapped_recording(path, mapping))))


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.1, 100.0])
def test_quaternions_of_another_norm_are_doubted(factor: float, tmp_path: Path) -> None:
    n = len(ATTITUDE.t)
    expected = f"attitude: {n} of {n} quaternions have a norm of {factor:.3g}"
    assert expected in doubts(tmp_path / "a.csv", factor * ATTITUDE.values)


def test_some_quaternions_of_another_norm_are_counted(tmp_path: Path) -> None:
    values = ATTITUDE.values.copy()
    values[:50] *= 0.5
    assert "50 of 400 quaternions have a norm of 0.5 to 0.5" in doubts(tmp_path / "a.csv", values)


@pytest.mark.parametrize("digits", [2, 3, 8])
def test_few_digits_and_unknown_attitudes_are_not_doubted(digits: int, tmp_path: Path) -> None:
    values = np.round(ATTITUDE.values, digits)
    values[100:110] = 0.0
    assert "norm" not in doubts(tmp_path / "a.csv", values)

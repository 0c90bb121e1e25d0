"""A vehicle whose velocity is known late, or was told wrongly, stays on its way."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from compiler import long_without_compiler
from scipy.spatial import cKDTree

from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.sim import parse_fault

ONSET, END = 20.0, 40.0  # [s]
USUAL = {"noise": True, "dt": 1 / 50, "duration": END}


@cache
def usual_way() -> np.ndarray:
    """Positions (n, 3) [m] where nothing fails."""
    return case1(**USUAL).run()["q"][:, :3]


@long_without_compiler
def test_a_vehicle_whose_dvl_falls_silent_stays_on_its_way() -> None:
    way = usual_way()
    without = case1(**USUAL, faults=(parse_fault(f"linear_velocity:lost@{ONSET:g}"),)).run()
    assert cKDTree(way).query(without["q"][:, :3])[0].max() < 0.3
    late = without["t"] > ONSET + 5.0
    assert np.abs(without["v"][late, :3]).max() < 0.3


@long_without_compiler
def test_a_dvl_that_is_off_is_found_out_by_position_fixes() -> None:
    way = usual_way()
    biased = case1(**USUAL, faults=(parse_fault(f"linear_velocity:bias=0.3,0,0@{ONSET:g}"),)).run()
    assert cKDTree(way).query(biased["q"][:, :3])[0].max() < 5.0
    estimated, true = biased["q_estimated"][:, :3], biased["q"][:, :3]
    assert np.abs(estimated - true)[biased["t"] > ONSET + 8.0].max() < 0.2


@pytest.mark.slow
@long_without_compiler
def test_encoders_that_are_late_shake_neither_arm_nor_vehicle() -> None:
    """Fed back at full bandwidth, joints that are known 50 ms late swing up as soon as the arm is to move."""
    usual = {"noise": True, "duration": 55.0}
    way = case1(**usual).run()["q"][:, :3]
    late = case1(**usual, faults=(parse_fault("joint_positions:late=0.05@28.6"),)).run()
    assert cKDTree(way).query(late["q"][:, :3])[0].max() < 1.0
    assert np.abs(late["v"][:, 6:]).max() < 0.6

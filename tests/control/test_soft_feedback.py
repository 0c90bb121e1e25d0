"""What is known late is fed back softly: a vehicle without DVL does not swing itself up."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.sim.faults import parse_fault

ONSET, END = 20.0, 40.0  # [s]


def test_a_vehicle_whose_dvl_falls_silent_stays_on_its_way() -> None:
    usual = {"noise": True, "dt": 1 / 50, "duration": END}
    way = case1(**usual).run()["q"][:, :3]
    without = case1(**usual, faults=(parse_fault(f"linear_velocity:lost@{ONSET:g}"),)).run()
    assert cKDTree(way).query(without["q"][:, :3])[0].max() < 0.3
    late = without["t"] > ONSET + 5.0
    assert np.abs(without["v"][late, :3]).max() < 0.3

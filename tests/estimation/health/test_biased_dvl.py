"""A DVL whose bias lies at the edge of what is possible does not get in by noise."""

from __future__ import annotations

import numpy as np
import pytest
from corruptors import with_defect
from health_run import HealthRun

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import Readings, Trust

ONSET, END = 3.0, 15.0  # [s]
EDGE = 0.31  # [m/s]: errors of the estimate bring some readings inside of the gate


@pytest.mark.parametrize("seed", range(2))
def test_fixes_carry_the_velocity_of_a_robot_whose_dvl_is_biased_by_as_much_as_its_gate(seed: int) -> None:
    robot = load_robot("girona_maris7")

    def biased(readings: Readings, t: float) -> Readings:
        def add(reading, now):
            return type(reading)(value=reading.value + np.array([EDGE, 0.0, 0.0]), t=reading.t)

        there = t >= ONSET and readings.linear_velocity is not None
        return with_defect(readings, "linear_velocity", add, t) if there else readings

    still = np.zeros(robot.n_v)
    run = HealthRun(robot, duration=END, spoil=biased, motion=lambda t: still, seed=seed)
    assert run.first_bad("linear_velocity", ONSET) < 1.0
    assert (run.of("position") == Trust.GOOD).all()
    assert np.abs(run.v_estimated[run.t > ONSET, :3]).max() < 0.8
    assert np.abs(run.v_estimated[run.t > END - 2.0, :3]).max() < 0.1

"""A DVL that is biased by as much as can be, or silent, leaves the velocity to the fixes."""

from __future__ import annotations

import numpy as np
import pytest
from corruptors import with_defect
from health_run import HealthRun, between, resting

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import Readings, Trust

# [s]
ONSET = 3.0
END = 15.0
EDGE = 0.31  # [m/s]: errors of the estimate bring some readings inside of the gate


def biased(by: float, since: float):
    def spoil(readings: Readings, t: float) -> Readings:
        def add(reading, t):
            return type(reading)(value=reading.value + np.array([by, 0.0, 0.0]), t=reading.t)

        if readings.linear_velocity is None or readings.linear_velocity.t < since:
            return readings
        return with_defect(readings, "linear_velocity", add, t)

    return spoil


@pytest.mark.parametrize("dt", [1 / 20, 1 / 50])
@pytest.mark.parametrize(("bias", "seed"), [(0.15, 0), (0.26, 3), (0.3, 0)])
def test_a_step_of_the_dvl_is_no_acceleration_that_goes_on(
    bias: float, seed: int, dt: float
) -> None:
    """The first reading of a bias made an acceleration, and the second was refused as it did not
    agree with that: 1.8 m/s.
    """
    robot = load_robot("girona_maris7")
    run = HealthRun(
        robot, duration=5.0, dt=dt, spoil=biased(bias, 2.0), motion=resting(robot), seed=seed
    )
    assert (
        np.abs(run.v_estimated[run.t > 2.0, :3]).max() < 4.0 * bias
    )  # twice as large until the second reading


@pytest.mark.parametrize("dt", [1 / 20, pytest.param(1 / 200, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("reach", "frequency"), [(0.5, 2.0), (0.7, 1.4), (1.0, 1.0)])
def test_fixes_follow_a_vehicle_without_a_dvl_that_accelerates_as_it_can(
    reach: float, frequency: float, dt: float
) -> None:
    """Sound fixes were refused as the velocity was thought to be known: wrong by 3 m/s, the
    position by 2.8 m.
    """
    robot = load_robot("girona_maris7")
    along = np.eye(robot.n_v)[0]

    def moves(t: float) -> np.ndarray:
        return along * reach * np.sin(frequency * max(t - ONSET, 0.0))

    silent = between("linear_velocity", "lost", 1.0, END)
    run = HealthRun(
        robot,
        duration=END - 3.0,
        dt=dt,
        spoil=silent,
        motion=moves,
        requested=lambda t: 0.0 * along,
    )
    assert (run.of("position") == Trust.GOOD).all()
    assert np.abs(run.q_estimated - run.q)[:, :3].max() < 0.3
    assert np.abs(run.v_estimated - run.v)[:, :3].max() < 1.0


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(2))
def test_fixes_carry_the_velocity_of_a_robot_whose_dvl_is_biased_by_as_much_as_its_gate(
    seed: int,
) -> None:
    robot = load_robot("girona_maris7")
    run = HealthRun(
        robot, duration=END, spoil=biased(EDGE, ONSET), motion=resting(robot), seed=seed
    )
    assert run.first_bad("linear_velocity", ONSET) < 1.0
    assert (run.of("position") == Trust.GOOD).all()
    assert np.abs(run.v_estimated[run.t > ONSET, :3]).max() < 0.8
    assert np.abs(run.v_estimated[run.t > END - 2.0, :3]).max() < 0.1

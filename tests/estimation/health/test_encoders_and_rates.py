"""A joint whose encoder jumps while its rate does not is where its rate has brought it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from health_run import HealthRun, Spoil, between, resting

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, SensorSpec, SensorSpecs, Trust

# [s]
ONSET = 3.0
END = 8.0
RATES = (SensorSpec(rate=200.0, sigma=2e-3), SensorSpec(rate=20.0, sigma=1e-2))


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("bluerov2_alpha5")


def jumps(by: float) -> Spoil:
    """The encoder of the second joint is off by `by` [rad] from the onset on."""

    def spoil(readings: Readings, t: float) -> Readings:
        reading = readings.joint_positions
        if reading is None or reading.t < ONSET:
            return readings
        value = np.array(reading.value)
        value[1] += by
        return replace(readings, joint_positions=Reading(value=value, t=reading.t))

    return spoil


def largest_joint_error(run: HealthRun, robot: Robot) -> float:
    return float(np.abs(run.q_estimated - run.q)[:, robot.joint_q].max())


@pytest.mark.sampled
@pytest.mark.parametrize("rates", RATES)
@pytest.mark.parametrize(("dt", "by"), [(0.005, 0.3), (0.02, -0.3), (0.05, 0.5)])
def test_a_jump_moves_no_estimate_where_rates_are_sound(
    dt: float, by: float, rates: SensorSpec, robot: Robot
) -> None:
    """After 0.3 s the jump was believed, and the arm was driven in a posture that it did not
    have.
    """
    specs = SensorSpecs(joint_velocities=rates)
    run = HealthRun(robot, duration=END, dt=dt, spoil=jumps(by), specs=specs)
    assert largest_joint_error(run, robot) < 0.05
    assert run.first_bad("joint_positions", ONSET) <= 2.0 * dt
    assert run.of("joint_positions")[-1] == Trust.LOST
    assert run.first_bad("joint_velocities", 0.0) == np.inf


@pytest.mark.parametrize("defect", ["lost", "frozen", "nan"])
def test_encoders_that_come_back_are_used_at_once_by_an_estimate_that_rates_carried(
    defect: str, robot: Robot
) -> None:
    specs = SensorSpecs(joint_velocities=RATES[0])
    spoil = between("joint_positions", defect, ONSET, ONSET + 2.0)
    run = HealthRun(robot, duration=END, dt=0.02, spoil=spoil, specs=specs)
    assert largest_joint_error(run, robot) < 0.05
    assert run.last_bad("joint_positions") < ONSET + 2.0 + 1.2


def _thrown(by: float, dt: float) -> Callable[[float], np.ndarray]:
    """The velocity of a robot whose second joint comes to a rate [rad/s] within one tick [s]."""

    def motion(t: float) -> np.ndarray:
        v = np.zeros(6 + 4)
        v[7] = by * min(max((t - ONSET) / dt, 0.0), 1.0)
        return v

    return motion


@pytest.mark.parametrize("by", [-1.5, 2.0])
def test_a_joint_that_is_thrown_is_seen_by_encoder_and_rate_alike(by: float, robot: Robot) -> None:
    """Each was refused as more than can be, and the arm fell at 31 times its limit, unseen."""
    dt = 0.05
    run = HealthRun(
        robot,
        duration=ONSET + 0.3,
        dt=dt,
        motion=_thrown(by, dt),
        requested=lambda t: np.zeros(robot.n_v),
        specs=SensorSpecs(joint_velocities=RATES[0]),
    )
    after = run.t > ONSET + 2.5 * dt
    assert (run.of("joint_velocities") == Trust.GOOD).all()
    assert (run.of("joint_positions") == Trust.GOOD).all()
    assert np.abs(run.v_estimated[after, 7] - by).max() < 0.2 * abs(by)


@pytest.mark.parametrize("dt", [0.02, 0.05])
def test_a_rate_that_no_encoder_shows_is_refused(dt: float, robot: Robot) -> None:
    def spoil(readings: Readings, t: float) -> Readings:
        reading = readings.joint_velocities
        if reading is None or reading.t < ONSET:
            return readings
        value = np.array(reading.value)
        value[1] += 2.0
        return replace(readings, joint_velocities=Reading(value=value, t=reading.t))

    run = HealthRun(
        robot,
        duration=ONSET + 0.3,
        dt=dt,
        spoil=spoil,
        motion=resting(robot),
        specs=SensorSpecs(joint_velocities=RATES[0]),
    )
    assert run.first_bad("joint_velocities", ONSET) <= dt
    assert np.abs(run.v_estimated[:, 7]).max() < 0.2

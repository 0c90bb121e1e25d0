"""A change of trust changes the estimate no faster than readings justify, at any rate of ticks."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from corruptors import with_defect
from health_run import HealthRun, between, resting

from uvms_ocp.estimation.tuning import EXPOSED
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import Reading, Readings, SensorSpecs, Trust

ONSET = 1.0  # [s]
# per second of a channel, what tells the same, which part of v, and how long it takes until trust
# has changed
DRIFTS = {
    "linear_velocity": (0.12, "position", slice(0, 3), 3.6),
    "position": (0.2, "position", slice(0, 3), 3.6),
    "angular_velocity": (0.08, "attitude", slice(3, 6), 6.6),
    "depth": (0.1, "depth", slice(2, 3), 3.6),
}


@pytest.mark.parametrize("dt", [1 / 20, 1 / 50, pytest.param(1 / 200, marks=pytest.mark.slow)])
@pytest.mark.parametrize("channel", DRIFTS)
def test_no_velocity_is_corrected_by_more_than_its_error_and_the_noise_of_two_readings(
    channel: str, dt: float
) -> None:
    """A doubted DVL left a velocity behind that the next fix changed by 2.4 m/s in a tick."""
    rate, witness, part, lasts = DRIFTS[channel]
    robot = load_robot("girona_maris7")
    spec = getattr(SensorSpecs(), witness)

    def drifting(readings: Readings, t: float) -> Readings:
        def add(reading: Reading, t: float) -> Reading:
            along = 1.0 if channel == "depth" else np.array([1.0, 0.0, 0.0])
            return Reading(value=reading.value + rate * (reading.t - ONSET) * along, t=reading.t)

        if t < ONSET or getattr(readings, channel) is None:
            return readings
        return with_defect(readings, channel, add, t)

    run = HealthRun(robot, duration=ONSET + lasts, dt=dt, spoil=drifting, motion=resting(robot))
    assert (run.of("linear_velocity" if channel == "position" else channel) != Trust.GOOD).any()
    error = run.v_estimated[:, part]
    # Where the fixes drift the velocity that they tell of is the drift.
    wrong = np.abs(error).max(axis=1) + (rate if channel == witness else 0.0)
    noise = sqrt(2.0) * spec.sigma * min(spec.rate, 1 / dt)
    change = np.abs(np.diff(error, axis=0)).max(axis=1)[run.t[1:] > ONSET]
    assert (change <= wrong[:-1][run.t[1:] > ONSET] + noise).all()


def test_a_velocity_whose_readings_end_leaves_the_position_as_sure_as_it_was() -> None:
    """It was right until then: with as much doubt as of a velocity that proves wrong, a depth that
    is read was unknown by 3 m.
    """
    ends = [between(channel, "lost", 2.0, 9.0) for channel in ("linear_velocity", "position")]
    run = HealthRun(
        load_robot("girona_maris7"),
        duration=4.0,
        spoil=lambda readings, t: ends[0](ends[1](readings, t), t),
        dt=0.02,
    )
    std = run.std[:, :3]
    assert (
        np.diff(std, axis=0).max() < (EXPOSED + EXPOSED * 1.0) * 0.02
    )  # a tick with velocity and a second of acceleration
    assert std[:, 2].max() < 0.1

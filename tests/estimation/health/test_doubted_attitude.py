"""An attitude that drifts turns ways and echoes wrongly into W: neither DVL nor altimeter is lost for
it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from health_run import HealthRun, drifting_until, resting

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, Trust

# [s]
STEP = 0.05
ONSET = 8.0
END = 33.0
LOST = 0.5  # for which a sound channel may be


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.mark.sampled
@pytest.mark.parametrize("motion", ["sways", "rests"])
@pytest.mark.parametrize(
    "rate", [(0.0, 0.03, 0.0), (0.02, -0.01, 0.02), (0.0, 0.0, 0.1), (-0.05, -0.165, -0.04)]
)
def test_a_drift_of_attitudes_loses_no_sound_channel(
    rate: tuple[float, float, float], motion: str, robot: Robot
) -> None:
    """The DVL was not used, and lost, for 7 to 23 s as ways that it tells of drifted from fixes, and
    the altimeter for 16 s whose beam seemed to lie flat; slow drifts were found after 12 s.
    """
    run = HealthRun(
        robot,
        duration=END + 8.0,
        spoil=drifting_until("attitude", np.array(rate), ONSET, END),
        motion=None if motion == "sways" else resting(robot),
        dt=STEP,
        start_z=-37.0,
    )
    assert run.first_bad("attitude", ONSET) < 3.0
    for name in set(run.guard.monitor.channels) - {"attitude"}:
        assert STEP * (run.of(name) == Trust.LOST).sum() <= LOST
    assert (run.of("linear_velocity") == Trust.GOOD).all()
    assert run.last_bad("attitude") < END + 6.0


def test_a_gyro_that_drifts_loses_neither_attitudes_nor_ways(robot: Robot) -> None:
    run = HealthRun(
        robot,
        duration=END + 8.0,
        spoil=drifting_until("angular_velocity", np.array([0.0, 0.01, 0.0]), ONSET, END),
        dt=STEP,
    )
    assert run.first_bad("angular_velocity", ONSET) < 6.0
    for name in set(run.guard.monitor.channels) - {"angular_velocity"}:
        assert STEP * (run.of(name) == Trust.LOST).sum() <= LOST


def test_a_dvl_that_drifted_before_the_gyro_failed_is_blamed_on(robot: Robot) -> None:
    """And the attitude is good again once the gyro is, however long the DVL drifts."""
    drift = drifting_until("linear_velocity", np.array([0.02, 0.0, 0.0]), 3.0, END)

    def spoil(readings: Readings, t: float) -> Readings:
        rate = readings.angular_velocity
        if rate is not None and 20.0 <= rate.t < 22.0:
            spoilt = Reading(value=rate.value + 0.12, t=rate.t)
            return replace(drift(readings, t), angular_velocity=spoilt)
        return drift(readings, t)

    run = HealthRun(robot, duration=END, spoil=spoil, dt=STEP)
    is_struck = (run.t > 20.0) & (run.t < 30.0)
    assert (run.of("linear_velocity")[is_struck] != Trust.GOOD).all()
    assert run.first_bad("angular_velocity", 20.0) < 2.0
    assert run.last_bad("attitude") < 26.0

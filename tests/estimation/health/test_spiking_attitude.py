"""Whatever else is wrong while attitudes spike, or are off for a while, is found, and the attitude is
good again soon.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from corruptors import added
from health_run import HealthRun, Spoil, drifting, drifting_until, resting

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, Trust

# [s]
STEP = 0.05
ONSET = 8.0
CLEAN = 1.0  # after its last spike an attitude is good again
HEIGHT = 2.67  # [m] that the altimeter reads of a robot at rest
YAW = np.array([0.0, 0.0, 0.5])  # [rad] of a spike


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7")


def spiking(times: np.ndarray) -> Spoil:
    """One attitude is wrong at each of these times [s]."""

    def spoil(readings: Readings, t: float) -> Readings:
        reading = readings.attitude
        if reading is None or not (np.abs(reading.t - times) < STEP / 2.0).any():
            return readings
        turned = Reading(value=added("attitude", reading.value, YAW), t=reading.t)
        return replace(readings, attitude=turned)

    return spoil


def turned_away(start: float, end: float) -> Spoil:
    """All attitudes of this time [s] are wrong, and turn on."""
    return drifting_until("attitude", np.array([0.0, 0.0, 0.2]), start, end)


def off(channel: str, by: np.ndarray | float, start: float, end: float = np.inf) -> Spoil:
    """A channel reads too much in this time [s]."""

    def spoil(readings: Readings, t: float) -> Readings:
        reading = getattr(readings, channel)
        if reading is None or not start <= reading.t < end:
            return readings
        spoilt = Reading(value=reading.value + by, t=reading.t)
        return replace(readings, **{channel: spoilt})

    return spoil


def both(first: Spoil, second: Spoil) -> Spoil:
    return lambda readings, t: second(first(readings, t), t)


BIASED = off("linear_velocity", np.array([0.15, 0.0, 0.0]), ONSET)
MANY = spiking(np.arange(8.5, 11.1, 0.5))
ONE = spiking(np.array([9.0]))


def test_a_biased_dvl_is_blamed_although_the_attitude_spikes(robot: Robot) -> None:
    run = HealthRun(robot, duration=20.0, spoil=both(BIASED, MANY), dt=STEP, start_z=-37.0)
    assert run.first_bad("linear_velocity", ONSET) < 3.0
    assert run.last_bad("attitude") < 11.0 + CLEAN + 2.0 * STEP


def test_a_biased_dvl_is_blamed_soon_after_an_attitude_that_was_off(robot: Robot) -> None:
    """The doubt of the attitude was renewed by the ways of the DVL, to the end."""
    spoil = both(BIASED, turned_away(8.5, 11.0))
    run = HealthRun(robot, duration=30.0, spoil=spoil, dt=STEP, start_z=-37.0)
    assert (run.of("linear_velocity")[run.t > 22.0] != Trust.GOOD).all()
    assert run.last_bad("attitude") < 20.0


def test_drifting_fixes_are_blamed_although_the_attitude_spikes(robot: Robot) -> None:
    drift = drifting("position", np.array([0.1, 0.0, 0.0]), ONSET)
    spoil = both(drift, spiking(np.arange(8.5, 13.6, 0.5)))
    run = HealthRun(robot, duration=20.0, spoil=spoil, dt=STEP, start_z=-37.0)
    assert run.first_bad("position", ONSET) < 6.0
    assert run.last_bad("attitude") < 13.5 + CLEAN + 2.0 * STEP


@pytest.mark.sampled
@pytest.mark.parametrize("channel", ["position", "linear_velocity"])
def test_spikes_of_attitudes_hide_no_slow_drift(channel: str, robot: Robot) -> None:
    """Comparisons over 20 s began anew after each of them."""
    along = np.array([0.03, 0.0, 0.0])
    drift = drifting("position", along, ONSET) if channel == "position" else None
    spoil = both(drift or off(channel, along, ONSET), spiking(np.arange(5.0, 40.0, 4.0)))
    run = HealthRun(
        robot, duration=30.0, spoil=spoil, motion=resting(robot), dt=STEP, start_z=-37.0
    )
    assert run.first_bad(channel, ONSET) < 12.0


@pytest.mark.parametrize("doubt", [ONE, turned_away(8.5, 12.0)], ids=["spike", "off"])
def test_a_floor_that_falls_away_is_not_believed_of_a_doubted_attitude(
    doubt: Spoil, robot: Robot
) -> None:
    spoil = both(off("altimeter_range", 3.0, 9.1), doubt)
    run = HealthRun(
        robot, duration=16.0, spoil=spoil, motion=resting(robot), dt=STEP, start_z=-37.0
    )
    assert np.nanmax(run.range[run.t > 5.0]) < HEIGHT + 0.1
    assert run.first_bad("altimeter_range", 9.1) < 0.6


def test_a_nearer_floor_is_believed_of_a_doubted_attitude(robot: Robot) -> None:
    spoil = both(off("altimeter_range", -1.0, 9.1), turned_away(8.5, 12.0))
    run = HealthRun(
        robot, duration=11.0, spoil=spoil, motion=resting(robot), dt=STEP, start_z=-37.0
    )
    assert np.abs(run.range[run.t > 9.5] - (HEIGHT - 1.0)).max() < 0.1


def test_a_frozen_altimeter_is_lost_although_the_attitude_is_off(robot: Robot) -> None:
    frozen = list[Reading]()

    def freeze(readings: Readings, t: float) -> Readings:
        reading = readings.altimeter_range
        if reading is None or reading.t < 15.0:
            return readings
        frozen.append(reading)
        return replace(readings, altimeter_range=replace(reading, value=frozen[0].value))

    drift = drifting("attitude", np.array([0.0, 0.0, 0.1]), ONSET)
    run = HealthRun(robot, duration=25.0, spoil=both(drift, freeze), dt=STEP, start_z=-37.0)
    is_late = run.t > 18.0
    assert (run.of("attitude")[is_late] != Trust.GOOD).all()
    assert (run.of("altimeter_range")[is_late] == Trust.LOST).all()

"""What the altimeter says against how the vehicle moves: stuck values are not believed, steps of
the floor are, in the end.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from health_run import HealthRun, Spoil, between

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Readings, Trust
from uvms_ocp.sim.rough_seafloor import RELIEFS, HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor, Seafloor

NAME = "altimeter_range"
SPEED = 0.2  # [m/s] of the descent


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


def sinking(robot: Robot, after: float = 3.0):
    """Straight down from a time [s] on."""
    down = np.zeros(robot.n_v)
    down[2] = -SPEED
    return lambda t: down * min(max(t - after, 0.0), 1.0)


def noisy_stuck(value: float, start: float) -> Spoil:
    """A range with noise that knows no floor."""
    rng = np.random.default_rng(0)
    last_reading = [0.0, value]

    def spoil(readings: Readings, t: float) -> Readings:
        reading = readings.altimeter_range
        if t < start or reading is None:
            return readings
        if reading.t != last_reading[0]:
            last_reading[:] = [reading.t, value + 0.01 * rng.standard_normal()]
        return _with(readings, last_reading[1])

    return spoil


def _with(readings: Readings, value: float) -> Readings:
    assert readings.altimeter_range is not None
    return replace(readings, altimeter_range=replace(readings.altimeter_range, value=value))


@pytest.mark.sampled
@pytest.mark.parametrize("start", [2.0, 5.0])
@pytest.mark.parametrize("defect", ["frozen", "stuck", "jump", "spikes", "noisy"])
def test_an_altimeter_that_lies_never_shows_more_water_than_the_descent_leaves(
    robot: Robot, defect: str, start: float
) -> None:
    if defect == "noisy":
        spoil = noisy_stuck(100.0, start)
    else:
        spoil = between(NAME, defect, start, math.inf)
    run = HealthRun(robot, duration=12.0, spoil=spoil, motion=sinking(robot))
    true = run.q[:, 2] - run.q[0, 2] + run.range[run.t > 1.5][0]
    has_echo = np.isfinite(run.range) & (run.t > 1.5)
    assert (run.range - true)[has_echo].max() < 0.15
    assert run.first_bad(NAME, max(start, 4.0 if defect == "frozen" else 0.0)) < 1.2
    if defect != "spikes":
        assert math.isnan(run.range[-1])


def test_a_range_that_stays_the_same_with_noise_is_lost_once_the_vehicle_sinks(
    robot: Robot,
) -> None:
    hovering = HealthRun(robot, duration=2.0, motion=sinking(robot)).range[-1]
    run = HealthRun(robot, duration=9.0, spoil=noisy_stuck(hovering, 2.0), motion=sinking(robot))
    assert (run.of(NAME)[run.t < 3.5] == Trust.GOOD).all()
    assert run.first_bad(NAME, 3.5) < 1.8
    assert run.of(NAME)[-1] == Trust.LOST
    assert math.isnan(run.range[-1])


class Cliff(Seafloor):
    """Two planes."""

    def __init__(self, low: float, high: float, edge: float) -> None:
        self._low = low
        self._high = high
        self._edge = edge

    def height(self, x: float, y: float) -> float:
        if x < self._edge:
            return self._high
        return self._low

    def normal(self, x: float, y: float) -> np.ndarray:
        return np.array([0.0, 0.0, 1.0])

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        return float(origin[2] - self.height(origin[0], origin[1])) / -float(direction[2])


def cruising(robot: Robot, climb: float):
    """Forward, and gently up or down after six seconds."""
    level = np.zeros(robot.n_v)
    level[0] = 0.4
    climbing = level.copy()
    climbing[2] = climb
    return lambda t: climbing if t > 6.0 else level


def test_a_floor_that_rises_at_once_is_believed_at_once(robot: Robot) -> None:
    run = HealthRun(
        robot, duration=8.0, floor=Cliff(-38.0, -40.0, 1.6), motion=cruising(robot, 0.0)
    )
    after = (run.t > 4.4) & (run.t < 5.0)
    assert np.abs(run.range[after] - run.range[run.t < 3.9][-1] + 2.0).max() < 0.05
    assert run.first_bad(NAME, 4.0) < 0.5
    assert run.of(NAME)[-1] == Trust.GOOD


@pytest.mark.sampled
@pytest.mark.parametrize("climb", [0.15, -0.15])
def test_a_floor_that_falls_at_once_is_believed_when_the_vehicle_has_moved_vertically(
    robot: Robot, climb: float
) -> None:
    run = HealthRun(
        robot, duration=12.0, floor=Cliff(-43.0, -38.0, 1.6), motion=cruising(robot, climb)
    )
    before = run.range[(run.t > 2.0) & (run.t < 3.9)].max()
    unproven = (run.t > 4.0) & (run.t < 7.0) & np.isfinite(run.range)
    assert run.range[unproven].max() < before + 0.1
    assert run.range[-1] - before == pytest.approx(5.0 + climb * 6.0, abs=0.1)
    assert run.of(NAME)[-1] == Trust.GOOD


def test_the_farther_the_vehicle_goes_the_more_a_floor_may_have_fallen(robot: Robot) -> None:
    run = HealthRun(
        robot, duration=8.0, floor=Cliff(-40.0, -38.0, 1.6), motion=cruising(robot, 0.0)
    )
    assert run.first_bad(NAME, 4.0) < 0.5
    assert run.of(NAME)[-1] == Trust.GOOD


def test_a_fish_below_the_vehicle_is_forgotten(robot: Robot) -> None:
    def fish(readings: Readings, t: float) -> Readings:
        if not 3.0 <= t < 3.1 or readings.altimeter_range is None:
            return readings
        return _with(readings, 0.5)

    run = HealthRun(robot, duration=6.0, spoil=fish, motion=lambda t: np.zeros(robot.n_v))
    assert run.range[(run.t > 3.0) & (run.t < 3.1)].min() < 0.6
    assert run.range[-1] == pytest.approx(run.range[200], abs=0.03)
    assert run.of(NAME)[-1] == Trust.GOOD


@pytest.mark.sampled
@pytest.mark.parametrize("relief", RELIEFS)
@pytest.mark.parametrize("seed", [0, 1])
def test_rough_floors_raise_no_alarm(robot: Robot, relief: str, seed: int) -> None:
    floor = HeightField.random(relief, z=-45.0, extent=30.0, seed=seed)
    run = HealthRun(
        robot, duration=20.0, floor=floor, motion=cruising(robot, 0.02), dt=0.02, seed=seed
    )
    assert run.guard.monitor.alarms == []
    assert np.isfinite(run.range[run.t > 0.5]).all()


def test_a_level_floor_is_a_floor_like_any_other(robot: Robot) -> None:
    run = HealthRun(robot, duration=8.0, floor=FlatSeafloor(z=-50.0), motion=sinking(robot))
    assert run.guard.monitor.alarms == []

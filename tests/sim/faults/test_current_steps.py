"""Laws of currents that set in under way."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.sim.currents import Current, GustyCurrent, ShearedCurrent, StillWater, water_at
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults import parse_faults
from uvms_ocp.sim.rough_seafloor import HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor, Seafloor
from uvms_ocp.sim.stepped_current import LAYER, RISE, with_steps

FLAT = FlatSeafloor(z=-40.0)
ROUGH = HeightField.random("large", z=-40.0, extent=30.0, seed=2)
LAYERED = ShearedCurrent(z=[-42.0, -30.0], velocities=[[0.1, 0.0, 0.02], [0.3, 0.1, 0.02]])
TEXTS = ("current:step=1,0,0@10", "current:step=0.2,0,-1@10", "current:step=0.2,0.1,0.5@10-11.5")
CASES = {
    f"{text} {name}": (text, floor, base)
    for text in TEXTS
    for name, floor, base in (
        ("still, flat", FLAT, StillWater()),
        ("still, rough", ROUGH, StillWater()),
        ("layers, rough", ROUGH, LAYERED),
        ("gusts, flat", FLAT, GustyCurrent(base=LAYERED, seed=2)),
    )
}
POINTS = np.random.default_rng(0).uniform([-5.0, -5.0, -39.9], [5.0, 5.0, -30.0], (12, 3))
TIMES = np.random.default_rng(1).uniform(9.0, 15.0, 30)


def stepped(text: str, floor: Seafloor, base: Current) -> Current:
    return with_steps(Environment(seafloor=floor, current=base), parse_faults([text])).current


@pytest.fixture(params=CASES, name="current")
def _current(request: pytest.FixtureRequest) -> Current:
    return stepped(*CASES[request.param])


def points_above(floor: Seafloor) -> np.ndarray:
    lift = np.random.default_rng(2).uniform(0.05, 2.0 * LAYER, len(POINTS))
    return np.array(
        [[x, y, floor.height(x, y) + h] for (x, y, _), h in zip(POINTS, lift, strict=True)]
    )


def test_rate_is_the_derivative_of_the_velocity_over_time(current: Current) -> None:
    h = 1e-5
    for t in TIMES:
        difference = (current.velocity(POINTS, t + h) - current.velocity(POINTS, t - h)) / (2 * h)
        np.testing.assert_allclose(current.rate(POINTS, t), difference, atol=1e-5)


@pytest.mark.parametrize("floor", [FLAT, ROUGH], ids=["flat", "rough"])
@pytest.mark.parametrize("text", TEXTS)
def test_gradient_and_acceleration_are_those_of_the_velocity(text: str, floor: Seafloor) -> None:
    """A rough floor is made of cells, at whose edges its slope jumps: points near them are left
    out.
    """
    current = stepped(text, floor, LAYERED)
    h = 1e-5
    places = points_above(floor)
    if floor is ROUGH:
        nearby = np.array(
            [[floor.normal(x + a, y + b) for a in (-h, h) for b in (-h, h)] for x, y, _ in places]
        )
        places = places[np.ptp(nearby, axis=1).max(axis=1) < 1e-4]
        assert len(places) > 5
    for t in TIMES:
        slopes = [
            (current.velocity(places + h * e, t) - current.velocity(places - h * e, t)) / (2 * h)
            for e in np.eye(3)
        ]
        np.testing.assert_allclose(current.gradient(places, t), np.stack(slopes, axis=2), atol=1e-4)
        water = water_at(current, places, t)
        ahead, behind = (places + sign * h * water.velocity for sign in (1, -1))
        rate = (current.velocity(ahead, t + h) - current.velocity(behind, t - h)) / (2 * h)
        np.testing.assert_allclose(water.acceleration, rate, atol=1e-4)


@pytest.mark.parametrize("name", CASES)
def test_nothing_flows_before_the_onset_that_did_not_flow_anyway(name: str) -> None:
    text, floor, base = CASES[name]
    current = stepped(text, floor, base)
    for t in (0.0, 5.0, 9.999, 10.0):
        for field in ("velocity", "rate", "gradient"):
            np.testing.assert_array_equal(
                getattr(current, field)(POINTS, t), getattr(base, field)(POINTS, t)
            )


def test_the_whole_step_flows_once_it_has_risen_and_nothing_once_it_has_fallen() -> None:
    high = np.array([[0.0, 0.0, -30.0]])
    current = stepped("current:step=0.2,0.1,-1@10-20", FLAT, StillWater())
    np.testing.assert_allclose(current.velocity(high, 10.0 + RISE), [[0.2, 0.1, -1.0]])
    np.testing.assert_allclose(current.velocity(high, 10.0 + RISE / 2), [[0.1, 0.05, -0.5]])
    np.testing.assert_allclose(current.velocity(high, 20.0 + RISE), 0.0, atol=1e-15)


@pytest.mark.parametrize("floor", [FLAT, ROUGH], ids=["flat", "rough"])
def test_no_water_flows_through_the_floor_and_sideways_it_slides_along(floor: Seafloor) -> None:
    current = stepped("current:step=0.2,0.1,-1@0", floor, StillWater())
    below = np.array([[x, y, floor.height(x, y)] for x, y, _ in POINTS])
    velocity = current.velocity(below, 5.0)
    np.testing.assert_allclose(velocity[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(velocity[:, :2], [[0.2, 0.1]] * len(below))
    heights = current.velocity(below + np.array([0.0, 0.0, LAYER]), 5.0)[:, 2]
    np.testing.assert_allclose(heights, -1.0)


def test_an_environment_without_such_faults_stays_as_it_is() -> None:
    environment = Environment(seafloor=FLAT)
    assert with_steps(environment, parse_faults(["depth:lost", "thruster1:dead"])) is environment

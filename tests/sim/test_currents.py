"""Laws of currents, and of the environment that holds them."""

import math

import coal
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.sim.currents import (
    GustyCurrent,
    OnsetCurrent,
    ShearedCurrent,
    StillWater,
    UniformCurrent,
    water_at,
)
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor

SHEARED = ShearedCurrent(
    z=[-40.0, -30.0, 0.0], velocities=[[0.0, 0.0, 0.0], [0.2, 0.1, 0.0], [0.5, 0.0, 0.0]]
)
CURRENTS = {
    "still": StillWater(),
    "uniform": UniformCurrent([0.3, -0.1, 0.05]),
    "sheared": SHEARED,
    "boundary layer": ShearedCurrent.over_floor([0.3, 0.1, 0.0], floor_z=-40.0, thickness=5.0),
    "upwelling": ShearedCurrent(z=[-42.0, 2.0], velocities=[[0.1, 0.0, 0.05], [0.6, -0.3, 0.05]]),
    "onset": OnsetCurrent([0.3, 0.1, -0.1], start=10.0, rise=20.0),
    "gusty": GustyCurrent(seed=2),
    "gusty over sheared": GustyCurrent(base=SHEARED, sigma=(0.1, 0.05, 0.03), seed=3),
}
POINTS = np.random.default_rng(0).uniform([-5.0, -5.0, -45.0], [5.0, 5.0, 0.0], (8, 3))


@pytest.fixture(params=CURRENTS, name="current")
def _current(request):
    return CURRENTS[request.param]


def test_rate_and_gradient_are_the_derivatives_of_the_velocity(current):
    h = 1e-5
    for t in np.random.default_rng(1).uniform(0.01, 60.0, 50):
        difference = (current.velocity(POINTS, t + h) - current.velocity(POINTS, t - h)) / (2 * h)
        np.testing.assert_allclose(current.rate(POINTS, t), difference, atol=1e-6)
        slopes = [
            (current.velocity(POINTS + h * e, t) - current.velocity(POINTS - h * e, t)) / (2 * h)
            for e in np.eye(3)
        ]
        np.testing.assert_allclose(current.gradient(POINTS, t), np.stack(slopes, axis=2), atol=1e-6)


def test_the_water_s_own_acceleration_is_that_of_a_particle_which_it_carries_along(current):
    h = 1e-5
    for t in np.random.default_rng(3).uniform(0.01, 60.0, 50):
        water = water_at(current, POINTS, t)
        ahead, behind = (POINTS + sign * h * water.velocity for sign in (1, -1))
        rate = (current.velocity(ahead, t + h) - current.velocity(behind, t - h)) / (2 * h)
        np.testing.assert_allclose(water.acceleration, rate, atol=1e-6)
        np.testing.assert_array_equal(water.velocity, current.velocity(POINTS, t))


@pytest.mark.parametrize("name", ["still", "uniform", "sheared", "boundary layer"])
def test_water_in_steady_parallel_layers_does_not_accelerate(name):
    assert not water_at(CURRENTS[name], POINTS, 3.0).acceleration.any()


def test_a_vertical_gust_carries_water_from_layer_to_layer():
    gust = GustyCurrent(sigma=(0.0, 0.0, 0.1), seed=3)
    up = gust.velocity(POINTS, 7.0)
    before = gust.rate(POINTS, 7.0)
    slope = np.array(
        [[0.02, 0.01, 0.0] if z < -30 else [0.01, -1 / 300, 0.0] for z in POINTS[:, 2]]
    )
    slope[POINTS[:, 2] < -40] = 0.0
    through = water_at(GustyCurrent(base=SHEARED, sigma=(0.0, 0.0, 0.1), seed=3), POINTS, 7.0)
    assert abs(up[0, 2]) > 0.01
    np.testing.assert_allclose(through.acceleration, before + up[:, 2:] * slope, atol=1e-12)


def test_velocity_and_rate_are_continuous_in_time(current):
    for t in (0.5, 1.0, 7.5, 128.0):  # nodes of the gusts
        for field in (current.velocity, current.rate):
            np.testing.assert_allclose(field(POINTS, t - 1e-9), field(POINTS, t + 1e-9), atol=1e-6)


def test_every_point_gets_one_velocity(current):
    for n in (0, 1, 8):
        water = water_at(current, POINTS[:n], 1.0)
        assert water.velocity.shape == water.acceleration.shape == (n, 3)


def test_a_gust_is_a_function_of_time_whatever_the_order_of_the_questions():
    times = np.random.default_rng(2).uniform(0.0, 600.0, 40)
    forward = GustyCurrent(seed=9)
    backward = GustyCurrent(seed=9)
    ascending = {t: forward.velocity(POINTS, t) for t in np.sort(times)}
    descending = {t: backward.velocity(POINTS, t) for t in np.sort(times)[::-1]}
    for t in times:
        np.testing.assert_array_equal(ascending[t], descending[t])


def test_another_seed_gives_another_gust():
    assert (
        np.abs(
            GustyCurrent(seed=1).velocity(POINTS, 5.0) - GustyCurrent(seed=2).velocity(POINTS, 5.0)
        ).max()
        > 1e-3
    )


def test_a_gust_has_the_deviation_and_correlation_time_that_were_asked_for():
    gust = GustyCurrent(sigma=(0.1, 0.05, 0.0), correlation_time=5.0, step=0.5, seed=0)
    point = POINTS[:1]
    series = np.array([gust.velocity(point, t)[0] for t in np.arange(0.0, 20_000.0, 2.5)])
    np.testing.assert_allclose(series.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(series.std(axis=0), [0.1, 0.05, 0.0], rtol=0.05)
    correlation = (series[:-2, 0] * series[2:, 0]).mean() / series[:, 0].var()
    assert correlation == pytest.approx(math.exp(-1.0), abs=0.06)


def test_shear_is_linear_between_heights_and_constant_beyond():
    p = np.array([[0.0, 0.0, z] for z in (-50.0, -35.0, -30.0, -15.0, 10.0)])
    expected = [
        [0.0, 0.0, 0.0],
        [0.1, 0.05, 0.0],
        [0.2, 0.1, 0.0],
        [0.35, 0.05, 0.0],
        [0.5, 0.0, 0.0],
    ]
    np.testing.assert_allclose(SHEARED.velocity(p, 3.0), expected, atol=1e-12)


def test_water_stands_still_at_the_bottom_of_a_boundary_layer_and_follows_the_power_law():
    current = CURRENTS["boundary layer"]
    p = np.array([[0.0, 0.0, -40.0], [0.0, 0.0, -37.5], [0.0, 0.0, -10.0]])
    speeds = current.velocity(p, 0.0)[:, 0]
    np.testing.assert_allclose(speeds, [0.0, 0.3 * 0.5 ** (1 / 7), 0.3], rtol=1e-3)


def test_wrong_currents_are_refused_in_one_line():
    for make in (
        lambda: UniformCurrent([0.1, 0.2]),
        lambda: UniformCurrent([0.1, 0.2, math.nan]),
        lambda: UniformCurrent([0.0, 300.0, 0.0]),
        lambda: ShearedCurrent(z=[0.0, -1.0], velocities=np.zeros((2, 3))),
        lambda: ShearedCurrent(z=[], velocities=np.zeros((0, 3))),
        lambda: ShearedCurrent(z=[0.0, 1.0], velocities=np.zeros((3, 3))),
        lambda: ShearedCurrent.over_floor([0.1, 0.0, 0.0], floor_z=0.0, thickness=0.0),
        lambda: GustyCurrent(sigma=-0.1),
        lambda: GustyCurrent(sigma=math.nan),
        lambda: GustyCurrent(correlation_time=0.0),
        lambda: GustyCurrent(step=math.inf),
        lambda: GustyCurrent().velocity(POINTS, -1.0),
    ):
        with pytest.raises(InvalidInput) as error:
            make()
        assert "\n" not in str(error.value)


def test_an_environment_is_still_and_empty_unless_told_otherwise():
    environment = Environment(seafloor=FlatSeafloor(z=-40.0))
    assert not environment.current.velocity(POINTS, 0.0).any()
    assert environment.obstacles == ()


def test_obstacles_need_finite_poses_and_names_of_their_own():
    sphere = Obstacle(name="rock", shape=coal.Sphere(0.5), X_WO=pin.SE3.Identity())
    with pytest.raises(InvalidInput, match="two obstacles are called 'rock'"):
        Environment(seafloor=FlatSeafloor(z=0.0), obstacles=(sphere, sphere))
    with pytest.raises(InvalidInput, match="name"):
        Obstacle(name="", shape=coal.Sphere(0.5), X_WO=pin.SE3.Identity())
    with pytest.raises(InvalidInput, match="X_WO"):
        Obstacle(
            name="rock",
            shape=coal.Sphere(0.5),
            X_WO=pin.SE3(np.eye(3), np.array([0.0, math.nan, 0.0])),
        )

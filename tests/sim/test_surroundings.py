"""Laws of what the plant samples: shortcuts for what is the same everywhere or always change
nothing.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.sim.currents import (
    Current,
    GustyCurrent,
    OnsetCurrent,
    ShearedCurrent,
    StillWater,
    UniformCurrent,
    water_at,
)
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.environment_sampler import EnvironmentSampler
from uvms_ocp.sim.rough_seafloor import HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor, Seafloor, ground_at

ROBOT = load_robot("girona_maris7_full")
DYNAMICS = robot_dynamics(ROBOT)
POINTS = skid_points(ROBOT)
SHEARED = ShearedCurrent.over_floor([0.3, 0.1, 0.0], floor_z=-40.0, thickness=5.0)
CURRENTS: dict[str, Current] = {
    "still": StillWater(),
    "uniform": UniformCurrent([0.3, -0.2, 0.1]),
    "onset": OnsetCurrent([0.3, -0.2, 0.1], start=1.0, rise=4.0),
    "gusty": GustyCurrent(base=UniformCurrent([0.2, 0.0, 0.0]), seed=3),
    "gusty onset": GustyCurrent(base=OnsetCurrent([0.3, 0.0, 0.0], start=1.0, rise=4.0)),
    "sheared": SHEARED,
    "gusty and sheared": GustyCurrent(base=SHEARED, seed=2),
}
FLOORS: dict[str, Seafloor] = {
    "flat": FlatSeafloor(z=-40.0),
    "bumpy": HeightField.random("small", z=-40.0, extent=40.0, seed=1),
}
T = 2.3
DT = 0.005


class OwnCurrent(Current):
    """Of a user: says nothing about where it is the same."""

    def __init__(self, base: Current) -> None:
        self._base = base

    def velocity(self, p_W: np.ndarray, t: float) -> np.ndarray:
        return self._base.velocity(p_W, t)

    def rate(self, p_W: np.ndarray, t: float) -> np.ndarray:
        return self._base.rate(p_W, t)

    def gradient(self, p_W: np.ndarray, t: float) -> np.ndarray:
        return self._base.gradient(p_W, t)


class OwnFloor(Seafloor):
    """Of a user: knows single points alone."""

    def __init__(self, base: Seafloor) -> None:
        self._base = base

    def height(self, x: float, y: float) -> float:
        return self._base.height(x, y)

    def normal(self, x: float, y: float) -> np.ndarray:
        return self._base.normal(x, y)

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        return self._base.range_along(origin, direction)


class HigherFloor(HeightField):
    """A built-in one with another height."""

    def height(self, x: float, y: float) -> float:
        return self.z + 1.0


def sampled(current: Current, floor: Seafloor, q: np.ndarray) -> dict[str, np.ndarray]:
    n_links = len(DYNAMICS.symbolic.links)
    n_points = len(POINTS)
    outputs = {name: np.full((n_links, 3), np.nan) for name in ("u", "Du_Dt")}
    outputs |= {
        "floor_z": np.full(n_points, np.nan),
        "floor_normal": np.full((n_points, 3), np.nan),
    }
    around = EnvironmentSampler(
        Environment(seafloor=floor, current=current), DYNAMICS.symbolic, POINTS
    )
    around.bind(**outputs)
    around.sample(ROBOT.configuration(position=(5.0, 5.0, 0.0)), 0.1, DT)
    around.sample(q, T, DT)
    return outputs


@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize("name", CURRENTS)
def test_every_link_and_point_feels_what_is_there(name: str, floor: str) -> None:
    q = ROBOT.configuration(position=(1.0, 2.0, -39.5), rpy=(0.1, -0.2, 0.5))
    links = DYNAMICS.link_positions(q)
    corners = POINTS @ quaternion_to_matrix(q[3:7]).T + q[:3]
    outputs = sampled(CURRENTS[name], FLOORS[floor], q)
    water = water_at(CURRENTS[name], links, T)
    ground = FLOORS[floor]
    np.testing.assert_allclose(outputs["u"], water.velocity, atol=1e-14)
    np.testing.assert_allclose(outputs["Du_Dt"], water.acceleration, atol=1e-14)
    np.testing.assert_allclose(
        outputs["floor_z"], [ground.height(x, y) for x, y, _ in corners], rtol=1e-14
    )
    np.testing.assert_allclose(
        outputs["floor_normal"], [ground.normal(x, y) for x, y, _ in corners], atol=1e-14
    )


@pytest.mark.parametrize("name", CURRENTS)
def test_a_current_and_a_floor_of_ones_own_are_asked_at_every_point(name: str) -> None:
    q = ROBOT.configuration(position=(1.0, 2.0, -39.5), rpy=(0.1, -0.2, 0.5))
    expected = sampled(CURRENTS[name], FLOORS["bumpy"], q)
    outputs = sampled(OwnCurrent(CURRENTS[name]), OwnFloor(FLOORS["bumpy"]), q)
    for key, value in expected.items():
        np.testing.assert_allclose(outputs[key], value, atol=1e-13, err_msg=key)


def test_a_floor_far_below_its_points_is_out_of_reach_and_no_higher_than_its_top() -> None:
    field = FLOORS["bumpy"]
    assert isinstance(field, HeightField)
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-20.0, 20.0, 60)]))
    assert ground_at(field, np.stack([x, y], axis=1))[0].max() <= field.top
    q = ROBOT.configuration(position=(1.0, 2.0, field.top + 3.0))
    np.testing.assert_array_equal(sampled(StillWater(), field, q)["floor_z"], np.full(4, field.top))


def test_a_floor_made_of_a_built_in_one_is_not_taken_for_it() -> None:
    field = FLOORS["bumpy"]
    assert isinstance(field, HeightField)
    higher = HigherFloor(z=field.z, centres=field.centres, heights=field.heights, radii=field.radii)
    np.testing.assert_array_equal(ground_at(higher, np.zeros((3, 2)))[0], np.full(3, -39.0))


def test_only_what_never_changes_is_taken_as_steady() -> None:
    assert {name for name, current in CURRENTS.items() if current.is_steady} == {"still", "uniform"}
    alike = {name for name, current in CURRENTS.items() if current.uniform_flow(T) is not None}
    assert alike == {"still", "uniform", "onset", "gusty", "gusty onset"}
    assert OwnCurrent(StillWater()).uniform_flow(T) is None


class LayeredCurrent(UniformCurrent):
    """Made of a uniform one, and different from place to place."""

    def velocity(self, p_W: np.ndarray, t: float) -> np.ndarray:
        return super().velocity(p_W, t) * p_W[:, 2:]


def test_a_current_made_of_a_uniform_one_is_not_taken_for_it() -> None:
    layered = LayeredCurrent([0.1, 0.0, 0.0])
    assert not layered.is_steady
    assert layered.uniform_flow(T) is None
    gusty = GustyCurrent(base=layered)
    assert gusty.uniform_flow(T) is None


class TidalCurrent(UniformCurrent):
    """Made of a uniform one, and still the same everywhere: its `flow` is its own."""

    def flow(self, t: float) -> np.ndarray:
        return math.cos(t) * super().flow(t)


class LayeredTidalCurrent(TidalCurrent):
    """Made of one that is made of a uniform one."""

    def velocity(self, p_W: np.ndarray, t: float) -> np.ndarray:
        return super().velocity(p_W, t) * p_W[:, 2:]


def test_a_current_made_of_a_uniform_one_may_ask_for_that_one() -> None:
    points = np.array([[0.0, 0.0, -2.0], [1.0, 0.0, -5.0]])
    layered = LayeredCurrent([0.1, 0.0, 0.0])
    np.testing.assert_array_equal(
        layered.velocity(points, T), np.array([[-0.2, 0.0, 0.0], [-0.5, 0.0, 0.0]])
    )
    np.testing.assert_array_equal(layered.rate(points, T), np.zeros((2, 3)))
    tide = np.array([0.1 * math.cos(T), 0.0, 0.0])
    tidal = TidalCurrent([0.1, 0.0, 0.0])
    np.testing.assert_array_equal(tidal.velocity(points, T), np.tile(tide, (2, 1)))
    layered_tidal = LayeredTidalCurrent([0.1, 0.0, 0.0])
    np.testing.assert_array_equal(layered_tidal.velocity(points, T), np.outer([-2.0, -5.0], tide))


@pytest.mark.parametrize("quantity", ["velocity", "rate"])
def test_water_that_is_no_number_is_refused(quantity: str) -> None:
    broken = OwnCurrent(StillWater())
    setattr(broken, quantity, lambda p_W, t: np.full((len(p_W), 3), np.nan))
    with pytest.raises(InvalidInput, match="give finite numbers"):
        sampled(broken, FLOORS["flat"], ROBOT.configuration())


def test_ground_is_a_plane_where_nothing_rises() -> None:
    flat = dataclasses.replace(FlatSeafloor(z=-7.0))
    heights, normals = ground_at(flat, np.zeros((4, 2)))
    np.testing.assert_array_equal(heights, np.full(4, -7.0))
    np.testing.assert_array_equal(normals, np.tile([0.0, 0.0, 1.0], (4, 1)))
    assert ground_at(OwnFloor(flat), np.zeros((0, 2)))[1].shape == (0, 3)

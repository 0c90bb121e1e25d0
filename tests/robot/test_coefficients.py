"""From descriptions to coefficients: shape rules, axes, floats and ballast."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.loading import list_robots, load_robot

RHO = 1000.0


def only_link(**entries: object) -> LinkHydrodynamics:
    (link,) = links_in_water(RobotDescription.model_validate({"water_density": RHO, **entries}))
    return link


def shaped(**shape: object) -> LinkHydrodynamics:
    return only_link(links={"arm": shape})


def test_a_cylinder_carries_its_displaced_mass_sideways() -> None:
    link = shaped(cylinder={"radius": 0.05, "length": 0.4, "pose": {"position": (0.0, 0.0, 0.2)}})
    volume = np.pi * 0.05**2 * 0.4
    side = 0.6 * RHO / 2 * 0.1 * 0.4
    end = 0.6 * RHO / 2 * np.pi * 0.05**2
    tumbling = RHO * np.pi * 0.05**2 * 0.4**3 / 12
    np.testing.assert_allclose(
        np.diag(link.added_mass),
        [RHO * volume, RHO * volume, 0.1 * RHO * volume, tumbling, tumbling, 0],
    )
    np.testing.assert_allclose(np.diag(link.linear_drag), [0.4, 0.4, 0.4, 0, 0, 0])
    np.testing.assert_allclose(np.diag(link.quadratic_drag)[:3], [side, side, end])
    assert link.volume == pytest.approx(volume)
    np.testing.assert_allclose(link.centre_of_buoyancy, [0.0, 0.0, 0.2])


def test_turning_drag_is_the_lateral_drag_of_strips() -> None:
    link = shaped(cylinder={"radius": 0.05, "length": 0.4})
    x = 0.2 * (np.arange(100000) + 0.5) / 100000
    strips = 0.6 * RHO / 2 * 0.1 * 2 * 0.2 * np.mean(x**3)
    np.testing.assert_allclose(np.diag(link.quadratic_drag)[3:], [strips, strips, 0.0], rtol=1e-6)


def test_a_square_prism_turns_its_corners_and_a_long_box_as_much_as_a_cylinder_would() -> None:
    cube, beam = (shaped(box={"size": size}) for size in ((0.3, 0.3, 0.3), (0.01, 0.01, 0.5)))
    prism = 0.725 * RHO * 0.15**4 * 0.3  # sides of 2 a, 0.3 m long
    np.testing.assert_allclose(np.diag(cube.added_mass), [27.0] * 3 + [prism] * 3)
    mass = RHO * 0.01 * 0.01 * 0.5
    np.testing.assert_allclose(np.diag(beam.added_mass)[3:5], mass * 0.5**2 / 12, rtol=2e-3)
    np.testing.assert_allclose(np.diag(cube.quadratic_drag)[:3], 0.6 * RHO / 2 * 0.09)


def test_a_sphere_carries_half_of_its_displaced_mass() -> None:
    link = shaped(sphere={"radius": 0.1})
    np.testing.assert_allclose(np.diag(link.added_mass), [RHO * link.volume / 2] * 3 + [0.0] * 3)


def test_ned_coefficients_become_forward_left_up() -> None:
    matrix = np.eye(6) * 10
    matrix[0, 1] = matrix[1, 0] = 1.0
    matrix[1, 5] = matrix[5, 1] = 2.0
    link = only_link(
        convention="NED",
        links={
            "hull": {
                "coefficients": {
                    "added_mass": matrix.tolist(),
                    "quadratic_drag": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
                    "pose": {"position": (0.1, 0.2, 0.3)},
                    "volume": 0.01,
                    "centre_of_buoyancy": (0.0, 0.1, -0.2),
                }
            }
        },
    )
    assert link.added_mass[0, 1] == -1.0
    assert link.added_mass[1, 5] == 2.0
    np.testing.assert_array_equal(np.diag(link.quadratic_drag), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_allclose(link.X_FL.translation, [0.1, -0.2, -0.3])
    np.testing.assert_allclose(link.centre_of_buoyancy, [0.0, -0.1, 0.2])


def test_floats_share_the_centre_of_buoyancy_by_volume() -> None:
    link = only_link(
        links={"hull": {"coefficients": {"volume": 0.03, "centre_of_buoyancy": (0.0, 0.0, 0.1)}}},
        trim=[
            {
                "name": "float",
                "link": "hull",
                "position": (0.4, 0.0, 0.1),
                "mass": 1.0,
                "volume": 0.01,
            }
        ],
    )
    assert link.volume == pytest.approx(0.04)
    np.testing.assert_allclose(link.centre_of_buoyancy, [0.1, 0.0, 0.1])


def test_ballast_on_a_dry_link_makes_it_wet() -> None:
    link = only_link(
        trim=[
            {
                "name": "lead",
                "link": "keel",
                "position": (0.4, 0.0, 0.1),
                "mass": 1.0,
                "volume": 1e-4,
            }
        ]
    )
    assert link.frame == "keel"
    assert link.volume == pytest.approx(1e-4)


@pytest.mark.parametrize("name", [name for name in list_robots() if load_robot(name).n_vehicle])
def test_robots_float_level_and_neutral_with_the_arm_stowed(name: str) -> None:
    robot = load_robot(name)
    residual = robot_dynamics(robot).bias_force(robot.configuration(), np.zeros(robot.n_v))[:6]
    assert np.linalg.norm(residual[:3]) < 0.5
    assert np.linalg.norm(residual[3:]) < 0.5

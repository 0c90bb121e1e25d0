"""Trim: residual of weight and buoyancy, floats and ballast."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import list_robots, load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import static_residual, trimmed, with_trim, without_trim

FLOATING = [name for name in list_robots() if load_robot(name).n_vehicle]


def total_mass(robot: Robot) -> float:
    return float(sum(inertia.mass for inertia in robot.model.inertias))


@pytest.mark.parametrize("name", FLOATING)
def test_the_static_residual_is_the_force_that_holds_the_vehicle_still(name: str) -> None:
    robot = without_trim(load_robot(name))
    rng = np.random.default_rng(5)
    joints = rng.uniform(robot.limits.position_lower, robot.limits.position_upper)
    q = robot.configuration(position=(1.0, -2.0, -3.0), rpy=(0.2, -0.3, 0.4), joints=joints)
    force, moment = static_residual(robot, q)
    R_WB = pin.XYZQUATToSE3(q[:7]).rotation
    holding = robot_dynamics(robot).bias_force(q, np.zeros(robot.n_v))[:6]
    assert R_WB @ holding[:3] == pytest.approx([0.0, 0.0, -force], abs=1e-8)
    assert R_WB @ holding[3:] == pytest.approx(-moment, abs=1e-8)


def test_without_trim_only_the_floats_and_the_ballast_are_gone() -> None:
    robot = load_robot("girona_maris7")
    floats = sum(body.mass for body in robot.description.trim)
    bared = without_trim(robot)
    assert total_mass(robot) - total_mass(bared) == pytest.approx(floats)
    assert bared.model.inertias[1].mass == pytest.approx(148.5)
    assert np.abs(bared.model.inertias[1].lever).max() < 1e-12


@pytest.mark.parametrize("name", FLOATING)
def test_taking_the_trim_off_and_putting_it_back_changes_nothing(name: str) -> None:
    robot = load_robot(name)
    again = with_trim(without_trim(robot), robot.description.trim)
    assert again.model.inertias[1].isApprox(robot.model.inertias[1], 1e-9)
    assert again.description == robot.description
    assert again.hydrodynamics[0].centre_of_buoyancy == pytest.approx(
        robot.hydrodynamics[0].centre_of_buoyancy
    )


@pytest.mark.parametrize("name", FLOATING)
def test_a_robot_can_be_trimmed_for_the_sea(name: str) -> None:
    robot = trimmed(without_trim(load_robot(name)).with_water_density(1025.0), bow=0.5, stern=-0.5)
    force, moment = static_residual(robot, robot.configuration())
    assert abs(force) < 1e-6
    assert np.abs(moment).max() < 1e-6


def test_trim_that_does_not_fit_is_refused() -> None:
    robot = load_robot("girona_maris7")
    with pytest.raises(FrameNotFound, match="unknown frame 'ghost'"):
        with_trim(
            robot,
            [TrimBody(name="t", link="ghost", position=(0.0, 0.0, 0.0), mass=1.0, volume=0.0)],
        )
    with pytest.raises(InvalidInput, match="names must be unique"):
        with_trim(robot, robot.description.trim)
    with pytest.raises(InvalidInput, match="ahead of stern"):
        trimmed(robot, bow=0.5, stern=0.5)
    with pytest.raises(InvalidInput, match="only a free-flyer can be trimmed"):
        trimmed(load_robot("planar5"), bow=0.5, stern=-0.5)

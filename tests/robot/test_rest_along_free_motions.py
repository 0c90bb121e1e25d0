"""Where a vehicle comes to rest along the motions that no thruster works on is where weight and buoyancy do no
more work; where nothing holds it there is no such place.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from studies.drawn_robots import drawn_body, write_robot
from tiny_robots import TINY, robot_of

from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.rest_along_free_motions import motion_to_rest, tilt_for_drag
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import with_trim
from uvms_ocp.robot.thrusters import free_motions, undriven_axes

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")

HEAVE = 2


def pull(robot: Robot, q: np.ndarray) -> float:
    """Return the largest work [J] of weight and buoyancy per unit of a free motion."""
    still = np.zeros(robot.n_v)
    force = robot_dynamics(robot).inverse_dynamics(q, still, still)
    return float(np.abs(free_motions(robot)[0].T @ force).max())


@pytest.mark.parametrize("seed", [17])
def test_there_weight_and_buoyancy_do_no_more_work(seed: int, tmp_path: Path) -> None:
    """Vehicles that rise only as they roll or pitch, out of trim, were called without anything that
    holds their depth.
    """
    rng = np.random.default_rng(seed)
    robot = write_robot(drawn_body(rng), rng, tmp_path)
    assert HEAVE in undriven_axes(robot)
    q = np.array(robot.configuration())
    displacement = np.zeros(robot.n_v)
    displacement[:6] = motion_to_rest(robot, q)
    assert 0.0 < abs(displacement[HEAVE]) < 0.1
    there = pin.integrate(robot.model, q, displacement)
    assert pull(robot, there) < 0.1 * pull(robot, q)


def test_a_tilt_makes_up_for_drag_where_thrusters_do_not(tmp_path: Path) -> None:
    rng = np.random.default_rng(17)
    robot = write_robot(drawn_body(rng), rng, tmp_path)
    q = np.array(robot.configuration())
    still = np.zeros(robot.n_v)
    v = still.copy()
    v[HEAVE] = 0.05
    tilt = tilt_for_drag(robot, q, v)
    assert 0.0 < np.abs(tilt).max() < 0.1
    step = still.copy()
    step[3:5] = tilt
    motions = free_motions(robot)[0]
    dynamics = robot_dynamics(robot)
    at_rest = motions.T @ dynamics.inverse_dynamics(q, still, still)
    resisted = motions.T @ dynamics.inverse_dynamics(q, v, still) - at_rest
    tilted = motions.T @ dynamics.inverse_dynamics(pin.integrate(robot.model, q, step), v, still)
    np.testing.assert_allclose(tilted, at_rest, atol=0.05 * np.abs(resisted).max())


def test_no_tilt_makes_up_for_drag_along_what_weight_does_not_right() -> None:
    robot = robot_of(TINY["no lift"])
    v = np.zeros(robot.n_v)
    v[HEAVE] = 0.05
    assert np.isinf(tilt_for_drag(robot, np.array(robot.configuration()), v)).all()


def test_what_nothing_rights_never_comes_to_rest() -> None:
    floating = robot_of(TINY["no lift"])
    lead = TrimBody(name="lead", position=(0.0, 0.0, 0.0), mass=1.0, volume=0.0)
    heavy = with_trim(floating, [lead])
    assert np.isinf(motion_to_rest(heavy, np.array(heavy.configuration()))[HEAVE])


def test_a_vehicle_that_drives_all_axes_rests_where_it_is() -> None:
    robot = robot_of(TINY["no joints"])
    assert not motion_to_rest(robot, np.array(robot.configuration())).any()

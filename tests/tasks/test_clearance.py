"""Clearance: gradients are those of the distance, and a robot asked to go through an obstacle stops before it."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.control.kinematic import KinematicController
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission import DONE, Below, Mission, Phase, Transition
from uvms_ocp.model.clearance import FAR, ClearanceSensor
from uvms_ocp.model.robot import Robot, load_robot
from uvms_ocp.record import Record
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.sim import Environment, FlatSeafloor, Obstacle
from uvms_ocp.tasks import Clearance, Hierarchy, JointLimits, ToolPosition

COLUMN = Obstacle(name="column", shape=coal.Capsule(0.3, 4.0), X_WO=pose_at((2.2, 0.3, -5.0)))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def _measured(sensor: ClearanceSensor, robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values = sensor(q)
    nearest = len(values) // (1 + robot.n_v)
    return values[:nearest], values[nearest:].reshape(nearest, robot.n_v)


def test_gradients_are_those_of_the_distances(robot: Robot) -> None:
    sensor = ClearanceSensor(robot, [COLUMN], nearest=10_000)
    rng = np.random.default_rng(0)
    limits = robot.limits.position_lower, robot.limits.position_upper
    wrong = 0
    for _ in range(10):
        joints = np.clip(robot.home + 0.3 * rng.standard_normal(7), *limits)
        q = robot.configuration(position=(0.0, 0.0, -5.0), rpy=rng.uniform(0.1, 0.4, 3), joints=joints)
        v = rng.standard_normal(robot.n_v)
        _, gradient = _measured(sensor, robot, q)
        ahead, behind = (_measured(sensor, robot, pin.integrate(robot.model, q, h * v))[0] for h in (1e-4, -1e-4))
        error = np.abs((ahead - behind) / 2e-4 - gradient @ v)[: sensor.n_pairs]
        wrong += int((error > 1e-2).sum())
    # Witness points jump between corners of parallel faces, which few differences hit.
    assert wrong <= 0.02 * 10 * sensor.n_pairs


def test_the_nearest_pairs_come_first_and_missing_ones_are_far(robot: Robot) -> None:
    q = robot.configuration(position=(0.0, 0.0, -5.0), joints=robot.home)
    everything = ClearanceSensor(robot, [COLUMN], nearest=10_000)
    few = ClearanceSensor(robot, [COLUMN], nearest=3)
    distances, gradients = _measured(everything, robot, q)
    assert (distances[everything.n_pairs :] == FAR).all()
    assert not gradients[everything.n_pairs :].any()
    np.testing.assert_allclose(np.sort(_measured(few, robot, q)[0]), np.sort(distances)[:3])


def _scenario(robot: Robot, *, watched: bool) -> Scenario:
    """The tool is asked for a point behind the column."""
    tasks = [
        JointLimits(),
        ToolPosition(goal=pose_at((4.0, 0.35, -5.0))),
        *([Clearance(obstacles=(COLUMN,))] if watched else []),
    ]
    there = Transition(to=DONE, when=(Below(quantity="TP.position_error", limit=0.01),))
    phase = Phase(name="A", title="through", gates={task.name: 1.0 for task in tasks}, transitions=(there,))
    return Scenario(
        name="column",
        robot=robot,
        mission=Mission(hierarchy=Hierarchy(tasks), phases=(phase,)),
        environment=Environment(seafloor=FlatSeafloor(z=-20.0), obstacles=(COLUMN,)),
        start=robot.configuration(position=(-1.0, 0.0, -5.0), joints=robot.home),
        plant="kinematic",
        duration=12.0,
    )


def _least_distance(record: Record, robot: Robot) -> float:
    sensor = ClearanceSensor(robot, [COLUMN], nearest=1, self_clearance=False)
    return min(float(sensor(q)[0]) for q in record["q"][::5])


def test_the_robot_keeps_its_distance_from_an_obstacle_on_its_way(robot: Robot) -> None:
    assert _least_distance(_scenario(robot, watched=False).run(), robot) < 0.0
    record = _scenario(robot, watched=True).run()
    # The threshold is 50 mm; witness points move along edges faster than one tick's gradient tells.
    assert _least_distance(record, robot) > 0.04
    steps = np.abs(np.diff(record["command"], axis=0))
    dt = record["t"][1] - record["t"][0]
    assert (steps <= robot.limits.acceleration * dt * (1 + 1e-6)).all()
    assert all(record.meta["statuses"][code] != "inexact" for code in np.unique(record["status"]))


def test_the_sensors_of_tasks_enter_the_tick_behind_the_references(robot: Robot) -> None:
    scenario = _scenario(robot, watched=True)
    controller = scenario.controller()
    assert isinstance(controller, KinematicController)
    assert len(controller.problem.measure(scenario.start)) == 6 * (1 + robot.n_v)
    assert "CL.clearance" in controller.problem.quantity_names


def test_a_number_of_pairs_below_one_is_refused() -> None:
    with pytest.raises(InvalidInput, match="nearest = 0"):
        Clearance(nearest=0)

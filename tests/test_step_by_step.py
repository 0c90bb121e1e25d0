"""What a real robot does, tick by tick: the same as a simulation, and refused in one line where the
shapes are wrong.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.signals import Command, Reading, Readings, StateEstimate, Trust
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import DynamicPlant, SensorSuite


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return case1(noise=True, duration=0.5)


def test_stepping_by_hand_is_what_a_run_does(scenario: Scenario) -> None:
    record = scenario.run()
    robot = scenario.robot
    plant = DynamicPlant(
        robot, scenario.start, dynamics=robot_dynamics(robot), environment=scenario.environment
    )
    sensors = SensorSuite(robot, scenario.environment.seafloor, scenario.sensors, scenario.seed)
    estimator = scenario.estimator()
    controller = scenario.controller()
    command: Command | None = None
    for k, t in enumerate(record["t"]):
        estimate = estimator(sensors.read(plant.state, float(t)), float(t), command)
        command = controller(estimate, float(t))
        np.testing.assert_array_equal(command.v, record["command"][k])
        np.testing.assert_array_equal(plant.state.q, record["q"][k])
        plant.step(command, scenario.dt)
    assert controller.kinematic.state.phase == record["phase"][-1]


def test_the_kinematic_plant_gets_velocities_alone() -> None:
    scenario = case1(plant="kinematic")
    command = scenario.controller()(scenario.estimator()(Readings(), 0.0), 0.0)
    assert command.thrust is None
    assert command.v.shape == (scenario.robot.n_v,)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"q": np.zeros(5)}, r"measurement.q has shape \(5,\); give \(14,\)"),
        ({"v": np.zeros(3)}, r"measurement.v has shape \(3,\); give \(13,\)"),
        ({"q": np.zeros((14, 1))}, r"q has shape \(14, 1\); give an array"),
    ],
)
def test_wrong_shapes_are_refused_in_one_line(
    scenario: Scenario, wrong: dict[str, Any], message: str
) -> None:
    """And change nothing: the next tick goes on."""
    controller = scenario.controller()
    n_v = scenario.robot.n_v
    right: dict[str, Any] = {"q": scenario.start, "v": np.zeros(n_v), "altimeter_range": 3.0}
    with pytest.raises(InvalidInput, match=message) as refused:
        controller(StateEstimate(**right | wrong), 0.0)
    assert "\n" not in str(refused.value)
    assert controller(StateEstimate(**right), 0.0).v.shape == (n_v,)


def test_a_reading_of_a_wrong_shape_is_named_and_not_used(scenario: Scenario) -> None:
    """A driver that goes wrong at sea is a sensor that fails: no exception takes the robot's
    controller away.
    """
    estimator = scenario.estimator()
    measurement = estimator(Readings(joint_positions=Reading(value=np.zeros(2), t=0.0)), 0.0)
    channel = next(
        channel for channel in measurement.health if channel.channel == "joint_positions"
    )
    assert channel.trust is not Trust.GOOD
    assert channel.why == "a value of shape (2,) in place of (7,)"
    assert measurement.age == np.inf


def test_a_quaternion_that_is_none_counts_as_no_measurement(scenario: Scenario) -> None:
    controller = scenario.controller()
    n_v = scenario.robot.n_v
    q = scenario.start.copy()
    q[3:7] *= 2.0
    command = controller(StateEstimate(q=q, v=np.zeros(n_v), altimeter_range=3.0), 0.0)
    assert command.hold

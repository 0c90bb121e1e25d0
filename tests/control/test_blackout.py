"""Sensors that fall silent in closed loop: the robot slows down, the arm holds, and it recovers
gently.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.record.meta_values import PhaseMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.signals import IDEAL_SENSORS, Readings, State, StateEstimate
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.loop import simulate
from uvms_ocp.sim.sensors import SensorSuite

BLACKOUT = 6.0  # [s] when it begins
ALL = (
    "position",
    "depth",
    "attitude",
    "angular_velocity",
    "linear_velocity",
    "joint_positions",
    "joint_velocities",
    "altimeter_range",
)


def run(
    lost: tuple[str, ...], duration: float, back: float = math.inf
) -> tuple[Record, KinematicController]:
    """Case 1 from the start, with some channels frozen from `BLACKOUT` until `back` [s]."""
    scenario = case1()
    robot = scenario.robot
    kinematic = scenario.kinematic_controller()
    dynamics = robot_dynamics(scenario.robot)
    suite = SensorSuite(robot, scenario.environment.seafloor, IDEAL_SENSORS)
    frozen: dict[str, object] = {}

    def read(state: State, t: float) -> Readings:
        readings = suite.read(state, t)
        if t < BLACKOUT:
            frozen.update({name: getattr(readings, name) for name in lost})
            return readings
        return readings if t >= back else replace(readings, **frozen)

    recorder = simulate(
        plant=DynamicPlant(
            robot, scenario.start, dynamics=dynamics, environment=scenario.environment
        ),
        sensors=read,
        estimator=PassThrough(robot, IDEAL_SENSORS),
        controller=DynamicController(robot=robot, dynamics=dynamics, kinematic=kinematic),
        dt=scenario.dt,
        duration=duration,
    )
    meta = RunMeta(
        scenario="blackout",
        robot=robot.name,
        joints=robot.joint_names,
        phases=(PhaseMeta(name="A"),),
        plant="dynamic",
        solver="none",
        floating=True,
        dt=scenario.dt,
        completed=False,
    )
    return recorder.freeze(meta), kinematic


@pytest.mark.slow
@pytest.mark.parametrize(
    "lost", [ALL, ("linear_velocity",), ("joint_positions",), ("altimeter_range",)]
)
def test_a_robot_without_sensors_slows_down_and_holds_its_arm(lost: tuple[str, ...]) -> None:
    record, kinematic = run(lost, BLACKOUT + 6.0)
    after = record["t"] >= BLACKOUT
    speed = np.linalg.norm(record["v"][after, :3], axis=1)
    assert speed.max() <= 1.2 * speed[0]
    assert speed.min() < 0.5 * speed[0]
    assert speed[-1] < 0.7 * speed[0]
    assert np.abs(record["v"][after, 6:]).max() < 0.3
    assert np.abs(record["v"][after, 3:6]).max() < 0.1
    assert len(kinematic.watchdog.alarms) == 2


@pytest.mark.slow
def test_a_robot_recovers_gently_after_a_blackout() -> None:
    record, kinematic = run(ALL, BLACKOUT + 12.0, back=BLACKOUT + 8.0)
    after = record["t"] >= BLACKOUT + 8.0
    assert np.abs(record["v"][after, 3:6]).max() < 0.2
    assert np.abs(record["v"][after, 6:]).max() < 0.3
    assert kinematic.watchdog.alarms[-1][1] == "measurements are back: going on"


def test_a_missing_echo_counts_as_a_missing_measurement_while_altitude_matters() -> None:
    scenario = case1(plant="kinematic")
    kinematic = scenario.kinematic_controller()
    silent = StateEstimate(q=scenario.start, v=np.zeros(13), altimeter_range=math.nan)
    holds = [kinematic(silent, 0.005 * k).hold for k in range(1, 400)]
    assert not holds[50]
    assert holds[-1]

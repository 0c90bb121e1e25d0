"""What an estimator with gates of its own tells of its readings, and joints that do not do as they
are told.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from health_run import FLOOR

from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.filter_memory import NUMBER
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.estimation.health.tuning import HealthTuning
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import IDEAL_SENSORS, Command, Readings, State, StateEstimate, Trust
from uvms_ocp.sim.sensors import SensorSuite

DT = 0.01


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


class Gated(Estimator):
    """Refuses, it says, position fixes of some time."""

    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        measurement = super().__call__(readings, t, command)
        fix = readings.position
        self.outcomes[:] = math.nan
        if fix is not None:
            self.outcomes[NUMBER["position"]] = fix.t, 75.0, 3.0, not 2.0 <= fix.t < 5.0
        return measurement


def test_readings_that_the_filter_refuses_make_a_channel_suspect_then_lost_and_good_again(
    robot: Robot,
) -> None:
    suite = SensorSuite(robot, FLOOR)
    guard = GuardedEstimator(Gated(robot), robot)
    state = State(q=robot.configuration(position=(0, 0, -36)), v=np.zeros(robot.n_v))
    trust = {}
    for k in range(800):
        measurement = guard(suite.read(state, k * DT), k * DT)
        trust[round(k * DT, 2)] = next(h for h in measurement.health if h.channel == "position")
    assert trust[1.9].trust is Trust.GOOD
    assert trust[2.5].trust is Trust.SUSPECT
    assert trust[2.5].why == "5 times the innovation expected"
    assert trust[4.5].trust is Trust.LOST
    assert trust[7.0].trust is Trust.GOOD
    assert {h.channel for h in measurement.health if h.trust is not Trust.GOOD} == set()


@pytest.mark.parametrize("ideal", [True, False])
def test_encoders_that_stand_still_while_joints_are_asked_to_move_are_frozen(
    robot: Robot, ideal: bool
) -> None:
    specs = {"specs": IDEAL_SENSORS} if ideal else {}
    suite = SensorSuite(robot, FLOOR, **specs)
    inner = PassThrough(robot) if ideal else Estimator(robot)
    guard = GuardedEstimator(inner, robot, **specs)
    requested = np.zeros(robot.n_v)
    requested[robot.joint_v] = 0.2
    state = State(q=robot.configuration(position=(0, 0, -36)), v=np.zeros(robot.n_v))
    first = None
    for k in range(60):
        readings = suite.read(state, k * DT)
        first = first or readings
        assert first.joint_positions is not None
        frozen = replace(first.joint_positions, t=k * DT)
        measurement = guard(replace(readings, joint_positions=frozen), k * DT, Command(v=requested))
    health = {h.channel: h for h in measurement.health}["joint_positions"]
    assert health.trust is not Trust.GOOD
    assert "joint1 does not change while" in health.why
    assert measurement.joint_age > 0.3


def test_locked_joints_are_not_asked_to_move(robot: Robot) -> None:
    suite = SensorSuite(robot, FLOOR, IDEAL_SENSORS)
    guard = GuardedEstimator(PassThrough(robot), robot, IDEAL_SENSORS)
    state = State(q=robot.configuration(position=(0, 0, -36)), v=np.zeros(robot.n_v))
    for k in range(100):
        guard(suite.read(state, k * DT), k * DT, Command(v=np.full(robot.n_v, 0.2), brakes=True))
    assert guard.monitor.alarms == []


def test_nothing_but_nonsense_from_the_start_gives_no_measurement_and_no_end(robot: Robot) -> None:
    suite = SensorSuite(robot, FLOOR, IDEAL_SENSORS)
    guard = GuardedEstimator(PassThrough(robot), robot, IDEAL_SENSORS)
    state = State(q=robot.configuration(position=(0, 0, -36)), v=np.zeros(robot.n_v))
    for k in range(50):
        readings = suite.read(state, k * DT)
        assert readings.attitude is not None
        bad = replace(readings.attitude, value=np.zeros(4)) if k < 40 else readings.attitude
        measurement = guard(replace(readings, attitude=bad), k * DT)
        assert (measurement.age == math.inf) == (k < 40)
    assert guard.monitor.alarms[0][1] == "attitude suspect: a quaternion of length 0"


@pytest.mark.parametrize("name", HealthTuning.__slots__)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_wrong_tunings_of_the_monitor_are_refused_in_one_line(name: str, value: float) -> None:
    with pytest.raises(InvalidInput, match=name) as error:
        HealthTuning(**{name: value})
    assert "\n" not in str(error.value)

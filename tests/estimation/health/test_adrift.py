"""A velocity that nothing tells any more is not carried on for ever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.filter_memory import Part
from uvms_ocp.robot.signals import State
from uvms_ocp.scenario.cases import case1
from uvms_ocp.sim import SensorSuite

# [s]
SILENCE = 3.0
END = 13.0
DT = 1 / 50


def test_without_fixes_and_dvl_an_acceleration_that_was_wrong_leads_nowhere() -> None:
    """Carried on, 2 m/s2 would be 20 m/s after ten seconds, from where no fix is believed again."""
    scenario = case1(noise=True, dt=DT)
    robot = scenario.robot
    estimator = scenario.estimator()
    inner = estimator.estimator
    assert isinstance(inner, Estimator)
    sensors = SensorSuite(robot, scenario.environment.seafloor, scenario.sensors, seed=3)
    at_rest = State(q=scenario.start, v=np.zeros(robot.n_v), a=np.zeros(robot.n_v))
    speeds = list[float]()
    is_present = True
    for k in range(round(END / DT)):
        t = k * DT
        is_present = k * DT < SILENCE
        readings = sensors.read(at_rest, t)
        measurement = estimator(
            readings if is_present else replace(readings, position=None, linear_velocity=None), t
        )
        if is_present:
            inner.memory.x[Part.ACCELERATION : Part.SPIN] = 2.0, 0.0, 0.0
        speeds.append(float(np.linalg.norm(measurement.v[:3])))
    assert max(speeds) < 4.0
    assert speeds[-1] < 1.0
    back = [
        estimator(sensors.read(at_rest, END + k * DT), END + k * DT) for k in range(round(5.0 / DT))
    ][-1]
    assert np.linalg.norm(back.q[:3] - scenario.start[:3]) < 0.1

"""Readings that are taken for the truth go through the monitor in one kernel: the same comes of it
as of two.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from corruptors import told_on_a_way
from health_run import FLOOR

from uvms_ocp.codegen.kernel_layout import assign
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import IDEAL_SENSORS, Command, Readings, SensorSpec, StateEstimate
from uvms_ocp.sim.sensors import SensorSuite

SPECS = replace(
    IDEAL_SENSORS, joint_positions=SensorSpec(rate=50.0), position=SensorSpec(rate=5.0, delay=0.1)
)


class InOneKernel:
    """Guarded pass-through whose ticks are one kernel, as in the compiled loop, once every channel
    has been read.
    """

    def __init__(self, robot: Robot) -> None:
        self.guard = GuardedEstimator(PassThrough(robot, SPECS), robot, SPECS)
        self._complete = False

    def __call__(self, readings: Readings, t: float, command: Command) -> StateEstimate:
        if not self._complete:
            estimate = self.guard(readings, t, command)
            self._complete = estimate.age < np.inf
            return estimate
        monitor = self.guard.monitor
        memory = self.guard.monitor.memory
        monitor.take_in(readings)
        memory.tick_t = t
        memory.moving = monitor._is_moved(command)
        monitor.ticks[2](memory, self.guard.support, self.guard.repeated)
        monitor.screened(readings)
        if memory.n_changed:
            monitor.publish(t)
        return self.guard.estimate()


def _told(in_one: bool, channel: str, defect: str) -> tuple[list[StateEstimate], HealthMonitor]:
    """What is measured of a robot on its way, with a defect after a while."""
    robot = load_robot("girona_maris7")
    kernel_run = InOneKernel(robot)
    suite = SensorSuite(robot, FLOOR, SPECS)
    return told_on_a_way(
        kernel_run if in_one else kernel_run.guard, robot, suite, channel, defect
    ), kernel_run.guard.monitor


@pytest.mark.parametrize("defect", ["jump", "nan", "frozen", "late"])
@pytest.mark.parametrize(
    "channel", ["position", "attitude", "joint_positions", "linear_velocity", "altimeter_range"]
)
def test_one_kernel_tells_what_two_do(channel: str, defect: str) -> None:
    (once, watched), (twice, watched_too) = (
        _told(in_one, channel, defect) for in_one in (True, False)
    )
    assert watched.alarms == watched_too.alarms
    for monitor in (watched, watched_too):
        assign(monitor.memory, tick_t=0.0, moving=False, n_changed=0)  # which only kernels read
    assert bytes(watched.memory) == bytes(watched_too.memory)
    for a, b in zip(once, twice, strict=True):
        _require_same(a, b)


def _require_same(a: StateEstimate, b: StateEstimate) -> None:
    np.testing.assert_array_equal(a.q, b.q)
    np.testing.assert_array_equal(a.v, b.v)
    np.testing.assert_array_equal(a.altimeter_range, b.altimeter_range)
    told: list[Any] = [(m.age, m.oldest, m.joint_age, m.health, m.std) for m in (a, b)]
    assert told[0] == told[1]


def test_a_measurement_is_not_changed_by_the_next() -> None:
    told, _ = _told(True, "depth", "jump")
    assert len({m.q[0] for m in told}) > 10

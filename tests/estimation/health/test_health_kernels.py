"""What the monitor computes, in C as in Python, and the parts of it that have a law of their
own.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np
import pytest
from compiler import needs_compiler
from corruptors import STEPS, told_on_a_way

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.health.floor import (
    MAX_FLOOR_POINTS,
    FloorPoint,
    FloorPoints,
    append_floor_point,
    floor_step,
    forget_older,
    height_allowance,
    keep_alone,
    slot_of,
)
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.estimation.health.plausibility import (
    EstimateHistory,
    angle_between,
    remember,
    rotate as turn,
    slot_at,
    small_rotation,
)
from uvms_ocp.estimation.health.redundancy import (
    SampleRing,
    append_value,
    mean_time,
    median_of,
    value_at,
)
from uvms_ocp.estimation.vehicle_model import multiply
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpecs
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


def _guarded(
    robot: Robot, channel: str, defect: str, *, compiled: bool
) -> tuple[HealthMonitor, list[Any]]:
    """A robot that moves on straight, with a defect after a while."""
    monitor = HealthMonitor(robot, compiled=compiled)
    guard = GuardedEstimator(Estimator(robot), robot, monitor=monitor)
    suite = SensorSuite(robot, FlatSeafloor(z=-40.0), SensorSpecs(), seed=4)
    return monitor, told_on_a_way(guard, robot, suite, channel, defect)


CASES = dict(zip(STEPS, ["jump", "bias", "late", "nan", "bias", "frozen", "jump"], strict=True))


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize(("channel", "defect"), CASES.items(), ids=CASES)
def test_c_and_python_tell_the_same(robot: Robot, channel: str, defect: str) -> None:
    (in_c, told), (in_python, same) = (
        _guarded(robot, channel, defect, compiled=compiled) for compiled in (True, False)
    )
    assert in_c.alarms == in_python.alarms
    assert in_c.alarms
    assert bytes(in_c.memory) == bytes(in_python.memory)
    for a, b in zip(told, same, strict=True):
        assert (a.age, a.oldest, a.joint_age, a.health) == (b.age, b.oldest, b.joint_age, b.health)


def _array(values: np.ndarray) -> Any:
    return (ctypes.c_double * len(values))(*values)


@pytest.mark.parametrize("dt", [0.001, 0.005, 0.1])
def test_the_estimate_nearest_to_a_time_is_found_for_as_long_as_any_reading_takes(
    dt: float,
) -> None:
    structure = structure_of(EstimateHistory, n_q=1, n_v=1, n_estimates=256)
    history = structure()
    add, find = bind_kernels((remember, slot_at), (structure, type(history.kept[0])))
    history.length = 2.0
    history.spacing = 2.0 / 254
    assert find(history, 0.0) == -1
    times = dt * np.arange(round(5.0 / dt))
    for t in times:
        estimate = type(history.kept[0])(t=t)
        estimate.q[0] = 10.0 * t
        add(history, estimate)
    finest = max(dt, history.spacing)
    for t in np.linspace(3.0, 4.99, 97):
        nearest = history.kept[find(history, t)]
        assert abs(nearest.t - t) <= 0.5 * finest + dt
        assert nearest.q[0] == 10.0 * nearest.t
    assert history.kept[find(history, 9.0)].t == times[-1]
    assert history.kept[find(history, 0.0)].t >= times[-1] - 2.0


def test_a_trail_has_the_medians_means_and_values_of_numpy() -> None:
    structure = structure_of(SampleRing)
    draw = np.random.default_rng(0)
    trail = structure()
    t = np.cumsum(draw.random(150))
    x = draw.normal(size=150)
    add, median, mean, value = bind_kernels(
        (append_value, median_of, mean_time, value_at), (structure,)
    )
    for time, number in zip(t, x, strict=True):
        add(trail, time, _array(np.array([0.0, number])), 2)
    t = t[-64:]
    x = x[-64:]
    for start, n in ((0, 1), (3, 12), (40, 24), (0, 64), (5, 7)):
        assert median(trail, 1, start, n) == pytest.approx(
            np.median(x[start : start + n]), rel=1e-14
        )
        assert mean(trail, start, n) == pytest.approx(t[start : start + n].mean(), rel=1e-14)
    for at in np.linspace(t[0] - 1.0, t[-1] + 1.0, 57):
        assert value(trail, 1, at) == pytest.approx(np.interp(at, t, x), rel=1e-12)


def test_turns_are_those_of_rotation_matrices() -> None:
    product, turn_by, rotate, angle = bind_kernels(
        (multiply, small_rotation, turn, angle_between), ()
    )
    by, more, out, vector = (_array(np.zeros(n)) for n in (4, 4, 4, 3))
    turn_by(_array(np.array([0.01, 0.0, 0.0])), 1.0, by)
    turn_by(_array(np.array([0.01, 0.0, 0.0])), -2.0, more)
    product(by, more, out)
    assert angle(by, out) == pytest.approx(0.02, rel=1e-4)
    quarter = _array(np.array([0.0, 0.0, 0.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]))
    rotate(quarter, _array(np.array([1.0, 2.0, 3.0])), vector)
    np.testing.assert_allclose(vector, [-2.0, 1.0, 3.0], atol=1e-15)


def test_spots_beyond_those_that_fit_push_the_oldest_out_and_one_is_never_forgotten() -> None:
    structure = structure_of(FloorPoints)
    spot = structure_of(FloorPoint)
    add, older, place, keep = bind_kernels(
        (append_floor_point, forget_older, slot_of, keep_alone), (structure, spot)
    )
    spots = structure()
    for t in range(200):
        add(spots, spot(t=float(t)))
    assert [spots.kept[place(spots, k)].t for k in range(spots.count)] == list(
        range(200 - MAX_FLOOR_POINTS, 200)
    )
    older(spots, 190.0)
    assert [spots.kept[place(spots, k)].t for k in range(spots.count)] == list(range(190, 200))
    older(spots, 1000.0)
    assert (spots.count, spots.kept[spots.first].t) == (1, 199.0)
    keep(spots, spot(t=300.0))
    assert (spots.count, spots.kept[spots.first].t) == (1, 300.0)


def test_a_floor_may_rise_with_the_way_and_more_along_a_beam_that_tilts() -> None:
    structure = structure_of(FloorPoints)
    spot = structure_of(FloorPoint)
    add, step, may = bind_kernels(
        (append_floor_point, floor_step, height_allowance), (structure, spot)
    )
    spots = structure()
    old = spot(x=0.0, z=-40.0, sensor_z=-36.0)
    add(spots, old)
    for x, z, sensor_x, rise in [
        (1.0, -39.1, 1.0, 0.0),
        (1.0, -37.9, 1.0, 2.1),
        (0.0, -40.05, 0.0, 0.0),
        (0.0, -41.0, 0.0, -1.0),
    ]:
        assert step(
            spots, spot(x=x, z=z, sensor_x=sensor_x, sensor_z=-36.0), 0.1, 1.0
        ) == pytest.approx(rise)
    straight, tilted = (spot(x=2.0, z=-42.0, sensor_x=x, sensor_z=-36.0) for x in (2.0, 1.0))
    assert may(straight, old, 1.0) == pytest.approx(2.0)
    assert may(tilted, old, 1.0) > 2.0 * (1.0 + 4.0 / 6.0) / 2.0

"""What the filter expects of each sensor of the vehicle is what the state says, and its slopes are
those of that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import uvms_ocp as uo
from uvms_ocp.codegen.kernel_layout import view
from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.filter_memory import MAIN, ChannelIndex, Part
from uvms_ocp.estimation.health import screening
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.estimation.measurement_update import _set_floor
from uvms_ocp.estimation.vehicle_model import predict_measurement, turn_by
from uvms_ocp.robot.signals import SensorSpecs

CHANNELS = [
    c
    for c in ChannelIndex
    if c not in (ChannelIndex.JOINT_POSITIONS, ChannelIndex.JOINT_VELOCITIES)
]
ROWS = {ChannelIndex.DEPTH: 1, ChannelIndex.ALTIMETER_RANGE: 1}


@pytest.fixture(scope="module")
def memory() -> Any:
    """Memory of a filter."""
    return Estimator(uo.load_robot("bluerov2_alpha5"), SensorSpecs()).structure


def _tilt(m: Any, seed: int) -> None:
    """A tilted, moving vehicle, whose altimeter stands beside its origin and leans."""
    rng = np.random.default_rng(seed)
    turn = pin.rpy.rpyToMatrix(np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-3, 3)]))
    view(m.turn)[:] = pin.Quaternion(turn).coeffs()
    view(m.x)[:MAIN] = rng.normal(size=MAIN)
    m.x[Part.PLACE + 2] += 5.0
    view(m.beam_at)[:] = [0.4, -0.3, -0.1]
    view(m.beam_up)[:] = pin.rpy.rpyToMatrix(0.2, -0.3, 0.0)[:, 2]


def _expected(m: Any, c: ChannelIndex) -> np.ndarray:
    predict_measurement(m, c, MAIN)
    h = np.array(m.predicted.h)
    return h[:1] / h[1] if c == ChannelIndex.ALTIMETER_RANGE else h[: ROWS.get(c, 3)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "channel", [c for c in CHANNELS if c != ChannelIndex.ATTITUDE], ids=lambda c: c.name
)
def test_slopes_are_those_of_what_is_expected(
    channel: ChannelIndex, seed: int, memory: Any
) -> None:
    step = 1e-6
    m = memory
    _tilt(m, seed)
    _expected(m, channel)
    n = ROWS.get(channel, 3)
    slopes = np.array([list(row) for row in m.predicted.H])[:n, :MAIN]
    if channel == ChannelIndex.ALTIMETER_RANGE:
        slopes = slopes / m.predicted.h[1]
    for i in range(MAIN):
        predictions = []
        for sign in (-1.0, 1.0):
            _tilt(m, seed)
            if i < Part.PLACE:
                by = [0.0, 0.0, 0.0]
                by[i] = sign * step
                turn_by(m.turn, by)
            else:
                m.x[i] += sign * step
            predictions.append(_expected(m, channel))
        np.testing.assert_allclose(
            slopes[:, i], (predictions[1] - predictions[0]) / (2 * step), atol=1e-7
        )


@pytest.mark.parametrize("seed", range(3))
def test_the_range_is_along_the_beam_from_where_the_altimeter_is(seed: int, memory: Any) -> None:
    m = memory
    _tilt(m, seed)
    X_WB = pin.SE3(pin.Quaternion(np.array(m.turn)), np.array(m.x)[Part.PLACE : Part.SPEED])
    altimeter = X_WB.act(np.array(m.beam_at))
    up = X_WB.rotation @ np.array(m.beam_up)
    distance = _expected(m, ChannelIndex.ALTIMETER_RANGE)[0]
    assert (altimeter - distance * up)[2] == pytest.approx(m.x[Part.FLOOR], abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_first_echo_puts_the_floor_where_it_came_from(seed: int, memory: Any) -> None:
    m = memory
    c = ChannelIndex.ALTIMETER_RANGE
    _tilt(m, seed)
    predict_measurement(m, c, MAIN)
    m.value[c][0] = 4.0
    _set_floor(m, 0.0, MAIN)
    assert _expected(m, c)[0] == pytest.approx(4.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_monitor_places_an_echo_on_the_beam_of_a_tilted_vehicle(seed: int, memory: Any) -> None:
    _tilt(memory, seed)
    m = HealthMonitor(uo.load_robot("bluerov2_alpha5"), SensorSpecs(), compiled=False).memory
    view(m.now.q)[:7] = [*view(memory.x)[Part.PLACE : Part.SPEED], *view(memory.turn)]
    view(m.now.beam_at)[:] = memory.beam_at
    view(m.now.beam_up)[:] = memory.beam_up
    channel = m.channels[ChannelIndex.ALTIMETER_RANGE]
    point = m.floor.here
    channel.value[0] = 4.0
    screening._is_floor(m, channel, m.now, m.belief.why)
    X_WB = pin.XYZQUATToSE3(np.array(m.now.q[:7]))
    sensor = X_WB.act(np.array(m.now.beam_at))
    up = X_WB.rotation @ np.array(m.now.beam_up)
    np.testing.assert_allclose([point.sensor_x, point.sensor_y, point.sensor_z], sensor, atol=1e-12)
    np.testing.assert_allclose([point.x, point.y, point.z], sensor - 4.0 * up, atol=1e-12)

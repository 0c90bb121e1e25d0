"""By how much a fix that surprises inflates the covariance of what it may contradict."""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest

from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.estimation.filter_memory import (
    ChannelIndex,
    FilterMemory,
    Part,
    filter_memory,
    pushed_time,
)
from uvms_ocp.estimation.measurement_update import _inflate_surprised, time_since_accepted
from uvms_ocp.estimation.tuning import SLOW_TICK, SLOWEST_TICK

SQUARED = 4.0  # [m2] of the innovation
NOW = 10.0  # [s]


@pytest.mark.parametrize(("last_velocity", "shaken"), [(9.9, 8.0), (8.0, -math.inf), (8.0, 8.0)])
def test_a_surprise_is_in_the_velocity_once(last_velocity: float, shaken: float) -> None:
    """Where a DVL had surprised and fell silent it was in it twice. It has made the place off by as
    much, over the time since the last fix.
    """
    memory = filter_memory(0)
    inflate, time_since = bind_kernels((_inflate_surprised, time_since_accepted), (type(memory),))
    fix = int(ChannelIndex.POSITION)
    for slot in range(len(memory.owner)):
        memory.owner[slot] = -1.0
    memory.recovery[fix] = 1.0
    memory.stamp[fix] = NOW
    memory.used[fix] = 9.0
    memory.used[ChannelIndex.LINEAR_VELOCITY] = last_velocity
    memory.shaken = shaken
    innovation = (ctypes.c_double * 3)(math.sqrt(SQUARED), 0.0, 0.0)
    inflate(memory, fix, SQUARED, innovation)
    variance = np.array([memory.P[i][i] for i in range(int(Part.PLACE), int(Part.SPEED) + 3)])
    speed = SQUARED / time_since(memory, fix) ** 2
    np.testing.assert_allclose(variance, [SQUARED] * 3 + [speed] * 3, rtol=1e-12)


TICK = 0.05  # [s] of a slow loop
PUSH = 30.0  # [rad/s2] that a thruster gives
TURNED = 0.04  # [rad] in one tick
RATE = 2.0 * TURNED / TICK  # [rad/s] by then
ATTITUDE = int(ChannelIndex.ATTITUDE)
GYRO = int(ChannelIndex.ANGULAR_VELOCITY)


def pushed_memory(attitude_used: float) -> FilterMemory:
    """Return the memory of a slow loop at NOW, in which a prompt gyro shows a turn that has begun since
    the last tick; attitude_used [s] is the time of the last attitude that was believed.
    """
    memory = filter_memory(0)
    for slot in range(len(memory.owner)):
        memory.owner[slot] = -1.0
    memory.dt = TICK
    memory.now = NOW
    for channel in (ATTITUDE, GYRO):
        memory.push[channel] = PUSH
        memory.recovery[channel] = 1.0
        memory.stamp[channel] = NOW
        memory.used[channel] = NOW - TICK
    memory.used[ATTITUDE] = attitude_used
    memory.fresh[GYRO] = 1.0
    memory.value[GYRO][0] = RATE
    return memory


def bias_after(memory: FilterMemory, channel: int, surprise: float) -> float:
    """Return the variance [rad2/s2] of the bias of the gyro once a channel has surprised."""
    (inflate,) = bind_kernels((_inflate_surprised,), (type(memory),))
    inflate(memory, channel, surprise**2, (ctypes.c_double * 3)(surprise, 0.0, 0.0))
    return float(memory.P[int(Part.GYRO_BIAS)][int(Part.GYRO_BIAS)])


def test_a_turn_that_attitude_and_gyro_show_is_no_bias_of_the_gyro() -> None:
    memory = pushed_memory(NOW - TICK)
    assert bias_after(memory, ATTITUDE, TURNED) == 0.0
    assert memory.P[int(Part.SPIN)][int(Part.SPIN)] > 0.0


@pytest.mark.parametrize(("age", "is_bias"), [(0.0, False), (TICK, False), (10.0 * TICK, True)])
def test_an_attitude_of_long_ago_does_not_vouch_for_the_gyro(age: float, is_bias: bool) -> None:
    memory = pushed_memory(NOW - age)
    memory.surprise[ATTITUDE] = TURNED
    assert (bias_after(memory, GYRO, RATE) > 0.0) == is_bias


def test_what_a_thruster_is_granted_grows_with_the_tick_without_a_step() -> None:
    """Ticks of 20 ms that jitter were granted 20 ms at times and nothing at others."""
    ticks = np.arange(0.0, 0.1, 1e-4)
    (pushed,) = bind_kernels((pushed_time,), ())
    granted = np.array([pushed(tick) for tick in ticks])
    assert (granted[ticks <= SLOW_TICK] == 0.0).all()
    assert (np.diff(granted) >= 0.0).all()
    assert np.diff(granted).max() <= 4e-4
    assert granted[ticks <= 1.05 * SLOW_TICK].max() <= 0.2 * SLOW_TICK
    is_slow = ticks >= 1.5 * SLOW_TICK
    np.testing.assert_allclose(granted[is_slow], np.minimum(ticks[is_slow], SLOWEST_TICK))

"""By how much a fix that surprises inflates the covariance of what it may contradict."""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest

from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.estimation.filter_memory import ChannelIndex, Part, filter_memory
from uvms_ocp.estimation.measurement_update import _inflate_surprised, time_since_accepted

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

"""What no reading of a working sensor can be: not a number, of another size, from the future."""

from __future__ import annotations

import math

from uvms_ocp.control.navigation.filter.memory import Channel
from uvms_ocp.control.navigation.health.reasons import Reason, Why, give
from uvms_ocp.functions.kernels.layout import Vector

_UNIT = 1e-3  # by which the norm of a quaternion may differ from 1, as in records


def is_nonsense(channel: int, value: Vector, size: int, why: Why) -> bool:
    """Whether a value of size [-] numbers means nothing. A range that is nan is no echo."""
    if channel == Channel.ALTIMETER_RANGE and value[0] < 0.0:
        give(why, Reason.RANGE, value[0], 0.0)
        return True
    for i in range(size):
        if not math.isfinite(value[i]) and not (channel == Channel.ALTIMETER_RANGE and math.isnan(value[i])):
            give(why, Reason.NO_NUMBER, 0.0, 0.0)
            return True
    return channel == Channel.ATTITUDE and _is_no_rotation(value, why)


def is_mistimed(stamp: float, last: float, t: float, clock: float, why: Why) -> bool:
    """Whether a time stamp [s] cannot be, after the `last` [s] one that was used and at time t [s]; clock [s] of grace."""
    if stamp > t + clock:
        give(why, Reason.FUTURE, stamp - t, 0.0)
    elif stamp < last:
        give(why, Reason.BEFORE, last - stamp, 0.0)
    return stamp > t + clock or stamp < last


def _is_no_rotation(value: Vector, why: Why) -> bool:
    squared = value[0] * value[0] + value[1] * value[1] + value[2] * value[2] + value[3] * value[3]
    if abs(squared - 1.0) <= 2.0 * _UNIT:
        return False
    give(why, Reason.LENGTH, math.sqrt(squared), 0.0)
    return True

"""Less than the hierarchy asks for: slower, no descent, the arm held; never by more than the acceleration limits allow.

Kernels. Slower keeps the direction, and so all priorities; joints that are held brake as fast as they can; what sinks is
lifted straight up.
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.control.navigation.degraded import RestrictionMemory
from uvms_ocp.control.navigation.last_known import EchoMemory
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, zeros

_STILL = 1e-12  # [m/s, rad/s]


class RestraintMemory(Layout):
    """What of the robot it depends on."""

    step: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] largest change in one tick."""
    is_joint: Annotated[list[int], Sized("n_v")]
    """(n_v,) which axes are joints."""
    has_vehicle: bool
    """The first six axes are those of one."""


def restrain(
    m: RestraintMemory, less: RestrictionMemory, beam: EchoMemory, q: Vector, previous: Vector, pace: float, v: Vector
) -> float:
    """Makes of the velocity v [m/s, rad/s] that is wanted the one for this tick, and returns the pace [-] that it is at.

    q [m, rad]: now. previous [m/s, rad/s]: of the tick before, which was at `pace` [-] of what was wanted then.
    """
    found = _pace(m, less.speed, v, previous, pace)
    for i in range(len(m.step)):
        v[i] = 0.0 if less.joints_held and m.is_joint[i] != 0 else found * v[i]
    _within(m, v, previous)
    if less.no_descent and m.has_vehicle:
        _lift(beam, q, v, len(m.step))
        _within(m, v, previous)
    return found


def _pace(m: RestraintMemory, speed: float, wanted: Vector, previous: Vector, pace: float) -> float:
    """As near to the speed as the acceleration limits let it come in this tick; they always let it stay where it is."""
    low, high = 0.0, 1.0
    for i in range(len(m.step)):
        if abs(wanted[i]) > _STILL:
            down, up = (previous[i] - m.step[i]) / wanted[i], (previous[i] + m.step[i]) / wanted[i]
            low = max(low, min(down, up))
            high = min(high, max(down, up))
    return min(max(speed, min(low, pace)), max(high, pace))


def _within(m: RestraintMemory, v: Vector, previous: Vector) -> None:
    for i in range(len(m.step)):
        v[i] = min(max(v[i], previous[i] - m.step[i]), previous[i] + m.step[i])


def _lift(beam: EchoMemory, q: Vector, v: Vector, n: int) -> None:
    """Neither vehicle nor altimeter sinks."""
    x, y, z, w = q[3], q[4], q[5], q[6]
    up = zeros(3)
    up[0] = 2.0 * z * x - 2.0 * y * w
    up[1] = 2.0 * z * y + 2.0 * x * w
    up[2] = 1.0 - (2.0 * x * x + 2.0 * y * y)
    rise = up[0] * v[0] + up[1] * v[1] + up[2] * v[2]
    if beam.exists:
        sensor = 0.0
        for i in range(n):
            sensor += beam.climb[i] * v[i]
        rise = min(rise, sensor)
    for i in range(3):
        v[i] += up[i] * max(0.0, -rise)

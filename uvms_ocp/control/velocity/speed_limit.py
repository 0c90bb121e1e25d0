"""Restrict the velocity of the hierarchy in degraded modes: slower, no descent, the arm held; never
by more than the acceleration limits allow.

Kernels. A slower velocity keeps its direction, and so all priorities; joints that are held brake as
fast as they can; a velocity that sinks is lifted straight up.
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros
from uvms_ocp.estimation.degraded_modes import RestrictionMemory
from uvms_ocp.estimation.fallbacks import AltimeterMemory
from uvms_ocp.solvers.bounded_least_squares import dot

_ZERO_SPEED = 1e-12  # [m/s, rad/s]


class SpeedLimitMemory(Layout):
    """Axes of the robot, and how much each velocity can change in a tick."""

    step: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] largest change in one tick."""
    is_joint: Annotated[list[int], Sized("n_v")]
    """(n_v,) 1 for axes of joints."""
    has_vehicle: bool
    """True where the first six axes are those of a vehicle."""


def limit_speed(
    speed_limit: SpeedLimitMemory,
    restriction: RestrictionMemory,
    altimeter: AltimeterMemory,
    q: Vector,
    previous: Vector,
    pace: float,
    v: Vector,
) -> float:
    """Restrict v [m/s, rad/s], which is the hierarchy's velocity at first; return the pace, its
    share of the hierarchy's speed.

    q (n_q,) [m, rad]: present configuration. previous (n_v,) [m/s, rad/s]: velocity of the tick
    before, which was `pace` times the hierarchy's.
    """
    pace_taken = _pace(speed_limit, restriction.speed, v, previous, pace)
    for i in range(len(speed_limit.step)):
        if restriction.joints_held and speed_limit.is_joint[i] != 0:
            v[i] = 0.0
        else:
            v[i] = pace_taken * v[i]
    _within(speed_limit, v, previous)
    if restriction.no_descent and speed_limit.has_vehicle:
        _lift(altimeter, q, v, len(speed_limit.step))
        _within(speed_limit, v, previous)
    return pace_taken


def _pace(
    speed_limit: SpeedLimitMemory, speed: float, desired: Vector, previous: Vector, pace: float
) -> float:
    """Return the share of the desired velocity that is nearest to `speed` and within reach of this
    tick's acceleration; to keep the pace is always allowed.
    """
    low = 0.0
    high = 1.0
    for i in range(len(speed_limit.step)):
        if abs(desired[i]) > _ZERO_SPEED:
            down = (previous[i] - speed_limit.step[i]) / desired[i]
            up = (previous[i] + speed_limit.step[i]) / desired[i]
            low = max(low, min(down, up))
            high = min(high, max(down, up))
    return min(max(speed, min(low, pace)), max(high, pace))


def _within(speed_limit: SpeedLimitMemory, v: Vector, previous: Vector) -> None:
    """Keep v within the largest change of one tick from the previous velocity."""
    for i in range(len(speed_limit.step)):
        v[i] = min(max(v[i], previous[i] - speed_limit.step[i]), previous[i] + speed_limit.step[i])


def _lift(altimeter: AltimeterMemory, q: Vector, v: Vector, n: int) -> None:
    """Lift the velocity so that neither vehicle nor altimeter sinks."""
    x = q[3]
    y = q[4]
    z = q[5]
    w = q[6]
    up = zeros(3)
    up[0] = 2.0 * z * x - 2.0 * y * w
    up[1] = 2.0 * z * y + 2.0 * x * w
    up[2] = 1.0 - (2.0 * x * x + 2.0 * y * y)
    rise = up[0] * v[0] + up[1] * v[1] + up[2] * v[2]
    if altimeter.exists:
        rise = min(rise, dot(altimeter.height_jacobian, v, n))
    for i in range(3):
        v[i] += up[i] * max(0.0, -rise)

"""Speeds of approach: towards a limit no faster than the robot can stop before it, and towards a goal
no faster than the task allows.
"""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import is_symbolic
from uvms_ocp.robot.spatial import Array

ENDLESS = 1e6
"""[m, rad; 1/s^2 of each] Stands in for what has no limit, such as an acceleration or a reach: its
product with 0 is 0.
"""


def approach_speed(
    distance: ca.SX, *, gain: float, deceleration: float | ca.SX, dt: float, saturation: float
) -> ca.SX:
    """Compute the largest speed towards a limit that is `distance` away; negative (retreat) where the limit is
    already passed.

    The smaller of a velocity damper ``gain * distance`` and the speed from which a full stop at
    `deceleration` still fits: in sampled time the stop after speed s takes at most ``s dt + s^2 /
    (2 a)``. If s keeps that inequality, s - a dt keeps it one tick later, so a hierarchy with
    acceleration limits on top can always obey.

    distance [m or rad] any shape; gain [1/s]; deceleration [m/s2 or rad/s2]; dt [s]; saturation
    [m/s or rad/s] caps both directions.
    """
    damper = ca.fmin(ca.fmax(gain * distance, -saturation), saturation)
    return ca.fmin(damper, stopping_speed(distance, deceleration=deceleration, dt=dt))


def stopping_speed(distance: Array, *, deceleration: Array, dt: float) -> Array:
    """Compute the largest speed from which a full stop within `distance` is possible in sampled time; 0
    beyond the limit.

    Of expressions, or of arrays: distance (..., m) [m or rad]; deceleration (m,) [m/s2 or rad/s2];
    dt [s].
    """
    sqrt: Any
    larger: Any
    smaller: Any
    if is_symbolic(distance, deceleration):
        sqrt, larger, smaller = ca.sqrt, ca.fmax, ca.fmin
    else:
        sqrt, larger, smaller = np.sqrt, np.maximum, np.minimum
    deceleration = larger(smaller(deceleration, ENDLESS), 1 / ENDLESS)
    return deceleration * (sqrt(dt**2 + 2 * larger(distance, 0) / deceleration) - dt)


def saturate(x: ca.SX, limit: float) -> ca.SX:
    """Scale `x` so that its norm is at most `limit` [unit of x]; the direction is kept."""
    return x * limit / ca.fmax(ca.norm_2(x), limit)


def row_acceleration(J: ca.SX, limit: np.ndarray) -> ca.SX:
    """Compute the largest rate of change (m,) of ``J v`` along each row's own gradient: there the
    first axis reaches its limit (n_v,) [m/s2, rad/s2].
    """
    shares_of_limits = ca.fabs(J) @ ca.diag(ca.DM(1 / limit))
    effort = functools.reduce(ca.fmax, ca.horzsplit(shares_of_limits))
    return ca.sum2(J**2) / ca.fmax(effort, 1 / ENDLESS)

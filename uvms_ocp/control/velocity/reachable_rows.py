"""References that the acceleration limits can follow, so that tasks change smoothly in a strict
hierarchy.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from uvms_ocp.control.velocity import jerk_limit
from uvms_ocp.solvers.hierarchy.level import widen_bounds
from uvms_ocp.tasks.approach_speed import ENDLESS, row_acceleration
from uvms_ocp.tasks.task import Rows, TickSymbols


def reachable_rows(
    rows: Rows, *, equality: bool, eased: bool, symbols: TickSymbols, previous: ca.SX, gate: ca.SX
) -> Rows:
    """Return the rows with bounds that can be followed from the previous velocity (n_v,) [m/s,
    rad/s], and with the gate in them.

    A row asks for no more change of its rate per tick than its least-norm motion gives within the
    acceleration limits. Otherwise every degree of freedom that moves the row would join in at its
    limit, whatever it was meant for. Rows of an equality change in proportion, so that where they
    settle does not depend on the limits. Accelerations towards references and bounds fall to 0 on
    the way; those away from a bound that is broken do so only where `eased`.

    The gate acts as `uvms_ocp.solvers.hierarchy.level` says. The range of a row is what the limits
    let one tick change of its rate: bounds that are farther away than that are kept by the limits
    themselves.
    """
    if not rows.n_rows:
        return rows
    dt = symbols.dt
    limits = symbols.robot.limits
    pace = jerk_limit.pace(symbols.robot)
    present = rows.jacobian @ previous
    acceleration = row_acceleration(rows.jacobian, limits.acceleration)
    if equality:
        desired = rows.rate - present
        lower = upper = present + jerk_limit.common_share(desired, acceleration, dt, pace) * desired
    else:
        if _is_endless(rows.lower):
            lower = rows.lower
        else:
            lower = present - _way(present - rows.lower, acceleration, dt, eased, pace)
        if _is_endless(rows.upper):
            upper = rows.upper
        else:
            upper = present + _way(rows.upper - present, acceleration, dt, eased, pace)
        if not (_is_endless(rows.lower) or _is_endless(rows.upper)):
            # The way back from one bound may be longer than what is left, eased, of the way to the
            # other one.
            far = ca.fmin(lower, upper), ca.fmax(lower, upper)
            lower = ca.if_else(present > rows.upper, far[0], lower)
            upper = ca.if_else(present < rows.lower, far[1], upper)
    step = np.minimum(np.minimum(limits.acceleration * dt, 2 * limits.velocity), ENDLESS)
    gates = ca.repmat(gate, rows.n_rows, 1)
    reach = ca.fabs(rows.jacobian) @ ca.DM(step)
    lower, upper = widen_bounds(rows.jacobian, lower, upper, gates, reach)
    return replace(rows, lower=lower, upper=upper)


def _is_endless(bound: ca.SX) -> bool:
    """Check for a bound that is infinite in every configuration."""
    return bool(bound.is_constant() and np.isinf(np.array(ca.DM(bound))).all())


def _way(room: ca.SX, acceleration: ca.SX, dt: float, eased: bool, pace: float) -> ca.SX:
    """Compute the changes (m,) that rates may make in this tick towards bounds that leave them this
    room (m,); negative: rates have to come back. pace: that of the robot.
    """
    bounded_room = ca.fmin(room, ENDLESS)
    ahead = ca.if_else(
        room < ENDLESS,
        bounded_room * jerk_limit.falling_share(bounded_room, acceleration, dt, pace),
        ca.inf,
    )
    if eased:
        back = bounded_room * jerk_limit.smooth_share(bounded_room, acceleration, dt, pace)
    else:
        back = ca.fmax(bounded_room, -acceleration * dt)
    return ca.if_else(room > 0, ahead, back)

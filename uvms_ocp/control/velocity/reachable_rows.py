"""References that the acceleration limits can follow, so that tasks change smoothly in a strict hierarchy."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from uvms_ocp.control.velocity.easing import common_share, eased_share, falling_share
from uvms_ocp.solvers.hierarchy.gated_rows import gated
from uvms_ocp.tasks.limits import ENDLESS, row_acceleration
from uvms_ocp.tasks.task import Rows, TickSymbols


def reachable_rows(
    rows: Rows, *, equality: bool, eased: bool, symbols: TickSymbols, previous: ca.SX, gate: ca.SX
) -> Rows:
    """The rows with bounds that can be followed from the previous velocity (n_v,) [m/s, rad/s], and with the gate [-] in them.

    A row asks for no more change of its rate per tick than its least-norm motion gives within the acceleration
    limits. Otherwise every degree of freedom that moves the row would join in at its limit, whatever it was meant for.
    Rows of an equality change in proportion, so that where they settle does not depend on the limits. Accelerations towards
    references and bounds fall to 0 on the way; those away from a bound that is broken do so only where `eased`.

    The gate acts as `uvms_ocp.solvers.hierarchy.gated_rows` says. The range of a row is what the limits let one tick change of
    its rate: bounds that are farther away than that are kept by the limits themselves.
    """
    dt, limits = symbols.dt, symbols.robot.limits
    present, acceleration = rows.jacobian @ previous, row_acceleration(rows.jacobian, limits.acceleration)
    if equality:
        wanted = rows.rate - present
        lower = upper = present + common_share(wanted, acceleration, dt) * wanted
    else:
        lower = rows.lower if _is_endless(rows.lower) else present - _way(present - rows.lower, acceleration, dt, eased)
        upper = rows.upper if _is_endless(rows.upper) else present + _way(rows.upper - present, acceleration, dt, eased)
        if not (_is_endless(rows.lower) or _is_endless(rows.upper)):
            # The way back from one bound may be longer than what is left, eased, of the way to the other one.
            far = ca.fmin(lower, upper), ca.fmax(lower, upper)
            lower = ca.if_else(present > rows.upper, far[0], lower)
            upper = ca.if_else(present < rows.lower, far[1], upper)
    step = np.minimum(np.minimum(limits.acceleration * dt, 2 * limits.velocity), ENDLESS)
    gates, reach = ca.repmat(gate, rows.n_rows, 1), ca.fabs(rows.jacobian) @ ca.DM(step)
    lower, upper = gated(rows.jacobian, lower, upper, gates, reach)
    return replace(rows, lower=lower, upper=upper)


def _is_endless(bound: ca.SX) -> bool:
    """True if there is no way to go, whatever the robot does."""
    return bool(bound.is_constant() and np.isinf(np.array(ca.DM(bound))).all())


def _way(room: ca.SX, acceleration: ca.SX, dt: float, eased: bool) -> ca.SX:
    """How far (m,) rates may go in this tick towards bounds that leave them this room (m,); negative: have to come back."""
    near = ca.fmin(room, ENDLESS)
    ahead = ca.if_else(room < ENDLESS, near * falling_share(near, acceleration, dt), ca.inf)
    back = near * eased_share(near, acceleration, dt) if eased else ca.fmax(near, -acceleration * dt)
    return ca.if_else(room > 0, ahead, back)

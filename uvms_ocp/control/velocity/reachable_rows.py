"""References that the acceleration limits can follow, so that tasks change smoothly in a strict hierarchy."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from uvms_ocp.tasks.limits import row_acceleration
from uvms_ocp.tasks.task import Rows, TickSymbols

_NOTHING = 1e-9  # keeps divisions by a row of zeros or a change of zero finite


def reachable_rows(rows: Rows, *, equality: bool, symbols: TickSymbols, previous: ca.SX, gate: ca.SX) -> Rows:
    """The rows with bounds that can be followed from the previous velocity (n_v,) [m/s, rad/s].

    A row asks for no more change of its rate per tick than its least-norm motion gives within the acceleration
    limits. Otherwise every degree of freedom that moves the row would join in at its limit, whatever it was meant for.
    The gate in [0, 1] scales that change: a task enters and leaves by holding the present velocity of its rows.
    Weights cannot do that in a strict hierarchy, they leave the minimiser as it is. Rows of an equality change in
    proportion, so that where they settle does not depend on the limits.
    """
    present = rows.jacobian @ previous
    step = gate * row_acceleration(rows.jacobian, symbols.robot.limits.acceleration) * symbols.dt
    if not equality:
        lower, upper = ca.fmin(rows.lower, present + step), ca.fmax(rows.upper, present - step)
        return replace(rows, lower=lower, upper=upper)
    change = rows.rate - present
    share = ca.fmin(1, ca.mmin(step / ca.fmax(ca.fabs(change), _NOTHING)))
    target = present + share * change
    return replace(rows, lower=target, upper=target)

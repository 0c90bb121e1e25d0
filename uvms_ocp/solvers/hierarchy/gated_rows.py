"""Rows ``lower <= J v <= upper`` with gates, for NumPy arrays and CasADi expressions alike; scaling.c is the twin in C.

What a gate g means, for `Level`, missions, the controller and what is exported from it:

- 1 keeps the row as it is, 0 removes it.
- Between, both bounds are wider by ``sqrt((1 - g) / g)`` times the range of the row: the row keeps its rank, but it is
  indifferent to what lies within that band. The band is all that the row can do, and more, as g goes to 0: the limit is the
  problem without the row, and by then v does not change any more. Along a cosine bell in time the band opens and closes at a
  steady pace.
- The range is ``sum |J_row|``, that of J v for |v| <= 1, where nothing is said; in the controller it is what the limits let
  one tick change, so that it is accelerations that grow and fade.

A fractional gate that is held is a tolerance, not a weight: weights do not move the optimum of a strict hierarchy. A gate
scales the activation for `Icat`, which weighs. `[rate]` is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

import numpy as np

from uvms_ocp.functions.elementwise import Array, both, everywhere, row_sums, where
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES
from uvms_ocp.solvers.intervals import distance


def is_valid(J: Array, lower: Array, upper: Array, gate: Array) -> Array:
    """True if a solver can take the rows: J of sensible size, an interval for every row, gates in [0, 1]; no NaN.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate]; gate (M,) [-].
    """
    # Comparisons with NaN are false.
    open_outwards = both(lower < np.inf, upper > -np.inf)
    ordered = both(lower <= upper, open_outwards)
    return both(
        everywhere(abs(J) < TOLERANCES.largest),
        everywhere(both(ordered, both(gate >= 0.0, gate <= 1.0))),
    )


def gated(J: Array, lower: Array, upper: Array, gate: Array, reach: Array | None = None) -> tuple[Array, Array]:
    """Bounds (M,) [rate] that leave to infinity as the gate goes from 1 to 0.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate]; gate (M,) [-]; reach (M,) [rate]: finite range of each row,
    ``sum |J_row|`` where it is not given.
    """
    removed = gate <= 0.0
    gate = where(removed, 1.0, gate)
    # Two roots: the quotient of the smallest gates is infinite, and 0 times that is not a number.
    width = (row_sums(abs(J)) if reach is None else reach) * ((1.0 - gate) ** 0.5 / gate**0.5)
    return where(removed, -np.inf, lower - width), where(removed, np.inf, upper + width)


def residual(J: Array, v: Array, lower: Array, upper: Array, gate: Array) -> Array:
    """Signed distance (M,) [rate] of ``J v`` to [lower, upper] as given, 0 where the gate is 0.

    J (M, n) [rate/velocity]; v (n,) [velocity]; lower and upper (M,) [rate]; gate (M,) [-].
    """
    return where(gate > 0.0, distance(J @ v, lower, upper), 0.0)

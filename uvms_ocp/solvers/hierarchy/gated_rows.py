"""Rows ``lower <= J v <= upper`` with gates, for NumPy arrays and CasADi expressions alike; entry.c is the twin in C.

A gate of 0 removes a row, 1 keeps it exactly. `[rate]` is the unit of a row, `[velocity]` that of an entry of v.
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


def gated(J: Array, lower: Array, upper: Array, gate: Array) -> tuple[Array, Array]:
    """Bounds (M,) [rate] that leave to infinity as the gate goes from 1 to 0; ``sum |J_row|`` is J v's range for |v| <= 1.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate]; gate (M,) [-].
    """
    removed = gate <= 0.0
    gate = where(removed, 1.0, gate)
    width = (1.0 - gate) / gate * row_sums(abs(J))
    return where(removed, -np.inf, lower - width), where(removed, np.inf, upper + width)


def residual(J: Array, v: Array, lower: Array, upper: Array, gate: Array) -> Array:
    """Signed distance (M,) [rate] of ``J v`` to [lower, upper] as given, 0 where the gate is 0.

    J (M, n) [rate/velocity]; v (n,) [velocity]; lower and upper (M,) [rate]; gate (M,) [-].
    """
    return where(gate > 0.0, distance(J @ v, lower, upper), 0.0)

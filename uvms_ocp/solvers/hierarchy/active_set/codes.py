"""What the numbers mean that the solver in C and Python exchange."""

from __future__ import annotations

from enum import IntEnum

from uvms_ocp.solvers.hierarchy.solution import Status

STATUSES = tuple(Status)
"""By their codes."""


class RowState(IntEnum):
    """Of one row: free, held at a bound, or an equality, which is always held."""

    LOWER = -1
    FREE = 0
    UPPER = 1
    EQUAL = 2


# As plain integers, which NumPy compares four times as fast.
LOWER, FREE, UPPER, EQUAL = (int(state) for state in RowState)

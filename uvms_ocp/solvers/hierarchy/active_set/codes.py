"""What the numbers mean that the core in C and Python exchange."""

from __future__ import annotations

from enum import IntEnum


class Outcome(IntEnum):
    """Of one run."""

    SOLVED = 0
    STALLED = 1
    LIMIT = 2
    DOUBTFUL = 3
    INVALID = 4


class RowState(IntEnum):
    """Of one row: free, held at a bound, or an equality, which is always held."""

    LOWER = -1
    FREE = 0
    UPPER = 1
    EQUAL = 2


# As plain integers, which NumPy compares four times as fast.
LOWER, FREE, UPPER, EQUAL = (int(state) for state in RowState)

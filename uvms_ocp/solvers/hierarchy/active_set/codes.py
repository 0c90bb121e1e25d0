"""What the numbers mean that the core in C and Python exchange."""

from __future__ import annotations

from enum import IntEnum


class Outcome(IntEnum):
    """Of one run."""

    SOLVED = 0
    """Certified, however the run has ended."""
    STALLED = 1
    """A row that should have been dropped could not be."""
    LIMIT = 2
    """Too many iterations, or numbers that are not finite."""
    DOUBTFUL = 3
    """All signs are right, but that is not certified."""
    INVALID = 4
    """Rows that no solver takes."""
    INCOMPLETE = 5
    """Certified but for rows that count as nothing beside the largest, and could be nearer to their bounds."""


class RowState(IntEnum):
    """Of one row: free, held at a bound, or an equality, which is always held."""

    LOWER = -1
    FREE = 0
    UPPER = 1
    EQUAL = 2


# As plain integers, which NumPy compares four times as fast.
LOWER, FREE, UPPER, EQUAL = (int(state) for state in RowState)

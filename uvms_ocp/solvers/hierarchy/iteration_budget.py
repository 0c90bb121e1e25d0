"""Limit the iterations of the active set by how many rows there are, shared by C (as macros) and
Python.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class IterationBudget:
    """Iteration budget of runs with a given number of rows."""

    most_iterations: int
    """Largest number of iterations of one run, which ends there."""
    most_of_all: int
    """Largest number of iterations of all runs of one call together, warm, cold and fallbacks, which
    bounds its time.
    """
    bland_stalls: int
    """Standstills after which the first wrong row is dropped, not the worst, which ends nearly
    every cycle.
    """
    tabu_stalls: int
    """Standstills after which a dropped row stays once it is active again, which ends every
    cycle.
    """
    tabu_iterations: int
    """Iterations after which a dropped row stays, since a cycle may move a little."""


def iteration_budget(n_rows: int) -> IterationBudget:
    """Return the budget of runs over n_rows rows of all levels."""
    per_run = 20 + 10 * n_rows
    return IterationBudget(
        most_iterations=per_run,
        most_of_all=6 * per_run,
        bland_stalls=n_rows // 2 + 10,
        tabu_stalls=2 * n_rows,
        tabu_iterations=20 + 3 * n_rows,
    )

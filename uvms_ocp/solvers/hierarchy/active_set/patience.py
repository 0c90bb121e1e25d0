"""After how many iterations a run changes its rule, and when it ends; the same for C and NumPy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Patience:
    """Of the runs with a given number of rows."""

    most_iterations: int
    """[-] A run that needs more ends where it is."""
    most_of_all: int
    """[-] Of all runs of one call together, whatever the numbers: warm, cold and all fallbacks. So its time is bounded."""
    bland_stalls: int
    """[-] Standstills after which the first wrong row is dropped, not the worst, which ends nearly every cycle."""
    tabu_stalls: int
    """[-] Standstills after which a dropped row stays once it is active again, which ends all of them."""
    tabu_iterations: int
    """[-] Iterations after which the same holds, since a cycle may move a little."""


def patience(n_rows: int) -> Patience:
    """What runs over n_rows rows of all levels are given."""
    most = 20 + 10 * n_rows
    return Patience(
        most_iterations=most,
        most_of_all=6 * most,
        bland_stalls=n_rows // 2 + 10,
        tabu_stalls=2 * n_rows,
        tabu_iterations=20 + 3 * n_rows,
    )

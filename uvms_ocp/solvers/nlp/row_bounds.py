"""Bounds of the variables and rows of a lexicographic program."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.intervals import excess
from uvms_ocp.solvers.nlp.program import RowRanges


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowBounds:
    """Of the variables and of all rows of the program; rows of levels that are not frozen yet are infinite."""

    x_lower: np.ndarray
    """(n_x,) [unit of x]"""
    x_upper: np.ndarray
    """(n_x,) [unit of x]"""
    lower: np.ndarray
    """(n_rows,) [unit of the row]"""
    upper: np.ndarray
    """(n_rows,) [unit of the row]"""

    def with_rows(self, rows: slice, bounds: tuple[np.ndarray, np.ndarray]) -> RowBounds:
        """The same with other bounds, lower and upper (m,) [unit of the row], for the given rows."""
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[rows], upper[rows] = bounds
        return replace(self, lower=lower, upper=upper)

    def violation(self, x: np.ndarray, g: np.ndarray, rows: np.ndarray | slice) -> float:
        """Largest violation [-] at x (n_x,) [unit of x], where the rows numbered `rows` (m,) [-] are g (m,) [unit of the row]."""
        broken = excess(g, self.lower[rows], self.upper[rows]).max(initial=0.0)
        return float(max(broken, excess(x, self.x_lower, self.x_upper).max(initial=0.0)))


def row_bounds(ranges: RowRanges, x_lower: np.ndarray | float, x_upper: np.ndarray | float, n_x: int) -> RowBounds:
    """Bounds with no level frozen; x_lower and x_upper (n_x,), or one for all variables [unit of x].

    Raises `InvalidInput` for bounds that are NaN or that no x keeps.
    """
    for name, bound in (("x_lower", x_lower), ("x_upper", x_upper)):
        if np.isnan(np.asarray(bound, dtype=float)).any():
            raise InvalidInput(f"{name} has NaN; give numbers, or an infinity where there is no bound")
    if (np.less_equal(x_upper, -np.inf) | np.greater_equal(x_lower, np.inf) | np.greater(x_lower, x_upper)).any():
        raise InvalidInput("x_lower and x_upper exclude every x; give x_lower <= x_upper, and infinity only outwards")
    lower, upper = np.full(ranges.n_rows, -np.inf), np.full(ranges.n_rows, np.inf)
    m = len(ranges.lower)
    lower[:m], upper[:m] = ranges.lower, ranges.upper
    return RowBounds(
        x_lower=np.broadcast_to(np.asarray(x_lower, dtype=float), (n_x,)),
        x_upper=np.broadcast_to(np.asarray(x_upper, dtype=float), (n_x,)),
        lower=lower,
        upper=upper,
    )

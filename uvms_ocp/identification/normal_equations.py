"""Gauss-Newton normal equations of one recording, and the robust loss that they come from.

Shared unknowns are coupled with those of the recording and with the starts of its segments; a start
is coupled with its neighbours alone. Eliminating recordings and starts takes a time that grows with
the number of segments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Elimination = Callable[[np.ndarray], np.ndarray]
"""Maps a change (n,) of the shared unknowns to those (m + 9 l,) of the others [as
`Unknowns.start`].
"""


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Gauss-Newton normal equations of n shared unknowns, m of the recording, and the starts of its
    l segments.

    Unknowns are a border of the matrix: a start is coupled with them and with the next start only, so
    that all starts are eliminated in a time and a memory that grow with l.
    """

    cost: float
    """Half the weighted squares."""
    H: np.ndarray
    """(n + m, n + m) [1 / unknowns^2] matrix of the unknowns."""
    g: np.ndarray
    """(n + m,) [1 / unknowns] gradient by the unknowns."""
    H_starts: np.ndarray
    """(18, 9 l) [1 / unknowns^2] lower band of the starts' matrix, diagonal by diagonal, as LAPACK
    has it.
    """
    g_starts: np.ndarray
    """(9 l,) [1 / unknowns] gradient by the starts."""
    cross: np.ndarray
    """(9 l, n + m) [1 / unknowns^2] matrix between starts and unknowns."""

    def without_starts(self, damping: float, n: int) -> tuple[np.ndarray, np.ndarray, Elimination]:
        """Compute the Schur complement (n, n), (n,) of n shared unknowns, and the map from their
        change to those of the others, whose diagonal is raised by damping.
        """
        from scipy.linalg import solveh_banded  # a tenth of a second

        band = self.H_starts.copy()
        band[0] *= 1.0 + damping
        right_sides = np.column_stack([self.cross, self.g_starts])
        solved_starts = solveh_banded(band, right_sides, lower=True, check_finite=False)
        H = self.H - self.cross.T @ solved_starts[:, :-1]
        g = self.g - self.cross.T @ solved_starts[:, -1]
        H_recording = H[n:, n:] + damping * np.diag(np.diag(self.H)[n:])
        solved_recording = np.linalg.solve(H_recording, np.column_stack([H[n:, :n], g[n:]]))

        def eliminated(change: np.ndarray) -> np.ndarray:
            """Compute changes (m + 9 l,) of the other unknowns from the change (n,) of the shared
            ones.
            """
            recording_change = -solved_recording @ np.r_[change, 1.0]
            start_changes = -solved_starts @ np.r_[change, recording_change, 1.0]
            return np.r_[recording_change, start_changes]

        H_shared = H[:n, :n] - H[:n, n:] @ solved_recording[:, :-1]
        g_shared = g[:n] - H[:n, n:] @ solved_recording[:, -1]
        return H_shared, g_shared, eliminated


def are_finite(blocks: Sequence[NormalEquations]) -> bool:
    """Check that all entries are finite: where a simulation runs away, its slopes do before its
    cost.
    """
    for block in blocks:
        if not np.isfinite(block.cost):
            return False
        if not (np.isfinite(block.H).all() and np.isfinite(block.H_starts).all()):
            return False
    return True


def loss(r: np.ndarray, outliers: float) -> float:
    """Compute the pseudo-Huber loss [-] of all residuals r (...): half their squares near zero, and
    linear beyond outliers.
    """
    return float((outliers**2 * (np.sqrt(1.0 + (r / outliers) ** 2) - 1.0)).sum())


def weights(r: np.ndarray, outliers: float) -> np.ndarray:
    """Compute weights (...) of squares of residuals r (...) that have the gradient of the loss,
    less beyond outliers.
    """
    return np.asarray((1.0 + (r / outliers) ** 2) ** -0.5)

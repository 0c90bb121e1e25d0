"""Independent check of lexicographic optimality, from the Karush-Kuhn-Tucker conditions of every level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from uvms_ocp.solvers.level import Array, Level, gated_bounds

# Distance to a bound, relative to the size of its row and bound, below which the row may carry a multiplier.
_ACTIVE = 1e-9
# Rows smaller than this part of the largest row are what is left of a cancellation.
_VANISHED = 1e-13


def certificate(levels: Sequence[Level], v: Array) -> float:
    """Largest ``|J' s + C' lambda| / (|J| |s| + 1)`` of any level, over the multipliers that the signs allow.

    s is the slack of the level at v and C the rows of the levels above that cannot move without worsening
    those: equalities and violated rows with any multiplier, rows at a bound with one that pushes outwards. 0 means that
    no level can be improved without worsening one above it; nothing of the solver's report is used.
    """
    pushes, worst = np.zeros((0, len(v))), 0.0
    largest = max(float(np.linalg.norm(level.jacobian, axis=1).max(initial=0.0)) for level in levels)
    for level in levels:
        slack, own = _conditions(level, v, _VANISHED * largest)
        gradient = level.jacobian.T @ slack
        scale = np.linalg.norm(level.jacobian) * np.linalg.norm(slack) + 1.0
        worst = max(worst, _unbalanced(pushes, gradient) / float(scale))
        pushes = np.vstack([pushes, own])
    return worst


def _conditions(level: Level, v: Array, vanished: float) -> tuple[Array, Array]:
    """Slack (m,), and unit directions (k, n) of the multipliers that its rows lend to the levels below."""
    lower, upper = gated_bounds(level)
    J, y = level.jacobian, level.jacobian @ v
    slack = y - np.clip(y, lower, upper)
    length = np.linalg.norm(J, axis=1)
    near = _ACTIVE * (length + np.abs(np.clip(y, lower, upper)))
    fixed = (lower >= upper) | (np.abs(slack) > near)
    up, down = fixed | (y >= upper - near), fixed | (y <= lower + near)
    units = np.where((length > vanished)[:, None], J / np.where(length > vanished, length, 1.0)[:, None], 0.0)
    return slack, np.vstack([units[up], -units[down]])


def _unbalanced(pushes: Array, gradient: Array) -> float:
    size = float(np.linalg.norm(gradient))
    if size == 0.0 or len(pushes) == 0:
        return size
    return size * float(nnls(pushes.T, -gradient / size, maxiter=100 * len(pushes))[1])

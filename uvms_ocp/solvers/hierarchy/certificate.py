"""Independent check of lexicographic optimality, from the Karush-Kuhn-Tucker conditions of every level.

`[velocity]` is the unit of an entry of v.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.hierarchy.level import Level, gated_bounds
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES
from uvms_ocp.solvers.intervals import distance


@np.errstate(over="ignore", invalid="ignore")  # what overflows has no certificate
def certificate(levels: Sequence[Level], v: Array) -> float:
    """Largest ``|J' s + C' lambda| / (|J| |s| + 1)`` of any level, over the multipliers that the signs allow.

    s is the slack of the level at v (n,) [velocity] and C the rows of the levels above that cannot move without worsening
    those: equalities and violated rows with any multiplier, rows at a bound with one that pushes outwards. 0 means that
    no level can be improved without worsening one above it; nothing of the solver's report is used. The + 1 asks for rows
    of the order of 1: of levels whose rows are all tiny it says little.
    """
    pushes, worst = np.zeros((0, len(v))), 0.0
    largest = max(float(np.linalg.norm(level.jacobian, axis=1).max(initial=0.0)) for level in levels)
    for level in levels:
        slack = _slack(level, v)
        size = float(np.linalg.norm(level.jacobian) * np.linalg.norm(slack))
        unbalanced = _unbalanced(pushes, level.jacobian.T @ slack)
        part = unbalanced / (size + 1.0)
        worst = max(worst, part if np.isfinite(part) else np.inf)
        # A slack as small as the distance to a bound is one only if it is balanced by itself, not by the + 1.
        least = TOLERANCES.slight if unbalanced <= TOLERANCES.slightly_balanced * size else TOLERANCES.active
        pushes = np.vstack([pushes, _pushes(level, v, least, TOLERANCES.vanished * largest)])
    return worst


def _slack(level: Level, v: Array) -> Array:
    lower, upper = gated_bounds(level)
    slack = distance(level.jacobian @ v, lower, upper)
    return np.where(np.abs(slack) > _noise(level, v), slack, 0.0)


def _noise(level: Level, v: Array) -> Array:
    lengths = np.linalg.norm(level.jacobian, axis=1)
    return np.asarray(TOLERANCES.rounding * len(v) * lengths * np.linalg.norm(v))


def _pushes(level: Level, v: Array, least: float, vanished: float) -> Array:
    """Unit directions (k, n) of the multipliers that the rows lend to the levels below; ``least`` makes a slack."""
    lower, upper = gated_bounds(level)
    y, length = level.jacobian @ v, np.linalg.norm(level.jacobian, axis=1)
    reached = np.clip(y, lower, upper)
    size, noise = length + np.abs(reached), _noise(level, v)
    fixed = (lower >= upper) | (np.abs(y - reached) > least * size + noise)
    near = TOLERANCES.active * size + noise
    up, down = fixed | (y >= upper - near), fixed | (y <= lower + near)
    real = length > vanished
    units = np.where(real[:, None], level.jacobian / np.where(real, length, 1.0)[:, None], 0.0)
    return np.vstack([units[up], -units[down]])


def _unbalanced(pushes: Array, gradient: Array) -> float:
    size = float(np.linalg.norm(gradient))
    if size == 0.0 or len(pushes) == 0:
        return size
    return size * float(nnls(pushes.T, -gradient / size, maxiter=100 * len(pushes))[1])

"""Random hierarchies, and a reference solution that shares no code and no method with the
package.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lstsq
from scipy.optimize import nnls

from uvms_ocp.solvers.hierarchy.level import Level

Array = np.ndarray


def random_hierarchy(
    seed: int, n: int = 13, sizes: tuple[int, ...] = (13, 3, 6, 1, 1, 6, 4, 6, 3, 3, 13)
) -> list[Level]:
    """A box, then conflicting equalities and one- and two-sided inequalities, then least
    velocity.
    """
    rng = np.random.default_rng(seed)
    middle = [_random_level(rng, n, size) for size in sizes[1:-1]]
    box = Level(jacobian=np.eye(n), lower=-rng.uniform(0.5, 1.5, n), upper=rng.uniform(0.5, 1.5, n))
    return [box, *middle, Level(jacobian=np.eye(n), lower=0.0, upper=0.0)]


def _random_level(rng: np.random.Generator, n: int, size: int) -> Level:
    lower = rng.standard_normal(size)
    kind = rng.integers(0, 4, size)
    width = np.where(kind == 2, rng.uniform(0.0, 1.0, size), np.where(kind == 3, np.inf, 0.0))
    return Level(jacobian=rng.standard_normal((size, n)), lower=lower, upper=lower + width)


def dependent_hierarchy(
    seed: int, n: int, sizes: tuple[int, ...], nearly: float = 0.0
) -> list[Level]:
    """Duplicated, combined, zero and random rows with bounds of every kind."""
    rng = np.random.default_rng(seed)
    earlier: list[Array] = [np.zeros(n)]
    return [_dependent_level(rng, n, size, earlier, nearly) for size in sizes]


def _dependent_level(
    rng: np.random.Generator, n: int, size: int, earlier: list[Array], nearly: float
) -> Level:
    for _ in range(size):
        parts = rng.integers(0, len(earlier), 2)
        combined = earlier[parts[0]] + rng.choice([-1.0, 0.0, 2.0]) * earlier[parts[1]]
        row = rng.standard_normal(n) if rng.random() < 0.55 else combined
        earlier.append(row + nearly * rng.standard_normal(n))
    low = np.round(rng.standard_normal(size), rng.integers(0, 3))
    kind = rng.integers(0, 5, size)
    width = np.select([kind < 2, kind == 2], [0.0, rng.uniform(0.0, 1.0, size)], np.inf)
    below = np.where(kind == 4, -np.inf, low)
    above = np.where(kind == 4, low, low + width)
    return Level(
        jacobian=np.reshape(earlier[len(earlier) - size :], (size, n)), lower=below, upper=above
    )


def distance(y: Array, lower: Array, upper: Array) -> Array:
    return y - np.clip(y, lower, upper)


def reference(levels: list[Level]) -> tuple[Array, Array]:
    """Norm of each level's optimal slack, and the largest error of the optimality conditions of any
    level.

    Method of multipliers, each of whose problems is solved by Newton steps on its piecewise
    quadratic; optimality is verified with non-negative least squares.
    """
    n = levels[0].n_velocities
    v = np.zeros(n)
    rows_above = (np.zeros((0, n)), np.zeros(0), np.zeros(0))
    errors = []
    for level in levels:
        v = _optimum(level, rows_above, v)
        errors.append(_optimality_error(level, rows_above, v))
        rows_above = _held(level, rows_above, v)
    norms = [
        np.linalg.norm(distance(level.jacobian @ v, level.lower, level.upper)) for level in levels
    ]
    return np.array(norms), np.array(errors)


def _held(
    level: Level, rows_above: tuple[Array, Array, Array], v: Array
) -> tuple[Array, Array, Array]:
    C, lower, upper = rows_above
    y = level.jacobian @ v
    low = np.minimum(level.lower, y)
    up = np.maximum(level.upper, y)
    slack = distance(y, level.lower, level.upper)
    # At an optimum the rows of a level that had to be violated have one and the same value
    # everywhere.
    low = np.where(np.abs(slack) > 1e-7, y, low)
    up = np.where(np.abs(slack) > 1e-7, y, up)
    return np.vstack([C, level.jacobian]), np.hstack([lower, low]), np.hstack([upper, up])


def _optimum(level: Level, rows_above: tuple[Array, Array, Array], v: Array) -> Array:
    C, lower, upper = rows_above
    multipliers = np.zeros(len(C))
    penalty = 1e5
    for _ in range(400):
        v = _newton(level, (C, lower - multipliers, upper - multipliers), v, penalty)
        updated = distance(C @ v + multipliers, lower, upper)
        change = np.abs(updated - multipliers).max(initial=0.0)
        multipliers = updated
        if change < 1e-13:
            break
    return v


def _newton(
    level: Level, rows_above: tuple[Array, Array, Array], v: Array, penalty: float
) -> Array:
    J = np.vstack([level.jacobian, np.sqrt(penalty) * rows_above[0]])
    lower = np.hstack([level.lower, np.sqrt(penalty) * rows_above[1]])
    upper = np.hstack([level.upper, np.sqrt(penalty) * rows_above[2]])
    for _ in range(100):
        slack = distance(J @ v, lower, upper)
        active = slack != 0.0
        if not active.any():
            break
        step = lstsq(J[active], -slack[active], cond=1e-12)[0]
        cost = slack @ slack
        slope = slack @ (J @ step)
        length = 1.0
        while (
            _cost(J, lower, upper, v + length * step) > cost + 1e-4 * length * slope
            and length > 1e-9
        ):
            length *= 0.5
        v = v + length * step
        if np.abs(length * step).max() < 1e-15:
            break
    return v


def _cost(J: Array, lower: Array, upper: Array, v: Array) -> float:
    slack = distance(J @ v, lower, upper)
    return float(slack @ slack)


def _optimality_error(level: Level, rows_above: tuple[Array, Array, Array], v: Array) -> float:
    """Norm of J' s + C' lambda over the multipliers that the active rows of C allow."""
    C, lower, upper = rows_above
    y = C @ v
    slack = distance(level.jacobian @ v, level.lower, level.upper)
    outward = np.vstack([C[y >= upper - 1e-9], -C[y <= lower + 1e-9], np.zeros((1, len(v)))])
    return float(nnls(outward.T, -level.jacobian.T @ slack, maxiter=10000)[1])

"""Bounded least squares whose free directions minimise a weighted norm: small, dense, by an active set.

Two strict levels: among the x in [lower, upper] that minimise ``|A x - b|``, the one that minimises
``x' diag(weight) x``. The answer is unique. The active set is found on the regularised problem
``|A x - b|^2 + epsilon^2 x' diag(weight) x`` [Stark1995] and the levels are then separated exactly. `[x]` is the unit of
a variable, `[b]` that of the rows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_EPSILON = 1e-4  # share of the norm while the active set is sought; its square is the loss of wrench
_TOLERANCE = 1e-9  # of signs and of singular values, relative

FreeSolution = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (x, free) -> x with its free part optimal


def bounded_least_squares(
    A: np.ndarray,
    b: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    weight: np.ndarray,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Return x (n,) [x] for A (m, n) [b/x], b (m,) [b], finite lower <= upper (n,) [x] and weight (n,) [1/x^2] > 0.

    Inputs are trusted. start (n,) [x] inside the bounds saves time when the same variables end at a bound.
    """
    scale = np.sqrt(weight)
    scaled_start = None if start is None else start * scale
    x = _active_set(A / scale, b, lower * scale, upper * scale, scaled_start) / scale
    return np.asarray(np.clip(x, lower, upper))


def _active_set(
    A: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray, start: np.ndarray | None
) -> np.ndarray:
    """The problem with unit weights."""
    n = len(lower)
    hessian = A.T @ A
    ridge = _EPSILON**2 * max(float(hessian.trace()) / n, np.finfo(float).tiny)
    hessian.flat[:: n + 1] += ridge
    linear = A.T @ b
    x = np.clip(np.linalg.solve(hessian, linear) if start is None else start, lower, upper)
    free = (x > lower) & (x < upper)
    for _ in range(10 * n):
        x, free = _advance(x, free, lower, upper, lambda x, free: _ridge_solution(hessian, linear, x, free))
        released = _most_wrong(hessian @ x - linear, x, free, lower, upper)
        if released is None:
            break
        free[released] = True
    return _advance(x, free, lower, upper, lambda x, free: _exact_solution(A, b, x, free))[0]


def _advance(
    x: np.ndarray, free: np.ndarray, lower: np.ndarray, upper: np.ndarray, solve: FreeSolution
) -> tuple[np.ndarray, np.ndarray]:
    """Move to the optimum of the free variables, fixing those that meet a bound on the way."""
    free = free.copy()
    while free.any():
        step = solve(x, free) - x
        share, blocking = _blocking(x, step, lower, upper)
        x = x + share * step
        if blocking is None:
            break
        x[blocking] = upper[blocking] if step[blocking] > 0.0 else lower[blocking]
        free[blocking] = False
    return x, free


def _blocking(x: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[float, int | None]:
    """Largest share <= 1 of the step that stays inside, and the variable that stops it."""
    room = np.where(step > 0.0, upper - x, lower - x)
    shares = np.divide(room, step, out=np.full_like(step, np.inf), where=step != 0.0)
    first = int(shares.argmin())
    share = max(float(shares[first]), 0.0)
    return (1.0, None) if share >= 1.0 else (share, first)


def _ridge_solution(hessian: np.ndarray, linear: np.ndarray, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    moved = np.where(free, 0.0, x)
    rest = linear - hessian @ moved
    moved[free] = np.linalg.solve(hessian[np.ix_(free, free)], rest[free])
    return moved


def _exact_solution(A: np.ndarray, b: np.ndarray, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Free part: least residual, then least norm."""
    moved = np.where(free, 0.0, x)
    moved[free] = np.linalg.lstsq(A[:, free], b - A @ moved, rcond=_TOLERANCE)[0]
    return moved


def _most_wrong(
    gradient: np.ndarray, x: np.ndarray, free: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> int | None:
    """Index of the fixed variable whose release lowers the cost most, if any."""
    gain = np.where(x <= lower, -gradient, gradient)
    gain[free | (lower == upper)] = 0.0
    worst = int(gain.argmax())
    return worst if gain[worst] > _TOLERANCE * _EPSILON * (1.0 + np.abs(gradient).max()) else None

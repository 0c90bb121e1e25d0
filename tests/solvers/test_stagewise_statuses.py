"""Laws of what a QP of stages ends with: linear programs say as well whether it has a point, and
whether its cost has an end.
"""

from __future__ import annotations

import numpy as np
import pytest
from compiler import IN_C_AND_PYTHON
from scipy.optimize import linprog
from stage_qps import dense, flat, kkt_failure, random_shape

from uvms_ocp.solvers.stage_qp import (
    StageQp,
    StageQpOptions,
    StageQpSolution,
    StageQpSolver,
    StageQpStatus,
)

SEEDS = (*range(40), 97, 165, 282, 289, 330, 333, 384)
"""The last ones bend little, or not at all, in most directions; in the same QPs stiff residuals
bend much.
"""


def wild_qp(seed: int) -> StageQp:
    """Scales from 1e-6 to 1e6, directions without curvature, rows that repeat or contradict each
    other.
    """
    rng = np.random.default_rng(seed)
    qp = StageQp(random_shape(rng, int(rng.integers(1, 5))))
    flat_qp = qp.flat
    for name, spread in (("dynamics", 0.6), ("b", 0.1), ("C", 1.0)):
        flat_qp[name][:] = spread * rng.standard_normal(len(flat_qp[name]))
    for k, n in enumerate(qp.shape.n_z):
        z = rng.standard_normal(n)
        qp.C[k][:] *= scales(rng, len(qp.C[k]))[:, None]
        if rng.random() < 0.7:
            qp.J[k][:] = rng.standard_normal(qp.J[k].shape) * scales(rng, len(qp.J[k]))[:, None]
        qp.r[k][:] = rng.standard_normal(len(qp.r[k])) * 10 ** rng.uniform(-2, 2)
        bound(rng, qp.lower[k], qp.upper[k], qp.C[k] @ z, equal=0.15)
        bound(rng, qp.z_lower[k], qp.z_upper[k], z, equal=0.0)
    bent = rng.random(len(flat_qp["damping"])) < 0.3
    flat_qp["damping"][bent] = 10 ** rng.uniform(-6, 6, int(bent.sum()))
    flat_qp["g"][:] = (
        rng.integers(0, 2) * rng.standard_normal(len(flat_qp["g"])) * 10 ** rng.uniform(-3, 3)
    )
    return qp


def scales(rng: np.random.Generator, n: int) -> np.ndarray:
    return 10 ** rng.uniform(-6, 6, n) if rng.random() < 0.3 else np.ones(n)


def bound(
    rng: np.random.Generator,
    lower: np.ndarray,
    upper: np.ndarray,
    value: np.ndarray,
    *,
    equal: float,
) -> None:
    """About a value, which some miss."""
    draw = rng.random((2, len(value)))
    room = (np.abs(value) + 1e-6) * (rng.random((2, len(value))) - 0.05)
    lower[draw[0] < 0.4] = (value - room[0])[draw[0] < 0.4]
    upper[draw[1] < 0.4] = (value + room[1])[draw[1] < 0.4]
    swapped = lower > upper
    lower[swapped] = upper[swapped] = value[swapped]
    is_equal = draw[0] > 1.0 - equal
    lower[is_equal] = upper[is_equal] = value[is_equal]


def scaled(A: np.ndarray) -> np.ndarray:
    """(m,) Largest entry of each row, 1 where all are 0."""
    norm = np.abs(A).max(axis=1, initial=0.0)
    return np.where(norm > 0.0, norm, 1.0)


def least_violation(qp: StageQp) -> float:
    """Of all rows, relative to their largest entry, where bounds of variables are kept."""
    _, _, A, lower, upper = dense(qp)
    norm = scaled(A)
    A = A / norm[:, None]
    lower = lower / norm
    upper = upper / norm
    above = np.isfinite(upper)
    below = np.isfinite(lower)
    rows = np.vstack([A[above], -A[below]])
    optimum = linprog(
        np.append(np.zeros(A.shape[1]), 1.0),
        A_ub=np.hstack([rows, -np.ones((len(rows), 1))]),
        b_ub=np.concatenate([upper[above], -lower[below]]),
        bounds=[*zip(qp.flat["z_lower"], qp.flat["z_upper"], strict=True), (0.0, None)],
    )
    return float(optimum.x[-1]) if optimum.status == 0 else np.inf


def steepest_way(qp: StageQp) -> float:
    """Slope of the cost, relative to its gradient, along the steepest way in a box on which only
    the linear cost changes.
    """
    H, _, A, lower, upper = dense(qp)
    g = qp.flat["g"]
    if not g.any():
        return 0.0
    A = A / scaled(A)[:, None]
    still = np.vstack([H / scaled(H)[:, None], A[lower == upper]])
    above = np.isfinite(upper)
    below = np.isfinite(lower)
    sides = zip(np.isfinite(qp.flat["z_lower"]), np.isfinite(qp.flat["z_upper"]), strict=True)
    optimum = linprog(
        g / np.abs(g).max(),
        A_eq=still,
        b_eq=np.zeros(len(still)),
        A_ub=np.vstack([A[above], -A[below]]),
        b_ub=np.zeros(int(above.sum() + below.sum())),
        bounds=[(0.0 if low else -1.0, 0.0 if high else 1.0) for low, high in sides],
    )
    assert optimum.status == 0
    return float(optimum.fun)


def relative_failure(qp: StageQp, solution: StageQpSolution) -> float:
    z = flat(solution.z)
    terms = [
        np.abs(flat(part)).max(initial=0.0)
        for part in (solution.y, solution.y_z, solution.costate, solution.z)
    ]
    return kkt_failure(qp, solution) / (1.0 + np.abs(dense(qp)[0] @ z).max() + max(terms))


@pytest.mark.sampled
@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_what_rows_are_missed_by_is_that_of_the_point(compiled: bool) -> None:
    """Also of QPs that were looked at again with their residuals as rows."""
    for seed in SEEDS:
        qp = wild_qp(seed)
        solution = StageQpSolver(qp.shape, StageQpOptions(compiled=compiled)).solve(qp)
        for k, z in enumerate(solution.z):
            y = qp.C[k] @ z
            missed = y - np.clip(y, qp.lower[k], qp.upper[k])
            np.testing.assert_allclose(
                solution.excess[k],
                missed,
                rtol=1e-9,
                atol=1e-9 * (1.0 + np.abs(y).max(initial=0.0)),
            )


@pytest.mark.sampled
@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_a_status_is_what_linear_programs_say(compiled: bool) -> None:
    options = StageQpOptions(compiled=compiled)
    for seed in SEEDS:
        qp = wild_qp(seed)
        solution = StageQpSolver(qp.shape, options).solve(qp)
        if solution.status is StageQpStatus.INFEASIBLE:
            assert least_violation(qp) > 1e-9, seed
        elif solution.status is StageQpStatus.UNBOUNDED:
            assert steepest_way(qp) < -1e-9, seed
        else:
            assert solution.status.usable, (seed, solution.status)
            assert relative_failure(qp, solution) < 1e-4, seed

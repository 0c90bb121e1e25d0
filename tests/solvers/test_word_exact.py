"""Whatever a solver of hierarchies returns, it is called exact by the certificate alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hierarchies import random_hierarchy, reference

from uvms_ocp.solvers.hierarchy import active_set_numpy, cascade
from uvms_ocp.solvers.hierarchy.active_set_numpy import RowState, SolvedRows
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.level import Level, stack
from uvms_ocp.solvers.hierarchy.solution import Status

SIZES = (5, 2, 3, 1, 5)
EXCESS = 1e-5  # [rate] above the optimum of a level, far above what the certificate lets pass
Wrong = Callable[[np.ndarray], np.ndarray]
WRONG: list[Wrong] = [
    lambda w: w + 1e-3,
    lambda w: 0.9 * w,
    lambda w: np.zeros_like(w),
    lambda w: -w,
    lambda w: np.full_like(w, np.nan),
    lambda w: 1e200 * (1.0 + w),
]


def excess(levels: Sequence[Level], v: np.ndarray) -> float:
    """[rate] by which a level misses its optimum, which quadratic programs of SciPy find level by
    level.
    """
    optimum, _ = reference(levels)
    missed = []
    for level in levels:
        y = level.jacobian @ v
        missed.append(
            np.linalg.norm(np.maximum(level.lower - y, 0) + np.maximum(y - level.upper, 0))
        )
    return float((np.array(missed) - optimum).max())


def solved_in_numpy(levels: Sequence[Level]) -> SolvedRows:
    rows = stack(levels)
    start = np.full(len(rows.lower), float(RowState.FREE))
    return active_set_numpy.solve_levels(
        rows.jacobian, rows.lower, rows.upper, rows.gate, start, rows.sizes
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_active_set_method_is_not_called_exact(
    wrong: Wrong, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels = random_hierarchy(seed, 5, SIZES)
    assert solved_in_numpy(levels).status is Status.SOLVED
    right = active_set_numpy.lexicographic_least_squares

    def lying(*inputs: Any) -> tuple[np.ndarray, np.ndarray, int]:
        w, reached, iterations = right(*inputs)
        return wrong(w), reached, iterations

    monkeypatch.setattr(active_set_numpy, "lexicographic_least_squares", lying)
    solution = solved_in_numpy(levels)
    assert np.isfinite(solution.v).all()
    assert solution.status is Status.INEXACT or excess(levels, solution.v) < EXCESS


@pytest.mark.parametrize("mended", [True, False])
@pytest.mark.parametrize("offset", [1e-3, 1.0])
def test_a_wrong_quadratic_program_is_mended_or_not_called_exact(
    offset: float, mended: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though every one of its programs reports success."""
    right = cascade.cascade

    def lying(*inputs: Any) -> tuple[ca.MX, ca.MX]:
        v, inexact = right(*inputs)
        return v + offset, 0.0 * inexact

    monkeypatch.setattr(cascade, "cascade", lying)
    if not mended:
        polish = cascade.solve_levels

        def unhelpful(*inputs: Any) -> SolvedRows:
            polished = polish(*inputs)
            nothing = np.zeros_like(polished.active_set)
            return SolvedRows(
                v=polished.v + offset,
                active_set=nothing,
                status=Status.INEXACT,
                residual=polished.residual,
                iterations=1,
            )

        monkeypatch.setattr(cascade, "solve_levels", unhelpful)
    levels = random_hierarchy(7, 5, SIZES)
    solution = LexicographicQp().solve(levels)
    assert solution.status.exact is mended
    if mended:
        assert excess(levels, solution.v) < EXCESS

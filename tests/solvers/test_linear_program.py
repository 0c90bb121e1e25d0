"""Laws of small linear programs, by SciPy's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from compiler import needs_compiler
from scipy.optimize import linprog

from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.solvers.linear_program import linear_program, solve_program, value_of

SIZES = ((1, 3), (3, 4), (4, 9), (6, 15))


def solved(
    A: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    compiled: bool = True,
) -> Any:
    """The program, or `None` without an answer."""
    m, n = A.shape
    structure = linear_program(m, n)
    p: Any = structure()
    for i in range(m):
        p.A[i][:] = A[i].tolist()
    p.b[:] = b.tolist()
    p.c[:] = c.tolist()
    p.lower[:n] = lower.tolist()
    p.upper[:n] = upper.tolist()
    return p if bind_kernels((solve_program,), (structure,), compiled=compiled)[0](p) else None


@pytest.mark.parametrize("seed", range(200))
def test_the_answer_is_the_largest_value_and_there_is_one_where_scipy_finds_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, n = SIZES[seed % 4]
    A = rng.normal(size=(m, n))
    c = rng.normal(size=n)
    if seed % 3 == 0:  # small whole numbers: many vertices in one place
        A = np.round(A)
        c = np.round(c)
    if seed % 5 == 0:
        A[-1] = A[0]
    lower = np.round(rng.normal(size=n))
    upper = lower + rng.choice([0.0, 1.0, 3.0, np.inf], n, p=[0.1, 0.4, 0.4, 0.1])
    inside = lower + rng.uniform(size=n) * np.minimum(upper - lower, 2.0)
    b = A @ (inside if seed % 4 else inside + rng.normal(size=n))
    oracle = linprog(-c, A_eq=A, b_eq=b, bounds=list(zip(lower, upper, strict=True)))
    mine = solved(A, b, c, lower, upper)
    assert (mine is not None) == oracle.success
    if mine is not None:
        x = np.array(mine.x[:n])
        assert value_of(mine) == pytest.approx(-oracle.fun, rel=1e-7, abs=1e-7)
        np.testing.assert_allclose(A @ x, b, atol=1e-9 * (1.0 + np.abs(b).max()))
        assert (x >= lower - 1e-9).all()
        assert (x <= upper + 1e-9).all()


@needs_compiler
def test_in_c_and_in_python_the_answer_is_the_same_to_the_bit() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 9))
    c = rng.normal(size=9)
    lower = -np.ones(9)
    upper = np.ones(9)
    mine, same = (
        solved(A, 0.3 * A.sum(axis=1), c, lower, upper, compiled=compiled)
        for compiled in (True, False)
    )
    assert mine.x[:] == same.x[:]


def test_what_grows_without_end_and_what_cannot_be_have_no_answer() -> None:
    upper = np.ones(2)
    endless = np.full(2, np.inf)
    row = np.array([[1.0, -1.0]])
    assert solved(row, np.zeros(1), upper, 0.0 * upper, endless) is None
    assert solved(row, np.full(1, 3.0), upper, 0.0 * upper, upper) is None

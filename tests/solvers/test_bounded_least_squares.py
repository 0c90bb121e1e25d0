"""Bounded least squares: optimality on random problems, against SciPy and by its own conditions."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from compiler import needs_compiler
from scipy.optimize import lsq_linear, minimize

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.solvers.bounded_least_squares import (
    BoundedProblem,
    LeastSquaresRows,
    room_for,
    solve_bounded,
)


def bounded_least_squares(
    A: np.ndarray,
    b: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    weight: np.ndarray,
    *,
    compiled: bool = True,
) -> np.ndarray:
    """Return x (n,) [x] for A (m, n) [b/x], b (m,) [b], lower, upper (n,) [x] and weight (n,)
    [1/x^2]; in C unless `compiled` is false or there is no compiler.
    """
    m, n = A.shape
    sizes = (A.shape[0], room_for(A.shape[1]))
    problem, solve = _bound(*sizes, compiled)
    p: Any = problem()
    p.rows = m
    p.columns = n
    p.b[:] = b.tolist()
    for i in range(m):
        p.A[i][:n] = A[i].tolist()
    for name, values in (("lower", lower), ("upper", upper), ("weight", weight)):
        getattr(p, name)[:n] = values.tolist()
    solve(p)
    return np.array(p.x[:n])


@lru_cache(maxsize=16)
def _bound(m: int, n: int, compiled: bool) -> tuple[type[BoundedProblem], Callable[..., Any]]:
    problem = structure_of(BoundedProblem, m=m, n=n)
    inner = structure_of(LeastSquaresRows, m=m, n=n)
    return problem, bind_kernels((solve_bounded,), (inner, problem), compiled=compiled)[0]


def random_problem(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 11))
    rank = int(rng.integers(1, 7))
    A = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, n))
    b = 10.0 ** rng.uniform(-2, 2) * rng.normal(size=6)
    return A, b, -rng.uniform(0.0, 2.0, n), rng.uniform(0.0, 2.0, n), rng.uniform(0.1, 10.0, n)


@pytest.mark.parametrize("seed", range(100))
def test_no_point_inside_the_bounds_has_a_smaller_residual(seed: int) -> None:
    A, b, lower, upper, weight = random_problem(seed)
    x = bounded_least_squares(A, b, lower, upper, weight)
    assert (x >= lower).all()
    assert (x <= upper).all()
    oracle = lsq_linear(A, b, (lower, upper + 1e-300), method="bvls", tol=1e-15)
    assert 0.5 * np.sum((A @ x - b) ** 2) <= oracle.cost + 1e-10 * (1.0 + b @ b)


@pytest.mark.parametrize("seed", range(40))
def test_among_equal_residuals_the_weighted_norm_is_the_smallest(seed: int) -> None:
    A, b, lower, upper, weight = random_problem(seed)
    x = bounded_least_squares(A, b, lower, upper, weight)
    same = {"type": "eq", "fun": lambda y: A @ (y - x), "jac": lambda y: A}
    bounds = list(zip(lower, upper, strict=True))
    options = {"ftol": 1e-14, "maxiter": 500}
    oracle = minimize(
        lambda y: y @ (weight * y),
        x,
        jac=lambda y: 2 * weight * y,
        bounds=bounds,
        constraints=same,
        options=options,
    )
    assert x @ (weight * x) <= oracle.fun + 1e-6 * (1.0 + oracle.fun)


def test_equal_bounds_fix_a_variable() -> None:
    x = bounded_least_squares(
        np.eye(2), np.array([3.0, 3.0]), np.array([1.0, -9.0]), np.array([1.0, 9.0]), np.ones(2)
    )
    np.testing.assert_allclose(x, [1.0, 3.0], atol=1e-12)


@needs_compiler
@pytest.mark.parametrize("seed", range(20))
def test_python_and_c_give_the_same_bits(seed: int) -> None:
    problem = random_problem(seed)
    np.testing.assert_array_equal(
        bounded_least_squares(*problem), bounded_least_squares(*problem, compiled=False)
    )


@pytest.mark.parametrize("seed", range(30))
def test_without_bounds_it_is_the_weighted_least_squares_of_least_norm(seed: int) -> None:
    A, b, _, _, weight = random_problem(seed)
    far = np.full(len(weight), 1e6)
    x = bounded_least_squares(A, b, -far, far, weight)
    scale = np.sqrt(weight)
    oracle = np.linalg.pinv(A / scale, rcond=1e-9) @ b / scale
    np.testing.assert_allclose(x, oracle, rtol=1e-9, atol=1e-9 * np.abs(oracle).max())


def test_rows_that_are_all_zero_leave_the_smallest_norm() -> None:
    x = bounded_least_squares(
        np.zeros((6, 3)),
        np.ones(6),
        np.array([-1.0, 0.5, -3.0]),
        np.array([1.0, 2.0, -1.0]),
        np.ones(3),
    )
    np.testing.assert_allclose(x, [0.0, 0.5, -1.0], atol=1e-12)

"""Validity, gates and residuals of rows are the same in NumPy, in CasADi and in C."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler
from hierarchies import random_hierarchy
from hierarchy_solvers.daqp_hierarchy import Daqp
from test_hierarchy import _tick_function

from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.core import STATUSES
from uvms_ocp.solvers.hierarchy.level import Level, is_valid, residual, widen_bounds

M = 4
N = 3
Strict = LexicographicActiveSet | LexicographicQp | Daqp
STRICT = [
    LexicographicActiveSet(),
    LexicographicActiveSet(compiled=False),
    LexicographicQp(),
    Daqp(),
]
Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
ODD = (np.nan, np.inf, -np.inf, 1e15, -1e16, 2.0, -0.1)


def _random_rows(rng: np.random.Generator) -> Rows:
    """Valid rows with infinite bounds, equalities, rows of zeros and gates of every kind."""
    J = rng.standard_normal((M, N))
    lower = rng.standard_normal(M)
    upper = lower + np.where(rng.random(M) < 0.4, 0.0, rng.random(M))
    J[rng.random(M) < 0.1] = 0.0
    lower[rng.random(M) < 0.3] = -np.inf
    upper[rng.random(M) < 0.3] = np.inf
    return J, lower, upper, np.clip(rng.uniform(-0.5, 1.5, M), 0.0, 1.0)


def _cases(count: int) -> Iterator[Rows]:
    """Rows of which two in three have one odd entry, which may make them invalid."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        rows = _random_rows(rng)
        if rng.random() < 2 / 3:
            rows[rng.integers(4)].flat[rng.integers(M)] = rng.choice(ODD)
        yield rows


@pytest.fixture(scope="module")
def expressions() -> ca.Function:
    J = ca.MX.sym("J", M, N)
    v = ca.MX.sym("v", N)
    lower, upper, gate = (ca.MX.sym(name, M) for name in ("lower", "upper", "gate"))
    outputs = [
        is_valid(J, lower, upper, gate),
        *widen_bounds(J, lower, upper, gate),
        residual(J, v, lower, upper, gate),
    ]
    return ca.Function("rows", [J, lower, upper, gate, v], outputs)


@pytest.fixture(scope="module")
def core() -> ca.Function:
    function = LexicographicActiveSet().function(_tick_function(N, M), [M])
    assert function is not None
    return function


def _solved(
    core: ca.Function, J: np.ndarray, lower: np.ndarray, upper: np.ndarray, gate: np.ndarray
) -> list:
    unread = np.zeros(M)
    cold = np.zeros(M)
    v, _, report, missed, _ = core(J, lower, upper, unread, unread, gate, cold)
    return [np.array(v).ravel(), STATUSES[int(report[0])], np.array(missed).ravel()]


def test_expressions_and_numbers_agree(expressions: ca.Function) -> None:
    valid_cases = 0
    for rows in _cases(300):
        J, lower, upper, gate = rows
        v = np.arange(1.0, N + 1)
        valid, low, up, missed = (np.array(x).ravel() for x in expressions(*rows, v))
        assert bool(valid[0]) == bool(is_valid(*rows))
        if valid[0]:
            np.testing.assert_allclose([low, up], widen_bounds(*rows), rtol=1e-14, atol=1e-14)
            np.testing.assert_allclose(missed, residual(J, v, lower, upper, gate), atol=1e-14)
            valid_cases += 1
    assert 100 < valid_cases < 250


@needs_compiler
def test_the_core_in_c_takes_the_rows_that_are_valid_and_no_others(core: ca.Function) -> None:
    for rows in _cases(300):
        v, status, missed = _solved(core, *rows)
        assert (status.usable) == bool(is_valid(*rows)), rows
        if not status.usable:
            assert not v.any()
            assert not missed.any()


@needs_compiler
def test_the_core_in_c_gates_the_rows_and_tells_their_residuals_as_numpy_does(
    core: ca.Function,
) -> None:
    for seed in range(300):
        J, lower, upper, gate = _random_rows(np.random.default_rng(seed))
        v, _, missed = _solved(core, J, lower, upper, gate)
        widened, _, _ = _solved(core, J, *widen_bounds(J, lower, upper, gate), np.ones(M))
        np.testing.assert_allclose(v, widened, atol=1e-12)
        np.testing.assert_allclose(missed, residual(J, v, lower, upper, gate), atol=1e-12)


def test_a_gate_of_one_keeps_the_bounds_and_a_gate_of_zero_leaves_none() -> None:
    J, lower, upper, _ = _random_rows(np.random.default_rng(0))
    np.testing.assert_array_equal(widen_bounds(J, lower, upper, np.ones(M)), [lower, upper])
    np.testing.assert_array_equal(
        widen_bounds(J, lower, upper, np.zeros(M)), [np.full(M, -np.inf), np.full(M, np.inf)]
    )


def test_bounds_widen_without_a_jump_as_the_gate_closes() -> None:
    J = np.ones((1, N))
    bound = np.ones(1)
    widths = [
        float(np.diff(widen_bounds(J, bound, bound, np.array([gate])), axis=0)[0, 0])
        for gate in (1.0, 0.999, 0.5, 0.1)
    ]
    np.testing.assert_allclose(widths, [0.0, 2 * N * np.sqrt(0.001 / 0.999), 2 * N, 6 * N])


@pytest.mark.parametrize("gate", [5e-324, 1e-300, 1e-9])
def test_the_smallest_gates_leave_numbers_also_of_rows_of_zeros(gate: float) -> None:
    J = np.array([[0.0] * N, [1.0] * N])
    bound = np.ones(2)
    low, up = widen_bounds(J, bound, bound, np.full(2, gate))
    assert (low[0], up[0]) == (1.0, 1.0)
    assert low[1] < -1e4
    assert up[1] > 1e4


@pytest.mark.sampled
@pytest.mark.parametrize("solver", STRICT)
def test_a_gate_that_closes_leads_to_the_problem_without_its_rows_and_one_that_opens_to_that_with_them(
    solver: Strict,
) -> None:
    mattered = 0
    for seed in range(20):
        levels = random_hierarchy(seed, 7, (7, 2, 3, 1, 2, 7))
        index = 1 + seed % 4
        removed = _velocity(solver, levels, index, 0.0)
        with_row = _velocity(solver, levels, index, 1.0)
        mattered += int(np.abs(removed - with_row).max() > 1e-3)
        for gate in (5e-324, 1e-9, 1e-3):
            np.testing.assert_allclose(
                _velocity(solver, levels, index, gate), removed, rtol=0.0, atol=1e-6
            )
        for opening in (1e-14, 1e-10):
            # The band is as wide as the root of what is left.
            difference = np.abs(_velocity(solver, levels, index, 1.0 - opening) - with_row).max()
            assert difference <= 1e3 * np.sqrt(opening), seed
    assert mattered >= 15


def _velocity(solver: Strict, levels: list[Level], index: int, gate: float) -> np.ndarray:
    """With one level of all behind a gate."""
    turned = levels[index]
    level = Level(jacobian=turned.jacobian, lower=turned.lower, upper=turned.upper, gate=gate)
    return solver.solve([*levels[:index], level, *levels[index + 1 :]]).v

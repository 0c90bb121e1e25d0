"""A hierarchy in other units has the same solution in those units, or a status that says that it
was not found.
"""

from __future__ import annotations

import numpy as np
import pytest
from hierarchies import random_hierarchy, reference
from hierarchy_solvers.daqp_hierarchy import Daqp
from test_hierarchy import _arguments, _tick_function

from uvms_ocp.codegen.c_compiler import has_compiler
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.certificate import level_excesses
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.hierarchy.solution import Solution, Status

Solver = LexicographicActiveSet | LexicographicQp | Daqp | Icat

ACTIVE_SETS = [LexicographicActiveSet(), LexicographicActiveSet(compiled=False)]
SOLVERS: list[Solver] = [*ACTIVE_SETS, LexicographicQp(), Daqp(), Icat()]
SIZES = (5, 2, 3, 2, 5)
POWERS = (-300, -150, -30, -12, -6, 6, 11, 14, 30, 150, 300)
# What is multiplied: of the Jacobian, of the bounds.
KINDS = {"rows": (1, 1), "velocities": (0, 1), "Jacobians": (1, 0)}


def _scaled(levels: list[Level], of_jacobian: list[float], of_bounds: list[float]) -> list[Level]:
    return [
        Level(jacobian=level.jacobian * f, lower=level.lower * g, upper=level.upper * g)
        for level, f, g in zip(levels, of_jacobian, of_bounds, strict=True)
    ]


def _is_right(solution: Solution, levels: list[Level], of_bounds: list[float]) -> bool:
    optimum, error = reference(levels)
    assert error.max() < 1e-10
    relative = solution.level_residuals / np.array(of_bounds)
    return bool(np.isfinite(solution.v).all() and np.abs(relative - optimum).max() < 1e-6)


@pytest.mark.sampled
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_scaled_hierarchy_is_solved_or_the_status_says_that_it_is_not(
    solver: Solver, kind: str
) -> None:
    on_jacobian, on_bounds = KINDS[kind]
    for seed, power in enumerate(POWERS):
        levels = random_hierarchy(seed, 5, SIZES)
        of_jacobian = [10.0 ** (power * on_jacobian)] * 5
        of_bounds = [10.0 ** (power * on_bounds)] * 5
        solution = solver.solve(_scaled(levels, of_jacobian, of_bounds))
        assert np.isfinite(solution.v).all()
        assert not solution.status.exact or _is_right(solution, levels, of_bounds), power


@pytest.mark.sampled
@pytest.mark.parametrize("solver", ACTIVE_SETS)
@pytest.mark.parametrize(
    ("kind", "largest"), [("rows", 14), ("velocities", 299), ("Jacobians", 14)]
)
def test_the_active_set_is_exact_at_every_scale(
    solver: LexicographicActiveSet, kind: str, largest: int
) -> None:
    on_jacobian, on_bounds = KINDS[kind]
    for seed, power in enumerate((*POWERS[1:], -290, -200, 3, 8, 13)):
        if power > largest:
            continue
        levels = random_hierarchy(seed, 5, SIZES)
        of_jacobian = [10.0 ** (power * on_jacobian)] * 5
        of_bounds = [10.0 ** (power * on_bounds)] * 5
        solution = solver.solve(_scaled(levels, of_jacobian, of_bounds))
        assert solution.status.exact, power
        assert _is_right(solution, levels, of_bounds), power


@pytest.mark.sampled
@pytest.mark.parametrize("solver", ACTIVE_SETS)
def test_every_level_may_have_its_own_unit(solver: LexicographicActiveSet) -> None:
    for seed in range(10):
        levels = random_hierarchy(seed, 5, SIZES)
        factors = (10.0 ** np.random.default_rng(seed).uniform(-6, 6, 5)).tolist()
        solution = solver.solve(_scaled(levels, factors, factors))
        assert not solution.status.exact or _is_right(solution, levels, factors), seed
        assert solution.status.exact, seed


def _is_proven(solution: Solution, levels: list[Level], units: list[float]) -> bool:
    """Whether no level can be better by more than 1e-6 of its own unit, or by what nobody would
    notice.
    """
    excess = level_excesses(levels, solution.v)
    size = np.maximum(solution.level_residuals, units)
    return bool((excess < np.maximum(1e-6 * size, 1e-11)).all())


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_result_is_exact_where_rows_that_vanish_beside_others_are_missed(solver: Solver) -> None:
    small = Level(jacobian=[[1.0, 0.0]], lower=1.0, upper=1.0)
    large = Level(jacobian=[[0.0, 1.0]], lower=1.0, upper=1.0)
    for power in (10, 12, 13, 14):
        units = [1.0, 10.0**power]
        levels = _scaled([small, large], units, units)
        for of in (slice(None), slice(None, None, -1)):
            solution = solver.solve(levels[of])
            assert not solution.status.exact or _is_proven(solution, levels[of], units[of]), power
    for seed in range(20):
        units = (10.0 ** np.random.default_rng(seed).uniform(-14, 14, 5)).tolist()
        levels = _scaled(random_hierarchy(seed, 5, SIZES), units, units)
        solution = solver.solve(levels)
        assert not solution.status.exact or _is_proven(solution, levels, units), seed


@pytest.mark.parametrize("solver", ACTIVE_SETS)
def test_noise_that_asks_for_nothing_leaves_a_result_exact(solver: LexicographicActiveSet) -> None:
    noise = Level(jacobian=[[1e-16, 1e-17]], lower=0.0, upper=0.0)
    solution = solver.solve([Level(jacobian=[[1.0, 0.0]], lower=1.0, upper=1.0), noise])
    assert solution.status.exact
    np.testing.assert_allclose(solution.v, [1.0, 0.0], atol=1e-15)


def test_factors_of_two_change_no_digit() -> None:
    """In C. In NumPy the order of sums is up to the processor's kernels."""
    for solver in ACTIVE_SETS:
        for power in (-600, -40, 40):
            levels = random_hierarchy(3, 5, SIZES)
            solution = solver.solve(_scaled(levels, [1.0] * 5, [2.0**power] * 5))
            expected = solver.solve(levels).v
            rounding = 0.0 if solver.compiled and has_compiler() else 1e-12 * np.abs(expected).max()
            np.testing.assert_allclose(solution.v / 2.0**power, expected, rtol=0, atol=rounding)


@pytest.mark.parametrize("size", [1e200, 1e308])
def test_an_overflow_in_the_regularised_solver_is_invalid_and_no_velocity(size: float) -> None:
    levels = [Level(jacobian=size * np.eye(3), lower=1.0, upper=1.0)]
    solution = Icat().solve(levels)
    assert solution.status is Status.INVALID_INPUT
    np.testing.assert_array_equal(solution.v, np.zeros(3))
    result = Icat().bind(_tick_function(3, 3), [3])(*_arguments(levels))
    assert result.status is Status.INVALID_INPUT
    np.testing.assert_array_equal(result.v, np.zeros(3))


@pytest.mark.sampled
@pytest.mark.parametrize(
    "solver", [LexicographicQp(), LexicographicQp(tolerance=1e-3), Daqp(), Daqp(tolerance=1e-3)]
)
def test_what_others_find_is_exact_only_if_it_is_certified(solver: LexicographicQp | Daqp) -> None:
    exact = []
    for seed in range(60):
        levels = random_hierarchy(seed, 6, (6, 2, 3, 6))
        solution = solver.solve(levels)
        exact.append(solution.status.exact)
        size = max(1.0, solution.level_residuals.max())
        assert not solution.status.exact or solution.certificate(levels) < 2e-6 * size, seed
    assert any(exact)


def test_what_is_not_certified_is_not_called_exact() -> None:
    levels = [Level(jacobian=np.eye(2), lower=1.0, upper=1.0)]
    assert LexicographicQp().solve(levels).status is Status.SOLVED
    assert LexicographicQp(certified=False).solve(levels).status is Status.INEXACT

"""The active-set solver is exact, says so truthfully, and does not depend on a compiler."""

from __future__ import annotations

import re
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from compiler import IN_C_AND_PYTHON, needs_compiler
from hierarchies import dependent_hierarchy, random_hierarchy, reference
from test_hierarchy import _arguments, _tick_function

from uvms_ocp.codegen.c_text import constants_of
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet, core_source
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.certificate import certificate, normal_rows
from uvms_ocp.solvers.hierarchy.iteration_budget import iteration_budget
from uvms_ocp.solvers.hierarchy.level import Level, stack, widen_bounds
from uvms_ocp.solvers.hierarchy.solution import Status

COMPILED = LexicographicActiveSet()
NUMPY = LexicographicActiveSet(compiled=False)
STRUCTURES = [
    (1, (2, 0, 1)),
    (4, (3, 2, 2)),
    (7, (1, 0, 6, 2, 7)),
    (13, (6, 6, 6, 3, 13)),
    (60, (20, 9, 30)),
]


@pytest.mark.parametrize("seed", range(40))
def test_levels_reach_the_reference(seed: int) -> None:
    levels = random_hierarchy(seed, 9, (9, 2, 4, 3, 3, 9))
    optimum, error = reference(levels)
    assert error.max() < 1e-10
    solution = COMPILED.solve(levels)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.level_residuals, optimum, atol=1e-7)


@pytest.mark.sampled
@pytest.mark.parametrize(("n", "sizes"), STRUCTURES)
def test_dependent_and_conflicting_rows_are_solved_exactly(n: int, sizes: tuple[int, ...]) -> None:
    for seed in range(100):
        levels = dependent_hierarchy(seed, n, sizes)
        solution = COMPILED.solve(levels)
        assert solution.status is Status.SOLVED, seed
        assert solution.certificate(levels) < 1e-9, seed


@pytest.mark.sampled
@pytest.mark.parametrize("nearly", [1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5])
@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_nearly_dependent_rows_end_with_a_truthful_status(nearly: float, compiled: bool) -> None:
    solver = LexicographicActiveSet(compiled=compiled)
    for n, sizes in ((4, (3, 2, 2)), (7, (1, 0, 6, 2, 7))):
        for seed in range(60 if compiled else 8):
            levels = dependent_hierarchy(seed, n, sizes, nearly)
            solution = solver.solve(levels)
            assert np.isfinite(solution.v).all()
            size = max(1.0, solution.level_residuals.max())
            # Without end no bound can be told where rows are nearly dependent: multipliers have too
            # few digits.
            lost = certificate(levels, solution.v, radius=tolerances.REACH * asked_velocity(levels))
            assert not solution.status.exact or lost < 5e-7 * size, (n, seed)


def asked_velocity(levels: list[Level]) -> float:
    """Size of the velocities that rows ask for, of which a status speaks."""
    rows = stack(levels)
    bounds = widen_bounds(rows.jacobian, rows.lower, rows.upper, rows.gate)
    return normal_rows(rows.jacobian, *bounds, [level.n_rows for level in levels]).velocity


def test_rows_dependent_to_1e_4_are_solved() -> None:
    for seed in range(60):
        levels = dependent_hierarchy(seed, 7, (1, 0, 6, 2, 7), 1e-4)
        assert COMPILED.solve(levels).status.exact, seed


@pytest.mark.parametrize("solver", [pytest.param(COMPILED, marks=needs_compiler), NUMPY])
@pytest.mark.parametrize("decades", [1, 4])
def test_rows_of_very_different_scale_end_with_a_truthful_status(
    solver: LexicographicActiveSet, decades: int
) -> None:
    exact = 0
    for seed in range(40 if solver.compiled else 8):
        rng = np.random.default_rng(seed)
        sizes = [
            10.0 ** rng.uniform(-decades, decades, level.n_rows)
            for level in random_hierarchy(seed, 8, (8, 2, 4, 2, 8))
        ]
        levels = [
            Level(
                jacobian=level.jacobian * f[:, None], lower=level.lower * f, upper=level.upper * f
            )
            for level, f in zip(random_hierarchy(seed, 8, (8, 2, 4, 2, 8)), sizes, strict=True)
        ]
        solution = solver.solve(levels)
        exact += solution.status.exact
        size = max(1.0, solution.level_residuals.max())
        assert not solution.status.exact or solution.certificate(levels) < 2e-7 * size, seed
    assert exact > 0


def test_what_is_given_up_on_nearly_dependent_rows_is_never_the_box_on_top() -> None:
    box = Level(jacobian=np.eye(7), lower=-0.5, upper=0.5)
    for seed in range(60):
        levels = [box, *dependent_hierarchy(seed, 7, (1, 0, 6, 2, 7), 1e-7)]
        assert np.abs(COMPILED.solve(levels).v).max() <= 0.5 + 1e-9, seed


@needs_compiler
@pytest.mark.parametrize(("n", "sizes"), STRUCTURES[:4])
def test_numpy_and_c_give_the_same(n: int, sizes: tuple[int, ...]) -> None:
    for seed in range(20):
        levels = dependent_hierarchy(seed, n, sizes)
        ours = COMPILED.solve(levels)
        theirs = NUMPY.solve(levels)
        np.testing.assert_allclose(ours.level_residuals, theirs.level_residuals, atol=1e-10)
        assert ours.status is theirs.status
        if np.linalg.matrix_rank(levels[-1].jacobian) == n:
            np.testing.assert_allclose(ours.v, theirs.v, atol=1e-8)


@pytest.mark.sampled
@pytest.mark.parametrize("solver", [pytest.param(COMPILED, marks=needs_compiler), NUMPY])
def test_a_warm_tick_follows_slow_changes_exactly(solver: LexicographicActiveSet) -> None:
    rng = np.random.default_rng(0)
    levels = random_hierarchy(2)
    tick = solver.bind(_tick_function(13, 59), [level.n_rows for level in levels])
    J, *bounds = _arguments(levels)
    for _ in range(50):
        J = J + np.where(np.arange(59)[:, None] < 46, 1e-3, 0.0) * rng.standard_normal(J.shape)
        result = tick(J, *bounds)
        assert result.status is Status.SOLVED
        start = np.cumsum([0, *(level.n_rows for level in levels)])
        active_sets = [
            Level(jacobian=J[a:b], lower=bounds[0][a:b], upper=bounds[1][a:b])
            for a, b in pairwise(start)
        ]
        assert certificate(active_sets, result.v) < 1e-9


@pytest.mark.sampled
@pytest.mark.parametrize("solver", [pytest.param(COMPILED, marks=needs_compiler), NUMPY])
def test_a_tick_that_reads_its_inputs_where_they_are_gives_what_a_call_gives(
    solver: LexicographicActiveSet,
) -> None:
    """Also where it recovers from an input that is no number."""
    rng = np.random.default_rng(0)
    levels = random_hierarchy(2)
    sizes = [level.n_rows for level in levels]
    called = solver.bind(_tick_function(13, 59), sizes)
    inputs = [np.asfortranarray(x) for x in _arguments(levels)]
    adopted = solver.bind(_tick_function(13, 59), sizes).adopt(*inputs)
    for k in range(20):
        inputs[0] += np.where(np.arange(59)[:, None] < 46, 1e-3, 0.0) * rng.standard_normal(
            (59, 13)
        )
        inputs[1][3] = np.nan if k == 10 else -1.0
        mine = adopted()
        result = called(*inputs)
        np.testing.assert_allclose(mine.v, result.v, atol=1e-9)
        np.testing.assert_allclose(mine.residual, result.residual, atol=1e-9)
        assert mine.status is result.status
        assert mine.status.usable is (k != 10)


def test_an_equality_that_becomes_an_inequality_is_released() -> None:
    tick = COMPILED.bind(_tick_function(2, 3), [1, 2])
    J = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    bounds = [np.zeros(3), np.ones(3), np.ones(3)]
    first = tick(J, [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], *bounds)
    np.testing.assert_allclose(first.v, [1.0, 0.0], atol=1e-12)
    second = tick(J, [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], *bounds)
    np.testing.assert_allclose(second.v, [0.0, 0.0], atol=1e-12)


@needs_compiler
def test_the_function_is_pure_and_can_be_mapped() -> None:
    levels = random_hierarchy(5)
    function = COMPILED.function(_tick_function(13, 59), [level.n_rows for level in levels])
    assert function is not None
    inputs = [*_arguments(levels), np.zeros(59)]
    once = np.asarray(function(*inputs)[0]).ravel()
    mapped = function.map(3)(*[ca.repmat(ca.DM(x), 1, 3) for x in inputs])[0]
    for i in range(3):
        np.testing.assert_array_equal(np.asarray(mapped)[:, i], once)


@pytest.mark.parametrize("solver", [pytest.param(COMPILED, marks=needs_compiler), NUMPY])
@pytest.mark.parametrize("wrong", [0, 1, 2, 5])
def test_nan_gives_zero_velocity_and_says_so(solver: LexicographicActiveSet, wrong: int) -> None:
    levels = random_hierarchy(4)
    tick = solver.bind(_tick_function(13, 59), [level.n_rows for level in levels])
    arguments = [array.copy() for array in _arguments(levels)]
    arguments[wrong].flat[7] = np.nan
    result = tick(*arguments)
    assert result.status is Status.INVALID_INPUT
    assert not result.v.any()
    assert tick(*_arguments(levels)).status is Status.SOLVED


def test_lower_levels_never_change_higher_ones() -> None:
    for seed in range(30):
        levels = random_hierarchy(seed)
        whole = COMPILED.solve(levels)
        part = COMPILED.solve(levels[:6])
        np.testing.assert_allclose(part.level_residuals, whole.level_residuals[:6], atol=1e-8)


def test_the_certificate_fails_for_a_perturbed_solution() -> None:
    rng = np.random.default_rng(3)
    for seed in range(20):
        levels = random_hierarchy(seed)
        v = COMPILED.solve(levels).v
        assert certificate(levels, v) < 1e-11
        assert certificate(levels, v + 1e-5 * rng.standard_normal(13)) > 1e-7


def test_the_certificate_sees_a_level_that_gave_way_to_a_lower_one() -> None:
    upper = np.array([[1.0, 0.0]])
    lower = np.array([[1.0, 0.0], [0.0, 1.0]])
    levels = [
        Level(jacobian=upper, lower=1.0, upper=1.0),
        Level(jacobian=lower, lower=0.0, upper=0.0),
    ]
    assert certificate(levels, np.array([1.0, 0.0])) < 1e-15
    assert certificate(levels, np.array([0.5, 0.0])) > 0.1


def test_the_certificate_accepts_the_cascade_within_its_accuracy() -> None:
    levels = random_hierarchy(7)
    solution = LexicographicQp().solve(levels)
    assert solution.certificate(levels) < 1e-3


def test_empty_hierarchies_and_levels_are_handled() -> None:
    with pytest.raises(InvalidInput, match="levels is empty"):
        COMPILED.solve([])
    for solver in (COMPILED, NUMPY):
        solution = solver.solve([Level(jacobian=np.zeros((0, 3)))])
        assert solution.status is Status.SOLVED
        np.testing.assert_array_equal(solution.v, np.zeros(3))


def test_the_core_needs_libm_only() -> None:
    includes = [
        line for line in core_source(3, (1, 0, 2)).splitlines() if line.startswith("#include")
    ]
    assert includes == ["#include <math.h>", "#include <string.h>"]
    assert "#define LEVEL_SIZES 1, 2" in core_source(3, (1, 0, 2))


def test_the_core_in_c_has_the_tolerances_and_the_patience_of_python() -> None:
    source = core_source(3, (1, 0, 2))
    for name, value in (constants_of(tolerances) | asdict(iteration_budget(3))).items():
        (defined,) = re.findall(rf"^#define {name.upper()} (.+)$", source, re.MULTILINE)
        assert float(defined) == value


@pytest.mark.sampled
@pytest.mark.parametrize(
    "solver", [pytest.param(COMPILED, marks=needs_compiler), NUMPY, LexicographicQp()]
)
def test_threads_that_share_a_solver_get_their_own_answers(
    solver: LexicographicActiveSet | LexicographicQp,
) -> None:
    def wrong(value: float) -> int:
        level = Level(jacobian=np.eye(4), lower=value, upper=value)
        return sum(not np.allclose(solver.solve([level]).v, value) for _ in range(400))

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as pool:
            assert list(pool.map(wrong, [1.0, 2.0])) == [0, 0]
    finally:
        sys.setswitchinterval(interval)


@pytest.mark.parametrize("solver", [pytest.param(COMPILED, marks=needs_compiler), NUMPY])
def test_what_overflows_is_never_called_exact(solver: LexicographicActiveSet) -> None:
    levels = [Level(jacobian=np.eye(2), lower=[1e300, 0.0], upper=[1e300, 0.0])]
    assert certificate(levels, np.zeros(2)) == pytest.approx(1e300)
    assert certificate(levels, [np.inf, 0.0]) == np.inf
    solution = solver.solve(levels)
    assert np.isfinite(solution.v).all()
    assert not solution.status.exact or np.allclose(solution.v, [1e300, 0.0])

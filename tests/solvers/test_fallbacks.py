"""Where the core gives up, what is tried next finds the same optimum, or keeps the levels in their
order and says so.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from compiler import needs_compiler
from hierarchies import dependent_hierarchy, random_hierarchy, reference

from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.solvers.hierarchy import active_set_numpy as fallbacks, tolerances
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet, core_source
from uvms_ocp.solvers.hierarchy.active_set_numpy import SolvedRows, solve_levels
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.certificate import NormalRows, normal_certificate, normal_rows
from uvms_ocp.solvers.hierarchy.core import STATUSES
from uvms_ocp.solvers.hierarchy.iteration_budget import iteration_budget
from uvms_ocp.solvers.hierarchy.level import Level, stack
from uvms_ocp.solvers.hierarchy.solution import Status

COMPILED = LexicographicActiveSet()
NUMPY = LexicographicActiveSet(compiled=False)
SIZES = (6, 2, 3, 2, 6)
FIRST = """  attempt(s, state);
  if (is_proven(s)) return SOLVED;
"""
LEVEL_BY_LEVEL = "by_levels(s, &ORDINARY) || by_levels(s, &CAREFUL) || by_fewer_levels(s)"
# What the core leaves unsolved: by how much rows are dependent, velocities, rows of each level,
# seeds.
LEFT = [
    (1e-6, 7, (1, 0, 6, 2, 7), (26,)),
    (1e-6, 13, (6, 6, 6, 3, 13), (0, 6, 7, 12, 28)),
    (1e-7, 4, (3, 2, 2), (0,)),
    (1e-7, 7, (1, 0, 6, 2, 7), (0, 3, 6, 10, 11, 17)),
    (1e-8, 4, (3, 2, 2), (0, 4, 19, 26)),
    (1e-8, 7, (1, 0, 6, 2, 7), (5, 11, 13, 14, 16, 17, 18)),
    (1e-9, 7, (1, 0, 6, 2, 7), (9, 11, 13, 18, 28)),
]


def _left() -> list[list[Level]]:
    return [
        dependent_hierarchy(seed, n, sizes, nearly)
        for nearly, n, sizes, seeds in LEFT
        for seed in seeds
    ]


def _broken(levels: list[Level], source: Callable[[str], str]) -> SolvedRows:
    """What the solver in C finds with another source, from a cold start."""
    rows = stack(levels)
    n = rows.jacobian.shape[1]
    v, active_set, (code, iterations), residual = (
        np.array(result).ravel()
        for result in _function(source(core_source(n, rows.sizes)))(
            rows.jacobian,
            rows.lower,
            rows.upper,
            rows.rate,
            rows.activation,
            rows.gate,
            np.zeros(len(rows.lower)),
        )
    )
    status = STATUSES[int(code)]
    return SolvedRows(
        v=v, active_set=active_set, status=status, residual=residual, iterations=int(iterations)
    )


@cache
def _function(source: str) -> ca.Function:
    return ca.external("solve_hierarchy", str(compile_library(source)))


def _without(*parts: str) -> Callable[[str], str]:
    """The source without all `parts` but the last, which takes the place of the one before it."""
    *old, new = parts

    def changed(source: str) -> str:
        for i, part in enumerate(old):
            assert part in source
            source = source.replace(part, new if i == len(old) - 1 else "")
        return source

    return changed


def _certificate(levels: list[Level], v: np.ndarray) -> float:
    rows = stack(levels)
    normal = normal_rows(rows.jacobian, rows.lower, rows.upper, rows.sizes)
    return normal_certificate(normal, v / normal.velocity)


@needs_compiler
@pytest.mark.parametrize("care", ["ORDINARY", "CAREFUL"])
def test_level_by_level_finds_what_the_core_finds(care: str) -> None:
    only = _without(FIRST, LEVEL_BY_LEVEL, f"by_levels(s, &{care})")
    for seed in range(40):
        levels = (
            random_hierarchy(seed, 6, SIZES) if seed % 2 else dependent_hierarchy(seed, 6, SIZES)
        )
        result = _broken(levels, only)
        usual = COMPILED.solve(levels)
        assert result.status is Status.CASCADED, seed
        assert _certificate(levels, result.v) <= tolerances.CERTIFIED
        np.testing.assert_allclose(result.residual, np.concatenate(usual.residuals), atol=1e-7)


@needs_compiler
def test_with_fewer_levels_those_above_are_at_their_optimum() -> None:
    """As if only the levels below could not be solved."""
    only = _without(FIRST, LEVEL_BY_LEVEL, "by_fewer_levels(s)")
    statuses = set()
    sizes = (6, 1, 1, 2, 6)
    for seed in range(20):
        levels = random_hierarchy(seed, 6, sizes)
        result = _broken(levels, only)
        optimum, error = reference(levels[:-1])
        assert error.max() < 1e-10
        missed = np.split(result.residual, np.cumsum(sizes)[:-1])[:-1]
        np.testing.assert_allclose([np.linalg.norm(r) for r in missed], optimum, atol=1e-7)
        assert result.status.exact == (_certificate(levels, result.v) <= tolerances.CERTIFIED)
        statuses.add(result.status)
    assert Status.INEXACT in statuses


@pytest.mark.parametrize("fails", [1, 2])
def test_in_numpy_level_by_level_takes_over_where_the_core_gives_up(
    fails: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = fallbacks.lexicographic_least_squares
    calls = []

    def lost(*arguments: object) -> tuple[np.ndarray, np.ndarray, int]:
        calls.append(arguments)
        v, state, iterations = honest(*arguments)  # type: ignore[arg-type]
        return (np.full_like(v, np.nan) if len(calls) <= fails else v), state, iterations

    monkeypatch.setattr(fallbacks, "lexicographic_least_squares", lost)
    rows = stack(random_hierarchy(1, 6, SIZES))
    warm = np.ones(len(rows.lower)) if fails == 2 else np.zeros(len(rows.lower))
    result = solve_levels(rows.jacobian, rows.lower, rows.upper, rows.gate, warm, SIZES)
    assert result.status is Status.CASCADED
    np.testing.assert_allclose(result.v, COMPILED.solve(random_hierarchy(1, 6, SIZES)).v, atol=1e-8)


@needs_compiler
def test_a_velocity_that_is_not_certified_is_the_best_and_called_inexact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In C and in NumPy, whose runs all end at the optimum here, which nobody certifies."""
    monkeypatch.setattr(fallbacks, "normal_certificate", lambda rows, w: np.inf)
    never = _without("#define CERTIFIED 1e-07", "#define CERTIFIED -1")
    for seed in range(8):
        levels = random_hierarchy(seed, 6, SIZES)
        usual = COMPILED.solve(levels)
        for result in (NUMPY.solve(levels), _broken(levels, never)):
            assert result.status is Status.INEXACT
            np.testing.assert_allclose(result.v, usual.v, atol=1e-8)


def test_where_no_run_ends_at_a_number_the_velocity_is_zero(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lost(rows: NormalRows, *_: object) -> tuple[np.ndarray, np.ndarray, int]:
        return np.full(rows.J.shape[1], np.nan), np.zeros(len(rows.J)), 1

    monkeypatch.setattr(fallbacks, "lexicographic_least_squares", lost)
    solution = NUMPY.solve(random_hierarchy(1))
    assert solution.status is Status.INEXACT
    np.testing.assert_array_equal(solution.v, 0.0)


@needs_compiler
def test_what_the_core_leaves_unsolved_is_solved_and_certified_by_someone_else() -> None:
    """Nearly dependent rows. A certificate holds for whatever found the velocity."""
    for levels in _left():
        solution = COMPILED.solve(levels)
        assert solution.status is Status.CASCADED
        assert _certificate(levels, solution.v) <= 10.0 * tolerances.CERTIFIED


@pytest.mark.slow
def test_from_where_quadratic_programs_end_it_is_solved_too() -> None:
    """By themselves they leave more than half of it inexact."""
    cascade = LexicographicQp()
    exact = [cascade.solve(levels).status.exact for levels in _left()]
    assert np.mean(exact) > 0.9


@needs_compiler
def test_where_velocities_have_limits_the_status_does_not_depend_on_a_compiler() -> None:
    """Without limits velocities of a million come of nearly dependent rows, and rounding decides
    what can be proven.
    """
    box = Level(jacobian=np.eye(7), lower=-0.5, upper=0.5)
    statuses = set()
    for seed in range(60):
        levels = [box, *dependent_hierarchy(seed, 7, (1, 0, 6, 2, 7), 10.0 ** -(5 + seed % 5))]
        status = COMPILED.solve(levels).status
        assert NUMPY.solve(levels).status.exact is status.exact, seed
        statuses.add(status)
    assert statuses >= {Status.SOLVED, Status.CASCADED, Status.INEXACT}


@pytest.mark.slow
def test_in_numpy_nearly_all_of_it_is_solved_too() -> None:
    """Where rounding decides whether a bound is proven, it need not decide alike."""
    exact = [NUMPY.solve(levels).status.exact for levels in _left()]
    assert np.mean(exact) > 0.9


@pytest.mark.sampled
@pytest.mark.parametrize("solver", [pytest.param(COMPILED, marks=needs_compiler), NUMPY])
def test_no_level_is_worse_for_those_below_it(solver: LexicographicActiveSet) -> None:
    """Also where rows are so nearly dependent that nothing is certified: the first level that
    differs is better.
    """
    box = Level(jacobian=np.eye(7), lower=-0.5, upper=0.5)
    compared = 0
    for seed in range(60 if solver.compiled else 6):
        levels = [box, *dependent_hierarchy(seed, 7, (1, 2, 6, 2, 7), 1e-9)]
        whole = solver.solve(levels).level_residuals
        for k in range(1, len(levels)):
            part = solver.solve(levels[:k])
            if part.status is Status.SOLVED:
                worse = whole[:k] - part.level_residuals
                different = worse[np.abs(worse) > 1e-6]
                assert not different.size or different[0] < 0.0, (seed, k)
                compared += 1
    assert compared > (200 if solver.compiled else 20)


def _adversaries() -> list[list[Level]]:
    """Rows of few whole numbers, copied, combined and turned around, which stall and cycle; nearly
    dependent ones.
    """
    hierarchies = [dependent_hierarchy(seed, 6, SIZES, 10.0 ** -(seed % 12)) for seed in range(60)]
    for seed in range(120):
        rng = np.random.default_rng(seed)
        J = rng.integers(-1, 2, (sum(SIZES), 6)).astype(float)
        J[rng.integers(0, len(J), 8)] = -J[rng.integers(0, len(J), 8)]
        lower = rng.integers(-1, 2, len(J)).astype(float)
        upper = lower + rng.integers(0, 2, len(J))
        cut = np.cumsum(SIZES)[:-1]
        parts = zip(np.split(J, cut), np.split(lower, cut), np.split(upper, cut), strict=True)
        hierarchies.append([Level(jacobian=a, lower=b, upper=c) for a, b, c in parts])
    return hierarchies


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("certified", ["1e-07", "-1"])
def test_no_call_takes_more_iterations_than_are_stated(certified: str) -> None:
    """Even if nothing were certified, so that everything is tried."""
    budget = iteration_budget(sum(SIZES)).most_of_all
    assert budget == 120 + 60 * sum(SIZES)
    source = _without("#define CERTIFIED 1e-07", f"#define CERTIFIED {certified}")
    iterations = [_broken(levels, source).iterations for levels in _adversaries()]
    assert max(iterations) <= budget
    assert (max(iterations) > 0.75 * budget) == (certified == "-1")


def test_numpy_keeps_to_the_same_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fallbacks, "normal_certificate", lambda rows, w: np.inf)
    for levels in _adversaries()[::30]:
        rows = stack(levels)
        result = solve_levels(
            rows.jacobian, rows.lower, rows.upper, rows.gate, np.zeros(len(rows.lower)), SIZES
        )
        assert 3 * len(SIZES) <= result.iterations <= iteration_budget(len(rows.lower)).most_of_all


@needs_compiler
@pytest.mark.parametrize("fill", [0x7F, 0xFF])
def test_what_the_memory_held_before_changes_nothing(fill: int) -> None:
    soiled = _without(
        "int status = INVALID_INPUT;", f"int status = INVALID_INPUT; memset(&s, {fill}, sizeof(s));"
    )
    for seed in range(40):
        levels = dependent_hierarchy(seed, 6, SIZES, 10.0 ** -(seed % 12))
        np.testing.assert_array_equal(_broken(levels, soiled).v, _broken(levels, str).v)


@needs_compiler
def test_ticks_whose_rows_are_dependent_to_1e_7_are_solved_warm_in_c_as_in_numpy() -> None:
    """Two of obstacle_field. That they are solved is proven by multipliers of 1e7, which are hard
    to find.
    """
    ticks = np.load(Path(__file__).with_name("dependent_ticks.npz"))
    sizes = tuple(ticks["sizes"].tolist())
    for rows in zip(
        *(ticks[name] for name in ("jacobian", "lower", "upper", "gate", "active_set")), strict=True
    ):
        J, lower, upper, *inputs = rows
        core = _function(core_source(J.shape[1], sizes))
        v, _, report, _ = (np.array(x).ravel() for x in core(J, lower, upper, 0.0, 0.0, *inputs))
        result = solve_levels(*rows, sizes)
        assert STATUSES[int(report[0])] is result.status is Status.SOLVED
        assert report[1] <= 5
        np.testing.assert_allclose(v, result.v, atol=1e-6)

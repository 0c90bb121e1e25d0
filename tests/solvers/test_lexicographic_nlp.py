"""Laws of lexicographic nonlinear programs: known optima, and levels that keep what they
reached.
"""

from __future__ import annotations

import itertools

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicNlp, LexicographicResult
from uvms_ocp.solvers.nlp.options import NlpOptions, solver_options
from uvms_ocp.solvers.nlp.program import NlpLevel, NlpStatus, lexicographic_program

TIGHT = NlpOptions(tolerance=1e-9, convergence=1e-10)


def himmelblau(x: ca.SX) -> ca.SX:
    return ca.vertcat(x[0] ** 2 + x[1] - 11, x[0] + x[1] ** 2 - 7)


def rosenbrock(x: ca.SX) -> ca.SX:
    return ca.vertcat(10 * (x[1] - x[0] ** 2), 1 - x[0])


def solve(
    x: ca.SX, levels: list[NlpLevel], start: np.ndarray, options: NlpOptions = TIGHT
) -> LexicographicResult:
    return LexicographicNlp(lexicographic_program(x, levels), options).solve(start)


def test_rosenbrock_below_himmelblau_takes_the_nearest_root() -> None:
    x = ca.SX.sym("x", 2)
    result = solve(x, [NlpLevel(y=himmelblau(x)), NlpLevel(y=rosenbrock(x))], np.array([2.5, 1.5]))
    assert result.status is NlpStatus.SOLVED
    np.testing.assert_allclose(result.x, [3.0, 2.0], atol=1e-6)


def test_himmelblau_below_rosenbrock_does_not_move_its_minimum() -> None:
    x = ca.SX.sym("x", 2)
    result = solve(x, [NlpLevel(y=rosenbrock(x)), NlpLevel(y=himmelblau(x))], np.array([-1.2, 1.0]))
    np.testing.assert_allclose(result.x, [1.0, 1.0], atol=1e-6)


def test_rosenbrock_on_a_curve_of_himmelblau_equals_the_minimum_along_the_curve() -> None:
    x = ca.SX.sym("x", 2)
    result = solve(
        x, [NlpLevel(y=himmelblau(x)[0]), NlpLevel(y=rosenbrock(x))], np.array([1.0, 2.0])
    )

    def along(s: float) -> float:
        return (10 * (11 - 2 * s**2)) ** 2 + (1 - s) ** 2

    best = minimize_scalar(along, bounds=(1.0, 4.0), method="bounded", options={"xatol": 1e-12}).x
    np.testing.assert_allclose(result.x, [best, 11 - best**2], atol=1e-6)


def test_rows_that_contradict_each_other_settle_in_their_middle_and_stay_there() -> None:
    x = ca.SX.sym("x", 2)
    levels = [NlpLevel(y=ca.vertcat(x[0] - 1, x[0] + 3)), NlpLevel(y=x[1] - x[0] - 5)]
    result = solve(x, levels, np.zeros(2))
    np.testing.assert_allclose(result.x, [-1.0, 4.0], atol=1e-6)
    np.testing.assert_allclose(result.level_residuals, [np.sqrt(8), 0.0], atol=1e-6)
    assert not result.anticipated


def test_an_inequality_level_leaves_its_inside_to_the_levels_below() -> None:
    x = ca.SX.sym("x", 2)
    disc = NlpLevel(y=ca.sumsqr(x), lower=-np.inf, upper=4.0)
    inside = solve(x, [disc, NlpLevel(y=x - ca.DM([1, 1]))], np.array([3.0, 0.5]))
    outside = solve(x, [disc, NlpLevel(y=x - ca.DM([3, 4]))], np.array([3.0, 0.5]))
    np.testing.assert_allclose(inside.x, [1, 1], atol=1e-6)
    np.testing.assert_allclose(outside.x, [1.2, 1.6], atol=1e-6)


def test_a_relaxed_level_pays_no_more_than_its_share() -> None:
    x = ca.SX.sym("x", 2)
    levels = [NlpLevel(y=ca.vertcat(x, x - 2), relax=0.1), NlpLevel(y=x[0] - 5)]
    result = solve(x, levels, np.zeros(2))
    cost = 0.5 * float(np.sum(result.residuals[0] ** 2))
    assert cost == pytest.approx(2.0 * 1.1, rel=1e-6)
    assert result.x[0] == pytest.approx(1 + np.sqrt(0.2), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100))
def test_no_lower_level_raises_the_residual_of_a_higher_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = ca.SX.sym("x", 6)
    levels = [
        NlpLevel(y=random_rows(rng, x), upper=float(rng.choice([0.0, 0.3]))) for _ in range(3)
    ]
    start = rng.standard_normal(6)
    options = NlpOptions(anticipate=False)
    everything = solve(x, levels, start, options)
    for k in range(1, 3):
        alone = solve(x, levels[:k], start, options)
        rise = everything.level_residuals[:k] - alone.level_residuals
        assert rise.max() <= options.tolerance


def random_rows(rng: np.random.Generator, x: ca.SX) -> ca.SX:
    A = rng.standard_normal((rng.integers(1, 4), 6))
    b = rng.standard_normal()
    return ca.DM(A) @ (x + 0.3 * ca.sin(x)) + b


def test_a_second_solve_from_the_first_needs_no_iterations() -> None:
    x = ca.SX.sym("x", 2)
    nlp = LexicographicNlp(
        lexicographic_program(x, [NlpLevel(y=himmelblau(x)[0]), NlpLevel(y=rosenbrock(x))])
    )
    first = nlp.solve(np.array([1.0, 2.0]))
    again = nlp.solve(first)
    assert sum(again.iterations) <= 1
    np.testing.assert_allclose(again.x, first.x, atol=1e-6)


def test_anticipation_gives_the_same_answer_as_solving_in_order() -> None:
    x = ca.SX.sym("x", 3)
    levels = [
        NlpLevel(y=ca.sumsqr(x) - 4),
        NlpLevel(y=x[0] - x[1]),
        NlpLevel(y=x - ca.DM([1, 2, 3])),
    ]
    start = np.array([1.0, 1.0, 1.0])
    first = solve(x, levels, start)
    in_order = solve(
        x, levels, start, NlpOptions(tolerance=1e-9, convergence=1e-10, anticipate=False)
    )
    assert first.anticipated
    assert first.iterations[-1] > 0
    assert not any(first.iterations[:-1])  # those levels were not solved
    np.testing.assert_allclose(first.x, in_order.x, atol=1e-5)


def test_constraints_that_exclude_each_other_are_reported_as_infeasible() -> None:
    x = ca.SX.sym("x", 2)
    program = lexicographic_program(x, [NlpLevel(y=x)], g=ca.vertcat(x[0] - 1, x[0] + 1))
    result = LexicographicNlp(program).solve(np.zeros(2))
    assert result.status is NlpStatus.INFEASIBLE
    assert np.isfinite(result.x).all()
    assert result.violation > 0.5


@pytest.mark.parametrize("max_iterations", [1, 3, 150])
def test_the_violation_is_that_of_the_point_however_the_search_ended(max_iterations: int) -> None:
    """Here there are more equations than variables, which contradict each other."""
    x = ca.SX.sym("x", 2)
    constraints = ca.vertcat(x[0] - 1, x[1] - 1, x[0] * x[1] - 5, x[0] + x[1])
    program = lexicographic_program(
        x, [NlpLevel(y=x - 3), NlpLevel(y=himmelblau(x))], g=constraints
    )
    options = NlpOptions(max_iterations=max_iterations, convergence=1e-6)
    result = LexicographicNlp(program, options).solve(np.array([0.2, 0.4]))
    values = np.array(ca.Function("g", [x], [constraints])(result.x)).ravel()
    assert result.violation >= np.abs(values).max() * (1.0 - 1e-9)
    assert not result.status.optimal


def test_levels_below_one_that_fixes_all_are_evaluated_where_it_ended(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Of two levels that are frozen exactly there are more equations than variables, which IPOPT
    does not take: its word was the limit of iterations.
    """
    x = ca.SX.sym("x", 2)
    levels = [NlpLevel(y=ca.vertcat(x[0] - 1, x[1] + 2)), NlpLevel(y=rosenbrock(x))]
    levels += [NlpLevel(y=himmelblau(x))] * 2
    options = NlpOptions(tolerance=0, convergence=1e-10, anticipate=False)
    result = solve(x, levels, np.array([0.2, 0.4]), options)
    assert result.level_status == (NlpStatus.SOLVED,) * 4
    np.testing.assert_allclose(result.x, [1.0, -2.0], atol=1e-9)
    assert result.iterations[-2:] == (0, 0)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("start", [(0.2, 0.4), (1.0, 1.0), (3.0, -2.0)])
@pytest.mark.parametrize("anticipate", [True, False])
def test_equations_that_repeat_others_change_no_optimum(
    start: tuple[float, float], anticipate: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    x = ca.SX.sym("x", 2)
    line = x[0] + x[1] - 2
    levels = [NlpLevel(y=x[0] - 3), NlpLevel(y=x - 5)]
    options = NlpOptions(anticipate=anticipate)
    once = LexicographicNlp(lexicographic_program(x, levels, g=line), options)
    often = LexicographicNlp(
        lexicographic_program(x, levels, g=ca.vertcat(line, 2 * line, -line)), options
    )
    expected = once.solve(np.array(start))
    result = often.solve(np.array(start))
    assert result.status.optimal
    assert result.violation <= options.feasibility
    np.testing.assert_allclose(result.x, expected.x, atol=1e-5)
    np.testing.assert_allclose(expected.x, [3.0, -1.0], atol=1e-5)
    assert capfd.readouterr() == ("", "")


def test_equations_that_contradict_each_other_are_reported_as_infeasible(
    capfd: pytest.CaptureFixture[str],
) -> None:
    x = ca.SX.sym("x", 2)
    constraints = ca.vertcat(x[0] - 1, x[1] - 1, x[0] + x[1])
    nlp = LexicographicNlp(lexicographic_program(x, [NlpLevel(y=himmelblau(x))], g=constraints))
    for start in ([0.2, 0.4], [1.0, 1.0]):
        result = nlp.solve(np.array(start))
        assert result.status is NlpStatus.INFEASIBLE
        assert result.violation > 0.5
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("n_equations", [2, 3])
def test_equations_without_a_slope_end_in_a_status(n_equations: int) -> None:
    x = ca.SX.sym("x", 2)
    equations = ca.vertcat(ca.norm_2(x), x[0], x[1])
    nlp = LexicographicNlp(lexicographic_program(x, [NlpLevel(y=x - 1)], g=equations[:n_equations]))
    assert not nlp.solve(np.zeros(2)).status.optimal


def test_a_time_limit_ends_all_levels_where_they_stand() -> None:
    x = ca.SX.sym("x", 2)
    nlp = LexicographicNlp(
        lexicographic_program(x, [NlpLevel(y=rosenbrock(x)), NlpLevel(y=himmelblau(x))])
    )
    result = nlp.solve(np.array([-1.2, 1.0]), time_limit=0.0)
    assert result.level_status == (NlpStatus.TIME_LIMIT, NlpStatus.TIME_LIMIT)
    assert sum(result.iterations) == 0
    np.testing.assert_array_equal(result.x, [-1.2, 1.0])
    assert nlp.solve(result.x).status is NlpStatus.SOLVED


def test_a_machine_that_is_busy_changes_no_result_unless_time_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    x = ca.SX.sym("x", 2)
    start = np.array([-1.2, 1.0])
    levels = [NlpLevel(y=rosenbrock(x)), NlpLevel(y=himmelblau(x))]
    quiet = LexicographicNlp(lexicographic_program(x, levels)).solve(start)
    readings = itertools.count(0.0, 60.0)  # a minute between any two

    def busy(options: NlpOptions) -> LexicographicResult:
        nlp = LexicographicNlp(lexicographic_program(x, levels), options)
        monkeypatch.setattr(nlp.deadline, "_clock", lambda: next(readings))
        return nlp.solve(start)

    result = busy(NlpOptions())
    assert (result.level_status, result.iterations) == (quiet.level_status, quiet.iterations)
    np.testing.assert_array_equal(result.x, quiet.x)
    assert busy(NlpOptions(time_limit=20.0)).status is NlpStatus.TIME_LIMIT


def test_once_the_levels_above_are_met_the_last_one_has_all_of_the_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    x = ca.SX.sym("x", 3)
    levels = [NlpLevel(y=x[2] - 1), NlpLevel(y=rosenbrock(x))]
    start = np.array([-1.2, 1.0, 1.0])
    quiet = LexicographicNlp(lexicographic_program(x, levels)).solve(start)
    enough = 3.0 * sum(quiet.iterations)
    assert quiet.anticipated
    assert enough > 30.0

    def timed(limit: float) -> LexicographicResult:
        """A second passes with every look at the clock."""
        nlp = LexicographicNlp(lexicographic_program(x, levels), NlpOptions(time_limit=limit))
        readings = itertools.count()
        monkeypatch.setattr(nlp.deadline, "_clock", lambda: float(next(readings)))
        return nlp.solve(start)

    assert timed(enough).status is NlpStatus.SOLVED
    half_is_too_little = timed(0.9 * sum(quiet.iterations))
    assert half_is_too_little.anticipated
    assert half_is_too_little.status is NlpStatus.SOLVED
    np.testing.assert_allclose(half_is_too_little.x, quiet.x, atol=1e-6)


def test_an_expression_that_is_not_a_number_is_a_status() -> None:
    x = ca.SX.sym("x", 1)
    result = solve(x, [NlpLevel(y=ca.log(x))], np.array([-1.0]))
    assert result.status is NlpStatus.NOT_A_NUMBER
    assert np.isfinite(result.x).all()


def test_misuse_is_refused() -> None:
    x = ca.SX.sym("x", 1)
    for name in ("snopt7", "fatrop"):
        with pytest.raises(NameNotFound, match=f"{name}.*auto.*ipopt.*stagewise"):
            NlpOptions(plugin=name)
    with pytest.raises(InvalidInput, match="at least one"):
        lexicographic_program(x, [])
    with pytest.raises(InvalidInput, match="lower > upper"):
        lexicographic_program(x, [NlpLevel(y=x, lower=1.0, upper=0.0)])
    with pytest.raises(InvalidInput, match="guess has NaN"):
        solve(x, [NlpLevel(y=x)], np.array([np.nan]))


@pytest.mark.parametrize("tolerance", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_frozen_rows_do_not_move_by_what_bounds_give_way(tolerance: float) -> None:
    relaxed = solver_options(NlpOptions(plugin="ipopt", tolerance=tolerance), warm=False)[
        "bound_relax_factor"
    ]
    assert 0.0 < relaxed <= 1e-8
    assert relaxed <= 0.01 * tolerance or tolerance == 0.0

"""Laws that every solver of hierarchies keeps, and the exactness of the strict one."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from hierarchies import dependent_hierarchy, random_hierarchy, reference
from hierarchy_solvers.daqp_hierarchy import Daqp

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp, QpTick, conic_plugins
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.level import Level, stack
from uvms_ocp.solvers.hierarchy.solution import Status

AnySolver = Icat | LexicographicQp | Daqp | LexicographicActiveSet
SOLVERS = [Icat(), LexicographicQp(), Daqp()]


def _good(solver: Icat | LexicographicQp | Daqp) -> Status:
    """The status of an optimum, which the regularised solver never promises."""
    return Status.REGULARISED if isinstance(solver, Icat) else Status.SOLVED


def _equalities(seed: int, n: int = 13) -> list[Level]:
    """Fully active equalities whose projected singular values all exceed 0.2."""
    rng = np.random.default_rng(seed)
    levels = []
    Q = np.eye(n)
    while np.trace(Q) > 0.5:
        J = rng.standard_normal((int(rng.integers(1, 4)), n))
        s = np.linalg.svd(J @ Q, compute_uv=False)
        if len(J) > round(np.trace(Q)) or s.min() <= 0.2:
            continue
        b = rng.standard_normal(len(J))
        levels.append(Level(jacobian=J, lower=b, upper=b, rate=b, activation=1.0))
        Q = Q @ (np.eye(n) - np.linalg.pinv(J @ Q) @ (J @ Q))
    return levels


def _tick_function(n: int, m: int, names: tuple[str, ...] = ()) -> ca.Function:
    """Levels given as inputs, with the sum of the bounds as an extra output."""
    J = ca.SX.sym("J", m, n)
    rows = [ca.SX.sym(name, m) for name in ("lower", "upper", "rate", "activation", "gate")]
    outputs = ["J", "lower", "upper", "rate", "activation", "gate", "extra"]
    inputs = [J, *rows]
    return ca.Function(
        "levels", inputs, [*inputs, rows[0] + 1], [f"{name}_in" for name in outputs[:-1]], outputs
    )


def _arguments(levels: list[Level]) -> list[np.ndarray]:
    rows = stack(levels)
    return [rows.jacobian, rows.lower, rows.upper, rows.rate, rows.activation, rows.gate]


@pytest.mark.parametrize(
    "solver", [*SOLVERS, LexicographicActiveSet(), LexicographicActiveSet(compiled=False)]
)
def test_a_level_without_rows_changes_nothing_below_it(solver: AnySolver) -> None:
    levels = random_hierarchy(3, 5, (5, 2, 3))
    nothing = Level(jacobian=np.zeros((0, 5)), lower=np.zeros(0), upper=np.zeros(0))
    alone = solver.solve(levels)
    among = solver.solve([levels[0], nothing, *levels[1:], nothing])
    np.testing.assert_allclose(among.v, alone.v, atol=1e-9)
    assert among.status is alone.status


@pytest.mark.sampled
@pytest.mark.parametrize(
    "block", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 8))]
)
def test_lexicographic_qp_reaches_the_reference_on_random_hierarchies(block: int) -> None:
    solver = LexicographicQp()
    for seed in range(25 * block, 25 * block + 25):
        levels = random_hierarchy(seed)
        optimum, error = reference(levels)
        assert error.max() < 1e-10
        solution = solver.solve(levels)
        np.testing.assert_allclose(
            solution.level_residuals, optimum, atol=1e-6, err_msg=f"seed {seed}"
        )


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(20))
def test_icat_and_lexicographic_qp_agree_on_well_conditioned_equalities(seed: int) -> None:
    levels = _equalities(seed)
    np.testing.assert_allclose(Icat().solve(levels).v, LexicographicQp().solve(levels).v, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_lower_levels_never_change_higher_ones(seed: int) -> None:
    levels = random_hierarchy(seed)
    solver = LexicographicQp()
    whole = solver.solve(levels)
    for count in range(1, len(levels)):
        part = solver.solve(levels[:count])
        np.testing.assert_allclose(part.level_residuals, whole.level_residuals[:count], atol=1e-7)


def test_a_last_level_of_zero_velocity_gives_the_shortest_velocity() -> None:
    rng = np.random.default_rng(1)
    J = rng.standard_normal((4, 9))
    b = rng.standard_normal(4)
    levels = [Level(jacobian=J, lower=b, upper=b), Level(jacobian=np.eye(9), lower=0.0, upper=0.0)]
    for solver in SOLVERS:
        np.testing.assert_allclose(solver.solve(levels).v, np.linalg.pinv(J) @ b, atol=1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_tick_is_the_same_as_a_solve_and_passes_extras_on(
    solver: Icat | LexicographicQp | Daqp,
) -> None:
    levels = random_hierarchy(3)
    solution = solver.solve(levels)
    tick = solver.bind(_tick_function(13, 59), [level.n_rows for level in levels])
    result = tick(*_arguments(levels))
    np.testing.assert_allclose(result.v, solution.v, atol=1e-6)
    np.testing.assert_allclose(result.residual, np.concatenate(solution.residuals), atol=1e-5)
    np.testing.assert_array_equal(result.extras[0], _arguments(levels)[1] + 1)


@pytest.mark.sampled
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("wrong", range(6))
def test_nan_in_a_tick_gives_zero_velocity_and_says_so(
    solver: Icat | LexicographicQp | Daqp, wrong: int
) -> None:
    if isinstance(solver, Icat) and wrong in (1, 2, 5):
        wrong = 3  # bounds and gate are not read by this solver
    levels = random_hierarchy(4)
    tick = solver.bind(_tick_function(13, 59), [level.n_rows for level in levels])
    arguments = [array.copy() for array in _arguments(levels)]
    if not isinstance(solver, Icat) and wrong in (3, 4):
        wrong = 0  # rate and activation are not read by the strict ones
    arguments[wrong].flat[7] = np.nan
    result = tick(*arguments)
    assert result.status is Status.INVALID_INPUT
    assert not result.v.any()
    assert np.isfinite(result.residual).all()
    np.testing.assert_allclose(tick(*_arguments(levels)).v, solver.solve(levels).v, atol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("n", "m"), [(1, 2), (3, 0), (2, 1)])
def test_ticks_work_at_the_smallest_sizes(
    solver: Icat | LexicographicQp | Daqp, n: int, m: int
) -> None:
    result = solver.bind(_tick_function(n, m), [m])(np.ones((m, n)), *[np.ones(m)] * 5)
    assert result.status is _good(solver)
    np.testing.assert_allclose(np.ones((m, n)) @ result.v, np.ones(m), atol=1e-3)


def test_contradictory_bounds_in_a_tick_are_invalid_input() -> None:
    tick = LexicographicQp().bind(_tick_function(2, 1), [1])
    result = tick([[1.0, 0.0]], [1.0], [0.0], [0.0], [1.0], [1.0])
    assert result.status is Status.INVALID_INPUT
    assert "lower > upper" in result.status.advice


def test_a_tick_refuses_wrong_inputs_and_levels() -> None:
    tick = LexicographicQp().bind(_tick_function(2, 1), [1])
    with pytest.raises(InvalidInput, match="tick: 2 arguments given; allowed: 6, J_in, lower_in"):
        tick(0.0, 0.0)
    with pytest.raises(
        InvalidInput, match=r"tick: lower_in of shape \(2,\) given; allowed: \(1,\)"
    ):
        tick(np.ones((1, 2)), np.zeros(2), *[np.zeros(1)] * 4)
    with pytest.raises(InvalidInput, match=r"sizes \(2,\) sum to 2; the levels have 1 rows"):
        LexicographicQp().bind(_tick_function(2, 1), [2])
    x = ca.SX.sym("x")
    with pytest.raises(InvalidInput, match="its first outputs must be"):
        Icat().bind(ca.Function("f", [x], [x], ["x"], ["y"]), [1])


@pytest.mark.parametrize("solver", SOLVERS)
def test_levels_without_effect_leave_the_velocity_at_zero(
    solver: Icat | LexicographicQp | Daqp,
) -> None:
    J = np.random.default_rng(0).standard_normal((3, 5))
    cases = [
        [Level(jacobian=np.zeros((0, 5)))],
        [Level(jacobian=J), Level(jacobian=J, lower=-1.0, upper=1.0)],
        [Level(jacobian=J, lower=1.0, upper=1.0, activation=0.0, gate=0.0)],
        [Level(jacobian=np.zeros((2, 5)), lower=1.0, upper=2.0)],
    ]
    for levels in cases:
        solution = solver.solve(levels)
        assert solution.status is _good(solver)
        np.testing.assert_allclose(solution.v, np.zeros(5), atol=1e-12)


@pytest.mark.parametrize("solver", SOLVERS)
def test_an_empty_hierarchy_is_refused(solver: Icat | LexicographicQp | Daqp) -> None:
    with pytest.raises(InvalidInput, match="levels is empty"):
        solver.solve([])


def test_conflicting_and_dependent_rows_share_the_error() -> None:
    J = np.array([[1.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    solution = LexicographicQp().solve(
        [Level(jacobian=J, lower=[1.0, 3.0, 4.0], upper=[1.0, 3.0, 4.0])]
    )
    np.testing.assert_allclose(solution.v, [2.0, 0.0], atol=1e-8)


def test_a_gate_removes_a_row_continuously() -> None:
    J = np.array([[1.0, 0.0]])
    solver = LexicographicQp()

    def reached(gate: float) -> float:
        resting = Level(jacobian=np.eye(2), lower=0.0, upper=0.0)
        return float(
            solver.solve([Level(jacobian=J, lower=1.0, upper=1.0, gate=gate), resting]).v[0]
        )

    gates = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 201))  # a bell in time, as missions have it
    path = np.array([reached(gate) for gate in gates])
    assert path[0] == pytest.approx(0.0, abs=1e-9)
    assert path[-1] == pytest.approx(1.0, abs=1e-9)
    assert np.abs(np.diff(path)).max() < 0.03
    assert (np.diff(path) >= -1e-9).all()


@pytest.mark.sampled
@pytest.mark.parametrize("plugin", conic_plugins())
def test_whatever_the_plugin_results_are_those_of_the_active_set(plugin: str) -> None:
    """Before, most of daqp, all of 60 variables, and two thirds of dependent rows were inexact."""
    kinds = [
        lambda seed: random_hierarchy(seed, 6, (6, 2, 3, 6)),
        lambda seed: dependent_hierarchy(seed, 9, (2, 3, 4, 2), 0.0),
    ]
    for seed in range(3):
        for levels in (kind(seed) for kind in kinds):
            solution = LexicographicQp(plugin=plugin).solve(levels)
            exact = LexicographicActiveSet().solve(levels)
            assert solution.status.exact
            np.testing.assert_allclose(solution.level_residuals, exact.level_residuals, atol=1e-6)


@pytest.mark.parametrize("plugin", ["daqp", "piqp", "qrqp"])
def test_levels_that_the_first_program_meets_are_given_to_no_second_one(plugin: str) -> None:
    """Below active bounds too, whose multipliers are zero but for rounding."""
    rows = [
        ([[1.0, 0.0, 0.0]], 1.0, 2.0),
        ([[1.0, 1.0, 0.0]], 3.0, np.inf),
        ([[0.3, 1.0, 1.0]], 2.0, 2.0),
    ]
    levels = [Level(jacobian=J, lower=lower, upper=upper) for J, lower, upper in rows]
    once, often = (
        LexicographicQp(plugin=plugin, attempts=attempts).solve(levels) for attempts in (1, 3)
    )
    assert once.status is often.status is Status.SOLVED
    np.testing.assert_array_equal(once.v, often.v)


def test_many_variables_are_exact_by_quadratic_programs_too() -> None:
    levels = random_hierarchy(0, 40, (40, 6, 9, 12, 40))
    solution = LexicographicQp().solve(levels)
    assert solution.status.exact
    assert solution.certificate(levels) < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_a_program_with_small_rows_keeps_them(seed: int) -> None:
    """As of model predictive control: entries of 1e-3 to 1e-1. Rows were missed by 1.5, where plain
    qpOASES was right.
    """
    rng = np.random.default_rng(seed)
    A = rng.choice([-1.0, 1.0], (32, 16)) * 10.0 ** rng.uniform(-3.0, -1.0, (32, 16))
    upper = A @ (5.0 * rng.standard_normal(16)) + rng.uniform(0.0, 1.0, 32)
    G = np.tril(rng.standard_normal((16, 16))) + 4.0 * np.eye(16)
    goal = G @ (30.0 * rng.standard_normal(16))
    levels = [
        Level(jacobian=A, lower=-np.inf, upper=upper),
        Level(jacobian=G, lower=goal, upper=goal),
    ]
    solution = LexicographicQp().solve(levels)
    assert solution.status.exact
    assert (A @ solution.v - upper).max() < 1e-7  # to which results are certified


@pytest.mark.parametrize("plugin", ["clp", "hpipm", "nlpsol"])
def test_a_plugin_for_other_programs_is_refused_in_one_line(plugin: str) -> None:
    with pytest.raises(
        InvalidInput,
        match=rf"conic plugin '{plugin}' takes no dense program .*give one of .*qpoases",
    ):
        LexicographicQp(plugin=plugin).solve(random_hierarchy(0, 6, (6, 2, 3, 6)))


def test_an_unknown_plugin_is_refused_with_the_names_that_exist() -> None:
    with pytest.raises(
        NameNotFound,
        match=r"unknown conic plugin 'qpoase'; known: .*qpoases.*Did you mean 'qpoases'",
    ):
        LexicographicQp(plugin="qpoase")


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(InvalidInput, match="give a number > 0"):
        LexicographicQp(proximal=0.0)
    with pytest.raises(InvalidInput, match="give a number > 0"):
        Icat(threshold=-1.0)


@pytest.mark.sampled
@pytest.mark.parametrize("plugin", ["daqp", "highs", "ipqp", "osqp", "qpoases", "qrqp"])
def test_solvers_print_nothing(plugin: str, capfd: pytest.CaptureFixture[str]) -> None:
    solver = LexicographicQp(plugin=plugin)
    for seed in range(5):
        solver.solve(random_hierarchy(seed, 6, (6, 2, 3, 2, 6)))
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


class _Misled:
    """A cascade whose plugins do not find the optimum until they are replaced ``cured`` times."""

    failed = False

    def __init__(self, honest: Callable[..., tuple[np.ndarray, ...]], cured: int) -> None:
        self.honest = honest
        self.cured = cured
        self.calls = 0

    def __call__(self, *inputs: np.ndarray) -> tuple[np.ndarray, ...]:
        self.calls += 1
        v, status, *extras = self.honest(*inputs)
        return (v, status, *extras) if self.calls > self.cured else (0.9 * v, np.ones(1), *extras)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("cured", "certified", "status"),
    [(1, True, Status.SOLVED), (99, True, Status.SOLVED), (99, False, Status.INEXACT)],
)
def test_misled_plugins_are_replaced_once(cured: int, certified: bool, status: Status) -> None:
    """And what they miss then is found from the rows that they hold."""
    levels = random_hierarchy(3)
    tick = LexicographicQp(certified=certified).bind(
        _tick_function(13, 59), [level.n_rows for level in levels]
    )
    assert isinstance(tick, QpTick)
    misled = tick._tick = _Misled(tick._tick, cured)
    results = [tick(*_arguments(levels)) for _ in range(3)]
    assert {result.status for result in results} == {status}
    assert misled.calls == 4


@pytest.mark.parametrize("number", [np.inf, np.nan, 0.0, -1.0])
@pytest.mark.parametrize(
    ("solver", "name"),
    [
        (Icat, "damping"),
        (Icat, "threshold"),
        (Icat, "weight"),
        (LexicographicQp, "proximal"),
        (LexicographicQp, "tolerance"),
    ],
)
def test_a_setting_with_which_nothing_can_be_solved_is_refused_at_once(
    solver: type, name: str, number: float
) -> None:
    with pytest.raises(InvalidInput, match=f"{name} = {number}; give a number > 0"):
        solver(**{name: number})


OWN: list[AnySolver] = [
    Icat(),
    LexicographicQp(),
    LexicographicActiveSet(),
    LexicographicActiveSet(compiled=False),
]
"""DAQP loses its way where a row is there twice."""


def _with_row(level: Level, row: np.ndarray, value: float) -> Level:
    """The level with one more row, asked to be `value` in full."""
    extra = Level(jacobian=row[None], lower=value, upper=value, rate=value, activation=1.0)
    columns = (
        np.concatenate([getattr(level, name), getattr(extra, name)])
        for name in ("jacobian", *_ROWS)
    )
    return Level(**dict(zip(("jacobian", *_ROWS), columns, strict=True)))


_ROWS = ("lower", "upper", "rate", "activation", "gate")


@pytest.mark.sampled
@pytest.mark.parametrize("solver", OWN)
@pytest.mark.parametrize("value", [0.0, 0.7])
def test_a_row_that_nothing_moves_changes_nothing(solver: AnySolver, value: float) -> None:
    """Whatever it asks for: its own residual aside, the solution is that without it."""
    for seed in range(3):
        levels = _equalities(seed)
        alone = solver.solve(levels)
        among = solver.solve([_with_row(level, np.zeros(13), value) for level in levels])
        np.testing.assert_allclose(
            among.v, alone.v, atol=1e-3 if isinstance(solver, Icat) else 1e-6
        )
        for k, residual in enumerate(among.residuals):
            np.testing.assert_allclose(abs(residual[-1]), value, atol=1e-9)
            np.testing.assert_allclose(
                residual[:-1], alone.residuals[k], atol=1e-3 if isinstance(solver, Icat) else 1e-6
            )


@pytest.mark.parametrize("solver", OWN)
@pytest.mark.parametrize("times", [1.0, -1.0, 3.0])
def test_a_row_that_is_there_twice_changes_nothing_where_it_can_be_met(
    solver: AnySolver, times: float
) -> None:
    """In its own level and in the one below, as it is and by a factor."""
    for seed in range(3):
        levels = _equalities(seed)
        alone = solver.solve(levels).v
        rows = [(level.jacobian[0] * times, float(level.lower[0]) * times) for level in levels]
        same = [_with_row(level, *row) for level, row in zip(levels, rows, strict=True)]
        below = [
            levels[0],
            *(_with_row(level, *row) for level, row in zip(levels[1:], rows[:-1], strict=True)),
        ]
        for doubled in (same, below):
            np.testing.assert_allclose(
                solver.solve(doubled).v, alone, atol=1e-2 if isinstance(solver, Icat) else 1e-5
            )

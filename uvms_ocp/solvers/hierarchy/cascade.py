"""Strict hierarchy as a cascade of quadratic programs ([Kanoun2011], [Escande2014]) inside one
CasADi Function.

A bound cascade survives a plugin that breaks down in the middle of a tick.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.elementwise import (
    interval_distance,
    interval_excess,
    logical_or,
    row_sums,
    where,
)
from uvms_ocp.errors import InvalidInput, NameNotFound, plain_line
from uvms_ocp.solvers.hierarchy import solution, tolerances
from uvms_ocp.solvers.hierarchy.active_set_numpy import RowState, solve_levels
from uvms_ocp.solvers.hierarchy.certificate import normal_certificate, normal_rows
from uvms_ocp.solvers.hierarchy.level import Level, is_valid, residual, widen_bounds
from uvms_ocp.types import Array, AtLeastOne, Positive

_STATUS = (solution.Status.SOLVED, solution.Status.INEXACT, solution.Status.INVALID_INPUT)
_INEXACT = 1
_INVALID = 2
_STAGE_PLUGINS = ("fatrop", "hpipm")  # take programs of stages alone
_PLUGIN_OPTIONS: dict[str, dict[str, object]] = {
    "qpoases": {"printLevel": "none", "enableFlippingBounds": False},
    "qrqp": {"print_iter": False, "print_header": False, "print_info": False},
    "osqp": {"osqp": {"verbose": False}},
    "ipqp": {"print_iter": False, "print_header": False, "print_info": False},
    "highs": {"highs": {"output_flag": False}},
}
_RANK_TOLERANCE = 1e-10  # share of a row that is free, below which it counts as fixed already
_SATISFIED = 1e-12  # [rate] a level whose rows are violated by less needs no program
_VIOLATED = 1e-6
"""[rate] Rows violated by less may be so for want of accuracy; kept as inequalities they lose
nothing at an optimum.
"""
_AT_BOUND = 1e-6  # distance to a bound, relative to the size of the row, up to which it may act
_STATIONARY = 3e-9  # residual of the optimality conditions, relative to the size of the gradient
_NOTHING = 0
_SATISFIED_CASE = 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _RowsAbove:
    """Rows of all levels above, with bounds widened to what was reached."""

    J: ca.MX
    """(k, n) Jacobian of these rows."""
    lower: ca.MX
    """(k,) lower bounds."""
    upper: ca.MX
    """(k,) upper bounds."""
    fixed: ca.MX
    """(k,) 1 where the row cannot move any more."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _LevelSymbols:
    """Symbolic inputs of one level."""

    above: _RowsAbove
    """Rows of the levels above."""
    J: ca.MX
    """(m, n) rows of the level."""
    lower: ca.MX
    """(m,) lower bounds."""
    upper: ca.MX
    """(m,) upper bounds."""
    v: ca.MX
    """(n,) result of the levels above."""
    P: ca.MX
    """(n, n) projector on what they leave free."""

    def inputs(self, v: ca.MX | None = None) -> list[ca.MX]:
        """Return the inputs of a `LevelStep`, with another v (n,) where it is not None."""
        if v is None:
            v = self.v
        above = self.above
        rows_above = [above.J, above.lower, above.upper, above.fixed]
        return [*rows_above, self.J, self.lower, self.upper, v, self.P]


def sanitised(
    J: ca.MX, lower: ca.MX, upper: ca.MX, gate: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
    """Return valid (1,), then J and the gated bounds, which are harmless where the input is not
    valid.
    """
    valid = is_valid(J, lower, upper, gate)
    J = ca.if_else(valid, J, ca.MX.zeros(J.shape))
    low, up = widen_bounds(J, lower, upper, ca.if_else(valid, gate, ca.MX.zeros(gate.shape)))
    return valid, J, low, up


def outcome(
    valid: ca.MX, v: ca.MX, inexact: ca.MX, J: ca.MX, lower: ca.MX, upper: ca.MX, gate: ca.MX
) -> tuple[ca.MX, ca.MX]:
    """Return the status (0 solved, 1 inexact, 2 invalid input) and the residual (M,)."""
    missed = ca.if_else(valid, residual(J, v, lower, upper, gate), ca.MX.zeros(gate.shape))
    return ca.if_else(valid, inexact, _INVALID), missed


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelStep:
    """Functions of one level: (J above, lower, upper, fixed, J, lower, upper, v, P) -> (v, P,
    failed).
    """

    solve: ca.Function
    """Function that gives v at the optimum of the level."""
    give_up: ca.Function
    """Function that keeps v; for a plugin that fails even on a fresh start."""
    conic: ca.Function
    """The program; its memory holds the active set of the last call."""


def cascade(
    steps: Sequence[LevelStep], J: ca.MX, lower: ca.MX, upper: ca.MX
) -> tuple[ca.MX, ca.MX]:
    """Return v (n,), and 1 if any level is inexact, from one step per level that has rows."""
    n = J.shape[1]
    v = ca.MX.zeros(n)
    P = ca.MX.eye(n)
    inexact = ca.MX.zeros(1)
    above = _RowsAbove(J=ca.MX(0, n), lower=ca.MX(0, 1), upper=ca.MX(0, 1), fixed=ca.MX(0, 1))
    for step in steps:
        rows = slice(above.J.shape[0], above.J.shape[0] + step.solve.size1_in(4))
        level = _LevelSymbols(
            above=above, J=J[rows, :], lower=lower[rows], upper=upper[rows], v=v, P=ca.densify(P)
        )
        v, P, failed = step.solve.call(level.inputs())
        above = _extended(level, v)
        inexact = ca.fmax(inexact, failed)
    return v, inexact


def level_step(settings: LexicographicQp, n: int, n_above: int, size: int) -> LevelStep:
    """Build the functions of a level of ``size`` rows below ``n_above`` rows, whose program is
    solved only where it is needed.

    Raises `InvalidInput` for a plugin that takes no such program.
    """
    name = f"level_{n_above}"
    symbols = _level_symbols(n, n_above, size)
    inputs = symbols.inputs()
    zero = ca.MX.zeros(1)
    nothing = ca.Function(f"{name}_nothing", inputs, [symbols.v, symbols.P, zero])
    projector = _projector(symbols, symbols.v)
    satisfied = ca.Function(f"{name}_satisfied", inputs, [symbols.v, projector, zero])
    conic = _conic(settings, name, symbols)
    programs = _programs(settings, name, conic, symbols)
    choice = ca.Function.conditional(f"{name}_case", [nothing, satisfied], programs)
    solve = ca.Function(name, inputs, choice.call([_case(symbols), *inputs]))
    give_up = ca.Function(f"{name}_kept", inputs, [symbols.v, projector, ca.MX.ones(1)])
    return LevelStep(solve=solve, give_up=give_up, conic=conic)


def fixed_rows(y: Any, lower: Any, upper: Any) -> Any:
    """Check which rows cannot move any more at y (m,) [rate]: equalities, and rows that had to be
    violated.

    lower and upper (m,) [rate].
    """
    return logical_or(lower >= upper, interval_excess(y, lower, upper) > _VIOLATED)


def _level_symbols(n: int, n_above: int, size: int) -> _LevelSymbols:
    rows_above = _RowsAbove(
        J=ca.MX.sym("held_J", n_above, n),
        lower=ca.MX.sym("held_lower", n_above),
        upper=ca.MX.sym("held_upper", n_above),
        fixed=ca.MX.sym("held_fixed", n_above),
    )
    return _LevelSymbols(
        above=rows_above,
        J=ca.MX.sym("J", size, n),
        lower=ca.MX.sym("lower", size),
        upper=ca.MX.sym("upper", size),
        v=ca.MX.sym("v", n),
        P=ca.MX.sym("P", n, n),
    )


def _case(symbols: _LevelSymbols) -> ca.MX:
    """Return _NOTHING where no program could change v, _SATISFIED_CASE where v is optimal but P may
    shrink, else 2.
    """
    free = ca.norm_inf(symbols.J @ symbols.P) > _RANK_TOLERANCE * ca.norm_inf(symbols.J)
    distance = interval_distance(symbols.J @ symbols.v, symbols.lower, symbols.upper)
    satisfied = ca.norm_inf(distance) <= _SATISFIED
    has_equalities = ca.sum1(symbols.lower >= symbols.upper) > 0
    unchanged = ca.if_else(has_equalities, _SATISFIED_CASE, _NOTHING)
    return ca.if_else(free, ca.if_else(satisfied, unchanged, 2), _NOTHING)


def _extended(level: _LevelSymbols, v: ca.MX) -> _RowsAbove:
    y = level.J @ v
    above = level.above
    return _RowsAbove(
        J=ca.vertcat(above.J, level.J),
        lower=ca.vertcat(above.lower, ca.fmin(level.lower, y)),
        upper=ca.vertcat(above.upper, ca.fmax(level.upper, y)),
        fixed=ca.vertcat(above.fixed, fixed_rows(y, level.lower, level.upper)),
    )


def _projector(level: _LevelSymbols, v: ca.MX) -> ca.MX:
    """Return P without the directions of the rows that are fixed at v."""
    P = level.P
    fixed = fixed_rows(level.J @ v, level.lower, level.upper)
    for i in range(level.J.shape[0]):
        a = level.J[i, :].T
        # Applied twice, so that what earlier rows have removed stays removed to rounding.
        r = P @ (P @ a)
        size = ca.sumsqr(r)
        new = ca.logic_and(fixed[i], size > _RANK_TOLERANCE**2 * ca.sumsqr(a))
        P = P - r @ (r * ca.if_else(new, 1 / size, 0)).T
    return P


def _programs(
    settings: LexicographicQp, name: str, solver: ca.Function, symbols: _LevelSymbols
) -> ca.Function:
    inputs = symbols.inputs()
    step = ca.Function(f"{name}_given_up", inputs, [symbols.v, ca.MX.ones(1)])
    for _ in range(settings.attempts):
        step = _attempt(settings, name, solver, symbols, step)
    v, failed = step.call(inputs)
    return ca.Function(f"{name}_programs", inputs, [v, _projector(symbols, v), failed])


def _conic(settings: LexicographicQp, name: str, symbols: _LevelSymbols) -> ca.Function:
    size, n = symbols.J.shape
    H = ca.diagcat(ca.Sparsity.dense(n, n), ca.Sparsity.diag(size))
    A = ca.Sparsity.dense(symbols.above.J.shape[0] + size, n + size)
    options = {
        "error_on_fail": False,
        **_PLUGIN_OPTIONS.get(settings.plugin, {}),
        **settings.options,
    }
    if settings.plugin == "qpoases":
        # Warm starts that need more working-set changes than this hardly ever recover.
        options.setdefault("nWSR", 40 + sum(A.shape))
    try:
        return ca.conic(f"{name}_qp", settings.plugin, {"h": H, "a": A}, options)
    except RuntimeError as error:
        why = plain_line(str(error).strip().splitlines()[-1], 80)
        refusal = f"conic plugin {settings.plugin!r} takes no dense program ({why})"
        raise InvalidInput(f"{refusal}; give one of {', '.join(conic_plugins())}") from None


def _attempt(
    settings: LexicographicQp,
    name: str,
    solver: ca.Function,
    symbols: _LevelSymbols,
    otherwise: ca.Function,
) -> ca.Function:
    """Solve one program; ``otherwise`` continues from its result if that is not verified to be
    optimal.
    """
    v, multipliers = _program(settings, solver, symbols)
    v = ca.if_else(_is_acceptable(settings, symbols, v), v, symbols.v)
    # Where rounding alone made the program look worse, its multipliers verify the former v.
    verified = _is_optimal(symbols, v, multipliers)
    inputs = symbols.inputs()
    done = ca.Function(f"{name}_done", inputs, [symbols.v, ca.MX.zeros(1)])
    choice = ca.Function.if_else(f"{name}_again", done, otherwise)
    return ca.Function(f"{name}_try", inputs, choice.call([verified, *symbols.inputs(v)]))


def _program(
    settings: LexicographicQp, solver: ca.Function, symbols: _LevelSymbols
) -> tuple[ca.MX, ca.MX]:
    """Return v, and the multipliers of the rows of the levels above."""
    size, n = symbols.J.shape
    JP = symbols.J @ symbols.P
    y = symbols.J @ symbols.v
    equal = symbols.lower >= symbols.upper
    E = ca.repmat(equal, 1, n) * JP
    target = ca.if_else(equal, symbols.lower - y, 0)
    curvature = E.T @ E + settings.proximal * ca.sumsqr(JP) / size * ca.MX.eye(n)
    JP_above, lower_above, upper_above = _projected_rows_above(symbols)
    n_above = JP_above.shape[0]
    rows_above = ca.horzcat(JP_above, ca.MX.zeros(n_above, size))
    rows = ca.horzcat(JP, ca.MX(-ca.DM.eye(size)))
    solution = solver(
        h=ca.diagcat(curvature, ca.MX.eye(size)),
        g=ca.vertcat(-(E.T @ target), ca.MX.zeros(size)),
        a=ca.densify(ca.vertcat(rows_above, rows)),
        lba=ca.vertcat(lower_above, where(equal, -ca.inf, symbols.lower - y)),
        uba=ca.vertcat(upper_above, where(equal, ca.inf, symbols.upper - y)),
    )
    v = symbols.v + symbols.P @ solution["x"][:n]
    if n_above == 0:
        return v, ca.MX(0, 1)
    return v, solution["lam_a"][:n_above]


def _projected_rows_above(symbols: _LevelSymbols) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Return the rows of the levels above in what is free, and bounds of their change; no bounds
    for rows that are fixed, or that nothing free moves.
    """
    above = symbols.above
    JP = above.J @ symbols.P
    y = above.J @ symbols.v
    if above.J.shape[0] == 0:
        return JP, y, y
    moves = ca.sum2(JP**2) > _RANK_TOLERANCE**2 * ca.sum2(above.J**2)
    dropped = ca.logic_or(above.fixed, ca.logic_not(moves))
    lower = where(dropped, -ca.inf, ca.fmin(above.lower - y, 0))
    upper = where(dropped, ca.inf, ca.fmax(above.upper - y, 0))
    return JP, lower, upper


def _is_acceptable(settings: LexicographicQp, symbols: _LevelSymbols, v: ca.MX) -> ca.MX:
    """Check that v is finite, keeps all levels above, and is no worse than before at this one."""
    before = ca.sumsqr(interval_distance(symbols.J @ symbols.v, symbols.lower, symbols.upper))
    after = ca.sumsqr(interval_distance(symbols.J @ v, symbols.lower, symbols.upper))
    # Comparisons with NaN are false, but norm_inf ignores NaN.
    better = ca.logic_and(ca.sumsqr(v) < 1e30, after <= before * (1 + 1e-12))
    above = symbols.above
    if above.J.shape[0] == 0:
        return better
    excess = interval_excess(above.J @ v, above.lower, above.upper)
    worse = excess / (1 + row_sums(ca.fabs(above.J)))
    return ca.logic_and(better, ca.norm_inf(worse) <= settings.tolerance)


def _is_optimal(symbols: _LevelSymbols, v: ca.MX, multipliers: ca.MX) -> ca.MX:
    """Check the Karush-Kuhn-Tucker conditions of the level without the proximal term."""
    slack = interval_distance(symbols.J @ v, symbols.lower, symbols.upper)
    scale = _STATIONARY * (1 + ca.norm_fro(symbols.J) * ca.norm_2(slack))
    above = symbols.above
    stationary = ca.norm_2(symbols.P.T @ (symbols.J.T @ slack + above.J.T @ multipliers)) <= scale
    if above.J.shape[0] == 0:
        return stationary
    y = above.J @ v
    far = 1e6
    at_upper = ca.fmax(multipliers, 0) * ca.fmin(ca.fmax(above.upper - y, 0), far)
    at_lower = ca.fmax(-multipliers, 0) * ca.fmin(ca.fmax(y - above.lower, 0), far)
    return ca.logic_and(stationary, ca.norm_inf(at_upper + at_lower) <= scale)


class QpTick:
    """The whole cascade in one Function; level by level where a plugin reports an error.

    CasADi abandons a Function as soon as a plugin inside it fails, and a plugin such as qpOASES
    that failed once on a warm start fails from then on, until its memory is replaced: a memory that
    is checked out and not released is never handed to the cascade again, and CasADi frees it with
    the Function. The same cures a plugin that reports success but whose warm start no longer leads
    to the optimum, as after a jump to another problem.
    """

    __slots__ = ("_certified", "_fresh", "_levels", "_sizes", "_steps", "_tick", "_width")

    def __init__(
        self,
        tick: ca.Function,
        levels: ca.Function,
        steps: Sequence[LevelStep],
        sizes: Sequence[int],
        *,
        certified: bool,
    ) -> None:
        r"""tick: inputs -> v, status, residual, \*extras. sizes: rows of each level; steps: of
        those that have rows.

        levels: inputs -> J, lower, upper (gated), J, lower, upper, gate (as given), \*extras.
        """
        self._tick = BufferedFunction(tick)
        self._levels = BufferedFunction(levels)
        self._steps = steps
        self._sizes = tuple(sizes)
        self._width = levels.size2_out(0)
        self._certified = certified
        self._fresh = False
        with contextlib.redirect_stdout(io.StringIO()):
            self._set_up()

    def __call__(self, *inputs: ArrayLike) -> solution.TickResult:
        """Raises `InvalidInput` for a wrong number or shape of inputs."""
        start = perf_counter()
        # Plugins report their troubles through Python's stdout, whatever their options say.
        with contextlib.redirect_stdout(io.StringIO()):
            outputs = self._tick(*inputs)
            if self._tick.failed or (outputs[1][0] == _INEXACT and not self._fresh):
                # On fresh plugins first, then level by level, where a level that still fails keeps
                # v.
                for step in self._steps:
                    step.conic.checkout()
                self._set_up()
                outputs = self._tick(*inputs)
                if self._tick.failed:
                    outputs = self._stepwise(inputs)
        # Where fresh plugins do not help either, they would not at the next tick.
        self._fresh = bool(outputs[1][0] == _INEXACT)
        v, code, missed, *extras = outputs
        status = _STATUS[int(code[0])]
        if self._certified and status is not solution.Status.INVALID_INPUT:
            v, status, missed = self._certify(v, missed, inputs)
        elif status is solution.Status.SOLVED:
            status = solution.Status.INEXACT
        return solution.tick_result(
            v=v,
            status=status,
            residual=missed,
            extras=tuple(extras),
            solve_time=perf_counter() - start,
        )

    def _certify(
        self, v: Array, missed: Array, inputs: Sequence[ArrayLike]
    ) -> tuple[Array, solution.Status, Array]:
        """Report an exact status only where it is certified; else polish from the rows at their
        bounds.

        Those are nearly the active set of the optimum, from which `active_set_numpy.solve_levels`
        takes an iteration or two.
        """
        J, low, up, J_given, lower, upper, gate = self._levels(*inputs)[:7]
        J = J.reshape(-1, len(v))
        J_given = J_given.reshape(-1, len(v))
        rows = normal_rows(J, low, up, self._sizes)
        if normal_certificate(rows, v / rows.velocity) <= tolerances.CERTIFIED:
            return v, solution.Status.SOLVED, missed
        margin = _AT_BOUND * (1.0 + np.abs(J).sum(axis=1))
        at_upper = (J @ v >= up - margin) * float(RowState.UPPER)
        at_lower = (J @ v <= low + margin) * float(RowState.LOWER)
        active_set = at_upper + at_lower
        polished = solve_levels(J_given, lower, upper, gate, active_set, self._sizes)
        if polished.status.exact:
            return (polished.v, polished.status, polished.residual)
        return (v, solution.Status.INEXACT, missed)

    def _set_up(self) -> None:
        for step in self._steps:
            step.conic.release(step.conic.checkout())

    def _stepwise(self, inputs: Sequence[ArrayLike]) -> tuple[Array, ...]:
        J, low, up, J_given, lower, upper, gate, *extras = self._levels(*inputs)
        n = self._width
        J = J.reshape(-1, n)
        J_given = J_given.reshape(-1, n)
        v = np.zeros(n)
        P = np.eye(n)
        inexact = 0.0
        first = 0
        reached_lower = low.copy()
        reached_upper = up.copy()
        fixed = np.zeros(len(low))
        for step in self._steps:
            rows = slice(first, first + step.solve.size1_in(4))
            rows_above = (J[:first], reached_lower[:first], reached_upper[:first], fixed[:first])
            v, P, failed = _level(step, [*rows_above, J[rows], low[rows], up[rows], v, P])
            y = J[rows] @ v
            fixed[rows] = fixed_rows(y, low[rows], up[rows])
            reached_lower[rows] = np.minimum(low[rows], y)
            reached_upper[rows] = np.maximum(up[rows], y)
            inexact = max(inexact, float(failed[0]))
            first = rows.stop
        return (v, np.array([inexact]), residual(J_given, v, lower, upper, gate), *extras)


def _level(step: LevelStep, inputs: list[Array]) -> tuple[Array, ...]:
    function = BufferedFunction(step.solve)
    outputs = function(*inputs)
    if function.failed:
        return BufferedFunction(step.give_up)(*inputs)
    return outputs


@checked_dataclass(eq=False)
class LexicographicQp:
    """Each level minimises its own slack subject to the optimal slack of all levels above it.

    What the plugin's programs do not reach to the certificate, the active set that they end with
    does: from it `LexicographicActiveSet` takes an iteration or two. So results are exact where its
    own are, whatever the plugin.

    What a gate between 0 and 1 does is said in `uvms_ocp.solvers.hierarchy.level`. Raises
    `InvalidInput` for a number out of its range.
    """

    plugin: str = "qpoases"
    """Any conic plugin of CasADi that solves quadratic programs."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Options of the plugin, on top of our defaults."""
    proximal: Positive = 1e-10
    """Weight of the distance to the velocity of the levels above, relative to the mean square of
    the rows: it makes each program strictly convex.
    """
    tolerance: Positive = 1e-9
    """Largest accepted violation of a higher level, relative to its row."""
    attempts: AtLeastOne = 3
    """Programs per level at most; a further one starts where the last one ended."""
    certified: bool = True
    """Certify every result, which takes longer than the solution; else no result is called
    exact.
    """

    def __post_init__(self) -> None:
        """Raises `NameNotFound` for an unknown plugin."""
        if not _exists(self.plugin):
            raise NameNotFound("conic plugin", self.plugin, conic_plugins())

    @checked_on_failure
    def solve(self, levels: Sequence[Level]) -> solution.Solution:
        """Raises `InvalidInput` where ``levels`` is empty or of mixed width."""
        return solution.timed_solution(levels, partial(solution.solve_stacked, self.bind))

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> solution.Tick:
        """Build one Function of ``levels_function`` and the cascade; outputs beyond the six of
        ``Level`` are extras.
        """
        solution.check_levels_function(levels_function, sizes)
        inputs = solution.dense_inputs(levels_function)
        names = levels_function.name_in()
        J, lower, upper, _, _, gate, *extras = solution.dense_outputs(levels_function, inputs)
        # Some plugins print a banner through Python's stdout when they are created.
        with contextlib.redirect_stdout(io.StringIO()):
            steps = list[LevelStep]()
            n_above = 0
            for size in sizes:
                if size > 0:
                    steps.append(level_step(self, J.shape[1], n_above, size))
                n_above += size
        valid, J_safe, low, up = sanitised(J, lower, upper, gate)
        v, inexact = cascade(steps, J_safe, low, up)
        status, residual = outcome(valid, v, inexact, J, lower, upper, gate)
        outputs = [v, status, residual, *extras]
        raw = [J_safe, low, up, J, lower, upper, gate, *extras]
        tick = ca.Function("tick", inputs, outputs, names, _output_names(outputs))
        levels = ca.Function("levels", inputs, raw, names, _output_names(raw))
        return QpTick(tick, levels, steps, sizes, certified=self.certified)


def _output_names(outputs: Sequence[ca.MX]) -> list[str]:
    return [f"out_{i}" for i in range(len(outputs))]


@cache
def conic_plugins() -> tuple[str, ...]:
    """Return the names of the conic plugins of this CasADi that can be loaded, and take a dense
    quadratic program as they are.
    """
    plugins = list[str]()
    for entry in sorted(str(ca.CasadiMeta.plugins()).split(";")):
        kind, _, name = entry.partition("::")
        if kind != "Conic" or name in _STAGE_PLUGINS:
            continue
        if _exists(name) and _takes_dense_programs(name):
            plugins.append(name)
    return tuple(plugins)


def _takes_dense_programs(plugin: str) -> bool:
    with (
        contextlib.suppress(RuntimeError),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        dense = ca.Sparsity.dense(2, 2)
        ca.conic("probe", plugin, {"h": dense, "a": dense}, _PLUGIN_OPTIONS.get(plugin, {}))
        return True
    return False


@cache
def _exists(plugin: str) -> bool:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return bool(ca.has_conic(plugin))

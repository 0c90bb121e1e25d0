"""Build the cascade of quadratic programs as one CasADi expression.

Level k is ``min |s|^2 + proximal |z|^2`` over (z, s) with ``v = v_0 + P z``, subject to ``lower <= J v - s <= upper``
and to the rows of the levels above. v_0 is the result of the levels above and P the projector on what their fixed
rows (equalities and rows that had to be violated) leave free, so z = 0 is feasible exactly and the constraints
of the program are inequalities only: that is what keeps an active-set plugin from cycling.
Equalities of the level itself enter the objective. `[rate]` is the unit of a row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from uvms_ocp.codegen.elementwise import Array, interval_distance, interval_excess, logical_or, row_sums, where
from uvms_ocp.solvers.hierarchy.level import is_valid, residual, widen_bounds

_INVALID = 2
# Relative to its row: a row of which less than this is free counts as fixed already.
_RANK_TOLERANCE = 1e-10
# A level whose rows are violated by less needs no program.
_SATISFIED = 1e-12
# Rows violated by less may be so for want of accuracy; held as inequalities they lose nothing at an optimum.
_VIOLATED = 1e-6
# Residual of the optimality conditions, relative to the size of the gradient.
_STATIONARY = 3e-9
_NOTHING, _SATISFIED_CASE = 0, 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QpSettings:
    """Settings of `LexicographicQp` that shape the graph, described there."""

    plugin: str
    """Name of the conic plugin."""
    options: Mapping[str, object]
    """All options of the plugin."""
    proximal: float
    tolerance: float
    attempts: int
    """Programs per level at most."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Held:
    """Rows of all levels above, with bounds widened to what was reached."""

    J: ca.MX
    """(k, n)"""
    lower: ca.MX
    """(k,)"""
    upper: ca.MX
    """(k,)"""
    fixed: ca.MX
    """(k,) 1 where the row cannot move any more."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _LevelSymbols:
    """Symbolic inputs of one level."""

    held: _Held
    """Solution of the levels above."""
    J: ca.MX
    """(m, n) its own rows."""
    lower: ca.MX
    """(m,)"""
    upper: ca.MX
    """(m,)"""
    v: ca.MX
    """(n,) result of the levels above."""
    P: ca.MX
    """(n, n) projector on what they leave free."""

    def inputs(self, v: ca.MX | None = None) -> list[ca.MX]:
        held = self.held
        start = self.v if v is None else v
        return [held.J, held.lower, held.upper, held.fixed, self.J, self.lower, self.upper, start, self.P]


def sanitised(J: ca.MX, lower: ca.MX, upper: ca.MX, gate: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
    """Valid (1,), then J and the gated bounds, which are harmless where the input is not valid."""
    valid = is_valid(J, lower, upper, gate)
    J = ca.if_else(valid, J, ca.MX.zeros(J.shape))
    low, up = widen_bounds(J, lower, upper, ca.if_else(valid, gate, ca.MX.zeros(gate.shape)))
    return valid, J, low, up


def outcome(
    valid: ca.MX, v: ca.MX, inexact: ca.MX, J: ca.MX, lower: ca.MX, upper: ca.MX, gate: ca.MX
) -> tuple[ca.MX, ca.MX]:
    """Status (0 solved, 1 inexact, 2 invalid input) and residual (M,)."""
    missed = ca.if_else(valid, residual(J, v, lower, upper, gate), ca.MX.zeros(gate.shape))
    return ca.if_else(valid, inexact, _INVALID), missed


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelStep:
    """Functions of one level: (held J, lower, upper, fixed, J, lower, upper, v, P) -> (v, P, failed)."""

    solve: ca.Function
    """V at the optimum of the level."""
    give_up: ca.Function
    """Keeps v; for a plugin that fails even on a fresh start."""
    conic: ca.Function
    """Its memory holds the active set of the last call."""


def cascade(steps: Sequence[LevelStep | None], J: ca.MX, lower: ca.MX, upper: ca.MX) -> tuple[ca.MX, ca.MX]:
    """V (n,) and 1 if any level is inexact, from one ``level_function`` per level (None: no rows)."""
    n = J.shape[1]
    v, P, inexact = ca.MX.zeros(n), ca.MX.eye(n), ca.MX.zeros(1)
    held = _Held(J=ca.MX(0, n), lower=ca.MX(0, 1), upper=ca.MX(0, 1), fixed=ca.MX(0, 1))
    for step in steps:
        if step is None:
            continue
        rows = slice(held.J.shape[0], held.J.shape[0] + step.solve.size1_in(4))
        own = _LevelSymbols(held=held, J=J[rows, :], lower=lower[rows], upper=upper[rows], v=v, P=ca.densify(P))
        v, P, failed = step.solve.call(own.inputs())
        held, inexact = _extended(own, v), ca.fmax(inexact, failed)
    return v, inexact


def level_step(settings: QpSettings, n: int, held: int, size: int) -> LevelStep:
    """Level of ``size`` rows below ``held`` rows; it does as little as is needed."""
    name, symbols = f"level_{held}", _level_symbols(n, held, size)
    inputs, zero = symbols.inputs(), ca.MX.zeros(1)
    nothing = ca.Function(f"{name}_nothing", inputs, [symbols.v, symbols.P, zero])
    projector = _projector(symbols, symbols.v)
    satisfied = ca.Function(f"{name}_satisfied", inputs, [symbols.v, projector, zero])
    conic = _conic(settings, name, symbols)
    programs = _programs(settings, name, conic, symbols)
    choice = ca.Function.conditional(f"{name}_case", [nothing, satisfied], programs)
    return LevelStep(
        solve=ca.Function(name, inputs, choice.call([_case(symbols), *inputs])),
        give_up=ca.Function(f"{name}_kept", inputs, [symbols.v, projector, ca.MX.ones(1)]),
        conic=conic,
    )


def fixed_rows(y: Array, lower: Array, upper: Array) -> Array:
    """True for rows that cannot move any more at y (m,) [rate]: equalities, and rows that had to be violated.

    lower and upper (m,) [rate].
    """
    return logical_or(lower >= upper, interval_excess(y, lower, upper) > _VIOLATED)


def _level_symbols(n: int, held: int, size: int) -> _LevelSymbols:
    return _LevelSymbols(
        held=_Held(
            J=ca.MX.sym("held_J", held, n),
            lower=ca.MX.sym("held_lower", held),
            upper=ca.MX.sym("held_upper", held),
            fixed=ca.MX.sym("held_fixed", held),
        ),
        J=ca.MX.sym("J", size, n),
        lower=ca.MX.sym("lower", size),
        upper=ca.MX.sym("upper", size),
        v=ca.MX.sym("v", n),
        P=ca.MX.sym("P", n, n),
    )


def _case(symbols: _LevelSymbols) -> ca.MX:
    """_NOTHING where no program could change v, _SATISFIED_CASE where v is optimal but P may shrink, else 2."""
    free = ca.norm_inf(symbols.J @ symbols.P) > _RANK_TOLERANCE * ca.norm_inf(symbols.J)
    satisfied = ca.norm_inf(interval_distance(symbols.J @ symbols.v, symbols.lower, symbols.upper)) <= _SATISFIED
    equality = ca.sum1(symbols.lower >= symbols.upper) > 0
    unchanged = ca.if_else(equality, _SATISFIED_CASE, _NOTHING)
    return ca.if_else(free, ca.if_else(satisfied, unchanged, 2), _NOTHING)


def _extended(own: _LevelSymbols, v: ca.MX) -> _Held:
    y, held = own.J @ v, own.held
    return _Held(
        J=ca.vertcat(held.J, own.J),
        lower=ca.vertcat(held.lower, ca.fmin(own.lower, y)),
        upper=ca.vertcat(held.upper, ca.fmax(own.upper, y)),
        fixed=ca.vertcat(held.fixed, fixed_rows(y, own.lower, own.upper)),
    )


def _projector(own: _LevelSymbols, v: ca.MX) -> ca.MX:
    """P without the directions of the rows that are fixed at v."""
    P, fixed = own.P, fixed_rows(own.J @ v, own.lower, own.upper)
    for i in range(own.J.shape[0]):
        a = own.J[i, :].T
        # Applied twice, so that what earlier rows have removed stays removed to rounding.
        r = P @ (P @ a)
        size = ca.sumsqr(r)
        new = ca.logic_and(fixed[i], size > _RANK_TOLERANCE**2 * ca.sumsqr(a))
        P = P - r @ (r * ca.if_else(new, 1 / size, 0)).T
    return P


def _programs(settings: QpSettings, name: str, solver: ca.Function, symbols: _LevelSymbols) -> ca.Function:
    inputs = symbols.inputs()
    step = ca.Function(f"{name}_given_up", inputs, [symbols.v, ca.MX.ones(1)])
    for _ in range(settings.attempts):
        step = _attempt(settings, name, solver, symbols, step)
    v, failed = step.call(inputs)
    return ca.Function(f"{name}_programs", inputs, [v, _projector(symbols, v), failed])


def _conic(settings: QpSettings, name: str, symbols: _LevelSymbols) -> ca.Function:
    size, n = symbols.J.shape
    H = ca.diagcat(ca.Sparsity.dense(n, n), ca.Sparsity.diag(size))
    A = ca.Sparsity.dense(symbols.held.J.shape[0] + size, n + size)
    options = dict(settings.options)
    if settings.plugin == "qpoases":
        # Warm starts that need more working-set changes than this hardly ever recover.
        options.setdefault("nWSR", 40 + sum(A.shape))
    return ca.conic(f"{name}_qp", settings.plugin, {"h": H, "a": A}, options)


def _attempt(
    settings: QpSettings, name: str, solver: ca.Function, symbols: _LevelSymbols, otherwise: ca.Function
) -> ca.Function:
    """One program; ``otherwise`` continues from its result if that is not verified to be optimal."""
    v, multipliers = _program(settings, solver, symbols)
    accepted = _is_acceptable(settings, symbols, v)
    v = ca.if_else(accepted, v, symbols.v)
    # Where rounding alone made the program look worse, its multipliers verify the former v.
    verified = _is_optimal(settings, symbols, v, multipliers)
    inputs = symbols.inputs()
    done = ca.Function(f"{name}_done", inputs, [symbols.v, ca.MX.zeros(1)])
    choice = ca.Function.if_else(f"{name}_again", done, otherwise)
    return ca.Function(f"{name}_try", inputs, choice.call([verified, *symbols.inputs(v)]))


def _program(settings: QpSettings, solver: ca.Function, symbols: _LevelSymbols) -> tuple[ca.MX, ca.MX]:
    """V, and the multipliers of the rows of the levels above."""
    size, n = symbols.J.shape
    JP, y = symbols.J @ symbols.P, symbols.J @ symbols.v
    equal = symbols.lower >= symbols.upper
    E = ca.repmat(equal, 1, n) * JP
    target = ca.if_else(equal, symbols.lower - y, 0)
    curvature = E.T @ E + settings.proximal * ca.sumsqr(JP) / size * ca.MX.eye(n)
    held_JP, held_lower, held_upper = _held_rows(symbols)
    held = held_JP.shape[0]
    own = (where(equal, -ca.inf, symbols.lower - y), where(equal, ca.inf, symbols.upper - y))
    solution = solver(
        h=ca.diagcat(curvature, ca.MX.eye(size)),
        g=ca.vertcat(-(E.T @ target), ca.MX.zeros(size)),
        a=ca.densify(ca.vertcat(ca.horzcat(held_JP, ca.MX.zeros(held, size)), ca.horzcat(JP, ca.MX(-ca.DM.eye(size))))),
        lba=ca.vertcat(held_lower, own[0]),
        uba=ca.vertcat(held_upper, own[1]),
    )
    multipliers = solution["lam_a"][:held] if held else ca.MX(0, 1)
    return symbols.v + symbols.P @ solution["x"][:n], multipliers


def _held_rows(symbols: _LevelSymbols) -> tuple[ca.MX, ca.MX, ca.MX]:
    held = symbols.held
    JP, y = held.J @ symbols.P, held.J @ symbols.v
    if held.J.shape[0] == 0:
        return JP, y, y
    moves = ca.sum2(JP**2) > _RANK_TOLERANCE**2 * ca.sum2(held.J**2)
    dropped = ca.logic_or(held.fixed, ca.logic_not(moves))
    low = where(dropped, -ca.inf, ca.fmin(held.lower - y, 0))
    return JP, low, where(dropped, ca.inf, ca.fmax(held.upper - y, 0))


def _is_acceptable(settings: QpSettings, symbols: _LevelSymbols, v: ca.MX) -> ca.MX:
    """True if v is finite, keeps all levels above, and is no worse than before at this one."""
    before = ca.sumsqr(interval_distance(symbols.J @ symbols.v, symbols.lower, symbols.upper))
    after = ca.sumsqr(interval_distance(symbols.J @ v, symbols.lower, symbols.upper))
    # Comparisons with NaN are false, but norm_inf ignores NaN.
    better = ca.logic_and(ca.sumsqr(v) < 1e30, after <= before * (1 + 1e-12))
    held = symbols.held
    if held.J.shape[0] == 0:
        return better
    worse = interval_excess(held.J @ v, held.lower, held.upper) / (1 + row_sums(ca.fabs(held.J)))
    return ca.logic_and(better, ca.norm_inf(worse) <= settings.tolerance)


def _is_optimal(settings: QpSettings, symbols: _LevelSymbols, v: ca.MX, multipliers: ca.MX) -> ca.MX:
    """Karush-Kuhn-Tucker conditions of the level without the proximal term."""
    slack = interval_distance(symbols.J @ v, symbols.lower, symbols.upper)
    scale = _STATIONARY * (1 + ca.norm_fro(symbols.J) * ca.norm_2(slack))
    held = symbols.held
    gradient = symbols.P.T @ (symbols.J.T @ slack + held.J.T @ multipliers)
    stationary = ca.norm_2(gradient) <= scale
    if held.J.shape[0] == 0:
        return stationary
    y, far = held.J @ v, 1e6
    above = ca.fmax(multipliers, 0) * ca.fmin(ca.fmax(held.upper - y, 0), far)
    below = ca.fmax(-multipliers, 0) * ca.fmin(ca.fmax(y - held.lower, 0), far)
    return ca.logic_and(stationary, ca.norm_inf(above + below) <= scale)

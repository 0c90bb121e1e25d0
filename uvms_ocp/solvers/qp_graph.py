"""The cascade of quadratic programs as one CasADi expression.

Level k is ``min |s|^2 + proximal |v - v_0|^2`` over (v, s), subject to ``lower <= J v - s <= upper`` and to the
rows of all levels above, whose bounds are widened to what the level above reached. Equalities enter the
objective instead, so that the active-set iterations of the plugin deal with inequalities only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

_INVALID = 2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QpSettings:
    """See ``LexicographicQp``."""

    plugin: str
    options: Mapping[str, object]
    proximal: float
    tolerance: float
    attempts: int


def cascade_graph(
    settings: QpSettings, J: ca.MX, lower: ca.MX, upper: ca.MX, gate: ca.MX, sizes: tuple[int, ...]
) -> tuple[ca.MX, ca.MX, ca.MX]:
    """v (n,), status (0 solved, 1 inexact, 2 invalid input), residual (M,)."""
    valid = _is_valid(J, lower, upper, gate)
    J = ca.if_else(valid, J, ca.MX.zeros(J.shape))
    low, up = _gated(J, lower, upper, ca.if_else(valid, gate, ca.MX.zeros(gate.shape)))
    v, inexact = _cascade(settings, J, low, up, sizes)
    status = ca.if_else(valid, inexact, _INVALID)
    residual = ca.if_else(gate > 0, _distance(J @ v, lower, upper), ca.MX.zeros(gate.shape))
    return v, status, ca.if_else(valid, residual, ca.MX.zeros(gate.shape))


def _cascade(
    settings: QpSettings, J: ca.MX, lower: ca.MX, upper: ca.MX, sizes: tuple[int, ...]
) -> tuple[ca.MX, ca.MX]:
    v, inexact = ca.MX.zeros(J.shape[1]), ca.MX.zeros(1)
    held_lower, held_upper, start = ca.MX(0, 1), ca.MX(0, 1), 0
    for k, size in enumerate(sizes):
        if size == 0:
            continue
        rows = slice(start, start + size)
        step = _level_function(settings, f"level_{k}", J.shape[1], start, size)
        held, own = (J[:start, :], held_lower, held_upper), (J[rows, :], lower[rows], upper[rows])
        v, failed = step(*held, *own, v)
        y = own[0] @ v
        held_lower = ca.vertcat(held_lower, ca.fmin(own[1], y))
        held_upper = ca.vertcat(held_upper, ca.fmax(own[2], y))
        inexact, start = ca.fmax(inexact, failed), start + size
    return v, inexact


def _level_function(settings: QpSettings, name: str, n: int, held: int, size: int) -> ca.Function:
    """(held J, lower, upper, own J, lower, upper, v) -> (v, failed): as few programs as are needed."""
    symbols = _level_symbols(n, held, size)
    v = symbols[-1]
    unchanged = ca.Function(f"{name}_kept", symbols, [v, ca.MX.zeros(1)])
    step = ca.Function(f"{name}_given_up", symbols, [v, ca.MX.ones(1)])
    solver = _conic(settings, name, n, held, size)
    for _ in range(settings.attempts):
        step = _attempt(settings, name, solver, symbols, step)
    own_J, low, up = symbols[3:6]
    violation = ca.norm_inf(_distance(own_J @ v, low, up))
    choice = ca.Function.if_else(f"{name}_choice", step, unchanged)
    return ca.Function(name, symbols, choice.call([violation > 1e-14, *symbols]))


def _level_symbols(n: int, held: int, size: int) -> list[ca.MX]:
    shapes = ((held, n), (held, 1), (held, 1), (size, n), (size, 1), (size, 1), (n, 1))
    names = ("held_J", "held_lower", "held_upper", "J", "lower", "upper", "v")
    return [ca.MX.sym(name, *shape) for name, shape in zip(names, shapes, strict=True)]


def _conic(settings: QpSettings, name: str, n: int, held: int, size: int) -> ca.Function:
    H = ca.diagcat(ca.Sparsity.dense(n, n), ca.Sparsity.diag(size))
    A = ca.Sparsity.dense(held + size, n + size)
    return ca.conic(f"{name}_qp", settings.plugin, {"h": H, "a": A}, dict(settings.options))


def _attempt(
    settings: QpSettings, name: str, solver: ca.Function, symbols: list[ca.MX], otherwise: ca.Function
) -> ca.Function:
    """One program; ``otherwise`` continues from its result if that is not verified to be optimal."""
    held_J, held_lower, held_upper, J, low, up, v_0 = symbols
    v, multipliers = _program(settings, solver, symbols)
    better = _is_better(settings, symbols, v)
    v = ca.if_else(better, v, v_0)
    slack = _distance(J @ v, low, up)
    gradient = J.T @ slack + held_J.T @ multipliers
    slope = ca.norm_inf(gradient) / (1 + ca.norm_inf(J))
    verified = ca.logic_and(better, slope <= settings.tolerance)
    done = ca.Function(f"{name}_done", symbols, [v_0, ca.MX.zeros(1)])
    choice = ca.Function.if_else(f"{name}_again", done, otherwise)
    return ca.Function(f"{name}_try", symbols, choice.call([verified, *symbols[:-1], v]))


def _program(settings: QpSettings, solver: ca.Function, symbols: list[ca.MX]) -> tuple[ca.MX, ca.MX]:
    held_J, held_lower, held_upper, J, low, up, v_0 = symbols
    n, held, size = J.shape[1], held_J.shape[0], J.shape[0]
    equal = low >= up
    E = ca.repmat(equal, 1, n) * J
    target = ca.if_else(equal, low, ca.MX.zeros(size))
    H = ca.diagcat(E.T @ E + settings.proximal * ca.MX.eye(n), ca.MX.eye(size))
    free = ca.MX(ca.inf * ca.DM.ones(size))
    bounds = (ca.if_else(equal, -free, low), ca.if_else(equal, free, up))
    A = ca.vertcat(ca.horzcat(held_J, ca.MX.zeros(held, size)), ca.horzcat(J, ca.MX(-ca.DM.eye(size))))
    solution = solver(
        h=H,
        g=ca.vertcat(-settings.proximal * v_0 - E.T @ target, ca.MX.zeros(size)),
        a=ca.densify(A),
        lba=ca.vertcat(held_lower, bounds[0]),
        uba=ca.vertcat(held_upper, bounds[1]),
        x0=ca.vertcat(v_0, ca.MX.zeros(size)),
    )
    return solution["x"][:n], solution["lam_a"][:held]


def _is_better(settings: QpSettings, symbols: list[ca.MX], v: ca.MX) -> ca.MX:
    """True if v is finite, keeps all levels above, and is no worse than v_0 at this one."""
    held_J, held_lower, held_upper, J, low, up, v_0 = symbols
    before = ca.sumsqr(_distance(J @ v_0, low, up))
    better = ca.logic_and(ca.sumsqr(v) < 1e30, ca.sumsqr(_distance(J @ v, low, up)) <= before)
    if held_J.shape[0] == 0:
        return better
    excess = ca.fabs(_distance(held_J @ v, held_lower, held_upper))
    scale = 1 + ca.sum2(ca.fabs(held_J))
    return ca.logic_and(better, ca.norm_inf(excess / scale) <= settings.tolerance)


def _gated(J: ca.MX, lower: ca.MX, upper: ca.MX, gate: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Bounds that leave to infinity as the gate goes from 1 to 0; sum |J_row| is J v's range for |v| <= 1."""
    free = ca.MX(ca.inf * ca.DM.ones(gate.shape[0]))
    width = (1 - gate) / ca.fmax(gate, 1e-300) * ca.sum2(ca.fabs(J))
    low = ca.if_else(gate > 0, lower - width, -free)
    return low, ca.if_else(gate > 0, upper + width, free)


def _is_valid(J: ca.MX, lower: ca.MX, upper: ca.MX, gate: ca.MX) -> ca.MX:
    # Comparisons with NaN are false.
    ordered = ca.logic_and(lower <= upper, ca.logic_and(lower < ca.inf, upper > -ca.inf))
    gated = ca.logic_and(gate >= 0, gate <= 1)
    return ca.logic_and(_all(ca.fabs(J) < 1e15), ca.logic_and(_all(ordered), _all(gated)))


def _all(condition: ca.MX) -> ca.MX:
    return ca.sum1(ca.vec(condition)) >= condition.numel()


def _distance(y: ca.MX, lower: ca.MX, upper: ca.MX) -> ca.MX:
    return y - ca.fmin(ca.fmax(y, lower), upper)

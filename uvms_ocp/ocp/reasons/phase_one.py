"""The least by which limits and constraints would have to give way for any motion to keep them.

An elastic program over the rows of the transcription, built on demand: each group of bounds and constraints gives way by
an amount of its own, alike at all nodes, and the sum of the amounts is least. Laws (motion, forces, start) do not give
way. It ends at a minimum where the problem itself has no solution to end at.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.reasons.groups import Group, Grouped, row_groups, variable_groups
from uvms_ocp.ocp.transcription.transcription import Transcription

_STAY = 1e-6  # [-] weight of staying near the start, which makes the minimum one point
_KEPT = 1e-4  # [-] amount that is none
_AGAINST = 0.05  # share of a group in what holds against the others, from which it is named
_ITERATIONS = 500
_GRADIENTS = ["f", "g", "grad_gamma_x", "grad_gamma_p"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Given:
    """A group that gives way."""

    group: Group
    amount: float
    """[-, or unit of the row] In its measure."""
    axes: tuple[str, ...]
    """On which it matters most."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PhaseOne:
    """Where the least violation is."""

    x: np.ndarray
    """(n_x,) [unit of x]"""
    converged: bool
    given: tuple[Given, ...]
    """The largest amount first."""
    against: tuple[Group, ...]
    """Groups that are kept and hold against them."""
    iterations: int

    @property
    def feasible(self) -> bool:
        return not self.given


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Elastic:
    """Rows ``P [g; x] + Q s`` within bounds, with amounts s >= 0 of the groups."""

    grouped: Grouped
    """Of the constraints, then of the variables."""
    P: ca.DM
    """(m, n_g + n_x)"""
    Q: ca.DM
    """(m, n_groups)"""
    lower: np.ndarray
    """(m,)"""
    upper: np.ndarray
    """(m,)"""

    @property
    def groups(self) -> tuple[Group, ...]:
        return self.grouped.groups


def phase_one(
    transcription: Transcription, problem: OcpProblem, p: np.ndarray, x: np.ndarray, *, time_limit: float
) -> PhaseOne:
    """Search from x (n_x,) [unit of x], with parameters p (n_p,), for `time_limit` [s] at most."""
    elastic = _elastic(transcription, problem)
    solver = _solver(transcription, elastic, p, x, time_limit)
    n = len(x)
    g = np.array(transcription.constraint_functions()["nlp_g"](x, p)).ravel()
    start = np.concatenate([x, _amounts(elastic, np.concatenate([g, x]))])
    infinite = np.full(n, np.inf)
    solution = solver(
        x0=start,
        lbx=np.concatenate([-infinite, np.zeros(len(elastic.groups))]),
        ubx=np.inf,
        lbg=elastic.lower,
        ubg=elastic.upper,
    )
    found, rows = np.array(solution["x"]).ravel(), np.abs(np.array(solution["lam_g"]).ravel())
    # What each variable and row holds, by the multipliers of its own rows.
    held = np.abs(np.array(elastic.P.T @ rows).ravel()) * elastic.grouped.scale
    amounts, groups = found[n:].tolist(), elastic.groups
    given = [
        Given(group=group, amount=amount, axes=elastic.grouped.strongest(i, held))
        for i, (group, amount) in enumerate(zip(groups, amounts, strict=True))
        if amount > _KEPT
    ]
    kept = [i for i, amount in enumerate(amounts) if amount <= _KEPT]
    stats = solver.stats()
    return PhaseOne(
        x=found[:n],
        converged=bool(stats["success"]) and bool(np.isfinite(found).all()),
        given=tuple(sorted(given, key=lambda item: -item.amount)),
        against=tuple(groups[i] for i in kept if held[elastic.grouped.number == i].sum() > _AGAINST),
        iterations=int(stats["iter_count"]),
    )


def _elastic(transcription: Transcription, problem: OcpProblem) -> _Elastic:
    grouped = _together(row_groups(transcription, problem), variable_groups(transcription))
    number, ranges, (low, up) = grouped.number, transcription.ranges(problem), transcription.bounds(problem)
    lower, upper = np.concatenate([ranges.lower, low]), np.concatenate([ranges.upper, up])
    hard, soft = number < 0, number >= 0
    parts = (
        (np.flatnonzero(hard & (np.isfinite(lower) | np.isfinite(upper))), 0.0),
        (np.flatnonzero(soft & np.isfinite(upper)), -1.0),
        (np.flatnonzero(soft & np.isfinite(lower)), 1.0),
    )
    chosen = np.concatenate([members for members, _ in parts])
    sign = np.concatenate([np.full(len(members), value) for members, value in parts])
    m = len(chosen)
    Q = np.zeros((m, len(grouped.groups)))
    Q[np.arange(m), np.maximum(number[chosen], 0)] = sign * grouped.scale[chosen]
    return _Elastic(
        grouped=grouped,
        P=ca.DM.triplet(list(range(m)), chosen.tolist(), ca.DM.ones(m), m, len(number)),
        Q=ca.sparsify(ca.DM(Q)),
        lower=np.where(sign < 0, -np.inf, lower[chosen]),
        upper=np.where(sign > 0, np.inf, upper[chosen]),
    )


def _together(rows: Grouped, variables: Grouped) -> Grouped:
    return Grouped(
        groups=(*rows.groups, *variables.groups),
        number=np.concatenate([rows.number, np.where(variables.number < 0, -1, variables.number + len(rows.groups))]),
        scale=np.concatenate([rows.scale, variables.scale]),
        axes=(*rows.axes, *variables.axes),
    )


def _amounts(elastic: _Elastic, values: np.ndarray) -> np.ndarray:
    """Of a start whose rows and variables have these values: enough to keep all, and a little more."""
    w, Q = np.array(elastic.P @ values).ravel(), np.abs(elastic.Q.full())
    broken = np.maximum(np.maximum(w - elastic.upper, elastic.lower - w), 0.0)
    units = np.where(Q > 0, Q, 1.0)
    return np.asarray(np.where(Q > 0, broken[:, None] / units, 0.0).max(axis=0, initial=0.0) + 0.01)


def _solver(
    transcription: Transcription, elastic: _Elastic, p: np.ndarray, x: np.ndarray, time_limit: float
) -> ca.Function:
    """IPOPT with the derivatives of the transcription."""
    functions, n, k = transcription.constraint_functions(), len(x), len(elastic.groups)
    X, none, lam_f = ca.MX.sym("X", n + k), ca.MX.sym("p", 0), ca.MX.sym("lam_f")
    lam = ca.MX.sym("lam_g", elastic.P.shape[0])
    n_g = elastic.P.shape[1] - n
    g, J = functions["nlp_jac_g"](X[:n], p)
    away = X[:n] - x
    f = ca.sum1(X[n:]) + _STAY / 2 * ca.sumsqr(away)
    rows = elastic.P @ ca.vertcat(g, X[:n]) + elastic.Q @ X[n:]
    jacobian = ca.horzcat(elastic.P @ ca.vertcat(J, ca.MX(ca.DM.eye(n))), ca.MX(elastic.Q))
    H = functions["nlp_hess_l"](X[:n], p, 0.0, (elastic.P.T @ lam)[:n_g])
    hessian = ca.diagcat(H + lam_f * _STAY * ca.DM.eye(n), ca.MX(k, k))
    inputs, names = [X, none], ["x", "p"]
    cache = (
        ca.Function("nlp_f", inputs, [f], names, ["f"]),
        ca.Function("nlp_g", inputs, [rows], names, ["g"]),
        ca.Function("nlp_grad_f", inputs, [f, ca.vertcat(_STAY * away, ca.MX.ones(k))], names, ["f", "grad_f_x"]),
        ca.Function("nlp_jac_g", inputs, [rows, jacobian], names, ["g", "jac_g_x"]),
        ca.Function(
            "nlp_hess_l", [X, none, lam_f, lam], [ca.triu(hessian)], [*names, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
        # Asked for at construction, never called.
        ca.Function(
            "nlp_grad", [X, none, lam_f, lam], [f, rows, jacobian.T @ lam, none], [*names, "lam_f", "lam_g"], _GRADIENTS
        ),
    )
    options = {
        "cache": {function.name(): function for function in cache},
        "error_on_fail": False,
        "print_time": False,
        "calc_lam_p": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": _ITERATIONS, "max_wall_time": max(time_limit, 0.1)},
    }
    return ca.nlpsol("phase_one", "ipopt", {"x": X, "p": none, "f": f, "g": rows}, options)

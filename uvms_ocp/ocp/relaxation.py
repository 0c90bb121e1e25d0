"""Find the least by which limits and constraints would have to give way for any motion to keep them
(phase one), or for a level to be met.

An elastic program over the rows of the transcription, built on demand: each group of bounds and
constraints gives way by an amount of its own, alike at all nodes, and the sum of the amounts is
least. Laws (motion, forces, start) do not give way. It ends at a minimum where the problem itself
has no solution to end at.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import casadi as ca
import numpy as np

from uvms_ocp.ocp.bound_groups import (
    BoundGroup,
    GroupIndex,
    RelaxationUnit,
    row_groups,
    together,
    variable_groups,
)
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers import LexicographicResult
from uvms_ocp.solvers.nlp.program import nlp_functions

_STAY = 1e-6  # weight of staying near the start, which makes the minimum one point
_KEPT = 1e-4  # amount that is none
_AGAINST = 0.05  # share of a group in what holds against the others, from which it is named
_ITERATIONS = 500
_SILENT = {"print_level": 0, "sb": "yes"}
_FARTHEST = (
    2.0  # amount by which a group gives way at most in the search for those that hold a level back
)
_GAIN = 1e-5  # share of the residual of a level that is none
_FULL = 1e-3  # share of the residual with which a level is met
_BESIDE = 1e-3  # share of the residual that rows of a level that are met may lose


@dataclass(frozen=True, kw_only=True, slots=True)
class Relaxation:
    """A group that gives way."""

    group: BoundGroup
    amount: float
    """[-, or unit of the row] by which the group gives way, in its measure."""
    axes: tuple[str, ...]
    """Axes on which it matters most."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PhaseOne:
    """Result of phase one: the point of least violation."""

    x: np.ndarray
    """(n_x,) [unit of x]"""
    converged: bool
    relaxations: tuple[Relaxation, ...]
    """The largest amount first."""
    opposing: tuple[BoundGroup, ...]
    """Groups that are kept and hold against them."""
    iterations: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """Groups that hold a level back, and what they would have to give."""

    left: float
    """[-] Share of the residual that is left then; 0 where the level is met."""
    relaxations: tuple[Relaxation, ...]
    """The largest amount first."""


def phase_one(
    transcription: Transcription,
    problem: OcpProblem,
    p: np.ndarray,
    x: np.ndarray,
    *,
    time_limit: float,
) -> PhaseOne:
    """Search from x (n_x,) [unit of x], with parameters p (n_p,), for `time_limit` [s] at most."""
    elastic = _Elastic(transcription, problem, _constraint_rows(transcription, problem), p)
    weights = np.ones(len(elastic.groups))
    return elastic.least(x, weights, np.inf * weights, time_limit=time_limit)[2]


def bindings(
    transcription: Transcription,
    problem: OcpProblem,
    p: np.ndarray,
    result: LexicographicResult,
    level: int,
    *,
    time_limit: float,
) -> tuple[Binding, ...] | None:
    """Find what holds a level back: limits of the robot, constraints and levels above, and all of
    them where neither does alone.

    They give way as far as they can, for the least that can be left at all; then by the least sum
    with which no more is left than half of the way there, or nothing where the level can be met.
    Empty where nothing gains; None where that is not found within `time_limit` [s].
    """
    ends = perf_counter() + time_limit
    rows = _level_rows(transcription, problem, result, level)
    elastic = _Elastic(transcription, problem, rows, p)
    goal = np.arange(len(elastic.groups)) == len(rows.grouped.groups) - 1
    limits = np.array([group.measure is not RelaxationUnit.ROW for group in elastic.groups])
    holding: list[Binding] = []
    all_converged = True
    for chosen in (limits, ~limits & ~goal, ~goal):
        if holding and (chosen == ~goal).all():
            break
        limits_of_amounts = np.where(chosen, _FARTHEST, 1.0 * goal)
        x, amounts, best = elastic.least(
            result.x,
            1.0 * goal,
            limits_of_amounts,
            time_limit=ends - perf_counter(),
            stay=1e-6 * _STAY,
        )
        gain = 1.0 - float(amounts[goal][0])
        all_converged &= best.converged
        if not best.converged or gain < _GAIN:
            continue
        if amounts[goal][0] < _FULL:
            share_left = 0.0
        else:
            share_left = 1.0 - gain / 2
        limits_of_amounts = np.where(chosen, np.inf, max(share_left, _FULL) * goal)
        for start in (x, result.x):
            smallest = elastic.least(
                start, 1.0 * chosen, limits_of_amounts, time_limit=ends - perf_counter()
            )[2]
            if smallest.converged:
                break
        if smallest.converged and smallest.relaxations:
            holding.append(Binding(left=share_left, relaxations=smallest.relaxations))
        all_converged &= smallest.converged
    if holding or all_converged:
        return tuple(holding)
    return None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _ElasticRows:
    """Constraints, the levels above that are held, and the level that is to be met; or the
    constraints alone.
    """

    raw: np.ndarray
    """(m,) rows of the transcription."""
    lower: np.ndarray
    """(m,) [unit of the row]"""
    upper: np.ndarray
    """(m,) [unit of the row]"""
    grouped: GroupIndex


def _constraint_rows(transcription: Transcription, problem: OcpProblem) -> _ElasticRows:
    raw = transcription.row_layout.constraints
    ranges = transcription.ranges(problem)
    grouped = row_groups(transcription, problem)
    return _ElasticRows(raw=raw, lower=ranges.lower, upper=ranges.upper, grouped=grouped)


def _level_rows(
    transcription: Transcription, problem: OcpProblem, result: LexicographicResult, level: int
) -> _ElasticRows:
    """The last group is the level itself: an amount of 1 leaves all its rows as they are."""
    rows = _constraint_rows(transcription, problem)
    ranges = transcription.ranges(problem)
    layout = transcription.row_layout
    residual = np.abs(result.residuals[level])
    parts = []
    for k, own in enumerate(ranges.levels[:level]):
        bounds = own.frozen_bounds(
            result.values[k], 0.5 * float(result.residuals[k] @ result.residuals[k]), _KEPT
        )
        parts.append((layout.held[k], *bounds, np.ones(len(bounds[0]))))
    goal = ranges.levels[level]
    parts.append(
        (
            layout.levels[level],
            goal.lower,
            goal.upper,
            np.maximum(residual, _BESIDE * np.linalg.norm(residual)),
        )
    )
    raw, lower, upper, scale = (np.concatenate(column) for column in zip(*parts, strict=True))
    above = GroupIndex(
        groups=tuple(
            BoundGroup(name=f"level {own.name!r}", measure=RelaxationUnit.ROW)
            for own in ranges.levels[: level + 1]
        ),
        number=np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts]),
        scale=scale,
        axes=("",) * len(raw),
    )
    return _ElasticRows(
        raw=np.concatenate([rows.raw, raw]),
        lower=np.concatenate([rows.lower, lower]),
        upper=np.concatenate([rows.upper, upper]),
        grouped=together(rows.grouped, above),
    )


class _Elastic:
    """Rows ``P [g; x] + Q s`` within bounds, with amounts s >= 0 of the groups, and IPOPT for their
    weighted sum.
    """

    def __init__(
        self, transcription: Transcription, problem: OcpProblem, rows: _ElasticRows, p: np.ndarray
    ) -> None:
        """p: (n_p,) [unit of the parameter]."""
        self.grouped = grouped = together(rows.grouped, variable_groups(transcription))
        self.groups = grouped.groups
        self.n_x = transcription.n_x
        number = grouped.number
        (low, up) = transcription.bounds(problem)
        lower = np.concatenate([rows.lower, low])
        upper = np.concatenate([rows.upper, up])
        hard = number < 0
        soft = number >= 0
        parts = (
            (np.flatnonzero(hard & (np.isfinite(lower) | np.isfinite(upper))), 0.0),
            (np.flatnonzero(soft & np.isfinite(upper)), -1.0),
            (np.flatnonzero(soft & np.isfinite(lower)), 1.0),
        )
        chosen = np.concatenate([members for members, _ in parts])
        sign = np.concatenate([np.full(len(members), value) for members, value in parts])
        m = len(chosen)
        Q = np.zeros((m, len(self.groups)))
        Q[np.arange(m), np.maximum(number[chosen], 0)] = sign * grouped.scale[chosen]
        self.P = ca.DM.triplet(list(range(m)), chosen.tolist(), ca.DM.ones(m), m, len(number))
        self.Q = ca.sparsify(ca.DM(Q))
        self.lower = np.where(sign < 0, -np.inf, lower[chosen])
        self.upper = np.where(sign > 0, np.inf, upper[chosen])
        self.functions = transcription.row_functions(rows.raw)
        self.p = p

    def least(
        self,
        x: np.ndarray,
        weights: np.ndarray,
        most: np.ndarray,
        *,
        time_limit: float,
        stay: float = _STAY,
    ) -> tuple[np.ndarray, np.ndarray, PhaseOne]:
        """Minimise the sum of amounts with `weights` (n_groups,), `most` (n_groups,) at most, from
        x (n_x,); time_limit [s].

        Returns the amounts (n_groups,), and what they mean.
        """
        n = self.n_x
        count = len(self.groups)
        g = np.array(self.functions["nlp_g"](x, self.p)).ravel()
        infinite = np.full(n, np.inf)
        solver = self._solver(x, time_limit)
        solution = solver(
            x0=np.concatenate([x, np.minimum(self._amounts(np.concatenate([g, x])), most)]),
            p=np.concatenate([weights, [stay]]),
            lbx=np.concatenate([-infinite, np.zeros(count)]),
            ubx=np.concatenate([infinite, most]),
            lbg=self.lower,
            ubg=self.upper,
        )
        variables = np.array(solution["x"]).ravel()
        rows = np.abs(np.array(solution["lam_g"]).ravel())
        # What each variable and row holds, by the multipliers of its own rows.
        held = np.abs(np.array(self.P.T @ rows).ravel()) * self.grouped.scale
        amounts = variables[n:]
        stats = solver.stats()
        relaxations = [
            Relaxation(
                group=self.groups[i], amount=float(amounts[i]), axes=self.grouped.strongest(i, held)
            )
            for i in np.flatnonzero((amounts > _KEPT) & (weights > 0)).tolist()
        ]
        kept = np.flatnonzero(amounts <= _KEPT).tolist()
        meaning = PhaseOne(
            x=variables[:n],
            converged=bool(stats["success"]) and bool(np.isfinite(variables).all()),
            relaxations=tuple(sorted(relaxations, key=lambda item: -item.amount)),
            opposing=tuple(
                self.groups[i] for i in kept if held[self.grouped.number == i].sum() > _AGAINST
            ),
            iterations=int(stats["iter_count"]),
        )
        return variables[:n], amounts, meaning

    def _amounts(self, values: np.ndarray) -> np.ndarray:
        """Return relaxations of a start whose rows and variables have these values: enough to keep
        all, and a little more.
        """
        w = np.array(self.P @ values).ravel()
        Q = np.abs(self.Q.full())
        broken = np.maximum(np.maximum(w - self.upper, self.lower - w), 0.0)
        return np.asarray(
            np.where(Q > 0, broken[:, None] / np.where(Q > 0, Q, 1.0), 0.0).max(axis=0, initial=0.0)
            + 0.01
        )

    def _solver(self, x: np.ndarray, time_limit: float) -> ca.Function:
        """IPOPT with the derivatives of the transcription; parameters are the weights, and that of
        staying.
        """
        functions = self.functions
        n = len(x)
        k = len(self.groups)
        X = ca.MX.sym("X", n + k)
        w = ca.MX.sym("w", k + 1)
        lam_f = ca.MX.sym("lam_f")
        lam = ca.MX.sym("lam_g", self.P.shape[0])
        n_g = self.P.shape[1] - n
        g, J = functions["nlp_jac_g"](X[:n], self.p)
        away = X[:n] - x
        f = ca.dot(w[:k], X[n:]) + w[k] / 2 * ca.sumsqr(away)
        rows = self.P @ ca.vertcat(g, X[:n]) + self.Q @ X[n:]
        jacobian = ca.horzcat(self.P @ ca.vertcat(J, ca.MX(ca.DM.eye(n))), ca.MX(self.Q))
        H = functions["nlp_hess_l"](X[:n], self.p, 0.0, (self.P.T @ lam)[:n_g])
        hessian = ca.diagcat(H + lam_f * w[k] * ca.DM.eye(n), ca.MX(k, k))
        derivatives = ca.vertcat(w[k] * away, w[:k]), jacobian, ca.triu(hessian)
        options = {
            "cache": nlp_functions([X, w], [f, rows], [lam_f, lam], derivatives),
            "error_on_fail": False,
            "print_time": False,
            "calc_lam_p": False,
            # Amounts that cost nothing are flat directions: a barrier that only falls stays on them
            # for hundreds of iterations.
            "ipopt": {
                "mu_strategy": "adaptive",
                "max_iter": _ITERATIONS,
                "max_wall_time": max(time_limit, 0.1),
                **_SILENT,
            },
        }
        return ca.nlpsol("elastic", "ipopt", {"x": X, "p": w, "f": f, "g": rows}, options)

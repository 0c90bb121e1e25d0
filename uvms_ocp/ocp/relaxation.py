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
    join_groups,
    row_groups,
    variable_groups,
)
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers import LexicographicResult
from uvms_ocp.solvers.nlp.program import nlp_functions

_STAY = 1e-6  # weight of staying near the start, which makes the minimum one point
_NEGLIGIBLE_AMOUNT = 1e-4  # amount that is none
_OPPOSING_SHARE = 0.05  # share of a group in what holds against the others, from which it is named
_MAX_ITERATIONS = 500
_SILENT = {"print_level": 0, "sb": "yes"}
# amount by which a group gives way at most in the search for those that hold a level back
_LARGEST_AMOUNT = 2.0
_NEGLIGIBLE_GAIN = 1e-5  # share of the residual of a level that is none
_MET_SHARE = 1e-3  # share of the residual with which a level is met
_MET_ROW_SHARE = 1e-3  # share of the residual that rows of a level that are met may lose


@dataclass(frozen=True, kw_only=True, slots=True)
class Relaxation:
    """A group that gives way."""

    group: BoundGroup
    amount: float
    """[-, or unit of the row] Amount by which the group gives way, in its measure."""
    axes: tuple[str, ...]
    """Axes on which it matters most."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PhaseOne:
    """Result of phase one: the point of least violation."""

    x: np.ndarray
    """(n_x,) [unit of x] variables of the point that was found."""
    converged: bool
    """The search ended at a minimum."""
    relaxations: tuple[Relaxation, ...]
    """Groups that give way, the largest amount first."""
    opposing: tuple[BoundGroup, ...]
    """Groups that are kept and hold against them."""
    iterations: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """Groups that hold a level back, and what they would have to give."""

    left: float
    """[-] Share of the residual that remains then; 0 where the level is met."""
    relaxations: tuple[Relaxation, ...]
    """Groups that give way, the largest amount first."""


def phase_one(
    transcription: Transcription,
    problem: OcpProblem,
    p: np.ndarray,
    x: np.ndarray,
    *,
    time_limit: float,
) -> PhaseOne:
    """Search from x (n_x,) [unit of x], with parameters p (n_p,), for `time_limit` [s] at most."""
    rows = _constraint_rows(transcription, problem)
    elastic = _ElasticProgram(transcription, problem, rows, p)
    weights = np.ones(len(elastic.groups))
    _, result = elastic.minimize(x, weights, np.inf * weights, time_limit=time_limit)
    return result


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
    deadline = perf_counter() + time_limit
    rows = _level_rows(transcription, problem, result, level)
    elastic = _ElasticProgram(transcription, problem, rows, p)
    is_goal = np.arange(len(elastic.groups)) == len(rows.grouped.groups) - 1
    is_limit = np.array([group.measure is not RelaxationUnit.ROW for group in elastic.groups])
    holding: list[Binding] = []
    all_converged = True
    for may_give in (is_limit, ~is_limit & ~is_goal, ~is_goal):
        is_all = bool((may_give == ~is_goal).all())
        if holding and is_all:
            break
        amounts, best = elastic.minimize(
            result.x,
            1.0 * is_goal,
            np.where(may_give, _LARGEST_AMOUNT, 1.0 * is_goal),
            time_limit=deadline - perf_counter(),
            stay=1e-6 * _STAY,
        )
        remaining = float(amounts[is_goal][0])
        gain = 1.0 - remaining
        all_converged &= best.converged
        if not best.converged or gain < _NEGLIGIBLE_GAIN:
            continue
        if remaining < _MET_SHARE:
            share_left = 0.0
        else:
            share_left = 1.0 - gain / 2
        upper = np.where(may_give, np.inf, max(share_left, _MET_SHARE) * is_goal)
        for start in (best.x, result.x):
            _, smallest = elastic.minimize(
                start, 1.0 * may_give, upper, time_limit=deadline - perf_counter()
            )
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
    """(m,) [unit of the row] lower bounds."""
    upper: np.ndarray
    """(m,) [unit of the row] upper bounds."""
    grouped: GroupIndex


def _constraint_rows(transcription: Transcription, problem: OcpProblem) -> _ElasticRows:
    raw = transcription.row_layout.constraints
    ranges = transcription.ranges(problem)
    grouped = row_groups(transcription, problem)
    return _ElasticRows(raw=raw, lower=ranges.lower, upper=ranges.upper, grouped=grouped)


def _level_rows(
    transcription: Transcription, problem: OcpProblem, result: LexicographicResult, level: int
) -> _ElasticRows:
    """Return the rows of constraints and of the levels up to `level`. The last group is that level
    itself: an amount of 1 leaves all its rows as they are.
    """
    rows = _constraint_rows(transcription, problem)
    ranges = transcription.ranges(problem)
    layout = transcription.row_layout
    levels = ranges.levels[: level + 1]
    raw = []
    lower = []
    upper = []
    scale = []
    for k, level_above in enumerate(levels[:-1]):
        cost = 0.5 * float(result.residuals[k] @ result.residuals[k])
        level_lower, level_upper = level_above.frozen_bounds(
            result.values[k], cost, _NEGLIGIBLE_AMOUNT
        )
        raw.append(layout.held[k])
        lower.append(level_lower)
        upper.append(level_upper)
        scale.append(np.ones(len(level_lower)))
    residual = np.abs(result.residuals[level])
    raw.append(layout.levels[level])
    lower.append(levels[-1].lower)
    upper.append(levels[-1].upper)
    scale.append(np.maximum(residual, _MET_ROW_SHARE * np.linalg.norm(residual)))
    group_of_row = np.repeat(np.arange(len(raw)), [len(level_rows) for level_rows in raw])
    groups = GroupIndex(
        groups=tuple(
            BoundGroup(name=f"level {item.name!r}", measure=RelaxationUnit.ROW) for item in levels
        ),
        number=group_of_row,
        scale=np.concatenate(scale),
        axes=("",) * len(group_of_row),
    )
    return _ElasticRows(
        raw=np.concatenate([rows.raw, *raw]),
        lower=np.concatenate([rows.lower, *lower]),
        upper=np.concatenate([rows.upper, *upper]),
        grouped=join_groups(rows.grouped, groups),
    )


class _ElasticProgram:
    """Rows ``P [g; x] + Q s`` within bounds, with amounts s >= 0 of the groups, and IPOPT for their
    weighted sum.
    """

    def __init__(
        self, transcription: Transcription, problem: OcpProblem, rows: _ElasticRows, p: np.ndarray
    ) -> None:
        """p: (n_p,) [unit of the parameter]."""
        self.grouped = join_groups(rows.grouped, variable_groups(transcription))
        self.groups = self.grouped.groups
        self.n_x = transcription.n_x
        number = self.grouped.number
        x_lower, x_upper = transcription.bounds(problem)
        lower = np.concatenate([rows.lower, x_lower])
        upper = np.concatenate([rows.upper, x_upper])
        is_soft = number >= 0
        is_bounded = np.isfinite(lower) | np.isfinite(upper)
        # Hard rows keep both sides in one row; soft ones give way at either side in a row of its
        # own.
        hard = np.flatnonzero(~is_soft & is_bounded)
        soft_above = np.flatnonzero(is_soft & np.isfinite(upper))
        soft_below = np.flatnonzero(is_soft & np.isfinite(lower))
        chosen = np.concatenate([hard, soft_above, soft_below])
        sign = np.concatenate(
            [np.zeros(len(hard)), np.full(len(soft_above), -1.0), np.ones(len(soft_below))]
        )
        m = len(chosen)
        Q = np.zeros((m, len(self.groups)))
        Q[np.arange(m), np.maximum(number[chosen], 0)] = sign * self.grouped.scale[chosen]
        self.P = ca.DM.triplet(list(range(m)), chosen.tolist(), ca.DM.ones(m), m, len(number))
        self.Q = ca.sparsify(ca.DM(Q))
        self.lower = np.where(sign < 0, -np.inf, lower[chosen])
        self.upper = np.where(sign > 0, np.inf, upper[chosen])
        self.functions = transcription.row_functions(rows.raw)
        self.p = p

    def minimize(
        self,
        x: np.ndarray,
        weights: np.ndarray,
        upper: np.ndarray,
        *,
        time_limit: float,
        stay: float = _STAY,
    ) -> tuple[np.ndarray, PhaseOne]:
        """Minimise the sum of amounts with `weights` (n_groups,), each at most `upper` (n_groups,),
        from x (n_x,); time_limit [s].

        Returns the amounts (n_groups,), and what they mean.
        """
        n = self.n_x
        n_groups = len(self.groups)
        g = np.array(self.functions["nlp_g"](x, self.p)).ravel()
        first_amounts = np.minimum(self._sufficient_amounts(np.concatenate([g, x])), upper)
        infinite = np.full(n, np.inf)
        solver = self._solver(x, time_limit)
        solution = solver(
            x0=np.concatenate([x, first_amounts]),
            p=np.concatenate([weights, [stay]]),
            lbx=np.concatenate([-infinite, np.zeros(n_groups)]),
            ubx=np.concatenate([infinite, upper]),
            lbg=self.lower,
            ubg=self.upper,
        )
        stats = solver.stats()
        variables = np.array(solution["x"]).ravel()
        amounts = variables[n:]
        multipliers = np.abs(np.array(solution["lam_g"]).ravel())
        # What each variable and row holds, by the multipliers of its rows.
        held = np.abs(np.array(self.P.T @ multipliers).ravel()) * self.grouped.scale
        relaxations = []
        for i in np.flatnonzero((amounts > _NEGLIGIBLE_AMOUNT) & (weights > 0)).tolist():
            axes = self.grouped.strongest(i, held)
            relaxations.append(
                Relaxation(group=self.groups[i], amount=float(amounts[i]), axes=axes)
            )
        opposing = []
        for i in np.flatnonzero(amounts <= _NEGLIGIBLE_AMOUNT).tolist():
            if held[self.grouped.number == i].sum() > _OPPOSING_SHARE:
                opposing.append(self.groups[i])
        result = PhaseOne(
            x=variables[:n],
            converged=bool(stats["success"]) and bool(np.isfinite(variables).all()),
            relaxations=tuple(sorted(relaxations, key=lambda item: -item.amount)),
            opposing=tuple(opposing),
            iterations=int(stats["iter_count"]),
        )
        return amounts, result

    def _sufficient_amounts(self, values: np.ndarray) -> np.ndarray:
        """Return amounts (n_groups,) for a start whose rows and variables have these values: enough
        to keep all, and a little more.
        """
        rows = np.array(self.P @ values).ravel()
        Q = np.abs(self.Q.full())
        excess = np.maximum(np.maximum(rows - self.upper, self.lower - rows), 0.0)
        amounts_of_rows = np.where(Q > 0, excess[:, None] / np.where(Q > 0, Q, 1.0), 0.0)
        return np.asarray(amounts_of_rows.max(axis=0, initial=0.0) + 0.01)

    def _solver(self, x: np.ndarray, time_limit: float) -> ca.Function:
        """Build IPOPT with the derivatives of the transcription; parameters are the weights, and
        that of staying.
        """
        functions = self.functions
        n = len(x)
        n_groups = len(self.groups)
        n_rows, n_values = self.P.shape
        variables = ca.MX.sym("X", n + n_groups)
        X = variables[:n]
        amounts = variables[n:]
        parameters = ca.MX.sym("w", n_groups + 1)
        weights = parameters[:n_groups]
        stay = parameters[n_groups]
        lam_f = ca.MX.sym("lam_f")
        lam_g = ca.MX.sym("lam_g", n_rows)
        g, J = functions["nlp_jac_g"](X, self.p)
        away = X - x
        f = ca.dot(weights, amounts) + stay / 2 * ca.sumsqr(away)
        rows = self.P @ ca.vertcat(g, X) + self.Q @ amounts
        gradient = ca.vertcat(stay * away, weights)
        value_slopes = ca.vertcat(J, ca.MX(ca.DM.eye(n)))
        jacobian = ca.horzcat(self.P @ value_slopes, ca.MX(self.Q))
        lam_of_g = (self.P.T @ lam_g)[: n_values - n]
        H = functions["nlp_hess_l"](X, self.p, 0.0, lam_of_g)
        hessian = ca.diagcat(H + lam_f * stay * ca.DM.eye(n), ca.MX(n_groups, n_groups))
        derivatives = (gradient, jacobian, ca.triu(hessian))
        options = {
            "cache": nlp_functions([variables, parameters], [f, rows], [lam_f, lam_g], derivatives),
            "error_on_fail": False,
            "print_time": False,
            "calc_lam_p": False,
            # Amounts that cost nothing are flat directions: a barrier that only falls stays on them
            # for hundreds of iterations.
            "ipopt": {
                "mu_strategy": "adaptive",
                "max_iter": _MAX_ITERATIONS,
                "max_wall_time": max(time_limit, 0.1),
                **_SILENT,
            },
        }
        nlp = {"x": variables, "p": parameters, "f": f, "g": rows}
        return ca.nlpsol("elastic", "ipopt", nlp, options)

"""Diagnose plans: the bounds that hold a level back, and the least relaxation that makes it
feasible (phase one).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from time import perf_counter

import casadi as ca
import numpy as np

from uvms_ocp.ocp.first_order_gain import level_residuals
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.layout import FIXED
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.ocp.verdict import (
    Verdict,
    describe_broken,
    describe_gain,
    describe_missed,
    is_missed,
)
from uvms_ocp.robot.thrusters import AXES
from uvms_ocp.solvers import LexicographicResult, NlpStatus
from uvms_ocp.solvers.nlp.program import nlp_functions
from uvms_ocp.types import DAY

# What the bounds of variables and the rows of constraints stand for, in groups that are loosened
# together.

# of the strongest axis from which others are named, and how many
_AXIS_SHARE = 0.2
_MOST_AXES = 3


class RelaxationUnit(Enum):
    """In what a group gives way, and how that is said."""

    SHARE = "{name} would have to be {amount:.0%} higher"
    POSITION = "{name} would have to be {amount:.3g} rad (m) wider"
    ROW = "{name} would have to give way by {amount:.3g}"


@dataclass(frozen=True, kw_only=True, slots=True)
class BoundGroup:
    """Bounds or rows of one kind."""

    name: str
    measure: RelaxationUnit

    def named(self, axes: tuple[str, ...]) -> str:
        """With the axes that matter."""
        if axes:
            return f"{self.name} ({', '.join(axes)})"
        return self.name

    def change(self, amount: float, axes: tuple[str, ...] = ()) -> str:
        """Describe a change by an amount [-, or unit of the row] in its measure."""
        return self.measure.value.format(name=self.named(axes), amount=amount)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GroupIndex:
    """Groups, and to which of them variables or rows belong."""

    groups: tuple[BoundGroup, ...]
    number: np.ndarray
    """(n,) of the group; -1 for what nobody can loosen."""
    scale: np.ndarray
    """(n,) [unit of the variable or row] that an amount of 1 in the measure of its group is."""
    axes: tuple[str, ...]
    """(n,) of what; empty where the group says it."""

    def strongest(self, group: int, strengths: np.ndarray) -> tuple[str, ...]:
        """Axes of a group on which most lies, for strengths (n,) [any] of all variables or rows."""
        total: dict[str, float] = {}
        for i in np.flatnonzero((self.number == group) & (strengths > 0)).tolist():
            total[self.axes[i]] = total.get(self.axes[i], 0.0) + float(strengths[i])
        most = max(total.values(), default=0.0)
        ranked = sorted(total, key=lambda axis: -total[axis])
        return tuple(axis for axis in ranked if axis and total[axis] >= _AXIS_SHARE * most)[
            :_MOST_AXES
        ]


def variable_groups(transcription: Transcription) -> GroupIndex:
    """Group the bounds of the variables (n_x,)."""
    labels, scales, axes = _labels(transcription)
    layout = transcription.variables
    groups = tuple(dict.fromkeys(label for label in labels if label))
    place = {group: i for i, group in enumerate(groups)}
    numbers = np.array([place[label] if label else -1 for label in labels])
    nodes, entries = np.nonzero((layout.all_columns >= 0) & (numbers >= 0))
    columns = layout.all_columns[nodes, entries]
    number = np.full(layout.n_x, -1)
    scale = np.ones(layout.n_x)
    names = np.full(layout.n_x, "", dtype=object)
    number[columns] = numbers[entries]
    scale[columns] = np.array(scales)[entries]
    names[columns] = np.array(axes, dtype=object)[entries]
    return GroupIndex(groups=groups, number=number, scale=scale, axes=tuple(names.tolist()))


def _labels(transcription: Transcription) -> tuple[list[BoundGroup | None], list[float], list[str]]:
    """Return the group, unit and axis of every entry of z."""
    model = transcription.model
    robot = model.robot
    layout = model.layout
    limits = model.robot.limits
    axes = [
        *AXES[: robot.n_vehicle],
        *(joint.name for joint in robot.joints for _ in range(joint.n_v)),
    ]
    labels: list[BoundGroup | None] = [None] * layout.n_z
    scales = [1.0] * layout.n_z
    names = [""] * layout.n_z

    def set_part(part: slice, kind: str, units: np.ndarray, of: list[str]) -> None:
        group = BoundGroup(name=f"the {kind} limits", measure=RelaxationUnit.SHARE)
        for i, unit, axis in zip(range(part.start, part.stop), units, of, strict=True):
            labels[i] = group
            scales[i] = float(unit) if np.isfinite(unit) else 1.0
            names[i] = axis

    for joint in robot.joints:
        for i in range(joint.q.start, joint.q.stop):
            labels[i] = BoundGroup(name="the joint limits", measure=RelaxationUnit.POSITION)
            names[i] = joint.name
    set_part(layout.v, "velocity", limits.velocity, axes)
    set_part(layout.a, "acceleration", limits.acceleration, axes)
    thrusters = [item.name for item in robot.description.thrusters][: layout.n_thrust]
    set_part(
        layout.thrust, "thrust", np.ones(layout.n_thrust), thrusters or axes[: layout.n_thrust]
    )
    set_part(
        layout.torque,
        "torque",
        np.ones(layout.n_torque),
        axes[robot.n_vehicle :][: layout.n_torque],
    )
    return labels, scales, names


def row_groups(transcription: Transcription, problem: OcpProblem) -> GroupIndex:
    """Group the constraints (n_constraints,) in the numbering of the program."""
    names = tuple(
        transcription.row_layout.names[row] for row in transcription.row_layout.constraints.tolist()
    )
    roots = {term.name: float(np.sqrt(term.weight)) for term in reversed(problem.constraints)}
    found = {
        name: i for i, name in enumerate(name for name in dict.fromkeys(names) if name not in FIXED)
    }
    return GroupIndex(
        groups=tuple(
            BoundGroup(name=f"constraint {name!r}", measure=RelaxationUnit.ROW) for name in found
        ),
        number=np.array([found.get(name, -1) for name in names], dtype=int),
        scale=np.array([roots.get(name, 1.0) for name in names]),
        axes=("",) * len(names),
    )


# What a level above costs a level, by the multipliers of the rows that hold it.


def level_prices(
    transcription: Transcription, result: LexicographicResult, level: int
) -> tuple[float, ...]:
    """See `uvms_ocp.ocp.plan.LevelReport.prices`; zeros where a level is met in full by
    anticipation, none if not known.

    Of all ways to let the residual of a level above grow by 1 as a norm, the best one lowers the
    cost by the norm of its multipliers.
    """
    last = level == len(result.points) - 1
    multipliers = result.points[level].row_multipliers
    if multipliers is None or (result.anticipated and not last):
        return (0.0,) * level
    prices = tuple(
        float(np.linalg.norm(multipliers[above.frozen]))
        for above in transcription.ranges().levels[:level]
    )
    if np.isnan(prices).any():
        return ()
    return prices


# The least by which limits and constraints would have to give way for any motion to keep them, or
# for a level to be met.
#
# An elastic program over the rows of the transcription, built on demand: each group of bounds and
# constraints gives way by an amount of its own, alike at all nodes, and the sum of the amounts is
# least. Laws (motion, forces, start) do not give way. It ends at a minimum where the problem itself
# has no solution to end at.

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
    """[-, or unit of the row] In its measure."""
    axes: tuple[str, ...]
    """On which it matters most."""


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
        grouped=_together(rows.grouped, above),
    )


class _Elastic:
    """Rows ``P [g; x] + Q s`` within bounds, with amounts s >= 0 of the groups, and IPOPT for their
    weighted sum.
    """

    def __init__(
        self, transcription: Transcription, problem: OcpProblem, rows: _ElasticRows, p: np.ndarray
    ) -> None:
        """p: (n_p,) [unit of the parameter]."""
        self.grouped = grouped = _together(rows.grouped, variable_groups(transcription))
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
        found = np.array(solution["x"]).ravel()
        rows = np.abs(np.array(solution["lam_g"]).ravel())
        # What each variable and row holds, by the multipliers of its own rows.
        held = np.abs(np.array(self.P.T @ rows).ravel()) * self.grouped.scale
        amounts = found[n:]
        stats = solver.stats()
        given = [
            Relaxation(
                group=self.groups[i], amount=float(amounts[i]), axes=self.grouped.strongest(i, held)
            )
            for i in np.flatnonzero((amounts > _KEPT) & (weights > 0)).tolist()
        ]
        kept = np.flatnonzero(amounts <= _KEPT).tolist()
        meaning = PhaseOne(
            x=found[:n],
            converged=bool(stats["success"]) and bool(np.isfinite(found).all()),
            relaxations=tuple(sorted(given, key=lambda item: -item.amount)),
            opposing=tuple(
                self.groups[i] for i in kept if held[self.grouped.number == i].sum() > _AGAINST
            ),
            iterations=int(stats["iter_count"]),
        )
        return found[:n], amounts, meaning

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
    every = np.ones(len(elastic.groups))
    return elastic.least(x, every, np.inf * every, time_limit=time_limit)[2]


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """Groups that hold a level back, and what they would have to give."""

    left: float
    """[-] Share of the residual that is left then; 0 where the level is met."""
    relaxations: tuple[Relaxation, ...]
    """The largest amount first."""


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
    found: list[Binding] = []
    known = True
    for chosen in (limits, ~limits & ~goal, ~goal):
        if found and (chosen == ~goal).all():
            break
        most = np.where(chosen, _FARTHEST, 1.0 * goal)
        x, amounts, best = elastic.least(
            result.x, 1.0 * goal, most, time_limit=ends - perf_counter(), stay=1e-6 * _STAY
        )
        gain = 1.0 - float(amounts[goal][0])
        known &= best.converged
        if not best.converged or gain < _GAIN:
            continue
        left = 0.0 if amounts[goal][0] < _FULL else 1.0 - gain / 2
        most = np.where(chosen, np.inf, max(left, _FULL) * goal)
        for start in (x, result.x):
            least = elastic.least(start, 1.0 * chosen, most, time_limit=ends - perf_counter())[2]
            if least.converged:
                found += (
                    [Binding(left=left, relaxations=least.relaxations)] if least.relaxations else []
                )
                break
        known &= least.converged
    if found or known:
        return tuple(found)
    return None


def _together(rows: GroupIndex, variables: GroupIndex) -> GroupIndex:
    return GroupIndex(
        groups=(*rows.groups, *variables.groups),
        number=np.concatenate(
            [rows.number, np.where(variables.number < 0, -1, variables.number + len(rows.groups))]
        ),
        scale=np.concatenate([rows.scale, variables.scale]),
        axes=(*rows.axes, *variables.axes),
    )


# Judge what a result of the solver means, and why a goal is missed or no motion keeps the
# constraints.

_LONGER = (2.0, 4.0)  # shares of the horizon that are tried to tell "too short" from "unreachable"
_UNHELD = "; no limit, constraint or level above holds it back: the robot does not get nearer"
_HELPS = 0.9  # share of the residual that more time must leave at most to count as a help

Solve = Callable[[OcpProblem, np.ndarray | None, float], LexicographicResult]
"""A problem, variables to start from (by default its start, held) and a time limit [s] to a
result.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SolveVerdict:
    """Verdict on a solve."""

    status: OcpStatus
    reason: str
    """In words, with numbers."""
    result: LexicographicResult
    """Result of the solve, or of one more that was better."""
    verdict: Verdict | None = None
    """Of the judge, on the motion of the result; `None` where it has no numbers."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Diagnosis:
    """Judges one result."""

    transcription: Transcription
    problem: OcpProblem
    p: np.ndarray
    """(n_p,) [unit of the parameter] of the problem."""
    feasibility: float
    """Largest violation of a point that counts as usable."""
    solve: Solve
    judge: Callable[[LexicographicResult], Verdict]
    """Judges the motion of a result."""
    deadline: float | None
    """[s] by `perf_counter`, until which longer horizons are tried; `None`: nothing is tried."""

    def verdict(self, result: LexicographicResult, *, again: bool = True) -> SolveVerdict:
        """again: one more solve is made where the search for what gives way finds a point that
        keeps all constraints.
        """
        if NlpStatus.NOT_A_NUMBER in result.level_status or not np.isfinite(result.x).all():
            return self._undefined(result)
        verdict = self.judge(result)
        status, reason = verdict.status, verdict.reason
        if NlpStatus.INTERRUPTED in result.level_status:
            status = OcpStatus.INTERRUPTED
            reason = self._interrupted(result)
        elif status is OcpStatus.BROKEN and result.violation > self.feasibility:
            return self._broken(result, verdict, again)
        elif status is OcpStatus.MISSED:
            status, reason = self._missed(result, verdict)
        elif status is OcpStatus.BROKEN and verdict.missed is not None:
            _, missed = self._missed(result, verdict)
            reason = f"{reason}; {missed}"
        elif status is OcpStatus.IMPROVABLE:
            assert verdict.improvable is not None
            reason += _ended(result, verdict.improvable)
        return SolveVerdict(status=status, reason=reason, result=result, verdict=verdict)

    def _interrupted(self, result: LexicographicResult) -> str:
        level = result.level_status.index(NlpStatus.INTERRUPTED)
        residual = self._residuals(result)[level]
        return (
            f"level {self._name(level)}: stopped by hand at a residual of {residual:.4g}, with"
            f" constraints broken by {result.violation:.2g}"
        )

    def _residuals(self, result: LexicographicResult) -> np.ndarray:
        """(n_levels,) see `uvms_ocp.ocp.plan_file.LevelReport.residual`."""
        t = self.transcription.unpack(result.x, self.problem).t
        return level_residuals(self.transcription, self.problem, result.values, t)

    def _name(self, level: int) -> str:
        return repr(self.problem.levels[level].name)

    def _undefined(self, result: LexicographicResult) -> SolveVerdict:
        names = self.transcription.undefined(self.problem)
        wrong = [i for i, one in enumerate(result.level_status) if one is NlpStatus.NOT_A_NUMBER]
        if wrong:
            level = wrong[0]
        else:
            level = len(result.level_status) - 1
        text = f"level {self._name(level)}: {NlpStatus.NOT_A_NUMBER.value}"
        if names:
            text += (
                f": at the start {_listed(names)} or its slope is none; add a small number under"
                " roots and divisions"
            )
        return SolveVerdict(status=OcpStatus.UNFINISHED, reason=text, result=result)

    # --- no motion was found --------------------------------------------------------------------------

    def _broken(self, result: LexicographicResult, verdict: Verdict, again: bool) -> SolveVerdict:
        groups = self.transcription.violations(result.x, self.p, self.problem)
        name = max(groups, key=lambda key: groups[key])
        failed = _first_failure(result)
        if failed is None:
            level = len(result.level_status) - 1
        else:
            level = failed
        status = result.level_status[level]
        text = f"level {self._name(level)}: {status.value} with {name} broken by {groups[name]:.4g}"
        if groups[name] <= self.feasibility:
            text = (
                f"level {self._name(level)}: {status.value}: {describe_broken(verdict.broken[0])}"
            )
        called = OcpStatus.UNFINISHED
        least = self._least(result)
        if least is not None and least.converged:
            if not least.relaxations and again:
                return self.verdict(self.solve(self.problem, least.x, self._left), again=False)
            if least.relaxations:
                called = OcpStatus.INFEASIBLE
                text += f"; {_describe_relaxations(least)}"
            else:
                text += "; a motion that keeps all constraints was found, but no optimum from there"
        if status is NlpStatus.INFEASIBLE and least is None:
            called = OcpStatus.INFEASIBLE
            text += ", and no small change helps"
        return SolveVerdict(status=called, reason=text, result=result, verdict=verdict)

    def _least(self, result: LexicographicResult) -> PhaseOne | None:
        """`None` where there is no time for it, or nobody waits for it."""
        if self._left > 0.0 and np.isfinite(result.x).all():
            with suppress(KeyboardInterrupt):
                return phase_one(
                    self.transcription, self.problem, self.p, result.x, time_limit=self._left
                )
        return None

    # --- a goal is missed -----------------------------------------------------------------------------

    def _missed(self, result: LexicographicResult, verdict: Verdict) -> tuple[OcpStatus, str]:
        """Why the first goal that is missed is so, if its level and those above are at their best."""
        missed = verdict.missed
        assert missed is not None
        improvable = verdict.improvable
        if improvable is None or improvable > missed:
            return self._why_missed(missed, result)
        text = describe_missed(verdict.report.levels[missed])
        gain = describe_gain(verdict.report.levels[improvable])
        return OcpStatus.UNFINISHED, f"{text}; {gain}{_ended(result, improvable)}"

    def _why_missed(self, missed: int, result: LexicographicResult) -> tuple[OcpStatus, str]:
        """No more than what longer horizons show until the deadline; without a deadline none is
        tried.
        """
        residual = float(self._residuals(result)[missed])
        text = f"level {self._name(missed)} is missed by {residual:.4g}"
        held = self._held(missed, result)
        failed = ""
        if self.problem.free_time:
            return OcpStatus.MISSED, f"{text} with the best of all durations allowed{held}"
        if self.deadline is None:
            return OcpStatus.MISSED, text
        for longer in self._longer(residual):
            trial = self.solve(longer, None, self._left)
            if trial.violation > self.feasibility or not trial.level_status[missed].optimal:
                failed = f"; a horizon of {_seconds(longer)} was tried in vain"
                continue
            t = self.transcription.unpack(trial.x, longer).t
            rest = float(level_residuals(self.transcription, longer, trial.values, t)[missed])
            rates = "" if held == _UNHELD else held
            if not is_missed(self.problem.levels[missed], rest):
                return OcpStatus.TOO_SHORT, f"{text}; {_seconds(longer)} would do{rates}"
            if rest < _HELPS * residual:
                return (
                    OcpStatus.TOO_SHORT,
                    f"{text}; with {_seconds(longer)} it would be {rest:.4g}{rates}",
                )
        if failed:
            return OcpStatus.MISSED, f"{text}{failed}{held}"
        return OcpStatus.UNREACHABLE, f"{text}, and more time does not help{held}"

    @property
    def _left(self) -> float:
        """[s] until the deadline."""
        if self.deadline is None:
            return 0.0
        return max(self.deadline - perf_counter(), 0.0)

    def _longer(self, residual: float) -> Iterator[OcpProblem]:
        """The last leaves every axis the time to move by the residual, at its limits from rest to
        rest.
        """
        limits = self.problem.robot.limits
        needed = np.concatenate(
            [residual / limits.velocity, 2 * (residual / limits.acceleration) ** 0.5]
        ).max(initial=0.0)
        enough = 2 * float(needed) / float(self.problem.nominal_times()[-1])
        for share in (
            *_LONGER,
            *([enough] if np.isfinite(enough) and enough > _LONGER[-1] else []),
        ):
            phases = tuple(
                replace(phase, duration=min(phase.nominal * share, DAY))
                for phase in self.problem.phases
            )
            yield replace(self.problem, phases=phases)

    def _held(self, missed: int, result: LexicographicResult) -> str:
        """Describe what holds the goal back, for the end of a sentence; empty where that is not
        known.
        """
        residual = float(result.level_residuals[missed])
        if self._left <= 0.0:
            return ""
        found = bindings(
            self.transcription, self.problem, self.p, result, missed, time_limit=self._left / 2
        )
        if found is None:
            return ""
        if not found:
            return _UNHELD
        names = [item.group.named(item.axes) for binding in found for item in binding.relaxations]
        return (
            f"; held back by {_listed(names)}:"
            f" {'; or '.join(_change(binding, residual) for binding in found)}"
        )


def _change(binding: Binding, residual: float) -> str:
    aim = f"for {binding.left * residual:.4g}" if binding.left > 0 else "to meet it"
    return (
        f"{aim},"
        f" {_listed([item.group.change(item.amount, item.axes) for item in binding.relaxations])}"
    )


def _describe_relaxations(least: PhaseOne) -> str:
    """Describe the relaxations that are needed, and the bounds that oppose them."""
    changes = _listed([item.group.change(item.amount, item.axes) for item in least.relaxations])
    if least.opposing:
        against = f", against {_listed([group.name for group in least.opposing])}"
    else:
        against = ""
    return f"for any motion near to keep them all, {changes}{against}"


def _listed(texts: list[str]) -> str:
    if len(texts) == 1:
        return texts[0]
    return f"{', '.join(texts[:-1])} and {texts[-1]}"


def _seconds(problem: OcpProblem) -> str:
    return f"{problem.nominal_times()[-1]:.3g} s"


def _ended(result: LexicographicResult, level: int) -> str:
    """Say how the search for a level ended, or that for one above it, for the end of a sentence;
    empty at an optimum.
    """
    failed = _first_failure(result)
    if failed is None or failed > level:
        return ""
    return f"; the search ended: {result.level_status[failed].value}"


def _first_failure(result: LexicographicResult) -> int | None:
    return next((i for i, status in enumerate(result.level_status) if not status.optimal), None)

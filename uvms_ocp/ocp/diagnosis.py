"""Diagnose plans: the bounds that hold a level back, and the least relaxation that makes it feasible (phase one)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from time import perf_counter

import casadi as ca
import numpy as np

from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.problem import OcpPhase, OcpProblem
from uvms_ocp.ocp.transcription.layout import FIXED
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers import NlpStatus
from uvms_ocp.solvers.nlp.level_solver import NlpPoint
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult
from uvms_ocp.solvers.nlp.program import LevelRows

# What the bounds of variables and the rows of constraints stand for, in groups that are loosened together.

_AXIS_SHARE, _MOST_AXES = 0.2, 3  # of the strongest axis from which others are named, and how many
_VEHICLE = ("surge", "sway", "heave", "roll", "pitch", "yaw")


class RelaxationUnit(Enum):
    """In what a group gives way, and how that is said."""

    SHARE = "{name} would have to be {amount:.0%} higher"
    POSITION = "{name} would have to be {amount:.3g} rad (m) wider"
    ROW = "{name} would have to give way by {amount:.3g}"
    LEVEL = "{name} would have to give up {amount:.3g} of its residual"


@dataclass(frozen=True, kw_only=True, slots=True)
class BoundGroup:
    """Bounds or rows of one kind."""

    name: str
    measure: RelaxationUnit

    def named(self, axes: tuple[str, ...]) -> str:
        """With the axes that matter."""
        return f"{self.name} ({', '.join(axes)})" if axes else self.name

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
        return tuple(axis for axis in ranked if axis and total[axis] >= _AXIS_SHARE * most)[:_MOST_AXES]


def variable_groups(transcription: Transcription) -> GroupIndex:
    """Group the bounds of the variables (n_x,)."""
    labels, scales, axes = _labels(transcription)
    layout, groups = transcription.variables, tuple(dict.fromkeys(label for label in labels if label))
    place = {group: i for i, group in enumerate(groups)}
    numbers = np.array([place[label] if label else -1 for label in labels])
    nodes, entries = np.nonzero((layout.all_columns >= 0) & (numbers >= 0))
    columns = layout.all_columns[nodes, entries]
    number, scale, names = np.full(layout.n_x, -1), np.ones(layout.n_x), np.full(layout.n_x, "", dtype=object)
    number[columns], scale[columns] = numbers[entries], np.array(scales)[entries]
    names[columns] = np.array(axes, dtype=object)[entries]
    return GroupIndex(groups=groups, number=number, scale=scale, axes=tuple(names.tolist()))


def _labels(transcription: Transcription) -> tuple[list[BoundGroup | None], list[float], list[str]]:
    """Return the group, unit and axis of every entry of z."""
    model = transcription.model
    robot, layout, limits = model.robot, model.layout, model.robot.limits
    axes = [*_VEHICLE[: robot.n_vehicle], *(joint.name for joint in robot.joints for _ in range(joint.n_v))]
    labels: list[BoundGroup | None] = [None] * layout.n_z
    scales, names = [1.0] * layout.n_z, [""] * layout.n_z

    def set_part(part: slice, kind: str, units: np.ndarray, of: list[str]) -> None:
        group = BoundGroup(name=f"the {kind} limits", measure=RelaxationUnit.SHARE)
        for i, unit, axis in zip(range(part.start, part.stop), units, of, strict=True):
            labels[i], scales[i], names[i] = group, float(unit) if np.isfinite(unit) else 1.0, axis

    for joint in robot.joints:
        for i in range(joint.q.start, joint.q.stop):
            labels[i], names[i] = BoundGroup(name="the joint limits", measure=RelaxationUnit.POSITION), joint.name
    set_part(layout.v, "velocity", limits.velocity, axes)
    set_part(layout.a, "acceleration", limits.acceleration, axes)
    thrusters = [item.name for item in robot.description.thrusters][: layout.n_thrust]
    set_part(layout.thrust, "thrust", np.ones(layout.n_thrust), thrusters or axes[: layout.n_thrust])
    set_part(layout.torque, "torque", np.ones(layout.n_torque), axes[robot.n_vehicle :][: layout.n_torque])
    return labels, scales, names


def row_groups(transcription: Transcription, problem: OcpProblem) -> GroupIndex:
    """Group the constraints (n_constraints,) in the numbering of the program."""
    names = transcription.constraint_names
    roots = {term.name: float(np.sqrt(term.weight)) for term in reversed(problem.constraints)}
    found = {name: i for i, name in enumerate(name for name in dict.fromkeys(names) if name not in FIXED)}
    number = np.array([found.get(name, -1) for name in names], dtype=int)
    return GroupIndex(
        groups=tuple(BoundGroup(name=f"constraint {name!r}", measure=RelaxationUnit.ROW) for name in found),
        number=number,
        scale=np.array([roots.get(name, 1.0) for name in names]),
        axes=("",) * len(names),
    )


# What holds a level back at its optimum, by the multipliers of bounds, constraints and levels above.

_WEAK = 0.1  # share of the strongest below which a group is not named
_MOST_GROUPS = 3  # groups that are named
_FARTHEST = 10.0  # times its scale: what would have to give way by more does not hold the level back


@dataclass(frozen=True, kw_only=True, slots=True)
class BindingGroup:
    """A group that holds a level back."""

    group: BoundGroup
    strength: float
    """Decrease of the cost of the level for an amount of 1, to first order."""
    axes: tuple[str, ...]
    """Axes that hold most, where the group has several."""

    def needed(self, cost: float) -> float:
        """Amount by which the group alone would have to give way for the level to lose its cost.

        The root of the cost is taken to go on falling as it does at first.
        """
        return 2 * cost / self.strength


def is_held(point: NlpPoint) -> bool:
    """Check whether anything holds the end of a level at all."""
    multipliers = (point.x_multipliers, point.row_multipliers)
    return any(own is not None and bool(own.any()) for own in multipliers)


def bindings(transcription: Transcription, problem: OcpProblem, point: NlpPoint, level: int, cost: float) -> list[BindingGroup]:
    """Find the bounds that hold a level at its end, at `cost`, the strongest first; none where its end has no multipliers."""
    if point.x_multipliers is None or point.row_multipliers is None or cost == 0.0:
        return []
    rows = row_groups(transcription, problem)
    found = [
        *_summed(variable_groups(transcription), point.x_multipliers),
        *_summed(rows, point.row_multipliers[: len(rows.number)]),
        *_levels(transcription, point.row_multipliers, level),
    ]
    strong = [item for item in found if item.strength > 0 and item.needed(cost) <= _FARTHEST]
    strong.sort(key=lambda item: -item.strength)
    return [item for item in strong if item.strength >= _WEAK * strong[0].strength][:_MOST_GROUPS]


def _summed(grouped: GroupIndex, multipliers: np.ndarray) -> Iterator[BindingGroup]:
    """An amount of 1 loosens all bounds of a group at all nodes."""
    strengths = np.abs(multipliers) * grouped.scale
    for i, group in enumerate(grouped.groups):
        strength = float(strengths[grouped.number == i].sum())
        yield BindingGroup(group=group, strength=strength, axes=grouped.strongest(i, strengths))


def _levels(transcription: Transcription, multipliers: np.ndarray, level: int) -> Iterator[BindingGroup]:
    rows = transcription.ranges().levels
    for above, price in zip(rows[:level], prices_of(rows, multipliers, level), strict=True):
        yield BindingGroup(group=BoundGroup(name=f"level {above.name!r}", measure=RelaxationUnit.LEVEL), strength=price, axes=())


def prices_of(rows: tuple[LevelRows, ...], multipliers: np.ndarray, level: int) -> tuple[float, ...]:
    """Compute the price of every level above for a level whose end has these multipliers (n_rows,) [1/unit of the row].

    Of all ways to let the residual of a level above grow by 1 as a norm, the best one lowers the cost by the norm of its
    multipliers.
    """
    return tuple(float(np.linalg.norm(multipliers[above.frozen])) for above in rows[:level])


def level_prices(transcription: Transcription, result: LexicographicResult, level: int) -> tuple[float, ...]:
    """See `uvms_ocp.ocp.plan.LevelReport.prices`; zeros where a level is met in full by anticipation, none if not known."""
    last = level == len(result.points) - 1
    multipliers = result.points[level].row_multipliers
    if multipliers is None or (result.anticipated and not last):
        return (0.0,) * level
    prices = prices_of(transcription.ranges().levels, multipliers, level)
    return () if np.isnan(prices).any() else prices


# The least by which limits and constraints would have to give way for any motion to keep them.
#
# An elastic program over the rows of the transcription, built on demand: each group of bounds and constraints gives way by
# an amount of its own, alike at all nodes, and the sum of the amounts is least. Laws (motion, forces, start) do not give
# way. It ends at a minimum where the problem itself has no solution to end at.

_STAY = 1e-6  # weight of staying near the start, which makes the minimum one point
_KEPT = 1e-4  # amount that is none
_AGAINST = 0.05  # share of a group in what holds against the others, from which it is named
_ITERATIONS = 500
_GRADIENTS = ["f", "g", "grad_gamma_x", "grad_gamma_p"]


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

    @property
    def feasible(self) -> bool:
        return not self.relaxations


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Elastic:
    """Rows ``P [g; x] + Q s`` within bounds, with amounts s >= 0 of the groups."""

    grouped: GroupIndex
    """Groups of the constraints, then of the variables."""
    P: ca.DM
    """(m, n_g + n_x)"""
    Q: ca.DM
    """(m, n_groups)"""
    lower: np.ndarray
    """(m,)"""
    upper: np.ndarray
    """(m,)"""

    @property
    def groups(self) -> tuple[BoundGroup, ...]:
        return self.grouped.groups


def phase_one(transcription: Transcription, problem: OcpProblem, p: np.ndarray, x: np.ndarray, *, time_limit: float) -> PhaseOne:
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
        Relaxation(group=group, amount=amount, axes=elastic.grouped.strongest(i, held))
        for i, (group, amount) in enumerate(zip(groups, amounts, strict=True))
        if amount > _KEPT
    ]
    kept = [i for i, amount in enumerate(amounts) if amount <= _KEPT]
    stats = solver.stats()
    return PhaseOne(
        x=found[:n],
        converged=bool(stats["success"]) and bool(np.isfinite(found).all()),
        relaxations=tuple(sorted(given, key=lambda item: -item.amount)),
        opposing=tuple(groups[i] for i in kept if held[elastic.grouped.number == i].sum() > _AGAINST),
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


def _together(rows: GroupIndex, variables: GroupIndex) -> GroupIndex:
    return GroupIndex(
        groups=(*rows.groups, *variables.groups),
        number=np.concatenate([rows.number, np.where(variables.number < 0, -1, variables.number + len(rows.groups))]),
        scale=np.concatenate([rows.scale, variables.scale]),
        axes=(*rows.axes, *variables.axes),
    )


def _amounts(elastic: _Elastic, values: np.ndarray) -> np.ndarray:
    """Return relaxations of a start whose rows and variables have these values: enough to keep all, and a little more."""
    w, Q = np.array(elastic.P @ values).ravel(), np.abs(elastic.Q.full())
    broken = np.maximum(np.maximum(w - elastic.upper, elastic.lower - w), 0.0)
    units = np.where(Q > 0, Q, 1.0)
    return np.asarray(np.where(Q > 0, broken[:, None] / units, 0.0).max(axis=0, initial=0.0) + 0.01)


def _solver(transcription: Transcription, elastic: _Elastic, p: np.ndarray, x: np.ndarray, time_limit: float) -> ca.Function:
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
        ca.Function("nlp_hess_l", [X, none, lam_f, lam], [ca.triu(hessian)], [*names, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
        # Asked for at construction, never called.
        ca.Function("nlp_grad", [X, none, lam_f, lam], [f, rows, jacobian.T @ lam, none], [*names, "lam_f", "lam_g"], _GRADIENTS),
    )
    options = {
        "cache": {function.name(): function for function in cache},
        "error_on_fail": False,
        "print_time": False,
        "calc_lam_p": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": _ITERATIONS, "max_wall_time": max(time_limit, 0.1)},
    }
    return ca.nlpsol("phase_one", "ipopt", {"x": X, "p": none, "f": f, "g": rows}, options)


# Judge what a result of the solver means, and why a goal is missed or no motion keeps the constraints.

_MISSED = 1e-3  # [unit of the row] residual of a goal level from which it counts as missed; weighted, where that is more
_LONGER = (2.0, 4.0)  # shares of the horizon that are tried to tell "too short" from "unreachable"
_HELPS = 0.9  # share of the residual that more time must leave at most to count as a help

Solve = Callable[[OcpProblem, np.ndarray | None, float], LexicographicResult]
"""A problem, variables to start from (by default its start, held) and a time limit [s] to a result."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SolveVerdict:
    """Verdict on a solve."""

    status: OcpStatus
    reason: str
    """In words, with numbers."""
    result: LexicographicResult
    """Result of the solve, or of one more that was better."""


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
    deadline: float | None
    """[s] by `perf_counter`, until which longer horizons are tried; `None`: nothing is tried."""

    def verdict(self, result: LexicographicResult, *, again: bool = True) -> SolveVerdict:
        """again: one more solve is made where the search for what gives way finds a point that keeps all constraints."""
        if NlpStatus.INTERRUPTED in result.level_status:
            return self._interrupted(result)
        if NlpStatus.NOT_A_NUMBER in result.level_status:
            return self._undefined(result)
        if result.violation > self.feasibility:
            return self._broken(result, again)
        missed = self._missed(result)
        failed = _first_failure(result)
        if missed is not None and (failed is None or missed < failed):
            status, text = self._why_missed(missed, result)
            return SolveVerdict(status=status, reason=text, result=result)
        if failed is not None:
            text = f"level {self._name(failed)}: {result.level_status[failed].value}"
            return SolveVerdict(status=OcpStatus.UNFINISHED, reason=text, result=result)
        return SolveVerdict(status=OcpStatus.SOLVED, reason="all goals are met", result=result)

    def _name(self, level: int) -> str:
        return repr(self.problem.levels[level].name)

    def _interrupted(self, result: LexicographicResult) -> SolveVerdict:
        level = result.level_status.index(NlpStatus.INTERRUPTED)
        residual = result.level_residuals[level]
        text = f"level {self._name(level)}: stopped by hand at a residual of {residual:.4g}, with constraints broken by"
        return SolveVerdict(status=OcpStatus.INTERRUPTED, reason=f"{text} {result.violation:.2g}", result=result)

    def _undefined(self, result: LexicographicResult) -> SolveVerdict:
        names = self.transcription.undefined(self.problem)
        level = result.level_status.index(NlpStatus.NOT_A_NUMBER)
        text = f"level {self._name(level)}: {NlpStatus.NOT_A_NUMBER.value}"
        if names:
            text += f": at the start {_listed(names)} or its slope is none; add a small number under roots and divisions"
        return SolveVerdict(status=OcpStatus.UNFINISHED, reason=text, result=result)

    # --- no motion was found --------------------------------------------------------------------------

    def _broken(self, result: LexicographicResult, again: bool) -> SolveVerdict:
        groups = self.transcription.violations(result.x, self.p, self.problem)
        name = max(groups, key=lambda key: groups[key])
        failed = _first_failure(result)
        level = len(result.level_status) - 1 if failed is None else failed
        status = result.level_status[level]
        text = f"level {self._name(level)}: {status.value} with {name} broken by {groups[name]:.4g}"
        least = self._least(result)
        if least is not None and least.converged:
            if not least.feasible:
                return SolveVerdict(status=OcpStatus.INFEASIBLE, reason=f"{text}; {_describe_relaxations(least)}", result=result)
            if again:
                return self._again(least)
            text += "; a motion that keeps all constraints was found, but no optimum from there"
        if status is NlpStatus.INFEASIBLE and least is None:
            text = f"{text}, and no small change helps"
            return SolveVerdict(status=OcpStatus.INFEASIBLE, reason=text, result=result)
        return SolveVerdict(status=OcpStatus.UNFINISHED, reason=text, result=result)

    def _least(self, result: LexicographicResult) -> PhaseOne | None:
        """`None` where there is no time for it, or nobody waits for it."""
        left = 0.0 if self.deadline is None else self.deadline - perf_counter()
        if left <= 0.0 or not np.isfinite(result.x).all():
            return None
        try:
            return phase_one(self.transcription, self.problem, self.p, result.x, time_limit=left)
        except KeyboardInterrupt:
            return None

    def _again(self, least: PhaseOne) -> SolveVerdict:
        assert self.deadline is not None
        result = self.solve(self.problem, least.x, max(self.deadline - perf_counter(), 0.0))
        return self.verdict(result, again=False)

    # --- a goal is missed -----------------------------------------------------------------------------

    def _missed(self, result: LexicographicResult) -> int | None:
        """The first level of goals, not costs, that is not met where it is at its best."""
        for i, status in enumerate(result.level_status):
            if status.optimal and self._is_missed(i, float(result.level_residuals[i])):
                return i
        return None

    def _is_missed(self, level: int, residual: float) -> bool:
        """A small weight says what a goal is worth beside others, not that it is met."""
        weights = [term.weight for term in self.problem.levels[level].terms if term.is_goal]
        return bool(weights) and residual > _MISSED * min(1.0, *weights) ** 0.5

    def _why_missed(self, missed: int, result: LexicographicResult) -> tuple[OcpStatus, str]:
        """No more than what longer horizons show until the deadline; without a deadline none is tried."""
        residual = float(result.level_residuals[missed])
        text = f"level {self._name(missed)} is missed by {residual:.4g}"
        held = self._held(missed, result)
        if self.problem.free_time:
            return OcpStatus.MISSED, f"{text} with the best of all durations allowed{held}"
        if self.deadline is None:
            return OcpStatus.MISSED, text + held
        for share in _LONGER:
            longer = replace(self.problem, phases=tuple(_stretched(phase, share) for phase in self.problem.phases))
            trial = self.solve(longer, None, max(self.deadline - perf_counter(), 0.0))
            if trial.violation > self.feasibility or not trial.level_status[missed].optimal:
                return OcpStatus.MISSED, f"{text}; a horizon of {_seconds(longer)} was tried in vain{held}"
            rest = float(trial.level_residuals[missed])
            if not self._is_missed(missed, rest):
                return OcpStatus.TOO_SHORT, f"{text}; {_seconds(longer)} would do{held}"
            if rest < _HELPS * residual:
                return OcpStatus.TOO_SHORT, f"{text}; with {_seconds(longer)} it would be {rest:.4g}{held}"
        return OcpStatus.UNREACHABLE, f"{text}, and more time does not help{held}"

    def _held(self, missed: int, result: LexicographicResult) -> str:
        """Describe the bounds that hold the goal back, for the end of a sentence."""
        point = result.points[missed]
        if point.row_multipliers is None or np.isnan(point.row_multipliers).any():
            return ""  # not known
        cost = float(self.transcription.costs(point.x, self.p)[missed]) if is_held(point) else 0.0
        found = bindings(self.transcription, self.problem, point, missed, cost)
        if not found:
            return "; no limit, constraint or level above holds it back: the robot does not get nearer"
        strongest = found[0]
        change = strongest.group.change(strongest.needed(cost), strongest.axes)
        return f"; held back by {_listed([item.group.named(item.axes) for item in found])}; to first order {change}"


def _describe_relaxations(least: PhaseOne) -> str:
    """Describe the relaxations that are needed, and the bounds that oppose them."""
    changes = _listed([item.group.change(item.amount, item.axes) for item in least.relaxations])
    against = f", against {_listed([group.name for group in least.opposing])}" if least.opposing else ""
    return f"for any motion near to keep them all, {changes}{against}"


def _listed(texts: list[str]) -> str:
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}"


def _seconds(problem: OcpProblem) -> str:
    return f"{problem.nominal_times()[-1]:.3g} s"


def _first_failure(result: LexicographicResult) -> int | None:
    return next((i for i, status in enumerate(result.level_status) if not status.optimal), None)


def _stretched(phase: OcpPhase, share: float) -> OcpPhase:
    return replace(phase, duration=phase.nominal * share)

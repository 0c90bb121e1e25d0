"""Judge what a result of the solver means, and why a goal is missed or no motion keeps the constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from uvms_ocp.ocp.diagnosis import PhaseOne, bindings, is_held, phase_one
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.problem import OcpPhase, OcpProblem
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers import LexicographicResult, NlpStatus

_MISSED = (
    1e-3  # [unit of the row] residual of a goal level from which it counts as missed; weighted, where that is more
)
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
            text += (
                f": at the start {_listed(names)} or its slope is none; add a small number under roots and divisions"
            )
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
                return SolveVerdict(
                    status=OcpStatus.INFEASIBLE, reason=f"{text}; {_describe_relaxations(least)}", result=result
                )
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

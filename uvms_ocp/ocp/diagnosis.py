"""Diagnose plans: what a result of the solver means, and why a goal is missed or no motion keeps
the constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from uvms_ocp.ocp.first_order_gain import level_residuals
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.relaxation import Binding, PhaseOne, Relaxation, bindings, phase_one
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.ocp.verdict import (
    Verdict,
    describe_broken,
    describe_gain,
    describe_missed,
    is_missed,
)
from uvms_ocp.solvers import LexicographicResult, NlpStatus
from uvms_ocp.types import DAY

# shares of the horizon that are tried to tell "too short" from "unreachable"
_LONGER_HORIZONS = (2.0, 4.0)
_NOTHING_BINDS = (
    "; no limit, constraint or level above holds it back: the robot does not get nearer"
)
_HELPFUL = 0.9  # share of the residual that more time must leave at most to count as a help

Solve = Callable[[OcpProblem, np.ndarray | None, float], LexicographicResult]
"""Solves a problem from variables (by default its start, held) within a time limit [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SolveVerdict:
    """Verdict on a solve."""

    status: OcpStatus
    reason: str
    """Reason of the status in words, with numbers."""
    result: LexicographicResult
    """Result of the solve, or of one more that was better."""
    verdict: Verdict | None = None
    """Verdict on the motion of the result; `None` where that has no numbers."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Diagnosis:
    """Finds out what a result of the solver means, and why a goal is missed."""

    transcription: Transcription
    problem: OcpProblem
    p: np.ndarray
    """(n_p,) [unit of the parameter] parameters of the problem."""
    feasibility: float
    """Largest violation of a point that counts as usable."""
    solve: Solve
    judge: Callable[[LexicographicResult], Verdict]
    """Judges the motion of a result."""
    deadline: float | None
    """[s] Time by `perf_counter` until which longer horizons are tried; `None`: nothing is tried.
    """

    def verdict(self, result: LexicographicResult, *, again: bool = True) -> SolveVerdict:
        """Judge a result, and find the reason.

        again: one more solve is made where the search for what gives way finds a point that keeps
        all constraints.
        """
        if NlpStatus.NOT_A_NUMBER in result.level_status or not np.isfinite(result.x).all():
            return self._undefined(result)
        verdict = self.judge(result)
        status = verdict.status
        reason = verdict.reason
        if NlpStatus.INTERRUPTED in result.level_status:
            status = OcpStatus.INTERRUPTED
            reason = self._interrupted(result)
        elif status is OcpStatus.BROKEN and result.violation > self.feasibility:
            return self._broken(result, verdict, again)
        elif status is OcpStatus.MISSED:
            status, reason = self._missed(result, verdict)
        elif status is OcpStatus.BROKEN and verdict.missed is not None:
            _, missed_reason = self._missed(result, verdict)
            reason = f"{reason}; {missed_reason}"
        elif status is OcpStatus.IMPROVABLE:
            assert verdict.improvable is not None
            reason += _ended(result, verdict.improvable)
        return SolveVerdict(status=status, reason=reason, result=result, verdict=verdict)

    def _interrupted(self, result: LexicographicResult) -> str:
        """Describe where a search was stopped by hand."""
        level = result.level_status.index(NlpStatus.INTERRUPTED)
        residual = self._residuals(result)[level]
        return (
            f"level {self._name(level)}: stopped by hand at a residual of {residual:.4g}, with"
            f" constraints broken by {result.violation:.2g}"
        )

    def _residuals(self, result: LexicographicResult) -> np.ndarray:
        """Return the residuals (n_levels,); see `uvms_ocp.ocp.plan_file.LevelReport.residual`."""
        t = self.transcription.unpack(result.x, self.problem).t
        return level_residuals(self.transcription, self.problem, result.values, t)

    def _name(self, level: int) -> str:
        return repr(self.problem.levels[level].name)

    def _undefined(self, result: LexicographicResult) -> SolveVerdict:
        """Name the terms that are no numbers."""
        names = self.transcription.undefined(self.problem)
        if NlpStatus.NOT_A_NUMBER in result.level_status:
            level = result.level_status.index(NlpStatus.NOT_A_NUMBER)
        else:
            level = len(result.level_status) - 1
        text = f"level {self._name(level)}: {NlpStatus.NOT_A_NUMBER.value}"
        if names:
            text += (
                f": at the start {_listed(names)} or its slope is none; add a small number under"
                " roots and divisions"
            )
        return SolveVerdict(status=OcpStatus.UNFINISHED, reason=text, result=result)

    def _broken(self, result: LexicographicResult, verdict: Verdict, again: bool) -> SolveVerdict:
        """Find out why no motion was found that keeps the constraints: by how much they would have
        to give way.
        """
        groups = self.transcription.violations(result.x, self.p, self.problem)
        name = max(groups, key=lambda key: groups[key])
        failed_level = _first_failure(result)
        level = len(result.level_status) - 1 if failed_level is None else failed_level
        nlp_status = result.level_status[level]
        reason = f"level {self._name(level)}: {nlp_status.value}"
        if groups[name] <= self.feasibility:
            reason += f": {describe_broken(verdict.broken[0])}"
        else:
            reason += f" with {name} broken by {groups[name]:.4g}"
        status = OcpStatus.UNFINISHED
        phase = self._phase_one(result)
        if phase is not None and phase.converged:
            if not phase.relaxations and again:
                next_result = self.solve(self.problem, phase.x, self._time_left)
                return self.verdict(next_result, again=False)
            if phase.relaxations:
                status = OcpStatus.INFEASIBLE
                reason += f"; {_describe_relaxations(phase)}"
            else:
                reason += (
                    "; a motion that keeps all constraints was found, but no optimum from there"
                )
        if nlp_status is NlpStatus.INFEASIBLE and phase is None:
            status = OcpStatus.INFEASIBLE
            reason += ", and no small change helps"
        return SolveVerdict(status=status, reason=reason, result=result, verdict=verdict)

    def _phase_one(self, result: LexicographicResult) -> PhaseOne | None:
        """Find what would have to give way; `None` where there is no time for it, or nobody waits
        for it.
        """
        time_left = self._time_left
        if time_left > 0.0 and np.isfinite(result.x).all():
            with suppress(KeyboardInterrupt):
                return phase_one(
                    self.transcription, self.problem, self.p, result.x, time_limit=time_left
                )
        return None

    def _missed(self, result: LexicographicResult, verdict: Verdict) -> tuple[OcpStatus, str]:
        """Find out why the first goal that is missed is so, if its level and those above are at
        their best.
        """
        missed = verdict.missed
        assert missed is not None
        improvable = verdict.improvable
        if improvable is None or improvable > missed:
            return self._why_missed(missed, result)
        text = describe_missed(verdict.report.levels[missed])
        gain = describe_gain(verdict.report.levels[improvable])
        return OcpStatus.UNFINISHED, f"{text}; {gain}{_ended(result, improvable)}"

    def _why_missed(self, missed: int, result: LexicographicResult) -> tuple[OcpStatus, str]:
        """Find out why a goal is missed by longer horizons, until the deadline; without a deadline
        none is tried.
        """
        residual = float(self._residuals(result)[missed])
        text = f"level {self._name(missed)} is missed by {residual:.4g}"
        held = self._describe_binding(missed, result)
        failed = ""
        if self.problem.free_time:
            return OcpStatus.MISSED, f"{text} with the best of all durations allowed{held}"
        if self.deadline is None:
            return OcpStatus.MISSED, text
        for longer in self._longer_problems(residual):
            time_left = self._time_left
            if time_left <= 0.0:
                failed += f"; no time was left to try a horizon of {_seconds(longer)}"
                break
            trial = self.solve(longer, None, time_left)
            is_kept = trial.violation <= self.feasibility
            if not is_kept or not all(status.optimal for status in trial.level_status[:missed]):
                failed = f"; a horizon of {_seconds(longer)} was tried in vain"
                continue
            t = self.transcription.unpack(trial.x, longer).t
            residuals = level_residuals(self.transcription, longer, trial.values, t)
            remaining = float(residuals[missed])
            rates = "" if held == _NOTHING_BINDS else held
            if not is_missed(self.problem.levels[missed], remaining):
                return OcpStatus.TOO_SHORT, f"{text}; {_seconds(longer)} would do{rates}"
            if remaining < _HELPFUL * residual:
                text += f"; with {_seconds(longer)} it would be {remaining:.4g}{rates}"
                return OcpStatus.TOO_SHORT, text
            if not trial.level_status[missed].optimal:
                failed = f"; a horizon of {_seconds(longer)} was tried in vain"
        if failed:
            return OcpStatus.MISSED, f"{text}{failed}{held}"
        return OcpStatus.UNREACHABLE, f"{text}, and more time does not help{held}"

    @property
    def _time_left(self) -> float:
        """Time [s] until the deadline."""
        if self.deadline is None:
            return 0.0
        return max(self.deadline - perf_counter(), 0.0)

    def _longer_problems(self, residual: float) -> Iterator[OcpProblem]:
        """Yield the problem with longer horizons; the last leaves every axis the time to move by
        the residual, at its limits from rest to rest.
        """
        limits = self.problem.robot.limits
        at_top_speed = residual / limits.velocity
        from_rest_to_rest = 2 * (residual / limits.acceleration) ** 0.5
        needed = np.concatenate([at_top_speed, from_rest_to_rest]).max(initial=0.0)
        sufficient = 2 * float(needed) / float(self.problem.nominal_times()[-1])
        shares = [*_LONGER_HORIZONS]
        if np.isfinite(sufficient) and sufficient > _LONGER_HORIZONS[-1]:
            shares.append(sufficient)
        for share in shares:
            phases = []
            for phase in self.problem.phases:
                phases.append(replace(phase, duration=min(phase.nominal * share, DAY)))
            yield replace(self.problem, phases=tuple(phases))

    def _describe_binding(self, missed: int, result: LexicographicResult) -> str:
        """Describe what holds the goal back, for the end of a sentence; empty where that is not
        known.
        """
        residual = float(result.level_residuals[missed])
        time_left = self._time_left
        if time_left <= 0.0:
            return ""
        holding = bindings(
            self.transcription, self.problem, self.p, result, missed, time_limit=time_left / 2
        )
        if holding is None:
            return ""
        if not holding:
            return _NOTHING_BINDS
        names = []
        for binding in holding:
            names += [item.group.named(item.axes) for item in binding.relaxations]
        changes = "; or ".join(_describe_change(binding, residual) for binding in holding)
        return f"; held back by {_listed(names)}: {changes}"


def _describe_change(binding: Binding, residual: float) -> str:
    """Describe what would have to give way for a level to be met, or to get nearer."""
    aim = f"for {binding.left * residual:.4g}" if binding.left > 0 else "to meet it"
    return f"{aim}, {_listed_changes(binding.relaxations)}"


def _describe_relaxations(phase: PhaseOne) -> str:
    """Describe the relaxations that are needed, and the bounds that oppose them."""
    text = f"for any motion near to keep them all, {_listed_changes(phase.relaxations)}"
    if phase.opposing:
        text += f", against {_listed([group.name for group in phase.opposing])}"
    return text


def _listed_changes(relaxations: Sequence[Relaxation]) -> str:
    return _listed([item.group.change(item.amount, item.axes) for item in relaxations])


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
    """Return the index of the first level without an optimum."""
    for i, status in enumerate(result.level_status):
        if not status.optimal:
            return i
    return None

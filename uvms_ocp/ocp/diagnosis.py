"""Diagnose plans: what a result of the solver means, and why a goal is missed or no motion keeps
the constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from uvms_ocp.ocp.first_order_gain import level_residuals
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.relaxation import Binding, PhaseOne, bindings, phase_one
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
    """Word of the judge on the motion of the result; `None` where that has no numbers."""


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
        wrong = [
            i for i, status in enumerate(result.level_status) if status is NlpStatus.NOT_A_NUMBER
        ]
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
        phase = self._least(result)
        if phase is not None and phase.converged:
            if not phase.relaxations and again:
                return self.verdict(self.solve(self.problem, phase.x, self._left), again=False)
            if phase.relaxations:
                called = OcpStatus.INFEASIBLE
                text += f"; {_describe_relaxations(phase)}"
            else:
                text += "; a motion that keeps all constraints was found, but no optimum from there"
        if status is NlpStatus.INFEASIBLE and phase is None:
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
        """Why the first goal that is missed is so, if its level and those above are at their
        best.
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
        holding = bindings(
            self.transcription, self.problem, self.p, result, missed, time_limit=self._left / 2
        )
        if holding is None:
            return ""
        if not holding:
            return _UNHELD
        names = [item.group.named(item.axes) for binding in holding for item in binding.relaxations]
        return (
            f"; held back by {_listed(names)}:"
            f" {'; or '.join(_change(binding, residual) for binding in holding)}"
        )


def _change(binding: Binding, residual: float) -> str:
    aim = f"for {binding.left * residual:.4g}" if binding.left > 0 else "to meet it"
    return (
        f"{aim},"
        f" {_listed([item.group.change(item.amount, item.axes) for item in binding.relaxations])}"
    )


def _describe_relaxations(phase: PhaseOne) -> str:
    """Describe the relaxations that are needed, and the bounds that oppose them."""
    changes = _listed([item.group.change(item.amount, item.axes) for item in phase.relaxations])
    if phase.opposing:
        against = f", against {_listed([group.name for group in phase.opposing])}"
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

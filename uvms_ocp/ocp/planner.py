"""From problem to plan: transcribe once, solve, and find out why where a goal is missed."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import TypeAlias

import numpy as np

from uvms_ocp.arguments import Finite, checked
from uvms_ocp.ocp.first_step import impossible_start
from uvms_ocp.ocp.plan import LevelReport, OcpStatus, Plan
from uvms_ocp.ocp.problem import OcpPhase, OcpProblem
from uvms_ocp.ocp.stagewise.stagewise_transcription import StagewiseTranscription
from uvms_ocp.ocp.trajectory import Trajectory, hold
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicNlp, LexicographicResult, NlpOptions
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus

_MISSED = 1e-3  # weighted residual of a goal level from which it counts as missed
_LONGER = (2.0, 4.0)  # shares of the horizon that are tried to tell "too short" from "unreachable"
_HELPS = 0.9  # share of the residual that more time must leave at most to count as a help

Verdict: TypeAlias = tuple[OcpStatus, str]
"""With the reason in words."""


@checked
class Planner:
    """Solves problems of one shape, built once with its NLPs; see `uvms_ocp.ocp.transcription.shape`."""

    def __init__(
        self,
        problem: OcpProblem,
        options: NlpOptions | None = None,
        *,
        transcription: Transcription | StagewiseTranscription | None = None,
    ) -> None:
        """transcription: of the same problem for the same plugin, to share it between planners of different options."""
        self.options = options or NlpOptions()
        self.problem = problem
        self.transcription = transcription or _transcribed(problem, self.options.plugin)
        self._nlp = LexicographicNlp(self.transcription.program, self.options)

    def plan(
        self,
        problem: OcpProblem | None = None,
        *,
        guess: Trajectory | Plan | None = None,
        t0: Finite = 0.0,
        diagnose: bool = True,
    ) -> Plan:
        """Plan for `problem`, by default the one this planner was built from.

        problem: of the same shape. Start, current, goals, places and sizes of obstacles, weights, bounds and durations may
        differ; anything else raises `InvalidInput`, which says what. guess: a trajectory, or an earlier plan to start
        from, warm; by default the robot holds its start. t0 [s]: time of the first node, for goals that move. diagnose:
        where a goal is missed, try longer horizons to say why, within the time limit of the options.
        """
        begin, given = perf_counter(), problem or self.problem
        obstruction = self.transcription.obstruction(given)
        if obstruction is not None:
            name, depth = obstruction
            return self._failed(given, OcpStatus.OBSTRUCTED, f"{name} is broken by {depth:.4g} at the start", begin)
        impossible = impossible_start(given)
        if impossible is not None:
            return self._failed(given, OcpStatus.INFEASIBLE, impossible, begin)
        p = self.transcription.parameters(given, t0=t0)
        result = self.solve(p, guess if guess is not None else hold(given), problem=given)
        deadline = begin + self.options.time_limit if diagnose else None
        verdict = (
            self._broken(given, p, result) or self._unfinished(result) or self._reached(given, result, t0, deadline)
        )
        return self._plan(given, result, *verdict, begin)

    def solve(
        self,
        p: np.ndarray,
        guess: Trajectory | Plan | LexicographicResult,
        *,
        problem: OcpProblem | None = None,
        time_limit: float | None = None,
    ) -> LexicographicResult:
        """The lexicographic solution for parameters p (n_p,) [unit of the parameter] of `Transcription.parameters`.

        problem: that of p, by default the one this planner was built from. time_limit [s]: where it is to be shorter than
        that of the options.
        """
        lower, upper = self.transcription.bounds(problem)
        ranges = self.transcription.ranges(problem)
        return self._nlp.solve(
            self._start(guess), p=p, x_lower=lower, x_upper=upper, ranges=ranges, time_limit=time_limit
        )

    def _start(self, guess: Trajectory | Plan | LexicographicResult) -> np.ndarray | LexicographicResult:
        if isinstance(guess, LexicographicResult):
            return guess
        if isinstance(guess, Plan):
            return guess.result if guess.result is not None else self.transcription.pack(guess.trajectory)
        return self.transcription.pack(guess)

    def _plan(
        self, given: OcpProblem, result: LexicographicResult, status: OcpStatus, reason: str, begin: float
    ) -> Plan:
        return Plan(
            robot=given.robot,
            trajectory=self.transcription.unpack(result.x, given),
            status=status,
            reason=reason,
            levels=tuple(self._reports(result)),
            solve_time=perf_counter() - begin,
            result=result,
        )

    def _reports(self, result: LexicographicResult) -> list[LevelReport]:
        rows = zip(
            self.problem.levels, result.level_status, result.level_residuals.tolist(), result.iterations, strict=True
        )
        return [
            LevelReport(name=level.name, status=status.value, advice=status.advice, residual=residual, iterations=n)
            for level, status, residual, n in rows
        ]

    def _failed(self, given: OcpProblem, status: OcpStatus, reason: str, begin: float) -> Plan:
        return Plan(
            robot=given.robot,
            trajectory=hold(given),
            status=status,
            reason=reason,
            levels=(),
            solve_time=perf_counter() - begin,
        )

    # --- why --------------------------------------------------------------------------------------

    def _broken(self, given: OcpProblem, p: np.ndarray, result: LexicographicResult) -> Verdict | None:
        if result.violation <= self.options.feasibility:
            return None
        groups = self.transcription.violations(result.x, p, given)
        name = max(groups, key=lambda key: groups[key])
        index = _first_failure(result)
        level, status = self.problem.levels[index].name, result.level_status[index]
        text = f"level {level!r}: {status.value} with {name} broken by {groups[name]:.4g}"
        if status is NlpStatus.INFEASIBLE:
            return OcpStatus.INFEASIBLE, f"{text}, and no small change helps"
        return OcpStatus.UNFINISHED, text

    def _unfinished(self, result: LexicographicResult) -> Verdict | None:
        if result.status.optimal:
            return None
        index = _first_failure(result)
        status = result.level_status[index]
        return OcpStatus.UNFINISHED, f"level {self.problem.levels[index].name!r}: {status.value}"

    def _reached(self, given: OcpProblem, result: LexicographicResult, t0: float, deadline: float | None) -> Verdict:
        missed = self._missed(result)
        if missed is None:
            return OcpStatus.SOLVED, "all goals are met"
        return self._why_missed(given, missed, result, t0, deadline)

    def _missed(self, result: LexicographicResult) -> int | None:
        """The first level of goals, not costs, that is not met."""
        for i, level in enumerate(self.problem.levels):
            if any(term.is_goal for term in level.terms) and result.level_residuals[i] > _MISSED:
                return i
        return None

    def _why_missed(
        self, given: OcpProblem, missed: int, result: LexicographicResult, t0: float, deadline: float | None
    ) -> Verdict:
        """No more than what longer horizons show until the deadline; without a deadline none is tried."""
        residual = float(result.level_residuals[missed])
        text = f"level {self.problem.levels[missed].name!r} is missed by {residual:.4g}"
        if given.free_time:
            return OcpStatus.MISSED, f"{text} with the best of all durations allowed"
        if deadline is None:
            return OcpStatus.MISSED, text
        for share in _LONGER:
            longer = replace(given, phases=tuple(_stretched(phase, share) for phase in given.phases))
            p, left = self.transcription.parameters(longer, t0=t0), deadline - perf_counter()
            trial = self.solve(p, hold(longer), problem=longer, time_limit=max(left, 0.0))
            if trial.violation > self.options.feasibility or not trial.level_status[missed].optimal:
                return OcpStatus.MISSED, f"{text}; a horizon of {_seconds(longer)} was tried in vain"
            rest = float(trial.level_residuals[missed])
            if rest <= _MISSED:
                return OcpStatus.TOO_SHORT, f"{text}; {_seconds(longer)} would do"
            if rest < _HELPS * residual:
                return OcpStatus.TOO_SHORT, f"{text}; with {_seconds(longer)} it would be {rest:.4g}"
        return OcpStatus.UNREACHABLE, f"{text}, and more time does not help"


def _transcribed(problem: OcpProblem, plugin: str) -> Transcription | StagewiseTranscription:
    return StagewiseTranscription(problem) if plugin == "stagewise" else Transcription(problem, plugin=plugin)


def _seconds(problem: OcpProblem) -> str:
    return f"{problem.nominal_times()[-1]:.3g} s"


def _first_failure(result: LexicographicResult) -> int:
    failures = (i for i, status in enumerate(result.level_status) if not status.optimal)
    return next(failures, len(result.level_status) - 1)


def _stretched(phase: OcpPhase, share: float) -> OcpPhase:
    return replace(phase, duration=phase.nominal * share)


@checked
def plan(problem: OcpProblem, options: NlpOptions | None = None, guess: Trajectory | None = None) -> Plan:
    """Plan once; build a `Planner` to plan again and again."""
    return Planner(problem, options).plan(guess=guess)

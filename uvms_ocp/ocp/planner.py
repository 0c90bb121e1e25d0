"""From problem to plan: transcribe once, solve, and find out why where a goal is missed."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from uvms_ocp.arguments import Finite, checked
from uvms_ocp.ocp.clearance.crowded_start import crowded_start
from uvms_ocp.ocp.first_step import impossible_start
from uvms_ocp.ocp.plan import LevelReport, OcpStatus, Plan
from uvms_ocp.ocp.plans.scenery import surroundings
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.reasons.binding import level_prices
from uvms_ocp.ocp.reasons.verdict import Court, Verdict
from uvms_ocp.ocp.refinement import Refinement, Written, worst_clearance
from uvms_ocp.ocp.stagewise.stagewise_program import program_for
from uvms_ocp.ocp.trajectory import Trajectory, hold
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicNlp, LexicographicResult, NlpOptions
from uvms_ocp.solvers.nlp.watch import Progress


@checked
class Planner:
    """Solves problems of one shape, built once with its NLPs; see `uvms_ocp.ocp.transcription.shape`.

    Threads that share one, or its transcription, take turns: their functions keep memory. Give each a planner, and none waits.
    """

    def __init__(
        self,
        problem: OcpProblem,
        options: NlpOptions | None = None,
        *,
        transcription: Transcription | None = None,
    ) -> None:
        """transcription: of the same problem for the same plugin, to share it between planners of different options."""
        self.options = options or NlpOptions()
        self.problem = problem
        self.transcription = transcription or Transcription(problem, plugin=self.options.plugin)
        self._nlp = LexicographicNlp(program_for(self.options.plugin, self.transcription), self.options)

    def plan(
        self,
        problem: OcpProblem | None = None,
        *,
        guess: Trajectory | Plan | None = None,
        t0: Finite = 0.0,
        diagnose: bool = True,
        progress: Progress | None = None,
    ) -> Plan:
        """Plan for `problem`, by default the one this planner was built from.

        problem: of the same shape. Start, current, goals, places and sizes of obstacles, weights, bounds and durations may
        differ; anything else raises `InvalidInput`, which says what. guess: a trajectory, or an earlier plan to start
        from, warm; by default the robot holds its start. t0 [s]: time of the first node, for goals that move. diagnose:
        where a goal is missed, try longer horizons to say why, and where constraints are, look for what would have to give
        way, within the time limit of the options. progress: told every iteration of IPOPT; Ctrl-C, or a
        `KeyboardInterrupt` from it, ends the search with the best plan so far, whose status says so.
        """
        with self.transcription.turn:
            begin, given = perf_counter(), problem or self.problem
            obstruction = self.transcription.obstruction(given)
            if obstruction is not None:
                name, depth = obstruction
                text = f"{name} is broken by {depth:.4g} at the start{crowded_start(given, name)}"
                return self._failed(given, OcpStatus.OBSTRUCTED, text, begin)
            impossible = impossible_start(given)
            if impossible is not None:
                return self._failed(given, OcpStatus.INFEASIBLE, impossible, begin)
            ends = begin + self.options.time_limit
            refinement = Refinement(planner=self, given=given, t0=t0, deadline=ends, progress=progress)
            found = refinement.solved(hold(given) if guess is None else guess)
            court = self._court(given, found, t0, ends if diagnose else None)
            return self._plan(given, court.verdict(found.result), t0, begin)

    def solve(
        self,
        p: np.ndarray,
        guess: Trajectory | Plan | LexicographicResult,
        *,
        problem: OcpProblem | None = None,
        time_limit: float | None = None,
        progress: Progress | None = None,
    ) -> LexicographicResult:
        """The lexicographic solution for parameters p (n_p,) [unit of the parameter] of `Transcription.parameters`.

        problem: that of p, by default the one this planner was built from. time_limit [s]: where it is to be shorter than
        that of the options. progress: as `plan` takes it.
        """
        with self.transcription.turn:
            lower, upper = self.transcription.bounds(problem)
            ranges = self.transcription.ranges(problem)
            return self._nlp.solve(
                self._start(guess),
                p=p,
                x_lower=lower,
                x_upper=upper,
                ranges=ranges,
                time_limit=time_limit,
                progress=progress,
            )

    def _start(self, guess: Trajectory | Plan | LexicographicResult) -> np.ndarray | LexicographicResult:
        if isinstance(guess, LexicographicResult):
            return guess
        if isinstance(guess, Plan):
            return guess.result if guess.result is not None else self.transcription.pack(guess.trajectory)
        return self.transcription.pack(guess)

    def _court(self, given: OcpProblem, found: Written, t0: float, deadline: float | None) -> Court:
        def solve(other: OcpProblem, x: np.ndarray | None, limit: float) -> LexicographicResult:
            numbers = self.transcription.parameters(other, t0=t0, near=found.near, tightened=found.tightened)
            guess = hold(other) if x is None else self.transcription.unpack(x, other)
            return self.solve(numbers, guess, problem=other, time_limit=limit)

        feasibility = self.options.feasibility
        return Court(
            transcription=self.transcription,
            problem=given,
            p=found.p,
            feasibility=feasibility,
            solve=solve,
            deadline=deadline,
        )

    def _plan(self, given: OcpProblem, verdict: Verdict, t0: float, begin: float) -> Plan:
        trajectory = self.transcription.unpack(verdict.result.x, given)
        return Plan(
            robot=given.robot,
            trajectory=trajectory,
            clearance=worst_clearance(given, trajectory) if verdict.status.usable else None,
            status=verdict.status,
            reason=verdict.reason,
            levels=tuple(self._reports(verdict.result)),
            solve_time=perf_counter() - begin,
            result=verdict.result,
            surroundings=surroundings(given, t0),
            current=tuple(given.mean_current.tolist()),
        )

    def _reports(self, result: LexicographicResult) -> list[LevelReport]:
        statuses, residuals = result.level_status, result.level_residuals.tolist()
        return [
            LevelReport(
                name=level.name,
                status=statuses[i].value,
                advice=statuses[i].advice,
                residual=residuals[i],
                iterations=result.iterations[i],
                prices=level_prices(self.transcription, result, i),
            )
            for i, level in enumerate(self.problem.levels)
        ]

    def _failed(self, given: OcpProblem, status: OcpStatus, reason: str, begin: float) -> Plan:
        return Plan(
            robot=given.robot,
            trajectory=hold(given),
            status=status,
            reason=reason,
            levels=(),
            solve_time=perf_counter() - begin,
            surroundings=surroundings(given, 0.0),
            current=tuple(given.mean_current.tolist()),
        )


@checked
def plan(problem: OcpProblem, options: NlpOptions | None = None, guess: Trajectory | None = None) -> Plan:
    """Plan once; build a `Planner` to plan again and again."""
    return Planner(problem, options).plan(guess=guess)

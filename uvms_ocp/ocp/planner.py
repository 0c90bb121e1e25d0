"""Plan: transcribe a problem once, solve it, and find out why where a goal is missed."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from time import perf_counter
from typing import Annotated, Any

import numpy as np

from uvms_ocp.checks import checked, replace_unchecked, unchecked_constructor, unchecked_method
from uvms_ocp.codegen.compile import compiling_beside
from uvms_ocp.interrupts import Interrupted, Stopped, on_interrupt, raised_outside_casadi
from uvms_ocp.ocp.clearance_certificate import certificate
from uvms_ocp.ocp.diagnosis import Diagnosis, SolveVerdict
from uvms_ocp.ocp.first_guess import first_guess
from uvms_ocp.ocp.first_order_gain import level_residuals
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.plan import LevelReport, OcpStatus, Plan
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.refinement import (
    USABLE,
    Guess,
    MotionGuess,
    RefinedResult,
    Refinement,
    held_apart,
)
from uvms_ocp.ocp.stagewise.program import program_for, stagewise_or
from uvms_ocp.ocp.start_checks import describe_crowded_start, impossible_start
from uvms_ocp.ocp.surroundings import surroundings
from uvms_ocp.ocp.trajectory import (
    Trajectory,
    admissible,
    coarse_problem,
    hold_guess,
)
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.ocp.verdict import Verdict, judge_motion
from uvms_ocp.progress import SILENT, progress_bar
from uvms_ocp.solvers import LexicographicNlp, LexicographicResult, NlpOptions, NlpStatus
from uvms_ocp.solvers.nlp.options import AUTO, IPOPT, STAGEWISE
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport, Progress
from uvms_ocp.types import DAY, Bound, Finite, Shape

_COARSE: dict[str, Any] = {"convergence": 1e-2, "max_iterations": 20}
_BAR = "{elapsed} planning: {desc}"
_FEW_STEPS = 100  # through which the virtual machine takes no longer than a compiler

_unchecked = unchecked_constructor(Plan)


@checked
class Planner:
    """Solves problems of one shape, built once with its NLPs; see
    `uvms_ocp.ocp.transcription.problem_reuse`.

    Threads that share one, or its transcription, take turns: their functions keep memory. Give each
    a planner, and none waits.
    """

    def __init__(
        self,
        problem: OcpProblem,
        options: NlpOptions | None = None,
        *,
        transcription: Transcription | None = None,
        wait_for_compiler: bool = False,
    ) -> None:
        """transcription: of the same problem for the same plugin, to share it between planners of
        different options. wait_for_compiler: before the first search, which else begins in CasADi's
        virtual machine, at a twentieth of the speed, and comes to the same plan: stage by stage it
        goes on in machine code as soon as that is there, with IPOPT the next planner does. It is
        waited for always where there is a time limit, and with IPOPT where steps are many.
        """
        requested = options or NlpOptions()
        if transcription is not None:
            plugin = transcription.plugin
        else:
            plugin = stagewise_or(IPOPT, problem)
        if requested.plugin == AUTO:
            self.options = replace(requested, plugin=plugin)
        else:
            self.options = requested
        """With the solver that was chosen."""
        has_many_steps = problem.n_steps > _FEW_STEPS and self.options.plugin != STAGEWISE
        self.problem = problem
        self._wait = wait_for_compiler or requested.time_limit < DAY or has_many_steps
        self._tries_ipopt = requested.plugin == AUTO and plugin == STAGEWISE
        with compiling_beside(not self._wait), raised_outside_casadi():
            self.transcription = transcription or Transcription(problem, plugin=self.options.plugin)
            self._nlp = LexicographicNlp(
                program_for(self.options.plugin, self.transcription), self.options
            )

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

        problem: of the same shape. Start, current, goals, places and sizes of obstacles, weights,
        bounds and durations may differ; anything else raises `InvalidInput`, which says what.
        guess: a trajectory, or an earlier plan to start from, warm; by default the robot holds its
        start, or, stage by stage with fixed durations, takes the best motion over a few steps
        towards several postures. t0 [s]: time of the first node, for goals that move. diagnose:
        where a goal is missed, try longer horizons to say why, and where constraints are, look for
        what would have to give way, within the time limit of the options. progress: called every
        iteration, in place of a line of text where somebody looks (`uvms_ocp.progress`); a
        `KeyboardInterrupt` from it ends the search with the best plan so far, whose status says so.
        Ctrl-C does too, and raises `Interrupted`, whose `result` is that plan.
        """
        presses: list[object] = []

        def report(moment: IterationReport) -> None:
            if presses:  # between two solves
                raise KeyboardInterrupt
            if progress is not None:
                progress(moment)
            else:
                show(moment)

        def show(moment: IterationReport) -> None:
            if not bar.disable:
                bar.set_description_str(str(moment), refresh=False)
                bar.update()

        with (
            on_interrupt(presses.append),
            self.transcription.turn,
            progress_bar(shown=progress is None, delay=SILENT, bar_format=_BAR) as bar,
        ):
            plan = self._planned(
                problem or self.problem,
                guess,
                t0,
                perf_counter() + self.options.time_limit,
                diagnose,
                report,
                None if bar.disable else show,
            )
        if presses:
            raise Interrupted(plan.reason, plan)
        return plan

    @cached_property
    def coarse(self) -> Planner:
        """The planner of the same problem over a few steps, of few digits."""
        return Planner(
            coarse_problem(self.problem),
            replace(self.options, **_COARSE),
            wait_for_compiler=self._wait,
        )

    @cached_property
    def _by_ipopt(self) -> Planner:
        return Planner(
            self.problem, replace(self.options, plugin=IPOPT), wait_for_compiler=self._wait
        )

    def _planned(
        self,
        problem: OcpProblem,
        guess: MotionGuess | None,
        t0: float,
        ends: float,
        diagnose: bool,
        progress: Progress,
        progress_of_diagnosis: Progress | None,
    ) -> Plan:
        begin = perf_counter()
        refusal = self._refusal(problem)
        if refusal is not None:
            status, reason = refusal
            held = hold_guess(problem)
            return _made(problem, 0.0, begin, held, status=status, reason=reason, levels=())
        refinement = Refinement(
            planner=self, problem=problem, t0=t0, deadline=ends, progress=progress
        )
        start: MotionGuess
        if guess is None:
            start = first_guess(self, problem, t0=t0, deadline=ends)
        else:
            start = guess
        finder, refined, note = self._second_try(refinement, start, refinement.solved(start))
        court = finder._court(
            problem, refined, t0, ends if diagnose else None, progress_of_diagnosis
        )
        plan = finder._plan(problem, court.verdict(refined.result), t0, begin)
        return replace_unchecked(plan, reason=plan.reason + note)

    def _refusal(self, problem: OcpProblem) -> tuple[OcpStatus, str] | None:
        """Return status and reason where the start alone shows that there is no motion."""
        obstruction = self.transcription.obstruction(problem)
        if obstruction is not None:
            name, depth = obstruction
            crowd = describe_crowded_start(problem, name)
            return OcpStatus.OBSTRUCTED, f"{name} is broken by {depth:.4g} at the start{crowd}"
        impossible = impossible_start(problem)
        if impossible is not None:
            return OcpStatus.INFEASIBLE, impossible
        return None

    def _second_try(
        self, refinement: Refinement, start: MotionGuess, first: RefinedResult
    ) -> tuple[Planner, RefinedResult, str]:
        """Return the planner whose result is taken, the result, and what the reason says of that:
        it is IPOPT's where this planner may try it, has no optimum and time is left, unless it
        breaks more.
        """
        status = first.result.status
        ended = self._nlp.watch.should_stop or perf_counter() > refinement.deadline
        if not self._tries_ipopt or status.optimal or ended:
            return self, first, ""
        second = None
        with suppress(Stopped):  # while it is built
            second = replace(refinement, planner=self._by_ipopt).solved(start)
        allowed = max(first.result.violation, USABLE)
        if second is not None and second.result.violation <= allowed:
            return self._by_ipopt, second, f"; by ipopt: {STAGEWISE} ended {status.value!r}"
        if second is None or NlpStatus.INTERRUPTED in second.result.level_status:
            return self, first.interrupted, ""  # nothing else is begun
        return self, first, ""

    def solve(
        self,
        p: Annotated[np.ndarray, Shape("self.transcription.parameter_layout.n")],
        guess: Trajectory | Plan | LexicographicResult,
        *,
        problem: OcpProblem | None = None,
        time_limit: Bound | None = None,
        progress: Progress | None = None,
        tightened: Tightening = NO_TIGHTENING,
        around: tuple[np.ndarray, float] | None = None,
    ) -> LexicographicResult:
        """Return the lexicographic solution for parameters p (n_p,) [unit of the parameter] of
        `Transcription.parameters`.

        problem: that of p, by default the one this planner was built from. time_limit [s]: where it
        is to be shorter than that of the options. progress: as `plan` takes it. tightened: what
        is asked of nodes beyond their ranges, as p was made for it. around: configurations (N + 1,
        n_q) [m, rad] and how far [m, rad] joints may go from there.
        """
        with self.transcription.turn:
            lower, upper = self.transcription.bounds(problem, tightened, around)
            ranges = self.transcription.ranges(problem, tightened)
            return unchecked_method(self._nlp.solve)(
                self._start(guess),
                p=p,
                x_lower=lower,
                x_upper=upper,
                ranges=ranges,
                time_limit=time_limit,
                progress=progress,
            )

    def _start(self, guess: Guess) -> np.ndarray | LexicographicResult:
        if isinstance(guess, Plan):
            guess = guess.trajectory if guess.result is None else guess.result
        if isinstance(guess, LexicographicResult):
            return guess
        return self.transcription.pack(guess)

    def _court(
        self,
        problem: OcpProblem,
        refined: RefinedResult,
        t0: float,
        deadline: float | None,
        progress: Progress | None,
    ) -> Diagnosis:
        def solve(varied: OcpProblem, x: np.ndarray | None, limit: float) -> LexicographicResult:
            numbers = self.transcription.parameters(
                varied, t0=t0, written_at=refined.written_at, tightened=refined.tightened
            )
            if x is None:
                guess = hold_guess(varied)
            else:
                guess = self.transcription.unpack(x, varied)
            return self.solve(
                numbers,
                guess,
                problem=varied,
                time_limit=limit,
                progress=progress,
                tightened=refined.tightened,
            )

        def judge(result: LexicographicResult) -> Verdict:
            return judge_motion(
                problem,
                self._motion(problem, result),
                t0=t0,
                transcription=self.transcription,
                tightened=refined.tightened,
            )

        feasibility = self.options.feasibility
        return Diagnosis(
            transcription=self.transcription,
            problem=problem,
            p=refined.p,
            feasibility=feasibility,
            solve=solve,
            judge=judge,
            deadline=deadline,
        )

    def _motion(self, problem: OcpProblem, result: LexicographicResult) -> Trajectory:
        return admissible(self.transcription.unpack(result.x, problem), problem.robot)

    def _plan(self, problem: OcpProblem, verdict: SolveVerdict, t0: float, begin: float) -> Plan:
        trajectory = self._motion(problem, verdict.result)
        if verdict.status.usable:
            reports = [certificate(term, trajectory) for term in held_apart(problem)]
        else:
            reports = []
        clearance = min(
            reports,
            key=lambda report: (report.collision_free, report.nearest.distance),
            default=None,
        )
        judged = verdict.verdict
        parts = {
            "clearance": clearance,
            "result": verdict.result,
            "plugin": self.options.plugin,
            "verdict": None if judged is None else judged.report,
        }
        levels = tuple(self._reports(problem, verdict.result, trajectory.t))
        return _made(
            problem,
            t0,
            begin,
            trajectory,
            status=verdict.status,
            reason=verdict.reason,
            levels=levels,
            **parts,
        )

    def _reports(
        self, problem: OcpProblem, result: LexicographicResult, t: np.ndarray
    ) -> list[LevelReport]:
        """Report on each level of a solution, on a horizon with these times (n + 1,) [s]."""
        residuals = level_residuals(self.transcription, problem, result.values, t).tolist()
        reports = []
        for i, level in enumerate(self.problem.levels):
            status = result.level_status[i]
            reports.append(
                LevelReport(
                    name=level.name,
                    status=status.value,
                    advice=status.advice,
                    residual=residuals[i],
                    iterations=result.iterations[i],
                    prices=self._level_prices(result, i),
                )
            )
        return reports

    def _level_prices(self, result: LexicographicResult, level: int) -> tuple[float, ...]:
        """Return `LevelReport.prices` of a level; zeros where a level is met in full by
        anticipation, none if not known.

        Of all ways to let the residual of a level above grow by 1 as a norm, the best one lowers
        the cost by the norm of the multipliers of the rows that hold it.
        """
        is_last = level == len(result.points) - 1
        multipliers = result.points[level].row_multipliers
        if multipliers is None or (result.anticipated and not is_last):
            return (0.0,) * level
        levels_above = self.transcription.ranges().levels[:level]
        prices = [float(np.linalg.norm(multipliers[above.frozen])) for above in levels_above]
        if np.isnan(prices).any():
            return ()
        return tuple(prices)


def _made(
    problem: OcpProblem, t0: float, begin: float, trajectory: Trajectory, **parts: Any
) -> Plan:
    """Plan begun at the moment `begin` [s], with what it has of its problem."""
    around = surroundings(problem, t0)
    current = tuple(problem.mean_current.tolist())
    spent = perf_counter() - begin
    return _unchecked(
        robot=problem.robot,
        trajectory=trajectory,
        surroundings=around,
        current=current,
        solve_time=spent,
        **parts,
    )


@checked
def plan(
    problem: OcpProblem, options: NlpOptions | None = None, guess: Trajectory | None = None
) -> Plan:
    """Plan once; build a `Planner` to plan again and again."""
    return Planner(problem, options).plan(guess=guess)

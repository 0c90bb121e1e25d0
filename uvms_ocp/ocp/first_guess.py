"""Guess where a plan begins: the best motion over a few steps that meets all levels above the last.

Stage by stage it takes little. Of motions towards several postures those that cost least over a few
steps are compared over all of them, as far as one iteration brings them.
"""

from __future__ import annotations

from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from uvms_ocp.interrupts import Stopped, on_interrupt
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.refinement import Refinement
from uvms_ocp.ocp.trajectory import (
    COARSE_STEPS,
    Trajectory,
    coarse_guesses,
    coarse_problem,
    hold_guess,
    shift_guess,
)
from uvms_ocp.solvers.nlp.options import STAGEWISE
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport

if TYPE_CHECKING:
    from uvms_ocp.ocp.planner import Planner

_TIME_SHARE = 0.2  # of a time limit, for the guess
# After so many iterations a motion is given up whose residual is so many times the smallest.
_FIRST_ITERATIONS = 3
_COSTLY = 1.08
# motions that all fail, as where shapes are in the way, after which no other is tried
_FAILED_MOTIONS = 2
_SAME_RESIDUAL = 5e-4  # share within which residuals are of the same motion
# Over all steps so many motions are compared, whose residuals are within so many times the smallest.
_COMPARED_MOTIONS = 3
_CLOSE_RESIDUAL = 1.05


def first_guess(planner: Planner, problem: OcpProblem, *, t0: float, deadline: float) -> Trajectory:
    """Guess a motion for a problem that begins at t0 [s], within a share of the time until the
    deadline [s] by `perf_counter`; the start held where no better one is found, or another plugin
    than stage by stage plans.
    """
    hold = hold_guess(problem)
    is_by_stages = planner.options.plugin == STAGEWISE
    if not is_by_stages or problem.free_time or problem.n_steps < 2 * COARSE_STEPS:
        return hold
    search = _GuessSearch(planner, problem, t0, deadline)
    return search.best() or hold


class _GuessSearch:
    """The search for one guess. Ctrl-C ends it with the best so far."""

    def __init__(self, planner: Planner, problem: OcpProblem, t0: float, deadline: float) -> None:
        begin = perf_counter()
        self._planner = planner
        self._problem = problem
        self._t0 = t0
        self._end = begin + _TIME_SHARE * (deadline - begin)
        self._presses: list[object] = []
        self._watch = _LastLevelWatch(problem.levels[-1].name)
        self._coarse: dict[float, Trajectory] = {}
        """Motions over a few steps, by their residual."""
        self._compared: dict[float, Trajectory] = {}
        """The best of them after one iteration over all steps, by their residual."""

    def best(self) -> Trajectory | None:
        """Search, and return the motion of least residual; `None` where there is none."""
        motions = self._coarse
        with on_interrupt(self._presses.append), suppress(Stopped):
            self._plan_over_few_steps()
            if self._compare_over_all_steps():
                motions = self._compared
        if motions:
            return motions[min(motions)]
        return None

    @property
    def _is_over(self) -> bool:
        return bool(self._presses) or perf_counter() >= self._end

    def _plan_over_few_steps(self) -> None:
        """Plan towards several postures, and keep each motion that is another one."""
        few_steps = coarse_problem(self._problem)
        coarse = self._planner.coarse
        for number, guess in enumerate(coarse_guesses(few_steps)):
            if self._is_over or (number == _FAILED_MOTIONS and not self._coarse):
                return
            refinement = self._refinement(coarse, few_steps)
            result = refinement.solved_once(guess, guess.q).result
            residual = self._watch.residual
            is_known = np.isclose(list(self._coarse), residual, rtol=_SAME_RESIDUAL).any()
            if result.status.optimal and not is_known:
                motion = coarse.transcription.unpack(result.x, few_steps)
                start = self._problem.start
                self._coarse[residual] = shift_guess(self._problem, motion, 0.0, start)
                self._watch.cheapest = min(self._coarse)

    def _compare_over_all_steps(self) -> bool:
        """Make one iteration from each guess of those that cost least; return False where there was
        nothing to compare, or no time for all.
        """
        limit = _CLOSE_RESIDUAL * min(self._coarse, default=0.0)
        residuals = sorted(self._coarse)[:_COMPARED_MOTIONS]
        cheapest = [self._coarse[residual] for residual in residuals if residual <= limit]
        if len(cheapest) < 2:
            return False
        self._watch.most_iterations = 1
        refinement = self._refinement(self._planner, self._problem)
        for guess in cheapest:
            if self._is_over:
                return False
            x = refinement.solved_once(guess, guess.q).result.x
            motion = self._planner.transcription.unpack(x, self._problem)
            self._compared[self._watch.residual] = motion
        return len(self._compared) == len(cheapest)

    def _refinement(self, planner: Planner, problem: OcpProblem) -> Refinement:
        return Refinement(
            planner=planner, problem=problem, t0=self._t0, deadline=self._end, progress=self._watch
        )


class _LastLevelWatch:
    """Looks on at the last level, and stops a solve that is of no use: where levels above it are
    not met at once, or the motion costs much more than the cheapest so far.
    """

    def __init__(self, last_level: str) -> None:
        self._last_level = last_level
        self.residual = np.inf
        """Residual of the last level at the latest iteration."""
        self.cheapest = np.inf
        """Least residual of the motions so far."""
        self.most_iterations = np.inf

    def __call__(self, report: IterationReport) -> None:
        if report.level != self._last_level:
            raise KeyboardInterrupt
        self.residual = report.residual
        is_costly = (
            report.iteration >= _FIRST_ITERATIONS and report.residual > _COSTLY * self.cheapest
        )
        if is_costly or report.iteration >= self.most_iterations:
            raise KeyboardInterrupt

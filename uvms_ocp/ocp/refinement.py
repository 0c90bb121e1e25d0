"""Solve a problem again until its terms are written at the motion that was found, and its ranges
are kept between nodes too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from uvms_ocp.checks import unchecked_method
from uvms_ocp.ocp.motion_check import between_checks
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.range_check import RangeCheck
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.tightening import lack, missing_between, tightened
from uvms_ocp.ocp.trajectory import (
    Trajectory,
    admissible,
)
from uvms_ocp.solvers import LexicographicResult, NlpStatus
from uvms_ocp.solvers.nlp.solve_monitor import Progress

if TYPE_CHECKING:
    from uvms_ocp.ocp.planner import Planner


_MOST_ROUNDS = 14
AGREES = 8e-4  # [m] between rows that decide and distances
# [m] of these, from which on what is missing is missing between nodes, not because rows are
# elsewhere
_NEAR = 5e-3
_GAIN = 1e-3  # share of a residual that is not worth another round
_PATIENCE = 3  # rounds of which one leaves so much less between nodes than the one before them
_HELPS = 0.9
_ZERO = 1e-4  # residual of a level that is met
USABLE = 1e-5  # violation of a point that counts


MotionGuess: TypeAlias = Trajectory | Plan
Guess: TypeAlias = MotionGuess | LexicographicResult


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Refinement:
    """One problem, solved until its terms are written where its motion is and nothing is left
    between nodes that more at the nodes would mend, or the deadline [s] is over.
    """

    planner: Planner
    given: OcpProblem
    t0: float
    """[s] of the first node."""
    deadline: float
    """[s] by the clock on the wall."""
    progress: Progress | None = None
    """Callback after every iteration."""

    def solved(self, guess: MotionGuess) -> RefinedResult:
        """The last that is no worse, or usable; of several that leave ranges between nodes the one
        that leaves them least.
        """
        q = (guess.trajectory if isinstance(guess, Plan) else guess).q
        if len(q) != self.given.n_steps + 1:
            q = np.tile(
                self.given.start.q, (self.given.n_steps + 1, 1)
            )  # a guess that `solve` refuses
        best = self.solved_once(guess, q)
        looked_at: list[tuple[float, RefinedResult]] = []
        gained = np.inf
        for _ in range(_MOST_ROUNDS):
            path = admissible(
                self.planner.transcription.unpack(best.result.x, self.given), self.given.robot
            )
            off = self._mismatch(best, path)
            same = gained <= _GAIN
            if best.result.status.optimal:
                settled = off <= AGREES or same
            else:  # another round from the same point ends as this one did
                settled = off <= AGREES and same
            stopped = NlpStatus.INTERRUPTED in best.result.level_status or self._left <= 0
            missing: list[RangeCheck] = []
            if best.result.violation <= USABLE and (settled or off <= _NEAR):
                checks = between_checks(self.given, path, t0=self.t0)
                missing = missing_between(checks)
                looked_at.append((lack(checks), best))
            if stopped or (not missing and (settled or not self._terms)) or _in_vain(looked_at):
                break
            more = tightened(best.tightened, missing, self.given, path, self.t0)
            candidate = self.solved_once(best.result, path.q, more).after(best.result)
            if candidate.result.violation > max(best.result.violation, USABLE):
                break
            gained = _gain(best.result, candidate.result)
            best = candidate
        return _least_lacking(looked_at, best)

    def solved_once(
        self, guess: Guess, q: np.ndarray, more: Tightening = NO_TIGHTENING
    ) -> RefinedResult:
        """Solve with terms written at configurations q (n_nodes, n_q), and more asked of nodes."""
        p = self.planner.transcription.parameters(self.given, t0=self.t0, near=q, tightened=more)
        solve = unchecked_method(self.planner.solve)
        seconds_left = max(self._left, 0.0)
        result = solve(
            p,
            guess,
            problem=self.given,
            time_limit=seconds_left,
            progress=self.progress,
            tightened=more,
        )
        return RefinedResult(result=result, p=p, near=q, tightened=more)

    def _mismatch(self, best: RefinedResult, path: Trajectory) -> float:
        """[m] By how much rows that follow the motion are off at it."""
        times: list[float] = (self.t0 + self.given.nominal_times()).tolist()
        return max((term.mismatch(times, best.near, path.q) for term in self._terms), default=0.0)

    @property
    def _left(self) -> float:
        return self.deadline - perf_counter()

    @property
    def _terms(self) -> list[ShapeClearance]:
        return [term for term in self.given.terms if isinstance(term, ShapeClearance)]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RefinedResult:
    """A result, and the parameters of its program."""

    result: LexicographicResult
    p: np.ndarray
    """(n_p,) [unit of the parameter]"""
    near: np.ndarray
    """(n_nodes, n_q) [m, rad] where terms were written."""
    tightened: Tightening
    """Margins of nodes for what was missing between them."""

    def after(self, before: LexicographicResult) -> RefinedResult:
        """With the iterations of an earlier result as well."""
        spent = tuple(a + b for a, b in zip(before.iterations, self.result.iterations, strict=True))
        return replace(self, result=replace(self.result, iterations=spent))

    @property
    def interrupted(self) -> RefinedResult:
        """Say of the levels without an optimum that they were stopped by hand."""
        ended = tuple(
            status if status.optimal else NlpStatus.INTERRUPTED
            for status in self.result.level_status
        )
        result = replace(self.result, level_status=ended, status=NlpStatus.INTERRUPTED)
        return replace(self, result=result)

    def after_all(self, last: RefinedResult) -> RefinedResult:
        """With the iterations of the last result."""
        return replace(self, result=replace(self.result, iterations=last.result.iterations))


def _in_vain(looked_at: list[tuple[float, RefinedResult]]) -> bool:
    """Check whether asking nodes for more has not helped several times over."""
    amounts = [amount for amount, _ in looked_at]
    return len(amounts) > _PATIENCE and min(amounts[-_PATIENCE:]) > _HELPS * amounts[-_PATIENCE - 1]


def _least_lacking(
    looked_at: list[tuple[float, RefinedResult]], last: RefinedResult
) -> RefinedResult:
    """The latest result of those that lack least, of all that were looked at: rounds may end at one
    whose rows are still far from its distances.
    """
    if not looked_at:
        return last
    smallest = min(amount for amount, _ in looked_at)
    latest = [result for amount, result in looked_at if amount == smallest][-1]
    return latest.after_all(last)


def _gain(before: LexicographicResult, after: LexicographicResult) -> float:
    """Share of its residual by which the first level that changed has changed."""
    old = before.level_residuals
    new = after.level_residuals
    share = (old - new) / np.maximum(old, _ZERO)
    changed = np.flatnonzero((np.abs(share) > _GAIN) & (np.maximum(old, new) > _ZERO))
    if len(changed):
        return float(abs(share[changed[0]]))
    return 0.0


def held_apart(problem: OcpProblem) -> list[ShapeClearance]:
    """Constraints on shapes, which are to be kept between nodes too."""
    return [term for term in problem.constraints if isinstance(term, ShapeClearance)]

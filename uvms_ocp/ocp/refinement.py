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


_MOST_ROUNDS = 20
AGREES = 8e-4  # [m] between rows that decide and distances
# [m] of these, from which on what is missing is missing between nodes, not because rows are
# elsewhere
_NEAR = 5e-3
_GAIN = 1e-3  # share of a residual that is not worth another round
# share of what rows were off before, above which a round goes less far from where they are written
_FALLS = 0.6
_AT_THE_END = 0.99  # share of the reach from which on a round has gone as far as it may
_MOST_RESTARTS = 12
_MOST_IN_VAIN = 3  # in a row: one may end dearer, and the next cheaper, as planes lie elsewhere
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
    problem: OcpProblem
    """Problem that is solved, whose terms are written anew in each round."""
    t0: float
    """[s] Time of the first node."""
    deadline: float
    """[s] Time by the clock on the wall at which rounds end."""
    progress: Progress | None = None
    """Callback after every iteration."""

    def solved(self, guess: MotionGuess) -> RefinedResult:
        """Solve in rounds; where nodes are asked for more in the end, again from there without that,
        as it was asked for at motions that are left behind, and where rows follow the motion, as it
        creeps along shapes by rounds that gain little each.
        """
        motion = guess.trajectory if isinstance(guess, Plan) else guess
        if len(motion.q) == self.problem.n_steps + 1:
            q = motion.q
        else:  # a guess that `solve` refuses
            q = np.tile(self.problem.start.q, (self.problem.n_steps + 1, 1))
        best = self._in_rounds(guess, q)
        latest = best
        n_in_vain = 0
        for _ in range(_MOST_RESTARTS):
            is_final = best.tightened.nothing and not self._terms
            if is_final or n_in_vain == _MOST_IN_VAIN:
                break
            if self._left <= 0 or latest.result.violation > USABLE:
                break
            path = self._path(latest)
            latest = self._in_rounds(path, path.q).after(latest.result)
            if latest.is_interrupted:
                return best.after_all(latest).stopped_as(latest.result)
            is_cheaper = _gain(best.result, latest.result) > _GAIN
            keeps_more = latest.lack < best.lack
            keeps_as_much = latest.lack == best.lack
            is_usable = latest.result.violation <= USABLE
            if is_usable and (keeps_more or (keeps_as_much and is_cheaper)):
                best = latest
                n_in_vain = 0
            else:
                n_in_vain += 1
        return best.after_all(latest)

    def _in_rounds(self, guess: Guess, q: np.ndarray) -> RefinedResult:
        """Return the last round that is no worse, or usable, written first at configurations q
        (n_nodes, n_q) [m, rad]; of several that leave ranges between nodes the one that leaves them
        least.
        """
        best = self.solved_once(guess, q)
        looked_at: list[RefinedResult] = []
        gained = np.inf
        reach = Reach()
        for _ in range(_MOST_ROUNDS):
            path = self._path(best)
            off = self._mismatch(best, path)
            reach = reach.after(off, moved=float(np.abs(path.q - best.written_at).max()))
            same = abs(gained) <= _GAIN
            if best.result.status.optimal:
                settled = (off <= AGREES and not reach.was_reached) or same
            else:  # another round from the same point ends as this one did
                settled = off <= AGREES and same
            stopped = best.is_interrupted or self._left <= 0
            missing: list[RangeCheck] = []
            if best.result.violation <= USABLE and (settled or off <= _NEAR):
                checks = between_checks(self.problem, path, t0=self.t0)
                missing = missing_between(checks)
                best = replace(best, lack=lack(checks))
                looked_at.append(best)
            if stopped or (not missing and (settled or not self._terms)) or _in_vain(looked_at):
                break
            more = tightened(best.tightened, missing, self.problem, path, self.t0)
            allowed_violation = max(best.result.violation, USABLE)
            candidate, reach = self._next_round(
                best.result, path.q, more, reach, allowed_violation=allowed_violation
            )
            if candidate.result.violation > allowed_violation:
                break
            gained = _gain(best.result, candidate.result)
            best = candidate.after(best.result)
        return _least_lacking(looked_at, best)

    def _next_round(
        self,
        start: LexicographicResult,
        q: np.ndarray,
        more: Tightening,
        reach: Reach,
        *,
        allowed_violation: float,
    ) -> tuple[RefinedResult, Reach]:
        """Solve with terms written at configurations q (n_nodes, n_q), within the reach; without it
        where nothing within it keeps the constraints and nobody has stopped the search. Return the
        result and the reach it was found with.
        """
        bounded = self.solved_once(start, q, more, reach.radius)
        is_kept = bounded.result.violation <= allowed_violation
        is_stopped = bounded.is_interrupted or self._left <= 0
        if is_kept or is_stopped or np.isinf(reach.radius):
            return bounded, reach
        free = self.solved_once(start, q, more)
        return free.after(bounded.result), Reach()

    def solved_once(
        self,
        guess: Guess,
        q: np.ndarray,
        more: Tightening = NO_TIGHTENING,
        reach: float = np.inf,
    ) -> RefinedResult:
        """Solve with terms written at configurations q (n_nodes, n_q), more asked of nodes, and
        joints no farther from q than reach [m, rad].
        """
        p = self.planner.transcription.parameters(
            self.problem, t0=self.t0, written_at=q, tightened=more
        )
        solve = unchecked_method(self.planner.solve)
        seconds_left = max(self._left, 0.0)
        result = solve(
            p,
            guess,
            problem=self.problem,
            time_limit=seconds_left,
            progress=self.progress,
            tightened=more,
            around=(q, reach),
        )
        return RefinedResult(result=result, p=p, written_at=q, tightened=more)

    def _path(self, refined: RefinedResult) -> Trajectory:
        motion = self.planner.transcription.unpack(refined.result.x, self.problem)
        return admissible(motion, self.problem.robot)

    def _mismatch(self, best: RefinedResult, path: Trajectory) -> float:
        """Compute the largest error [m], at the motion, of rows that follow it."""
        times: list[float] = (self.t0 + self.problem.nominal_times()).tolist()
        return max(
            (term.mismatch(times, best.written_at, path.q) for term in self._terms), default=0.0
        )

    @property
    def _left(self) -> float:
        return self.deadline - perf_counter()

    @property
    def _terms(self) -> list[ShapeClearance]:
        return [term for term in self.problem.terms if isinstance(term, ShapeClearance)]


@dataclass(frozen=True, kw_only=True, slots=True)
class Reach:
    """Trust region of a round: by how much joints may move from where its rows are written. Without
    it a motion goes to and fro between two places, each of which is right only by the rows of the
    other.
    """

    radius: float = np.inf
    """[m, rad] largest change of joints in the next round."""
    off: float = np.inf
    """[m] Largest error of rows after the last round."""
    was_reached: bool = False
    """The last round went as far as it might."""

    def after(self, off: float, moved: float) -> Reach:
        """Return the region of the next round, after one that moved the joints by `moved` [m, rad]
        and whose rows are `off` [m]: half of it where rows agree no better than before, twice of it
        where they agree and it was reached.
        """
        was_reached = moved >= _AT_THE_END * self.radius
        if off > max(AGREES, _FALLS * self.off):
            radius = 0.5 * min(self.radius, moved)
        elif was_reached and off <= AGREES:
            radius = 2.0 * self.radius
        else:
            radius = self.radius
        return Reach(radius=radius, off=off, was_reached=was_reached)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RefinedResult:
    """A result, and the parameters of its program."""

    result: LexicographicResult
    p: np.ndarray
    """(n_p,) [unit of the parameter] parameters of the program."""
    written_at: np.ndarray
    """(n_nodes, n_q) [m, rad] configurations at which terms that follow the guess were written."""
    tightened: Tightening
    """Margins of nodes for what was missing between them."""
    lack: float = np.inf
    """Largest excess of a range between nodes, as a multiple of what is allowed; infinite where the
    motion between nodes was not looked at.
    """

    @property
    def is_interrupted(self) -> bool:
        """True where a level was stopped by hand."""
        return NlpStatus.INTERRUPTED in self.result.level_status

    def after(self, before: LexicographicResult) -> RefinedResult:
        """Return this result with the iterations of an earlier one as well."""
        spent = tuple(a + b for a, b in zip(before.iterations, self.result.iterations, strict=True))
        return replace(self, result=replace(self.result, iterations=spent))

    @property
    def interrupted(self) -> RefinedResult:
        """Say of the levels without an optimum that they were stopped by hand."""
        level_status = []
        for status in self.result.level_status:
            level_status.append(status if status.optimal else NlpStatus.INTERRUPTED)
        result = replace(
            self.result, level_status=tuple(level_status), status=NlpStatus.INTERRUPTED
        )
        return replace(self, result=result)

    def stopped_as(self, last: LexicographicResult) -> RefinedResult:
        """Give this result the statuses of a later one that was stopped by hand."""
        result = replace(self.result, level_status=last.level_status, status=last.status)
        return replace(self, result=result)

    def after_all(self, last: RefinedResult) -> RefinedResult:
        """Return this result with the iterations of the last one."""
        return replace(self, result=replace(self.result, iterations=last.result.iterations))


def _in_vain(looked_at: list[RefinedResult]) -> bool:
    """Check whether asking nodes for more has not helped several times over."""
    amounts = [result.lack for result in looked_at]
    return len(amounts) > _PATIENCE and min(amounts[-_PATIENCE:]) > _HELPS * amounts[-_PATIENCE - 1]


def _least_lacking(looked_at: list[RefinedResult], last: RefinedResult) -> RefinedResult:
    """Return the latest result of those that lack least, of all that were looked at: rounds may end
    at one whose rows are still far from its distances.
    """
    if not looked_at:
        return last
    smallest = min(result.lack for result in looked_at)
    latest = [result for result in looked_at if result.lack == smallest][-1]
    return latest.after_all(last)


def _gain(before: LexicographicResult, after: LexicographicResult) -> float:
    """Share of its residual by which the first level that changed has fallen."""
    old = before.level_residuals
    new = after.level_residuals
    share = (old - new) / np.maximum(old, _ZERO)
    changed = np.flatnonzero((np.abs(share) > _GAIN) & (np.maximum(old, new) > _ZERO))
    if len(changed):
        return float(share[changed[0]])
    return 0.0


def held_apart(problem: OcpProblem) -> list[ShapeClearance]:
    """Return the constraints on shapes, which are to be kept between nodes too."""
    return [term for term in problem.constraints if isinstance(term, ShapeClearance)]

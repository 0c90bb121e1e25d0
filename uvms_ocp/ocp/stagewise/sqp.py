"""Sequential quadratic programming over stages: Gauss-Newton steps where they work, a filter line
search where not.

A QP that no step can fulfil gives the step that breaks its rows least, in sum: the way to a point
that keeps them, or, where that does not help either, the proof that no small change does.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np

from uvms_ocp.ocp.stagewise.filter import Filter, FilterMerit
from uvms_ocp.ocp.stagewise.level_qp import StageLevelQp
from uvms_ocp.ocp.stagewise.memory import StageRanges
from uvms_ocp.solvers import NlpOptions, NlpStatus
from uvms_ocp.solvers.nlp.level_solver import Deadline
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport, SolveMonitor
from uvms_ocp.solvers.stage_qp.problem import FlatSolution, StageQpStatus, WarmStart

_SMALLEST_SHARE = 1e-7
# ratios of what a merit lost to what the QP promised, below which damping grows, and above which it
# falls, and by how much
_POOR = 0.25
_GOOD = 0.5
_NOISE = 1e-10  # share of the cost below which a promise is rounding and tells nothing
_MORE = 10.0
_LESS = 4.0
_DAMPED = 1e-6  # times the curvature up to 1: from where damping grows
_NO_DAMPING = 1e-9  # the same: what every model of the cost has; damping below is none
# times the largest curvature of the cost: what makes steps no shorter any more, as they are those
# that the rows ask for
_MOST_DAMPED = 1.0
# share of the tolerance of a residual's norm that is not worth a step, and is no residual at all
_NOTHING = 0.1
# largest entry of the gradient of the cost at a point up to which the error of its optimality
# conditions is not scaled: of a larger one more digits are rounding
_STEEP = 100.0
_GIVE = 1e4
_MODELS = (
    (_NO_DAMPING, True, np.inf),
    (_NO_DAMPING, False, np.inf),
    (1e-6, False, np.inf),
    (1e-6, True, _GIVE),
    (1e-4, False, _GIVE),
    (1e-2, False, _GIVE),
)
"""Damping in units of the largest curvature of the cost up to 1, whether the cost has the curvature
of constraints, and what it costs to miss levels above [1/unit of the row]; the next where one
fails.
"""
_DAMPED_MODELS = 2  # the first of them
_DIGITS = 1e-5  # share of the cost that no step from an optimum may promise to gain
_PATIENCE = 15  # iterations of the last level before it ends with no more digits than that
# ways back to the rows, and what makes them short [1/unit of z^2]
_MENDS = 3
_STIFF = 1e6
# times the first violation, beyond which no point is accepted: it bounds steps and tells no end
_LOUDEST = 1e4
# share of the violation that is left from which on a step is corrected
_REPAIRED = 0.25
_CORRECTED = 0.5  # share of the violation to which a correction of the second order is to bring it
# tolerance of a QP, of how far its point is from the optimum, and at most
_ROUGHLY = 0.1
_ROUGHEST = 1e-2
_NEARER = 0.5  # times the violation at which curvature was not convex, from where it may be
_FEW_DIGITS = 1e-2  # convergence from which on curvature takes more time than it saves
_NO_HELP = 1e-6  # share of the violation that a step must take away to count as a help


class StageSqp:
    """One solve of one level, from the point in the memory."""

    def __init__(
        self,
        level: StageLevelQp,
        ranges: StageRanges,
        options: NlpOptions,
        deadline: Deadline,
        watch: SolveMonitor,
    ) -> None:
        self._level = level
        self._ranges = ranges
        self._options = options
        self._deadline = deadline
        self._watch = watch
        self._memory = level.memory
        self._solution: FlatSolution | None = None
        self._filter = Filter(first=0.0, most=np.inf)
        self._worst = np.inf
        """Largest violation at the point."""
        self._excess = np.zeros(0)
        """(n,) [unit of the row] by how much rows are broken at the point."""
        self._count = 0
        self._best = (True, np.inf), self._memory.z.copy()
        self._model = int(options.convergence >= _FEW_DIGITS)
        self._damping = 0.0
        """[1/unit of z^2] on top of that of the model, at most `_MOST_DAMPED` of the curvature."""
        self._refused = np.inf
        self._was_whole = False
        """The last step was neither damped nor cut."""
        self._has_levels_below = level.level + 1 < level.memory.n_levels
        # What levels above leave open, those below decide: no step goes far there.
        self._least = _DAMPED if self._has_levels_below else 0.0
        self._unit = 1.0
        """[1/unit of z^2] unit of the damping of models."""

    def run(self, warm: FlatSolution | None) -> SqpOutcome:
        """Iterate to the optimum."""
        self._level.linearize()
        merit = self._merit()
        self._filter = Filter(first=merit.violation, most=self._most(merit))
        self._unit = self._damping_unit()
        self._solution = warm
        if warm is not None and self._is_optimal(warm) and self._is_proven(merit):
            return self._end(NlpStatus.SOLVED, 0)
        for iteration in range(self._options.max_iterations):
            if not (isfinite(merit.cost) and isfinite(merit.violation)):
                return self._end(NlpStatus.NOT_A_NUMBER, iteration)
            self._report_iteration(iteration, merit)
            if self._deadline.over or self._watch.should_stop:
                self._memory.z[:] = self._best[1]
                self._memory.evaluate()
                return self._end(
                    NlpStatus.INTERRUPTED if self._watch.should_stop else NlpStatus.TIME_LIMIT,
                    iteration,
                )
            status, merit = self._iterate(merit)
            if status is not None:
                self._report_iteration(iteration + 1, merit)
                return self._end(status, iteration + 1)
        return self._end(NlpStatus.ITERATION_LIMIT, self._options.max_iterations)

    def _report_iteration(self, iteration: int, merit: FilterMerit) -> None:
        is_feasible = self._worst <= self._options.feasibility
        key = (not is_feasible, merit.cost if is_feasible else self._worst)
        if key < self._best[0]:
            self._best = key, self._memory.z.copy()
        level = self._memory.whole.problem.levels[self._level.level].name
        self._watch.report(
            IterationReport(
                level=level, iteration=iteration, residual=merit.residual, violation=self._worst
            )
        )

    def _most(self, merit: FilterMerit) -> float:
        """Below levels that are held where they were left no violation comes in: there may be no
        way back.
        """
        if self._level.level and merit.violation <= self._options.feasibility:
            return self._options.feasibility
        return _LOUDEST * max(1.0, merit.violation)

    def _iterate(self, merit: FilterMerit) -> tuple[NlpStatus | None, FilterMerit]:
        """Status where it ends, and what the new point is worth."""
        self._count += 1
        solution = self._solution = self._solved(self._damping + self._least, self._roughness())
        self._memory.z_from[:] = self._memory.z
        if solution.status is StageQpStatus.INFEASIBLE:
            return self._restore(merit, solution)
        if not solution.status.usable:
            return NlpStatus.STALLED, merit
        # A step that changes no gradient leads to the same multipliers: they are judged here.
        still = solution.products.change <= self._options.convergence
        optimal = still and self._is_optimal(solution)
        if optimal or self._is_flat(merit, self._promise(solution)):
            if self._is_proven(merit):
                optimal = optimal or self._is_optimal(solution)
                return NlpStatus.SOLVED if optimal else NlpStatus.INEXACT, merit
            solution = self._solution
            self._memory.step[:] = solution.z
        promise = self._promise(solution)
        status, next_merit = self._search(merit, solution, promise)
        if status is None and self._is_optimal(solution):
            settled = self._was_whole and promise <= self._worth(next_merit)
            if settled or self._is_proven(next_merit):
                status = NlpStatus.SOLVED
        return status, next_merit

    def _promise(self, solution: FlatSolution) -> float:
        """Return the gain that the QP promises, of the cost and of what broken rows cost by their
        multipliers: the exact penalty, in which rows of any unit count as what they are worth.
        """
        products = solution.products
        missed = float(self._ranges.weights(solution) @ self._excess)
        return missed - products.slope - products.square / 2 - self._level.bend(solution) / 2

    def _is_optimal(self, solution: FlatSolution) -> bool:
        """Check the conditions of optimality of the NLP at the point where it is linearised, with
        these multipliers: no step, no damping and no curvature is in them.
        """
        if self._worst > self._options.convergence:
            return False
        error = self._level.error(self._ranges, solution)
        if error <= self._options.convergence:
            return True
        scale = max(1.0, self._level.steepest() / _STEEP)
        return error <= self._options.convergence * scale

    def _worth(self, merit: FilterMerit) -> float:
        """Return the gain of cost from which on another step is worth it: of a level that others
        follow, what its tolerance would notice.
        """
        tolerance = self._options.tolerance
        if self._has_levels_below:
            return max(_NOTHING * tolerance * merit.residual, tolerance**2 / 2)
        return (
            max(_DIGITS, self._options.convergence) * merit.cost + (_NOTHING * tolerance) ** 2 / 2
        )

    def _is_proven(self, merit: FilterMerit) -> bool:
        """Check that a step without damping, of a QP solved to all digits, promises no gain that is
        worth it; where it does, that of what levels below decide comes down.
        """
        worth = self._worth(merit)
        if merit.cost <= worth:  # no step gains more than all of it
            return True
        proof = self._undamped()
        if not proof.status.usable:
            return False
        if self._promise(proof) <= worth:
            return True
        self._solution = proof
        self._least = self._lowered(self._least / _LESS)
        return False

    def _is_flat(self, merit: FilterMerit, promise: float) -> bool:
        """Check that no step promises a gain that is worth it: of a level that others follow, one
        that its tolerance would notice.

        The last level gets some iterations first: where curvature is left out that matters, more
        would bring no more digits.
        """
        if self._has_levels_below:
            allowed = 0.1 * self._options.feasibility
            return self._worst <= allowed and promise <= self._worth(merit)
        allowed = self._options.feasibility
        patient = self._count > _PATIENCE
        return patient and self._worst <= allowed and promise <= _DIGITS * merit.cost

    def _roughness(self) -> float:
        """Return the tolerance of a QP: as little of rows as the point breaks, and of the gradient
        as the last step has changed.

        Where little is broken but much missed of the gradient, steps along weak curvature would
        break rows again.
        """
        last = self._solution
        if last is None:
            return min(_ROUGHLY * self._worst, _ROUGHEST)
        changed = last.products.change / max(self._level.steepest(), 1e-300)
        return min(_ROUGHLY * min(self._worst, changed), _ROUGHEST)

    def _solved(self, damping: float, rough: float) -> FlatSolution:
        """Solve the first model of the cost that is convex where the constraints leave freedom:
        that of the last, or coarser ones; damping [1/unit of z^2] on top of theirs, rough: how
        exact the QP is at least.

        Where curvature makes none, that of Gauss and Newton takes the place; where that leaves
        directions open, steps are damped.
        """
        last = self._solution
        warm_start = self._near()
        solution = None
        for share_of_unit, curved, give in _MODELS[self._model :]:
            if curved and give == np.inf and self._is_curvature_refused:
                continue
            self._level.set_curvature(last if curved else None)
            total = self._unit * share_of_unit + damping
            solution = self._level.solve(self._ranges, total, give, warm_start, rough=rough)
            if solution.status in (StageQpStatus.SOLVED, StageQpStatus.INFEASIBLE):
                break
            # Curvature may come back to be convex; what is singular once stays so.
            if curved:
                self._refused = self._worst
            self._model = min(self._model + (not curved), len(_MODELS) - 1)
        assert solution is not None
        return solution

    def _undamped(self) -> FlatSolution:
        """Solve the QP without damping to all digits: with curvature where that is convex, and with
        the least damping where what nothing determines makes it singular.
        """
        last = self._solution
        self._unit = self._damping_unit()
        smallest_damping = self._unit * _NO_DAMPING
        if not self._is_curvature_refused and self._model == 0:
            self._level.set_curvature(last)
            bent = self._level.solve(self._ranges, smallest_damping, np.inf, self._near())
            if bent.status is StageQpStatus.SOLVED:
                return bent
        self._level.set_curvature(None)
        proof = self._level.solve(self._ranges, smallest_damping, np.inf, self._near())
        if proof.status.usable:
            return proof
        return self._level.solve(self._ranges, self._unit * _DAMPED, np.inf, self._near())

    def _damping_unit(self) -> float:
        """Return the largest curvature of the cost, at most 1: beside small costs damping is to be
        as small as beside others.
        """
        return min(1.0, self._level.largest_curvature())

    @property
    def _is_curvature_refused(self) -> bool:
        """Curvature is hardly more convex than when it was last found not to be."""
        return self._worst > max(_NEARER * self._refused, self._options.feasibility)

    def _near(self) -> WarmStart | None:
        """Return the start of QPs: the last one, if it has an optimum."""
        last = self._solution
        if last is not None and last.status is StageQpStatus.SOLVED:
            return last.warm_start()
        return None

    def _search(
        self, merit: FilterMerit, solution: FlatSolution, promise: float
    ) -> tuple[NlpStatus | None, FilterMerit]:
        """Take the largest share of the step that the filter accepts; a whole one that breaks rows
        because they bend is corrected before it is cut.
        """
        slope = solution.products.slope
        weights = self._ranges.weights(solution)
        excess = self._excess
        share = 1.0
        while share > _SMALLEST_SHARE:
            trial = self._mended(self._tried(share), share)
            accepted = self._filter.accepts(trial, merit, slope, share)
            # if no row stays broken
            possible_gain = merit.cost - trial.cost + float(weights @ excess)
            corrected = (
                not accepted
                and share == 1.0
                and trial.violation > _REPAIRED * merit.violation
                and possible_gain > _POOR * promise
            )
            if corrected:
                trial = self._corrected(trial, merit)
                accepted = self._filter.accepts(trial, merit, slope, share)
            gained = merit.cost - trial.cost + float(weights @ (excess - self._excess))
            if corrected:
                accepted = accepted and gained > _POOR * promise
            if accepted:
                if not self._filter.descends(merit, slope, share):
                    self._filter.entries.append(merit)
                if share < 1.0:
                    self._level.linearize()
                undamped = self._damping == self._least == 0.0 and self._model < _DAMPED_MODELS
                self._was_whole = undamped and share == 1.0
                self._adapt_damping(merit, share, gained, promise)
                return None, trial
            share /= 2
        self._back()
        return self._refusal(merit), merit

    def _adapt_damping(
        self, merit: FilterMerit, share: float, gained: float, promise: float
    ) -> None:
        """Raise damping after steps that had to be cut, and after those that gain little of what
        the QP promised; lower it after those that keep the promise [Levenberg1944] [Marquardt1963].

        It is bounded: where it outweighs all curvature, steps are those that the rows ask for.
        """
        is_beyond_rounding = promise > _NOISE * merit.cost
        if share < 1.0 or (is_beyond_rounding and gained < _POOR * promise):
            self._raise_damping()
        elif not is_beyond_rounding or gained > _GOOD * promise:
            self._damping = self._lowered(self._damping)

    def _raise_damping(self) -> None:
        largest = _MOST_DAMPED * self._level.largest_curvature()
        self._damping = min(max(_MORE * self._damping, self._unit * _DAMPED), largest)

    def _lowered(self, damping: float) -> float:
        less = damping / _LESS
        if less > self._unit * _NO_DAMPING:
            return less
        return 0.0

    def _refusal(self, merit: FilterMerit) -> NlpStatus | None:
        """Tell why no share of a step was accepted: there is nothing to gain, or, where more
        damping does not help either, none is found.
        """
        is_feasible = self._worst <= self._options.feasibility
        before = self._damping
        if is_feasible and self._is_proven(merit):
            return NlpStatus.INEXACT
        self._damping = before
        self._raise_damping()
        if self._damping > before:
            return None
        return NlpStatus.STALLED

    def _corrected(self, trial: FilterMerit, merit: FilterMerit) -> FilterMerit:
        """Correct a whole step to the second order: back to the rows from where it leads
        [Fletcher1982].
        """
        return self._brought_back(trial, max(_CORRECTED * merit.violation, 1e-12))

    def _mended(self, trial: FilterMerit, share: float) -> FilterMerit:
        """The point after a share of the step, brought back by the shortest ways to rows that it
        breaks by too much.

        Rows that are held bend: without it steps along them are as short as the root of what may be
        broken.
        """
        if trial.violation <= self._filter.most:
            return trial
        if share < 1.0:
            self._level.linearize()
        return self._brought_back(trial, self._filter.most)

    def _brought_back(self, trial: FilterMerit, allowed: float) -> FilterMerit:
        """The point after short steps to the rows, from a linearised one; the step that led there
        stays in the memory.
        """
        begin = self._memory.z_from.copy()
        step = self._memory.step.copy()
        trial = self._restored(trial, allowed)
        self._memory.step[:] = step
        self._memory.z_from[:] = begin
        return trial

    def _restored(self, merit: FilterMerit, allowed: float) -> FilterMerit:
        """Restore feasibility by short steps, until no more than `most` is broken in sum, or they
        do not help.
        """
        warm_start = self._near()
        for _ in range(_MENDS):
            self._memory.z_from[:] = self._memory.z
            if not (
                merit.violation > allowed
                and self._level.solve(self._ranges, _STIFF, np.inf, warm_start).status.usable
            ):
                break
            trial = self._tried(1.0)
            if not trial.violation < merit.violation:
                self._back()
                break
            merit = trial
        return merit

    def _restore(
        self, merit: FilterMerit, solution: FlatSolution
    ) -> tuple[NlpStatus | None, FilterMerit]:
        """Towards the constraints, whatever it costs."""
        gain = merit.violation - float(np.abs(solution.excess(self._level.qp)).sum())
        smallest_gain = _NO_HELP * merit.violation
        share = 1.0
        while gain > smallest_gain and share > _SMALLEST_SHARE:
            trial = self._tried(share)
            if trial.violation <= merit.violation - 0.1 * share * gain:
                if share < 1.0:
                    self._level.linearize()
                if merit.violation - trial.violation > smallest_gain:
                    return None, trial
                return NlpStatus.INFEASIBLE, trial
            share /= 2
        self._back()
        return NlpStatus.INFEASIBLE, merit

    def _tried(self, share: float) -> FilterMerit:
        """Return the merit of the point at a share of the step; a full step, which is mostly taken,
        is linearised at once.
        """
        self._memory.share[0] = share
        self._memory.move()
        if share == 1.0:
            self._level.linearize()
        else:
            self._memory.evaluate()
        return self._merit()

    def _back(self) -> None:
        self._memory.z[:] = self._memory.z_from
        self._level.linearize()
        self._merit()

    def _merit(self) -> FilterMerit:
        excess = self._excess = self._ranges.excess()
        self._worst = float(excess.max(initial=0.0))
        return FilterMerit(cost=self._level.cost, violation=float(excess.sum()))

    def _end(self, status: NlpStatus, iterations: int) -> SqpOutcome:
        merit = self._merit()
        # What levels above lose by steps that were taken while little was broken is given back; a
        # point that was judged stays where it is.
        judged = status is NlpStatus.SOLVED
        if not judged and self._level.level and self._worst <= self._options.feasibility:
            self._restored(merit, self._options.convergence)
            self._merit()
        cost = self._level.cost
        solution = self._solution
        return SqpOutcome(
            status=status,
            iterations=iterations,
            violation=self._worst,
            cost=cost,
            solution=solution,
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpOutcome:
    """End of the iterations; the point is in the memory."""

    status: NlpStatus
    iterations: int
    violation: float
    """Largest."""
    cost: float
    solution: FlatSolution | None
    """Solution of the last QP."""

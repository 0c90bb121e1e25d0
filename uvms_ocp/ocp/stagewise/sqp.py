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
from uvms_ocp.solvers.nlp.level_solver import Deadline, IterationReport, SolveMonitor
from uvms_ocp.solvers.stage_qp.problem import FlatSolution, StageQpStatus, WarmStart

_SMALLEST_SHARE = 1e-7
# by how much damping grows, and by how much it falls
_MORE = 10.0
_LESS = 4.0
_KEPT = 0.25  # share of a violation down to which a step has to bring it for less damping
# [1/unit of z^2] from where it grows, and where steps do not lower the cost
_DAMPED = 1e-6
_IDLE = 1e-5
_NOTHING = 0.1  # share of the tolerance of a residual's norm that is not worth a step
# largest entry of the gradient at the start up to which errors are not scaled, as in IPOPT
_STEEP = 100.0
_GIVE = 1e4
_MODELS = (
    (1e-9, True, np.inf),
    (1e-9, False, np.inf),
    (1e-6, False, np.inf),
    (1e-6, True, _GIVE),
    (1e-4, False, _GIVE),
    (1e-2, False, _GIVE),
)
"""Damping [1/unit of z^2], whether the cost has the curvature of constraints, and what it costs to
miss levels above [1/unit of the row]; the next where one fails.
"""
# iterations of the last level before a gain of this share of its cost is none
_PATIENCE = 15
_DIGITS = 1e-5
# ways back to the rows, and what makes them short [1/unit of z^2]
_MENDS = 3
_STIFF = 1e6
_LOUDEST = 1e4  # times the first violation
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
        self._steepest = 0.0
        self._worst = np.inf
        self._count = 0
        self._best = (True, np.inf), self._memory.z.copy()
        self._model = int(options.convergence >= _FEW_DIGITS)
        self._damping = 0.0
        self._refused = np.inf
        # What levels above leave open, those below decide: no step goes far there.
        self._least = _DAMPED if level.level + 1 < level.memory.n_levels else 0.0

    def run(self, warm: FlatSolution | None) -> SqpOutcome:
        """Iterate to the optimum."""
        self._level.linearize()
        here = self._merit()
        self._steepest = self._level.steepest()
        self._filter = Filter(first=here.violation, most=self._most(here))
        self._solution = warm
        if warm is not None and self._is_optimal(warm):
            return self._end(NlpStatus.SOLVED, 0)
        for iteration in range(self._options.max_iterations):
            if not (isfinite(here.cost) and isfinite(here.violation)):
                return self._end(NlpStatus.NOT_A_NUMBER, iteration)
            self._report_iteration(iteration, here)
            if self._deadline.over or self._watch.should_stop:
                self._memory.z[:] = self._best[1]
                self._memory.evaluate()
                return self._end(
                    NlpStatus.INTERRUPTED if self._watch.should_stop else NlpStatus.TIME_LIMIT,
                    iteration,
                )
            status, here = self._iterate(here)
            if status is not None:
                self._report_iteration(iteration + 1, here)
                return self._end(status, iteration + 1)
        return self._end(NlpStatus.ITERATION_LIMIT, self._options.max_iterations)

    def _report_iteration(self, iteration: int, here: FilterMerit) -> None:
        kept = self._worst <= self._options.feasibility
        key = (not kept, here.cost if kept else self._worst)
        if key < self._best[0]:
            self._best = key, self._memory.z.copy()
        level = self._memory.whole.problem.levels[self._level.level].name
        self._watch.report(
            IterationReport(
                level=level, iteration=iteration, residual=here.residual, violation=self._worst
            )
        )

    @property
    def _scale(self) -> float:
        """Return the scale of errors."""
        return max(1.0, self._steepest / _STEEP)

    def _most(self, here: FilterMerit) -> float:
        """Below levels that are held where they were left no violation comes in: there may be no
        way back.
        """
        if self._level.level and here.violation <= self._options.feasibility:
            return self._options.feasibility
        return _LOUDEST * max(1.0, here.violation)

    def _iterate(self, here: FilterMerit) -> tuple[NlpStatus | None, FilterMerit]:
        """Status where it ends, and what the new point is worth."""
        self._count += 1
        solution = self._solution = self._solved()
        self._memory.z_from[:] = self._memory.z
        if solution.status is StageQpStatus.INFEASIBLE:
            return self._restore(here, solution)
        if not solution.status.usable:
            return NlpStatus.STALLED, here
        slope = solution.products.slope
        if solution.products.change <= self._options.convergence * self._scale and self._is_kept(
            here
        ):
            return NlpStatus.SOLVED, here
        if self._is_flat(here, slope):
            kept = self._is_kept(here)
            self._level.linearize()
            return NlpStatus.SOLVED if kept and self._is_optimal(
                solution
            ) else NlpStatus.INEXACT, self._merit()
        status, here = self._search(here, slope)
        return (NlpStatus.SOLVED if status is None and self._is_optimal(solution) else status), here

    def _is_optimal(self, found: FlatSolution) -> bool:
        """Check whether its multipliers are those of the point: of the step that led there."""
        if self._worst > self._options.convergence:
            return False
        return self._level.error(self._ranges, found) <= self._options.convergence * self._scale

    def _is_flat(self, here: FilterMerit, slope: float) -> bool:
        """No step promises what is worth one: of a level that others follow, what its tolerance
        would notice.

        The last level gets some iterations first: where curvature is left out that matters, more
        would bring no more digits.
        """
        if self._least:
            kept = 0.1 * self._options.feasibility
            worth = _NOTHING * self._options.tolerance * here.residual
        else:
            kept = self._options.feasibility
            worth = _DIGITS * here.cost
        return bool(
            (self._least or self._count > _PATIENCE) and self._worst <= kept and -slope <= worth
        )

    def _solved(self) -> FlatSolution:
        """Solve the first model of the cost that is convex where the constraints leave freedom:
        that of the last, or coarser ones.

        Where curvature makes none, that of Gauss and Newton takes the place; where that leaves
        directions open, steps are damped.
        """
        last = self._solution
        # Tolerance of a QP: as little of rows as the point breaks, and of the gradient as the last
        # step has changed. Where little is broken but much missed of the gradient, steps along weak
        # curvature would break rows again.
        changed = 1.0 if last is None else last.products.change / max(self._steepest, 1e-300)
        near = self._near()
        solution = None
        rough = min(_ROUGHLY * min(self._worst, changed), _ROUGHEST)
        for damping, curved, give in _MODELS[self._model :]:
            # Curvature is hardly more convex than when it was last found not to be.
            if (
                curved
                and give == np.inf
                and self._worst > max(_NEARER * self._refused, self._options.feasibility)
            ):
                continue
            self._level.set_curvature(last if curved else None)
            damping += self._least + self._damping
            solution = self._level.solve(self._ranges, damping, give, near, rough=rough)
            if solution.status in (StageQpStatus.SOLVED, StageQpStatus.INFEASIBLE):
                break
            # Curvature may come back to be convex; what is singular once stays so.
            if curved:
                self._refused = self._worst
            self._model = min(self._model + (not curved), len(_MODELS) - 1)
        assert solution is not None
        return solution

    def _near(self) -> WarmStart | None:
        """Return the start of QPs: the last one, if it has an optimum."""
        last = self._solution
        return (
            last.warm_start() if last is not None and last.status is StageQpStatus.SOLVED else None
        )

    def _search(self, here: FilterMerit, slope: float) -> tuple[NlpStatus | None, FilterMerit]:
        share = 1.0
        before = self._worst
        while share > _SMALLEST_SHARE:
            trial = self._mended(self._tried(share), share)
            if self._filter.accepts(trial, here, slope, share):
                if not self._filter.descends(here, slope, share):
                    self._filter.entries.append(here)
                if share < 1.0:
                    self._level.linearize()
                # Steps that had to be cut short were too long where nothing but damping makes them
                # shorter, and so are those that leave the rows as broken as they were before, and
                # more so idle ones, with which no cost falls.
                idle = -slope <= _DIGITS * here.cost
                kept = self._options.feasibility
                if share < 1.0 or (idle and self._worst > max(before, kept)):
                    self._damping = max(_MORE * self._damping, _IDLE if idle else _DAMPED)
                elif self._worst <= max(_KEPT * before, kept):
                    self._damping /= _LESS
                return None, trial
            share /= 2
        self._back()
        return (
            NlpStatus.INEXACT if self._worst <= self._options.feasibility else NlpStatus.STALLED,
            here,
        )

    def _mended(self, trial: FilterMerit, share: float) -> FilterMerit:
        """The point after a share of the step, brought back by the shortest ways to rows that it
        breaks by too much.

        Rows that are held bend: without it steps along them are as short as the root of what may be
        broken.
        """
        if trial.violation <= self._filter.most:
            return trial
        begin = self._memory.z_from.copy()
        if share < 1.0:
            self._level.linearize()
        trial = self._restored(trial, self._filter.most)
        if self._solution is not None:
            self._memory.step[:] = self._solution.z
        self._memory.z_from[:] = begin
        return trial

    def _restored(self, here: FilterMerit, most: float) -> FilterMerit:
        """Restore feasibility by short steps, until no more than `most` is broken in sum, or they
        do not help.
        """
        near = self._near()
        for _ in range(_MENDS):
            self._memory.z_from[:] = self._memory.z
            if not (
                here.violation > most
                and self._level.solve(self._ranges, _STIFF, np.inf, near).status.usable
            ):
                break
            trial = self._tried(1.0)
            if not trial.violation < here.violation:
                self._back()
                break
            here = trial
        return here

    def _restore(
        self, here: FilterMerit, solution: FlatSolution
    ) -> tuple[NlpStatus | None, FilterMerit]:
        """Towards the constraints, whatever it costs."""
        gain = here.violation - float(np.abs(solution.excess(self._level.qp)).sum())
        least = _NO_HELP * here.violation
        share = 1.0
        while gain > least and share > _SMALLEST_SHARE:
            trial = self._tried(share)
            if trial.violation <= here.violation - 0.1 * share * gain:
                if share < 1.0:
                    self._level.linearize()
                return (
                    None if here.violation - trial.violation > least else NlpStatus.INFEASIBLE,
                    trial,
                )
            share /= 2
        self._back()
        return NlpStatus.INFEASIBLE, here

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

    def _is_kept(self, here: FilterMerit) -> bool:
        """Check whether all rows are kept after the last step; where rounding makes that worse it
        is not taken.
        """
        before = self._worst
        self._memory.share[0] = 1.0
        self._memory.move()
        self._memory.evaluate()
        if not self._merit().violation <= max(here.violation, self._options.convergence):
            self._back()
            self._worst = before
        return self._worst <= self._options.convergence

    def _back(self) -> None:
        self._memory.z[:] = self._memory.z_from
        self._level.linearize()

    def _merit(self) -> FilterMerit:
        excess = self._ranges.excess()
        self._worst = float(excess.max(initial=0.0))
        return FilterMerit(cost=self._level.cost, violation=float(excess.sum()))

    def _end(self, status: NlpStatus, iterations: int) -> SqpOutcome:
        here = self._merit()
        # What levels above lose by rounding, and by steps that were taken while little was broken,
        # is given back.
        if self._level.level and self._worst <= self._options.feasibility:
            self._restored(here, self._options.convergence)
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

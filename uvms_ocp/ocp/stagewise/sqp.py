"""Sequential quadratic programming over stages: Gauss-Newton steps where they work, a filter line
search where not.

A QP that no step can fulfil gives the step that breaks its rows least, in sum: the way to a point
that keeps them, or, where that does not help either, the proof that no small change does.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import numpy as np

from uvms_ocp.ocp.stagewise.filter import Filter, FilterMerit
from uvms_ocp.ocp.stagewise.level_qp import StageLevelQp
from uvms_ocp.ocp.stagewise.ranges import StageRanges
from uvms_ocp.solvers import NlpOptions, NlpStatus
from uvms_ocp.solvers.nlp.level_solver import Deadline
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport, SolveMonitor
from uvms_ocp.solvers.stage_qp.problem import FlatSolution, StageQpStatus, WarmStart

_SMALLEST_STEP = 1e-7  # share of a step below which the line search gives up

# Damping of steps, after Levenberg and Marquardt. The ratios are of actual to predicted gain.
_POOR_GAIN = 0.25  # ratio below which damping grows
_GOOD_GAIN = 0.5  # ratio above which damping falls
_ROUNDING = 1e-10  # share of the cost below which a predicted gain is rounding and tells nothing
_DAMPING_GROWTH = 10.0  # factor by which damping grows
_DAMPING_DECAY = 4.0  # divisor by which damping falls
# Times the unit of damping, which is the largest curvature of the cost up to 1:
_INITIAL_DAMPING = 1e-6  # from where damping grows
_NEGLIGIBLE_DAMPING = 1e-9  # in every model of the cost; less on top of it is none
# Times the largest curvature of the cost: more damping would not make steps shorter, as they are
# those that the rows ask for.
_LARGEST_DAMPING = 1.0

# When to end.
# share of the tolerance of a residual's norm that is not worth a step, and is no residual at all
_NEGLIGIBLE_RESIDUAL = 0.1
# largest entry of the gradient of the cost at a point up to which the error of its optimality
# conditions is not scaled: of a larger one more digits are rounding
_LARGE_GRADIENT = 100.0
_FLAT_GAIN = 1e-5  # share of the cost that no step from an optimum may promise to gain
_FLAT_AFTER = 15  # iterations of the last level before it ends with no more digits than that
# steps that gain nothing, taken for digits of the optimality conditions before a level ends without
_MAX_FLAT_STEPS = 2

# Ways back to the rows.
_MAX_RESTORATION_STEPS = 3
_RESTORATION_DAMPING = 1e6  # [1/unit of z^2] makes them short
# times the first violation, beyond which no point is accepted: it bounds steps and tells no end
_LARGEST_VIOLATION = 1e4
# share of the violation that remains after a whole step, from which on the step is corrected
_UNREPAIRED = 0.25
# share of the violation to which a correction of the second order is to bring it
_CORRECTION_TARGET = 0.5
# share of the violation that a step must take away to count as a help
_NEGLIGIBLE_REDUCTION = 1e-6

# Tolerance of a QP: a share of how far its point is from the optimum, up to a largest one.
_QP_TOLERANCE_SHARE = 0.1
_LARGEST_QP_TOLERANCE = 1e-2

# times the violation at which curvature was not convex, from where it may be convex again
_CONVEXITY_RETRY = 0.5
# convergence from which on curvature takes more time than it saves
_COARSE_CONVERGENCE = 1e-2
_SOFT_PENALTY = 1e4  # [1/unit of the row]


class _CostModel(NamedTuple):
    """A quadratic model of the cost of one level."""

    damping: float
    """Damping of steps, in units of the largest curvature of the cost up to 1."""
    has_curvature: bool
    """The Hessian has the curvature of constraints; if not, it is that of Gauss and Newton."""
    penalty_above: float
    """[1/unit of the row] Price of missing levels above; infinite: they are hard."""


_MODELS = (
    _CostModel(_NEGLIGIBLE_DAMPING, True, np.inf),
    _CostModel(_NEGLIGIBLE_DAMPING, False, np.inf),
    _CostModel(1e-6, False, np.inf),
    _CostModel(1e-6, True, _SOFT_PENALTY),
    _CostModel(1e-4, False, _SOFT_PENALTY),
    _CostModel(1e-2, False, _SOFT_PENALTY),
)
"""Models of the cost, from the finest to the coarsest: the next where one fails."""
_UNDAMPED_MODELS = 2
"""Number of models, the first ones, whose damping is negligible."""


class StageSqp:
    """Sequential quadratic programming for one level, from the point in the memory."""

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
        """Solution of the last QP."""
        self._filter = Filter(first_violation=0.0, largest_violation=np.inf)
        self._worst = np.inf
        """Largest violation at the point."""
        self._excess = np.zeros(0)
        """(n,) [unit of the row] by how much rows are broken at the point."""
        self._count = 0
        """Iterations so far."""
        self._best_rank = (True, np.inf)
        """Rank of the best point so far: whether it is infeasible, then its violation or cost."""
        self._best_z = self._memory.z.copy()
        """Best point so far."""
        self._model = int(options.convergence >= _COARSE_CONVERGENCE)
        """Index of the finest of `_MODELS` that is tried."""
        self._damping = 0.0
        """[1/unit of z^2] on top of that of the model, at most `_LARGEST_DAMPING` of the
        curvature.
        """
        self._violation_not_convex = np.inf
        """Largest violation at the point where curvature was last found not to be convex."""
        self._was_whole = False
        """The last step was neither damped nor cut."""
        self._flat_steps = 0
        """Steps taken so far that promised no gain worth one."""
        self._has_levels_below = level.level + 1 < level.memory.n_levels
        # What levels above leave open, those below decide: no step goes far there.
        self._base_damping = _INITIAL_DAMPING if self._has_levels_below else 0.0
        """[1/unit of z^2] damping of what levels below decide."""
        self._unit = 1.0
        """[1/unit of z^2] unit of the damping of models."""

    def run(self, warm: FlatSolution | None) -> SqpOutcome:
        """Iterate to the optimum, from the QP that ended at the point if there is one."""
        self._level.linearize()
        merit = self._evaluate_merit()
        self._filter = Filter(
            first_violation=merit.violation, largest_violation=self._largest_violation(merit)
        )
        self._unit = self._damping_unit()
        self._solution = warm
        if warm is not None and self._is_optimal(warm) and self._is_proven(merit):
            return self._finish(NlpStatus.SOLVED, 0)
        for iteration in range(self._options.max_iterations):
            if not (isfinite(merit.cost) and isfinite(merit.violation)):
                return self._finish(NlpStatus.NOT_A_NUMBER, iteration)
            self._report_iteration(iteration, merit)
            if self._deadline.over or self._watch.should_stop:
                return self._finish_at_best(iteration)
            status, merit = self._iterate(merit)
            if status is not None:
                self._report_iteration(iteration + 1, merit)
                return self._finish(status, iteration + 1)
        return self._finish(NlpStatus.ITERATION_LIMIT, self._options.max_iterations)

    def _finish_at_best(self, iterations: int) -> SqpOutcome:
        """End before convergence, at the best point so far."""
        self._memory.z[:] = self._best_z
        self._memory.evaluate()
        if self._watch.should_stop:
            status = NlpStatus.INTERRUPTED
        else:
            status = NlpStatus.TIME_LIMIT
        return self._finish(status, iterations)

    def _report_iteration(self, iteration: int, merit: FilterMerit) -> None:
        """Keep the point if it is the best so far, and report it."""
        is_feasible = self._worst <= self._options.feasibility
        rank = (not is_feasible, merit.cost if is_feasible else self._worst)
        if rank < self._best_rank:
            self._best_rank = rank
            self._best_z = self._memory.z.copy()
        level = self._memory.whole.problem.levels[self._level.level].name
        report = IterationReport(
            level=level, iteration=iteration, residual=merit.residual, violation=self._worst
        )
        self._watch.report(report)

    def _largest_violation(self, merit: FilterMerit) -> float:
        """Return the violation beyond which no point is accepted.

        Below levels that are held where they were left no violation comes in: there may be no way
        back.
        """
        if self._level.level and merit.violation <= self._options.feasibility:
            return self._options.feasibility
        return _LARGEST_VIOLATION * max(1.0, merit.violation)

    def _iterate(self, merit: FilterMerit) -> tuple[NlpStatus | None, FilterMerit]:
        """Take one step; return the status where it ends, and the merit of the new point."""
        self._count += 1
        damping = self._damping + self._base_damping
        solution = self._solve_convex_model(damping, self._qp_tolerance())
        self._solution = solution
        self._memory.z_from[:] = self._memory.z
        if solution.status is StageQpStatus.INFEASIBLE:
            return self._restore_feasibility(merit, solution)
        if not solution.status.usable:
            return NlpStatus.STALLED, merit
        # A step that changes no gradient leads to the same multipliers: they are judged here.
        is_stationary = solution.products.change <= self._options.convergence
        is_optimal = is_stationary and self._is_optimal(solution)
        predicted_gain = self._predicted_gain(solution)
        if is_optimal or self._is_flat(merit, predicted_gain):
            if not self._is_proven(merit):
                solution = self._solution  # the undamped one, which does promise a gain
                predicted_gain = self._predicted_gain(solution)
            elif is_optimal or self._is_optimal(solution):
                return NlpStatus.SOLVED, merit
            elif self._flat_steps == _MAX_FLAT_STEPS:
                return NlpStatus.INEXACT, merit
            else:
                self._flat_steps += 1
            self._memory.step[:] = solution.z
        status, next_merit = self._search_line(merit, solution, predicted_gain)
        if status is None and self._is_optimal(solution):
            has_settled = self._was_whole and predicted_gain <= self._worthwhile_gain(next_merit)
            if has_settled or self._is_proven(next_merit):
                status = NlpStatus.SOLVED
        return status, next_merit

    def _predicted_gain(self, solution: FlatSolution) -> float:
        """Return the gain that the QP promises, of the cost and of what broken rows cost by their
        multipliers: the exact penalty, in which rows of any unit count as what they are worth.
        """
        products = solution.products
        penalty = float(self._ranges.weights(solution) @ self._excess)
        constraint_curvature = self._level.constraint_curvature(solution)
        return penalty - products.slope - products.square / 2 - constraint_curvature / 2

    def _is_optimal(self, solution: FlatSolution) -> bool:
        """Check the conditions of optimality of the NLP at the point where it is linearised, with
        these multipliers: no step, no damping and no curvature is in them.
        """
        if self._worst > self._options.convergence:
            return False
        error = self._level.error(self._ranges, solution)
        if error <= self._options.convergence:
            return True
        scale = max(1.0, self._level.largest_gradient() / _LARGE_GRADIENT)
        return error <= self._options.convergence * scale

    def _worthwhile_gain(self, merit: FilterMerit) -> float:
        """Return the gain of cost from which on another step is worth it: of a level that others
        follow, what its tolerance would notice.
        """
        tolerance = self._options.tolerance
        if self._has_levels_below:
            return max(_NEGLIGIBLE_RESIDUAL * tolerance * merit.residual, tolerance**2 / 2)
        relative_gain = max(_FLAT_GAIN, self._options.convergence)
        negligible_cost = (_NEGLIGIBLE_RESIDUAL * tolerance) ** 2 / 2
        return relative_gain * merit.cost + negligible_cost

    def _is_proven(self, merit: FilterMerit) -> bool:
        """Check that a step without damping, of a QP solved to all digits, promises no gain that is
        worth it; where it does, the damping of what levels below decide comes down.
        """
        worthwhile_gain = self._worthwhile_gain(merit)
        if merit.cost <= worthwhile_gain:  # no step gains more than all of it
            return True
        proof = self._solve_undamped()
        if not proof.status.usable:
            return False
        if self._predicted_gain(proof) <= worthwhile_gain:
            return True
        self._solution = proof
        self._base_damping = self._lower_damping(self._base_damping / _DAMPING_DECAY)
        return False

    def _is_flat(self, merit: FilterMerit, predicted_gain: float) -> bool:
        """Check that no step promises a gain that is worth it: of a level that others follow, one
        that its tolerance would notice.

        The last level gets some iterations first: where curvature is left out that matters, more
        would bring no more digits.
        """
        if self._has_levels_below:
            is_feasible = self._worst <= 0.1 * self._options.feasibility
            return is_feasible and predicted_gain <= self._worthwhile_gain(merit)
        is_feasible = self._worst <= self._options.feasibility
        is_late = self._count > _FLAT_AFTER
        return is_late and is_feasible and predicted_gain <= _FLAT_GAIN * merit.cost

    def _qp_tolerance(self) -> float:
        """Return the tolerance of a QP: as little of rows as the point breaks, and of the gradient
        as the last step has changed.

        Where little is broken but much missed of the gradient, steps along weak curvature would
        break rows again.
        """
        last = self._solution
        if last is None:
            return min(_QP_TOLERANCE_SHARE * self._worst, _LARGEST_QP_TOLERANCE)
        relative_change = last.products.change / max(self._level.largest_gradient(), 1e-300)
        error = min(self._worst, relative_change)
        return min(_QP_TOLERANCE_SHARE * error, _LARGEST_QP_TOLERANCE)

    def _solve_convex_model(self, damping: float, tolerance: float) -> FlatSolution:
        """Solve the first model of the cost that is convex where the constraints leave freedom:
        that of the last iteration, or coarser ones.

        Where curvature makes none, that of Gauss and Newton takes the place; where that leaves
        directions open, steps are damped. `damping` [1/unit of z^2] is on top of that of the
        models; `tolerance` is of the QP, where it is larger than that of its solver.
        """
        last = self._solution
        warm_start = self._warm_start()
        solution = None
        for model in _MODELS[self._model :]:
            is_exact = model.has_curvature and model.penalty_above == np.inf
            if is_exact and self._is_curvature_refused:
                continue
            self._level.set_curvature(last if model.has_curvature else None)
            solution = self._level.solve(
                self._ranges,
                self._unit * model.damping + damping,
                model.penalty_above,
                warm_start,
                tolerance=tolerance,
            )
            if solution.status in (StageQpStatus.SOLVED, StageQpStatus.INFEASIBLE):
                break
            # Curvature may come back to be convex; what is singular once stays so.
            if model.has_curvature:
                self._violation_not_convex = self._worst
            else:
                self._model = min(self._model + 1, len(_MODELS) - 1)
        assert solution is not None
        return solution

    def _solve_undamped(self) -> FlatSolution:
        """Solve the QP without damping to all digits: with curvature where that is convex, and with
        the smallest damping where what nothing determines makes it singular.
        """
        last = self._solution
        self._unit = self._damping_unit()
        negligible = self._unit * _NEGLIGIBLE_DAMPING
        if not self._is_curvature_refused and self._model == 0:
            self._level.set_curvature(last)
            exact = self._level.solve(self._ranges, negligible, np.inf, self._warm_start())
            if exact.status is StageQpStatus.SOLVED:
                return exact
        self._level.set_curvature(None)
        gauss_newton = self._level.solve(self._ranges, negligible, np.inf, self._warm_start())
        if gauss_newton.status.usable:
            return gauss_newton
        damping = self._unit * _INITIAL_DAMPING
        return self._level.solve(self._ranges, damping, np.inf, self._warm_start())

    def _damping_unit(self) -> float:
        """Return the largest curvature of the cost, at most 1: beside small costs damping is to be
        as small as beside others.
        """
        return min(1.0, self._level.largest_curvature())

    @property
    def _is_curvature_refused(self) -> bool:
        """Curvature is hardly more convex than when it was last found not to be."""
        retry_violation = _CONVEXITY_RETRY * self._violation_not_convex
        return self._worst > max(retry_violation, self._options.feasibility)

    def _warm_start(self) -> WarmStart | None:
        """Return the start of QPs: the last one, if it has an optimum."""
        last = self._solution
        if last is not None and last.status is StageQpStatus.SOLVED:
            return last.warm_start()
        return None

    def _search_line(
        self, merit: FilterMerit, solution: FlatSolution, predicted_gain: float
    ) -> tuple[NlpStatus | None, FilterMerit]:
        """Take the largest share of the step that the filter accepts; a whole one that breaks rows
        because they bend is corrected before it is cut.
        """
        slope = solution.products.slope
        weights = self._ranges.weights(solution)
        excess = self._excess
        step_length = 1.0
        while step_length > _SMALLEST_STEP:
            trial = self._try_step(step_length)
            trial = self._limit_violation(trial, step_length)
            is_accepted = self._filter.accepts(trial, merit, slope, step_length)
            gain_if_repaired = merit.cost - trial.cost + float(weights @ excess)
            is_corrected = (
                not is_accepted
                and step_length == 1.0
                and trial.violation > _UNREPAIRED * merit.violation
                and gain_if_repaired > _POOR_GAIN * predicted_gain
            )
            if is_corrected:
                trial = self._correct_second_order(trial, merit)
                is_accepted = self._filter.accepts(trial, merit, slope, step_length)
            gain = merit.cost - trial.cost + float(weights @ (excess - self._excess))
            if is_corrected:
                is_accepted = is_accepted and gain > _POOR_GAIN * predicted_gain
            if is_accepted:
                if not self._filter.descends(merit, slope, step_length):
                    self._filter.entries.append(merit)
                self._accept_step(step_length)
                self._adapt_damping(merit, step_length, gain, predicted_gain)
                return None, trial
            step_length /= 2
        self._undo_step()
        return self._explain_refusal(merit), merit

    def _accept_step(self, step_length: float) -> None:
        """Linearise at the new point, and note whether the step was whole."""
        if step_length < 1.0:
            self._level.linearize()
        has_no_damping = self._damping == self._base_damping == 0.0
        is_undamped = has_no_damping and self._model < _UNDAMPED_MODELS
        self._was_whole = is_undamped and step_length == 1.0

    def _adapt_damping(
        self, merit: FilterMerit, step_length: float, gain: float, predicted_gain: float
    ) -> None:
        """Raise damping after steps that had to be cut, and after those that gain little of what
        the QP promised; lower it after those that keep the promise [Levenberg1944] [Marquardt1963].

        It is bounded: where it outweighs all curvature, steps are those that the rows ask for.
        """
        is_beyond_rounding = predicted_gain > _ROUNDING * merit.cost
        is_poor = is_beyond_rounding and gain < _POOR_GAIN * predicted_gain
        is_good = not is_beyond_rounding or gain > _GOOD_GAIN * predicted_gain
        if step_length < 1.0 or is_poor:
            self._raise_damping()
        elif is_good:
            self._damping = self._lower_damping(self._damping)

    def _raise_damping(self) -> None:
        """Raise damping, at most to where it outweighs the curvature of the cost."""
        upper = _LARGEST_DAMPING * self._level.largest_curvature()
        raised = max(_DAMPING_GROWTH * self._damping, self._unit * _INITIAL_DAMPING)
        self._damping = min(raised, upper)

    def _lower_damping(self, damping: float) -> float:
        """Return less damping; none where it is negligible."""
        lowered = damping / _DAMPING_DECAY
        if lowered > self._unit * _NEGLIGIBLE_DAMPING:
            return lowered
        return 0.0

    def _explain_refusal(self, merit: FilterMerit) -> NlpStatus | None:
        """Tell why no share of a step was accepted: there is nothing to gain, or, where more
        damping does not help either, none is found.
        """
        is_feasible = self._worst <= self._options.feasibility
        damping_before = self._damping
        if is_feasible and self._is_proven(merit):
            return NlpStatus.INEXACT
        self._damping = damping_before
        self._raise_damping()
        if self._damping > damping_before:
            return None
        return NlpStatus.STALLED

    def _correct_second_order(self, trial: FilterMerit, merit: FilterMerit) -> FilterMerit:
        """Correct a whole step to the second order: back to the rows from where it leads
        [Fletcher1982].
        """
        allowed_violation = max(_CORRECTION_TARGET * merit.violation, 1e-12)
        return self._reduce_violation_of_trial(trial, allowed_violation)

    def _limit_violation(self, trial: FilterMerit, step_length: float) -> FilterMerit:
        """Return the merit of the point after a share of the step, brought back by the shortest
        ways to rows that it breaks by too much.

        Rows that are held bend: without it steps along them are as short as the root of what may be
        broken.
        """
        if trial.violation <= self._filter.largest_violation:
            return trial
        if step_length < 1.0:
            self._level.linearize()
        return self._reduce_violation_of_trial(trial, self._filter.largest_violation)

    def _reduce_violation_of_trial(
        self, trial: FilterMerit, allowed_violation: float
    ) -> FilterMerit:
        """Return the merit after short steps to the rows, from a linearised point; the step that
        led there stays in the memory.
        """
        z_from = self._memory.z_from.copy()
        step = self._memory.step.copy()
        trial = self._reduce_violation(trial, allowed_violation)
        self._memory.step[:] = step
        self._memory.z_from[:] = z_from
        return trial

    def _reduce_violation(self, merit: FilterMerit, allowed_violation: float) -> FilterMerit:
        """Take short steps to the rows until no more than `allowed_violation` is broken in sum, or
        they do not help; return the merit of the point.
        """
        warm_start = self._warm_start()
        for _ in range(_MAX_RESTORATION_STEPS):
            self._memory.z_from[:] = self._memory.z
            if not merit.violation > allowed_violation:
                break
            solution = self._level.solve(self._ranges, _RESTORATION_DAMPING, np.inf, warm_start)
            if not solution.status.usable:
                break
            trial = self._try_step(1.0)
            if not trial.violation < merit.violation:
                self._undo_step()
                break
            merit = trial
        return merit

    def _restore_feasibility(
        self, merit: FilterMerit, solution: FlatSolution
    ) -> tuple[NlpStatus | None, FilterMerit]:
        """Take the longest step that reduces the violation of the constraints, at any cost."""
        predicted_violation = float(np.abs(solution.excess(self._level.qp)).sum())
        predicted_reduction = merit.violation - predicted_violation
        negligible_reduction = _NEGLIGIBLE_REDUCTION * merit.violation
        step_length = 1.0
        while predicted_reduction > negligible_reduction and step_length > _SMALLEST_STEP:
            trial = self._try_step(step_length)
            if trial.violation <= merit.violation - 0.1 * step_length * predicted_reduction:
                if step_length < 1.0:
                    self._level.linearize()
                if merit.violation - trial.violation > negligible_reduction:
                    return None, trial
                return NlpStatus.INFEASIBLE, trial
            step_length /= 2
        self._undo_step()
        return NlpStatus.INFEASIBLE, merit

    def _try_step(self, step_length: float) -> FilterMerit:
        """Return the merit of the point at a share of the step; a full step, which is mostly taken,
        is linearised at once.
        """
        self._memory.step_length[0] = step_length
        self._memory.move()
        if step_length == 1.0:
            self._level.linearize()
        else:
            self._memory.evaluate()
        return self._evaluate_merit()

    def _undo_step(self) -> None:
        """Go back to the point from which steps were tried, and linearise there."""
        self._memory.z[:] = self._memory.z_from
        self._level.linearize()
        self._evaluate_merit()

    def _evaluate_merit(self) -> FilterMerit:
        """Return the merit of the point in the memory, and keep how far it breaks the rows."""
        excess = self._ranges.excess()
        self._excess = excess
        self._worst = float(excess.max(initial=0.0))
        return FilterMerit(cost=self._level.cost, violation=float(excess.sum()))

    def _finish(self, status: NlpStatus, iterations: int) -> SqpOutcome:
        """Return the outcome at the point in the memory."""
        merit = self._evaluate_merit()
        # What levels above lose by steps that were taken while little was broken is given back; a
        # point that was judged stays where it is.
        is_judged = status is NlpStatus.SOLVED
        if not is_judged and self._level.level and self._worst <= self._options.feasibility:
            self._reduce_violation(merit, self._options.convergence)
            self._evaluate_merit()
        return SqpOutcome(
            status=status,
            iterations=iterations,
            violation=self._worst,
            cost=self._level.cost,
            solution=self._solution,
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpOutcome:
    """End of the iterations; the point is in the memory."""

    status: NlpStatus
    """Reliability of the point."""
    iterations: int
    """Steps tried, one for each QP."""
    violation: float
    """[unit of the row] largest violation of a row, bound or gap."""
    cost: float
    """Half square of the residual of the level."""
    solution: FlatSolution | None
    """Solution of the last QP; None before the first."""

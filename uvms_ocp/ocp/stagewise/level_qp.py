"""The QP of one level, linearised at the point in the memory of all stages."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from uvms_ocp.codegen.bound_calls import BoundCalls
from uvms_ocp.ocp.problem import HessianKind
from uvms_ocp.ocp.stagewise.memory import StageMemory
from uvms_ocp.ocp.stagewise.ranges import StageRanges
from uvms_ocp.solvers import StageQpSolver
from uvms_ocp.solvers.stage_qp.options import StageQpOptions
from uvms_ocp.solvers.stage_qp.problem import (
    FlatSolution,
    StageQp,
    StageShape,
    WarmStart,
    leading,
    parts,
)
from uvms_ocp.types import Array, Mask


class StageLevelQp:
    """QP of one level, linearised at `StageMemory.z`: its variables are the step from there."""

    def __init__(self, memory: StageMemory, level: int, options: StageQpOptions) -> None:
        """Bind the QP of a level to the memory. level: its index; options: of the solver of QPs."""
        self.memory = memory
        self.level = level
        # Constraints come first in a stage, then the rows of each level: those above this one are
        # rows of its QP.
        self.shape = StageShape(
            n_x=(memory.tangent.n_x,) * len(memory.stages),
            n_u=memory.n_u,
            n_r=tuple(len(residuals) for residuals in memory.residual_parts(level)),
            n_c=tuple(sum(sizes[: level + 1]) for sizes in memory.group_sizes),
        )
        self.qp = StageQp(self.shape)
        self._solver = StageQpSolver(self.shape, options)
        self.held = leading(map(sum, memory.group_sizes), self.shape.n_c)
        """(m,) Indices of the rows of the QP among all that may be held."""
        self._has_curvature = False
        """The Hessian has the curvature of constraints."""
        self.max_iterations: int | None = None
        """Iterations after which a QP is given up, unexplained; None: those of the options."""
        self.multipliers = Multipliers(memory, level)
        self._is_above = self._find_rows_above()
        """(m,) True for rows of the QP that belong to levels above."""
        self.linearize = self._linearization(slopes=True)
        """Linearise at the point in the memory."""
        needs_slopes = any(function.errors_forced[level] for function in memory.functions)
        self.relinearize = self._linearization(slopes=needs_slopes)
        """Linearise with slopes of forces from nearby, where they matter to limits alone."""
        self.qp.fix_initial_state(np.zeros(self.shape.n_x[0]))

    def _find_rows_above(self) -> Mask:
        """Return which rows (m,) of the QP belong to levels above: all but constraints."""
        masks = [np.zeros(0, dtype=bool)]
        for sizes in self.memory.group_sizes:
            for group, n_rows in enumerate(sizes[: self.level + 1]):
                masks.append(np.full(n_rows, group > 0))
        return np.concatenate(masks)

    def _linearization(self, *, slopes: bool) -> BoundCalls:
        """Return the calls that linearise: one function for all stages, then the next, so that each
        stays where code is read from.

        Without `slopes` of forces those that were found last remain.
        """
        memory = self.memory
        calls = BoundCalls()
        for i, stage in enumerate(memory.stages):
            if stage.step:
                calls.add(
                    memory.motion_linear,
                    [memory.z[i], memory.z[i + 1]],
                    [memory.gaps[i], self.qp.dynamics[i]],
                )
            elif i + 1 < len(memory.stages):
                self._write_turn(self.qp.dynamics[i])
        memory.add_forces(calls, linear=slopes)
        for i, stage in enumerate(memory.stages):
            function = memory.function(stage)
            if function is not None:
                *values, _ = memory.row_memory(i)  # the rows of the last level are never held
                calls.add(function.linear, memory.arguments(i), [*values, *self._jacobians(i)])
        return calls

    def _write_turn(self, dynamics: Array) -> None:
        """Write the dynamics (n_x, n_x + n_u) of a turn from phase to phase: the state stays, but
        for the length of the steps that follow, which is the control.
        """
        n = self.memory.tangent.n_x
        dynamics[...] = np.eye(*dynamics.shape)
        if self.memory.tangent.free:
            dynamics[n - 1, n - 1 :] = (0.0, 1.0)

    def _jacobians(self, i: int) -> list[Array | None]:
        """Return the arrays that the functions of rows at stage i write: of residuals, then of rows
        that may be held; None where the QP has none.
        """
        n_levels = self.memory.n_levels
        jacobians: list[Array | None] = [None] * n_levels
        jacobians[self.level] = self.qp.J[i]
        first = 0
        for group in self.memory.groups(self.memory.stages[i])[: self.level + 1]:
            jacobians.append(self.qp.C[i][first : first + group.n])
            first += group.n
        levels_below = n_levels - 1 - self.level
        return jacobians + [None] * levels_below

    @cached_property
    def _write_curvature(self) -> BoundCalls:
        """Calls that write the curvature of constraints, function by function as well, at the point
        where forces were linearised.
        """
        memory = self.memory
        multipliers = self.multipliers
        tangent = memory.tangent
        calls = BoundCalls()
        functions = []
        for i, stage in enumerate(memory.stages):
            function = memory.function(stage)
            if function is not None:
                functions.append((i, function))
        n = len(memory.stages)
        weights = np.zeros((n, tangent.n_v))
        bent = np.zeros((n, tangent.step_curvature.numel_in(3)))
        step_curvatures = np.zeros((n, tangent.step_curvature.nnz_out(0)))
        weighted_stages = []
        for i, function in functions:
            if function.weights is not None:
                weighted_stages.append(i)
                inputs = [*memory.arguments(i), multipliers.rows[i], multipliers.residuals[i]]
                calls.add(function.weights, inputs, [weights[i]])
        for i in weighted_stages:
            motion = memory.z[i, : tangent.model.n_motion]
            water = memory.arguments(i)[2]
            calls.add(tangent.model.force_curvature, [motion, water, weights[i]], [bent[i]])
        no_costates = np.zeros(tangent.n_x)
        for i, function in functions:
            if not function.bends:
                continue
            z_next = memory.z[min(i + 1, n - 1)]
            costates = multipliers.costates[i] if memory.stages[i].step else no_costates
            inputs = [memory.z[i], z_next, costates, bent[i]]
            calls.add(tangent.step_curvature, inputs, [step_curvatures[i]])
        for i, function in functions:
            inputs = [
                *memory.arguments(i),
                multipliers.rows[i],
                multipliers.residuals[i],
                step_curvatures[i],
            ]
            calls.add(function.curvature, inputs, [self.qp.H[i]])
        return calls

    def set_curvature(self, last: FlatSolution | None) -> None:
        """Set the curvature of constraints with the multipliers of the last QP; none without one,
        and for Gauss and Newton.
        """
        is_exact = self.memory.whole.problem.hessian is HessianKind.EXACT
        has_curvature = last is not None and is_exact
        if last is not None and is_exact:
            self.multipliers.update(last)
            self._write_curvature()
        elif self._has_curvature:
            self.qp.flat["H"][:] = 0.0
        self._has_curvature = has_curvature

    @property
    def cost(self) -> float:
        """Half square of the residual at the point."""
        r = self.memory.residuals(self.level)
        return float(r @ r) / 2

    def solve(
        self,
        ranges: StageRanges,
        damping: float,
        l1_above: float,
        warm_start: WarmStart | None,
        *,
        tolerance: float = 0.0,
        l2_above: float = 0.0,
    ) -> FlatSolution:
        """Solve for the step, with damping [1/unit of z^2]; it stands in the memory too.

        l1_above [1/unit of the row], l2_above [1/unit of the row^2]: what it costs to miss levels
        above, and the square. tolerance: of the QP, where it is larger than that of the options.
        Only what has no curvature of constraints is explained where it fails.
        """
        flat = self.qp.flat
        flat["damping"][:] = damping
        flat["l1"][self._is_above] = l1_above
        flat["l2"][self._is_above] = l2_above
        self._load(ranges)
        is_explained = not (self._has_curvature or self.max_iterations)
        solution = self._solver.solve_flat(
            self.qp,
            warm_start,
            tolerance=max(tolerance, self._solver.options.tolerance),
            max_iterations=self.max_iterations,
            explained=is_explained,
        )
        self.memory.step[:] = solution.z
        return solution

    def multipliers_above(self, solution: FlatSolution) -> Array:
        """Return the multipliers of the rows of levels above."""
        of_rows = solution.y[: len(self._is_above)]
        return np.asarray(of_rows[self._is_above])

    def _load(self, ranges: StageRanges) -> None:
        """Load values and ranges into the QP."""
        self.qp.flat["r"][:] = self.memory.residuals(self.level)
        ranges.write(self.qp.flat)

    def error(self, ranges: StageRanges, solution: FlatSolution) -> float:
        """Return the error of the optimality conditions at the present linearisation, with the
        multipliers of a QP.
        """
        self._load(ranges)
        return self._solver.error(self.qp, solution.warm_start())

    def largest_gradient(self) -> float:
        """Return the largest entry of the gradient of the cost."""
        self.qp.flat["r"][:] = self.memory.residuals(self.level)
        return self._solver.steepest(self.qp)

    def constraint_curvature(self, solution: FlatSolution) -> float:
        """Return the curvature that the multipliers of the last QP add along the whole step: twice
        what it costs.
        """
        if not self._has_curvature:
            return 0.0
        steps = parts(solution.z, self.shape.n_z)
        return float(sum(z @ H @ z for z, H in zip(steps, self.qp.H, strict=True)))

    def largest_curvature(self) -> float:
        """Return the largest diagonal entry [1/unit of z^2] of the Hessian of Gauss and Newton."""
        return max(float((J * J).sum(axis=0).max(initial=0.0)) for J in self.qp.J)


class Multipliers:
    """Multipliers of one level, which bend its next QP, where the functions of curvature read
    them.
    """

    def __init__(self, memory: StageMemory, level: int) -> None:
        n = len(memory.stages)
        self.costates = np.zeros((n, memory.tangent.n_x))
        """(n, n_x) [1/unit of x] costates of the step that leads away from each stage."""
        n_rows = [sum(sizes[:-1]) for sizes in memory.group_sizes]
        n_qp_rows = [sum(sizes[: level + 1]) for sizes in memory.group_sizes]
        self._rows = np.zeros(sum(n_rows))
        self.rows = np.split(self._rows, np.cumsum(n_rows)[:-1])
        """Multipliers of rows that may be held, a view for each stage."""
        self._held = leading(n_rows, n_qp_rows)
        """(m,) indices in `_rows` of the rows of the QP."""
        self.residuals: list[Array] = []
        """Multipliers of residuals of all levels, for each stage. A residual is its own multiplier;
        those of other levels are 0.
        """
        self._residual_copies: list[tuple[Array, Array]] = []
        """For each stage the multipliers of the residuals of this level, and these residuals."""
        parts_of_levels = [memory.residual_parts(i) for i in range(memory.n_levels)]
        for stage_parts in zip(*parts_of_levels, strict=True):
            sizes = [len(part) for part in stage_parts]
            multipliers = np.zeros(sum(sizes))
            level_multipliers = multipliers[sum(sizes[:level]) : sum(sizes[: level + 1])]
            self.residuals.append(multipliers)
            self._residual_copies.append((level_multipliers, stage_parts[level]))

    def update(self, solution: FlatSolution) -> None:
        """Take the multipliers of a QP, and the present residuals."""
        self.costates[:-1] = solution.costate.reshape(self.costates.shape)[1:]
        self._rows[self._held] = solution.y[: len(self._held)]
        for multipliers, residuals in self._residual_copies:
            multipliers[:] = residuals

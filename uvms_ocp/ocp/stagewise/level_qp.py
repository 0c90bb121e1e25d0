"""The QP of one level, linearised at the point in the memory of all stages."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from uvms_ocp.codegen.bound_calls import BoundCalls
from uvms_ocp.ocp.problem import HessianKind
from uvms_ocp.ocp.stagewise.memory import StageMemory, StageRanges
from uvms_ocp.ocp.stagewise.multipliers import Multipliers
from uvms_ocp.solvers import StageQpSolver
from uvms_ocp.solvers.stage_qp.problem import (
    FlatSolution,
    StageQp,
    StageQpOptions,
    StageShape,
    WarmStart,
    leading,
    parts,
)
from uvms_ocp.types import Array


class StageLevelQp:
    """Linearised at `StageMemory.z`; the QP moves from there."""

    def __init__(self, memory: StageMemory, level: int, options: StageQpOptions) -> None:
        self.memory = memory
        self.level = level
        self.shape = StageShape(
            n_x=(memory.tangent.n_x,) * len(memory.stages),
            n_u=memory.n_u,
            n_r=tuple(len(part) for part in memory.residual_parts(level)),
            n_c=tuple(sum(own[: level + 1]) for own in memory.group_sizes),
        )
        self.qp = StageQp(self.shape)
        self._solver = StageQpSolver(self.shape, options)
        self.held = leading(map(sum, memory.group_sizes), self.shape.n_c)
        self._bends = False
        """Rows (m,) that may be held and are rows of the QP, and whether it has curvature."""
        self.most: int | None = None
        """Iterations of a QP that is given up then, unexplained; None: those of the options."""
        self.multipliers = Multipliers(memory, level)
        groups = [group for own in memory.group_sizes for group in enumerate(own[: level + 1])]
        self._above = np.concatenate(
            [np.zeros(0, dtype=bool), *(np.full(n, i > 0) for i, n in groups)]
        )
        """(m,) True for rows of the QP that belong to levels above."""
        self.linearize = self._linearization(slopes=True)
        self.relinearize = self._linearization(
            slopes=any(one.errors_forced[level] for one in memory.functions)
        )
        """Linearization with slopes of forces that are near, where they matter to limits alone."""
        self.qp.fix_initial_state(np.zeros(self.shape.n_x[0]))

    def _linearization(self, *, slopes: bool) -> BoundCalls:
        """One function for all stages, then the other: so each stays where code is read from.

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
                F = self.qp.dynamics[i]
                n = self.memory.tangent.n_x
                F[...] = np.eye(*F.shape)
                if self.memory.tangent.free:
                    F[n - 1, n - 1 :] = (0.0, 1.0)
        memory.add_forces(calls, linear=slopes)
        for i, stage in enumerate(memory.stages):
            function = memory.function(stage)
            if function is not None:
                calls.add(
                    function.linear,
                    memory.arguments(i),
                    [*memory.row_memory(i)[:-1], *self._jacobians(i)],
                )
        return calls

    def _jacobians(self, i: int) -> list[Array | None]:
        """Return the arrays that the functions of rows at stage i write: of residuals, then of rows
        that may be held.
        """
        n_levels = self.memory.n_levels
        first = 0
        found: list[Array | None] = [
            self.qp.J[i] if level == self.level else None for level in range(n_levels)
        ]
        for group in self.memory.groups(self.memory.stages[i])[: self.level + 1]:
            found.append(self.qp.C[i][first : first + group.n])
            first += group.n
        return found + [None] * (n_levels - 1 - self.level)

    @cached_property
    def _curve(self) -> BoundCalls:
        """Function by function as well, at the point where forces were linearised."""
        memory = self.memory
        own = self.multipliers
        calls = BoundCalls()
        found = [
            (i, function)
            for i, stage in enumerate(memory.stages)
            if (function := memory.function(stage)) is not None
        ]
        tangent = memory.tangent
        n = len(memory.stages)
        sizes = tangent.n_v, tangent.step_curvature.numel_in(3), tangent.step_curvature.nnz_out(0)
        weights, bent, steps = (np.zeros((n, m)) for m in sizes)
        weighted = [(i, function.weights) for i, function in found if function.weights is not None]
        none = np.zeros(tangent.n_x)
        for i, function in weighted:
            calls.add(function, [*memory.arguments(i), own.rows[i], own.residuals[i]], [weights[i]])
        for i, _ in weighted:
            calls.add(
                tangent.model.bend,
                [memory.z[i, : tangent.model.n_motion], memory.arguments(i)[2], weights[i]],
                [bent[i]],
            )
        for i in (i for i, function in found if function.bends):
            after = memory.z[min(i + 1, n - 1)]
            costates = own.costates[i] if memory.stages[i].step else none
            calls.add(tangent.step_curvature, [memory.z[i], after, costates, bent[i]], [steps[i]])
        for i, function in found:
            calls.add(
                function.curvature,
                [*memory.arguments(i), own.rows[i], own.residuals[i], steps[i]],
                [self.qp.H[i]],
            )
        return calls

    def set_curvature(self, last: FlatSolution | None) -> None:
        """Curvature with the multipliers of the last QP; none without one, and for Gauss and
        Newton.
        """
        bends = last is not None and self.memory.whole.problem.hessian is HessianKind.EXACT
        if last is not None and bends:
            self.multipliers.update(last)
            self._curve()
        elif self._bends:
            self.qp.flat["H"][:] = 0.0
        self._bends = bends

    # --- values -----------------------------------------------------------------------------------

    @property
    def cost(self) -> float:
        r = self.memory.residuals(self.level)
        return float(r @ r) / 2

    def solve(
        self,
        ranges: StageRanges,
        damping: float,
        give: float,
        near: WarmStart | None,
        *,
        rough: float = 0.0,
        kept: float = 0.0,
    ) -> FlatSolution:
        """The step, with damping [1/unit of z^2]; it stands in the memory too.

        give [1/unit of the row], kept [1/unit of the row^2]: what it costs to miss levels above,
        and the square. near: where the QP starts. rough: how exact it is at least, where that is
        less than the tolerance asks for. Only what no curvature bends is explained where it fails.
        """
        flat = self.qp.flat
        flat["damping"][:] = damping
        flat["l1"][self._above] = give
        flat["l2"][self._above] = kept
        self._load(ranges)
        tolerance = max(rough, self._solver.options.tolerance)
        explained = not (self._bends or self.most)
        found = self._solver.solve_flat(
            self.qp, near, tolerance=tolerance, max_iterations=self.most, explained=explained
        )
        self.memory.step[:] = found.z
        return found

    def multipliers_above(self, found: FlatSolution) -> Array:
        """Multipliers of the rows of levels above."""
        return np.asarray(found.y[: len(self._above)][self._above])

    def _load(self, ranges: StageRanges) -> None:
        """Load values and ranges into the QP."""
        self.qp.flat["r"][:] = self.memory.residuals(self.level)
        ranges.write(self.qp.flat)

    def error(self, ranges: StageRanges, found: FlatSolution) -> float:
        """Return the error of the optimality conditions at the present linearisation, with the
        multipliers of the last QP.
        """
        self._load(ranges)
        return self._solver.error(self.qp, found.warm_start())

    # --- products ---------------------------------------------------------------------------------

    def steepest(self) -> float:
        """Largest entry of the gradient of the cost."""
        self.qp.flat["r"][:] = self.memory.residuals(self.level)
        return self._solver.steepest(self.qp)

    def bend(self, solution: FlatSolution) -> float:
        """Curvature that the multipliers of the last QP add along the whole step: twice what it
        costs.
        """
        if not self._bends:
            return 0.0
        z = parts(solution.z, self.shape.n_z)
        return float(sum(own @ H @ own for own, H in zip(z, self.qp.H, strict=True)))

    def largest_curvature(self) -> float:
        """Largest diagonal entry [1/unit of z^2] of the Hessian of Gauss and Newton."""
        return max(float((J * J).sum(axis=0).max(initial=0.0)) for J in self.qp.J)

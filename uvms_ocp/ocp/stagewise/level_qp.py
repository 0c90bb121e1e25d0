"""The QP of one level about a point: its residuals, and what levels above and limits hold."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from uvms_ocp.codegen.buffered import BoundCalls
from uvms_ocp.codegen.elementwise import interval_excess
from uvms_ocp.ocp.problem import HessianKind
from uvms_ocp.ocp.stagewise.memory import StageMemory, StageRanges
from uvms_ocp.solvers.stage_qp.problem import FlatSolution, StageQp, StageQpOptions, StageShape, WarmStart
from uvms_ocp.solvers.stage_qp.solver import StageQpSolver
from uvms_ocp.types import Array

# Multipliers that bend the QP of the next iteration.


class Multipliers:
    """Multipliers of one level, where the functions of curvature read them."""

    def __init__(self, memory: StageMemory, level: int) -> None:
        n, levels = len(memory.stages), range(memory.n_levels)
        sizes = [[len(memory.residual_parts(i)[k]) for i in levels] for k in range(n)]
        self.costates = np.zeros((n, memory.tangent.n_x))
        """Costates of the step that leads away from each stage."""
        groups = [memory.groups(stage) for stage in memory.stages]
        rows = [sum(group.n for group in own[:-1]) for own in groups]
        self._rows = np.zeros(sum(rows))
        self.rows = np.split(self._rows, np.cumsum(rows)[:-1])
        """Multipliers of rows that may be held."""
        held = [sum(group.n for group in own[: level + 1]) for own in groups]
        starts = np.cumsum([0, *rows[:-1]])
        self._held = np.concatenate([first + np.arange(count) for first, count in zip(starts, held, strict=True)])
        self.residuals = [np.zeros(sum(own)) for own in sizes]
        """A residual is its own multiplier; those of other levels are 0."""
        self._own = [
            (whole[sum(own[:level]) : sum(own[: level + 1])], part)
            for whole, own, part in zip(self.residuals, sizes, memory.residual_parts(level), strict=True)
        ]

    def update(self, found: FlatSolution) -> None:
        """Update: the multipliers of the last QP, and the present residuals."""
        self.costates[:-1] = found.costate.reshape(self.costates.shape)[1:]
        self._rows[self._held] = found.y[: len(self._held)]
        for own, residual in self._own:
            own[:] = residual


class StageLevelQp:
    """Linearised at `StageMemory.z`; the QP moves from there."""

    def __init__(self, memory: StageMemory, level: int, options: StageQpOptions) -> None:
        self.memory, self.level = memory, level
        self.shape = self._shape()
        self.qp, self._solver = StageQp(self.shape), StageQpSolver(self.shape, options)
        self.held, self._bends = self._held_numbers(), False
        """Rows (m,) that may be held and are rows of the QP, and whether it has curvature."""
        self.multipliers = Multipliers(memory, level)
        # Rows of the QP that belong to levels above.
        found = []
        for stage in self.memory.stages:
            sizes = [group.n for group in self.memory.groups(stage)[: self.level + 1]]
            found += [np.full(n, bool(i)) for i, n in enumerate(sizes)]
        self.linearize, self._above = self._linearization(), np.concatenate([np.zeros(0, dtype=bool), *found])
        self.qp.fix_initial_state(np.zeros(self.shape.n_x[0]))

    def _shape(self) -> StageShape:
        memory, tangent = self.memory, self.memory.tangent
        stages = memory.stages
        held = [sum(group.n for group in memory.groups(stage)[: self.level + 1]) for stage in stages]
        return StageShape(
            n_x=(tangent.n_x,) * len(stages),
            n_u=tuple(tangent.n_u if stage.step else int(tangent.free) for stage in stages[:-1]),
            n_r=tuple(len(part) for part in memory.residual_parts(self.level)),
            n_c=tuple(held),
        )

    def _held_numbers(self) -> Array:
        numbers, first = [], 0
        for stage, n in zip(self.memory.stages, self.shape.n_c, strict=True):
            numbers.append(np.arange(first, first + n))
            first += sum(group.n for group in self.memory.groups(stage))
        return np.concatenate(numbers)

    def _linearization(self) -> BoundCalls:
        """One function for all stages, then the other: so each stays where code is read from."""
        memory, calls = self.memory, BoundCalls()
        for i, stage in enumerate(memory.stages):
            if stage.step:
                calls.add(memory.motion_linear, [memory.z[i], memory.z[i + 1]], [memory.gaps[i], self.qp.dynamics[i]])
            elif i + 1 < len(memory.stages):
                F, n = self.qp.dynamics[i], self.memory.tangent.n_x
                F[...] = np.eye(*F.shape)
                if self.memory.tangent.free:
                    F[n - 1, n - 1 :] = (0.0, 1.0)
        for i, stage in enumerate(memory.stages):
            function = memory.function(stage)
            if function is not None:
                values = memory.row_memory(i)[:-1]
                calls.add(function.linear, memory.arguments(i), [*values, *self._jacobians(i)])
        return calls

    def _jacobians(self, i: int) -> list[Array | None]:
        """Return the arrays that the functions of rows at stage i write: of residuals, then of rows that may be held."""
        n_levels, first = self.memory.n_levels, 0
        found: list[Array | None] = [self.qp.J[i] if level == self.level else None for level in range(n_levels)]
        for group in self.memory.groups(self.memory.stages[i])[: self.level + 1]:
            found.append(self.qp.C[i][first : first + group.n])
            first += group.n
        return found + [None] * (n_levels - 1 - self.level)

    @cached_property
    def _curve(self) -> BoundCalls:
        """Function by function as well."""
        memory, own, calls = self.memory, self.multipliers, BoundCalls()
        found = [
            (i, function) for i, stage in enumerate(memory.stages) if (function := memory.function(stage)) is not None
        ]
        bends = [np.zeros(function.bend.numel_out(0)) for _, function in found]
        for (i, function), bend in zip(found, bends, strict=True):
            calls.add(function.bend, [*memory.arguments(i), own.rows[i], own.residuals[i]], [bend])
        for (i, function), bend in zip(found, bends, strict=True):
            z, parameters, water = memory.arguments(i)
            after = memory.z[min(i + 1, len(memory.stages) - 1)]
            arguments = [z, after, parameters, water, own.costates[i], own.rows[i], own.residuals[i], bend]
            calls.add(function.curvature, arguments, [self.qp.H[i]])
        return calls

    def set_curvature(self, last: FlatSolution | None) -> None:
        """Curvature with the multipliers of the last QP; none without one, and for Gauss and Newton."""
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

    def broken(self, ranges: StageRanges) -> Array:
        """Return how far gaps, rows and variables are outside their ranges, one after the other."""
        memory = self.memory
        rows = interval_excess(memory.held, ranges.lower, ranges.upper)[self.held]
        return np.concatenate([np.abs(memory.gaps.ravel()), rows, ranges.z_excess(memory.z)])

    def fits(self, found: FlatSolution) -> bool:
        """Check whether a solution is that of a QP of this shape."""
        return found.shape == self.shape

    def solve(
        self, ranges: StageRanges, damping: float, give: float, near: WarmStart | None, *, rough: float = 0.0
    ) -> FlatSolution:
        """The step, with damping [1/unit of z^2]; it stands in the memory too.

        give [1/unit of the row]: what it costs to miss levels above. near: where the QP starts. rough: how exact it is at
        least, where that is less than the tolerance asks for. Only what no curvature bends is explained where it fails.
        """
        flat = self.qp.flat
        flat["damping"][:], flat["l1"][self._above] = damping, give
        self._load(ranges)
        tolerance = max(rough, self._solver.options.tolerance)
        found = self._solver.solve_flat(self.qp, near, tolerance=tolerance, explained=not self._bends)
        self.keep(found)
        return found

    def _load(self, ranges: StageRanges) -> None:
        """Load values and ranges into the QP."""
        memory, flat = self.memory, self.qp.flat
        flat["b"][:] = memory.gaps.ravel()
        flat["r"][:] = memory.residuals(self.level)
        held = memory.held[self.held]
        flat["lower"][:], flat["upper"][:] = ranges.lower[self.held] - held, ranges.upper[self.held] - held
        ranges.write_z(memory.z, flat["z_lower"], flat["z_upper"])

    def error(self, ranges: StageRanges, found: FlatSolution) -> float:
        """Return the error of the optimality conditions at the present linearisation, with the multipliers of the last QP."""
        self._load(ranges)
        return self._solver.error(self.qp, found.warm_start())

    def keep(self, found: FlatSolution) -> None:
        """Its step is that of the memory."""
        memory = self.memory
        memory.x_step[...] = found.z[self._x_places]
        memory.u_step[memory.steps] = found.z[self._u_places]

    @cached_property
    def _x_places(self) -> Array:
        """(n, n_x) of states in z."""
        return self._first[:, None] + np.arange(self.memory.tangent.n_x)

    @cached_property
    def _u_places(self) -> Array:
        """(n_steps, n_u) of the controls of steps in z."""
        tangent = self.memory.tangent
        return self._first[self.memory.steps, None] + tangent.n_x + np.arange(tangent.n_u)

    @cached_property
    def _first(self) -> Array:
        """(n,) where each stage begins in z."""
        return np.cumsum([0, *self.shape.n_z[:-1]])

    # --- products ---------------------------------------------------------------------------------

    def steepest(self) -> float:
        """Largest entry of the gradient of the cost."""
        self.qp.flat["r"][:] = self.memory.residuals(self.level)
        return self._solver.steepest(self.qp)

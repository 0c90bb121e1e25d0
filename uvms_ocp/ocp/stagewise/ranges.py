"""Ranges of gaps, rows and variables of all stages, in one solve of one level."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uvms_ocp.ocp.stagewise.memory import Stage, StageMemory
from uvms_ocp.solvers.nlp.program import RowBounds
from uvms_ocp.solvers.stage_qp.problem import FlatSolution
from uvms_ocp.types import Array, Indices


class StageRanges:
    """Ranges of one solve of one level."""

    def __init__(self, indices: StageIndices, bounds: RowBounds, level: int, held: Indices) -> None:
        """level: number of the level, those above which are held by `bounds`. held (m,): rows of its
        QP, among those that may be held.
        """
        self._memory = indices.memory
        self._held = held
        z_ranges = indices.z_ranges(bounds.x_lower, bounds.x_upper)
        self._bounded = np.flatnonzero(np.isfinite(z_ranges).any(axis=0))
        """(n_bounded,) indices of the variables that have ranges."""
        self._bounded_in_memory = indices.z[self._bounded]
        """(n_bounded,) their indices among the points in the memory, flat."""
        program_ranges = _program_ranges(self._memory, bounds, level)
        force_ranges = indices.force_ranges(bounds.x_lower, bounds.x_upper)
        row_ranges = np.where(indices.raw >= 0, program_ranges[:, indices.raw], force_ranges)
        gap_ranges = np.zeros((2, self._memory.gaps.size))
        self._ranges = np.hstack([gap_ranges, row_ranges[:, held], z_ranges[:, self._bounded]])
        """(2, n) lower and upper ends of gaps, which are to be 0, then of rows, then of
        variables.
        """
        self._first_row = gap_ranges.shape[1]
        self._first_variable = gap_ranges.shape[1] + len(held)

    def _values(self) -> Array:
        """Return gaps, rows and variables (n,) at the point in the memory."""
        memory = self._memory
        z = memory.z.reshape(-1)
        return np.concatenate(
            [memory.gaps.reshape(-1), memory.held[self._held], z[self._bounded_in_memory]]
        )

    def excess(self) -> Array:
        """Return by how much gaps, rows and variables (n,) are outside their ranges at the point in
        the memory; NaN where they are NaN.
        """
        values = self._values()
        lower, upper = self._ranges
        return np.maximum(np.maximum(lower - values, values - upper), 0.0)

    def weights(self, solution: FlatSolution) -> Array:
        """Return the weights (n,) [1/unit of the row] of the rows of `excess` in a merit function:
        the sizes of their multipliers.
        """
        n_x = self._memory.tangent.n_x
        gap_multipliers = solution.costate[n_x:]
        row_multipliers = solution.y[: len(self._held)]
        variable_multipliers = solution.y[len(self._held) :][self._bounded]
        return np.abs(np.concatenate([gap_multipliers, row_multipliers, variable_multipliers]))

    def write(self, flat: Mapping[str, Array]) -> None:
        """Write gaps, and ranges of the step from the point in the memory, into the arrays of a
        QP.
        """
        values = self._values()
        distances = self._ranges - values
        rows = slice(self._first_row, self._first_variable)
        variables = slice(self._first_variable, None)
        flat["b"][:] = values[: self._first_row]
        flat["lower"][:], flat["upper"][:] = distances[:, rows]
        lower, upper = distances[:, variables]
        flat["z_lower"][self._bounded] = lower
        flat["z_upper"][self._bounded] = upper


def _program_ranges(memory: StageMemory, bounds: RowBounds, level: int) -> Array:
    """Return the ranges (2, n_rows + 1) of the raw rows of a program: those of `bounds` for
    constraints and levels above, infinite ones for other rows and for the last column, of no row.
    """
    transcription = memory.whole
    layout = transcription.row_layout
    levels = transcription.ranges().levels
    ranges = np.full((2, layout.n_rows + 1), [[-np.inf], [np.inf]])
    n_constraints = len(layout.constraints)
    ranges[0, layout.constraints] = bounds.lower[:n_constraints]
    ranges[1, layout.constraints] = bounds.upper[:n_constraints]
    for i in range(level):
        ranges[0, layout.levels[i]] = bounds.lower[levels[i].frozen]
        ranges[1, layout.levels[i]] = bounds.upper[levels[i].frozen]
    return ranges


class StageIndices:
    """Indices of every row and every variable of the QPs of stages, in the program."""

    def __init__(self, memory: StageMemory) -> None:
        self.memory = memory
        raw_rows = [self._raw_rows(i) for i in range(len(memory.stages))]
        self.raw = np.concatenate([np.zeros(0, dtype=int), *raw_rows])
        """(n,) raw row of each row that may be held; -1 for limits of forces."""
        is_force = self.raw < 0
        self.force_lower = np.full(len(self.raw), -np.inf)
        self.force_upper = np.full(len(self.raw), np.inf)
        self.force_lower[is_force] = np.tile(memory.forces.lower, len(memory.steps))
        self.force_upper[is_force] = np.tile(memory.forces.upper, len(memory.steps))
        self.z, self._x = self._variables()
        self._force_x = self._inputs()

    def _raw_rows(self, i: int) -> Array:
        """Return the raw row of each row that may be held at stage i; -1 for limits of forces."""
        memory = self.memory
        stage = memory.stages[i]
        function = memory.function(stage)
        if function is None:
            return np.zeros(0, dtype=int)
        assert stage.block is not None
        term_rows = memory.whole.row_layout.terms[stage.block][stage.place]
        n_force_rows = len(memory.forces.lower) if stage.step else 0
        force_rows = np.full(n_force_rows, -1)
        return np.concatenate([force_rows, *(term_rows[group.numbers] for group in function.held)])

    def _variables(self) -> tuple[Array, Array]:
        """Return the index of each variable of the QP in the points, and in x; -1 in x where it has
        no range.
        """
        in_points = []
        in_x = []
        memory = self.memory
        n_z = memory.z.shape[1]
        h = memory.tangent.model.layout.h
        h_of_program = memory.whole.variables.model.layout.h
        for i, stage in enumerate(memory.stages):
            columns = memory.whole.variables.columns(stage.node)
            entries = self._entries_of_z(stage)
            is_entry = entries >= 0
            in_points.append(np.where(is_entry, i * n_z + entries, 0))
            if stage.starts_phase is None:
                in_x.append(np.where(is_entry, columns[np.maximum(entries, 0)], -1))
                continue
            in_x.append(np.full(len(entries), -1))
            if memory.tangent.free:
                in_points.append(np.array([(i + 1) * n_z + h]))
                in_x.append(columns[[h_of_program]])
        return np.concatenate(in_points), np.concatenate(in_x)

    def _entries_of_z(self, stage: Stage) -> Array:
        """Return the entry of z to which each state and control of a stage is added; -1 where there
        is none, as for axes that turn and for lengths of steps.
        """
        tangent = self.memory.tangent
        layout = tangent.model.layout
        positions = np.full(tangent.n_v, -1)
        for joint in self.memory.whole.problem.robot.joints:
            if joint.n_q == joint.n_v:
                axes = slice(joint.idx_v, joint.idx_v + joint.n_v)
                positions[axes] = np.arange(joint.q.start, joint.q.stop)
        velocity = np.arange(layout.v.start, layout.v.stop)
        step_length = np.full(int(tangent.free), -1)
        entries = [positions, velocity, step_length]
        if stage.step:
            entries += [np.arange(layout.a.start, layout.a.stop), np.full(layout.n_null, -1)]
        return np.concatenate(entries)

    def _inputs(self) -> Array:
        """Return the index in x of the thrust or torque of each row of forces, step after step; -1
        where it has none.
        """
        memory = self.memory
        variables = memory.whole.variables
        layout = variables.model.layout
        inputs = memory.forces.inputs
        if not layout.n_thrust + layout.n_torque:
            return np.full(len(inputs) * len(memory.steps), -1)
        in_x = []
        for i in memory.steps:
            first_input = variables.columns(memory.stages[i].node)[layout.thrust.start]
            in_x.append(np.where(inputs >= 0, first_input + inputs, -1))
        return np.concatenate(in_x)

    def program_multipliers(self, rows: Indices, solution: FlatSolution) -> tuple[Array, Array]:
        """Return multipliers (n_x,) [1/unit of x] of bounds and (n_rows,) [1/unit of the row] of
        rows; 0 for laws of motion and the start, which no level can loosen.

        rows (m,): rows of the QP that was solved, among those that may be held.
        """
        transcription = self.memory.whole
        layout = transcription.row_layout
        ranges = transcription.ranges()
        held = np.zeros(len(self.raw))
        held[rows] = solution.y[: len(rows)]
        # What has no index, -1, is written behind the last one.
        x = np.zeros(transcription.n_x + 1)
        raw = np.zeros(layout.n_rows + 1)
        x[self._x] = solution.y[len(rows) :]
        x[self._force_x] = held[self.raw < 0]
        start = transcription.variables.columns(0)[: transcription.model.layout.h]
        x[start] = 0.0
        raw[self.raw] = held
        program_rows = np.zeros(ranges.n_rows)
        program_rows[: len(layout.constraints)] = raw[layout.constraints]
        for level, held_rows in zip(ranges.levels, layout.held, strict=True):
            program_rows[level.frozen] = raw[held_rows]
        return x[:-1], program_rows

    def force_ranges(self, x_lower: Array, x_upper: Array) -> Array:
        """Return the limits (2, n) of forces: those that are variables have bounds x_lower and
        x_upper (n_x,) [unit of x].
        """
        ranges = np.array([self.force_lower, self.force_upper])
        is_variable = self._force_x >= 0
        rows = np.flatnonzero(self.raw < 0)[is_variable]
        columns = self._force_x[is_variable]
        ranges[:, rows] = [x_lower[columns], x_upper[columns]]
        return ranges

    def z_ranges(self, x_lower: Array, x_upper: Array) -> Array:
        """Return the ranges (2, n) of the variables of the QP, of bounds x_lower and x_upper
        (n_x,) [unit of x].
        """
        is_unbounded = self._x < 0
        lower = np.where(is_unbounded, -np.inf, x_lower[self._x])
        upper = np.where(is_unbounded, np.inf, x_upper[self._x])
        return np.array([lower, upper])

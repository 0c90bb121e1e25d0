"""Where rows and variables of all stages are to be."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.ocp.stagewise.stage_memory import StageMemory
from uvms_ocp.solvers.intervals import excess
from uvms_ocp.solvers.nlp.row_bounds import RowBounds
from uvms_ocp.solvers.stagewise.solution import Found


class StageRanges:
    """Ranges of one solve of one level."""

    def __init__(self, places: Places, bounds: RowBounds, level: int) -> None:
        """level [-]: those above it are held, as `bounds` has it."""
        self._places, whole = places, places.memory.whole
        layout, levels = whole.row_layout, whole.ranges().levels
        raw = np.full((2, layout.n_rows + 1), [[-np.inf], [np.inf]])
        held = [(layout.constraints, slice(0, len(layout.constraints)))]
        held += [(layout.levels[i], levels[i].frozen) for i in range(level)]
        for rows, own in held:
            raw[0, rows], raw[1, rows] = bounds.lower[own], bounds.upper[own]
        self.lower = np.where(places.raw >= 0, raw[0, places.raw], places.force_lower)
        """(n,) [unit of the row] of all rows that may be held."""
        self.upper = np.where(places.raw >= 0, raw[1, places.raw], places.force_upper)
        """(n,) [unit of the row]"""
        self._z = places.z_ranges(bounds.x_lower, bounds.x_upper)
        self._limited = np.isfinite(self._z).any(axis=0)

    def z_excess(self, z: Array) -> Array:
        """How far variables are outside at the points z (n, n_z) [unit of z]."""
        own = self._limited
        return np.asarray(excess(z.reshape(-1)[self._places.z[own]], self._z[0, own], self._z[1, own]))

    def write_z(self, z: Array, lower: Array, upper: Array) -> None:
        """Ranges of the step from z (n, n_z) [unit of z] into lower and upper (m,) [unit of z]."""
        own = self._limited
        here = z.reshape(-1)[self._places.z[own]]
        lower[own], upper[own] = self._z[0, own] - here, self._z[1, own] - here


class Places:
    """What every row and every variable of the QP is."""

    def __init__(self, memory: StageMemory) -> None:
        self.memory = memory
        rows = [self._row_numbers(i) for i in range(len(memory.stages))]
        self.raw = np.concatenate([np.zeros(0, dtype=int), *rows])
        """(n,) [-] raw row of each row that may be held; -1 for limits of forces."""
        forces = memory.forces
        self.force_lower, self.force_upper = np.full(len(self.raw), -np.inf), np.full(len(self.raw), np.inf)
        self.force_lower[self.raw < 0] = np.tile(forces.lower, len(memory.steps))
        self.force_upper[self.raw < 0] = np.tile(forces.upper, len(memory.steps))
        self.z, self._x = self._variables()
        self._force_x = self._inputs()

    def _row_numbers(self, i: int) -> Array:
        memory, stage = self.memory, self.memory.stages[i]
        function = memory.function(stage)
        if function is None:
            return np.zeros(0, dtype=int)
        assert stage.block is not None
        own = memory.whole.row_layout.terms[stage.block][stage.place]
        forces = np.full(len(memory.forces.lower) if stage.step else 0, -1)
        return np.concatenate([forces, *(own[group.numbers] for group in function.held)])

    def _variables(self) -> tuple[Array, Array]:
        """Place of each variable of the QP in the points, and in x; where it has no range the latter is -1."""
        memory, tangent, layout = self.memory, self.memory.tangent, self.memory.tangent.model.layout
        variables, robot = memory.whole.variables, memory.whole.problem.robot
        straight = np.full(tangent.n_v, -1)
        for joint in robot.joints:
            if joint.n_q == joint.n_v:
                straight[joint.idx_v : joint.idx_v + joint.n_v] = np.arange(joint.q.start, joint.q.stop)
        state = np.concatenate([straight, np.arange(layout.v.start, layout.v.stop)])
        places, numbers = [], []
        for i, stage in enumerate(memory.stages):
            columns, n_z = variables.columns(stage.node), memory.z.shape[1]
            own = np.concatenate([state, np.full(int(tangent.free), -1)])
            if stage.step:
                own = np.concatenate([own, np.arange(layout.a.start, layout.a.stop), np.full(layout.n_null, -1)])
            used = own >= 0 if stage.turn_to is None else np.zeros(len(own), dtype=bool)
            places.append(np.where(own >= 0, i * n_z + own, 0))
            numbers.append(np.where(used, columns[np.maximum(own, 0)], -1))
            if stage.turn_to is not None and tangent.free:
                places.append(np.array([(i + 1) * n_z + layout.h]))
                numbers.append(columns[[variables.model.layout.h]])
        return np.concatenate(places), np.concatenate(numbers)

    def _inputs(self) -> Array:
        """Place in x of the thrust or torque of each row of forces, step after step; -1 where it has none."""
        memory, variables = self.memory, self.memory.whole.variables
        layout, own = variables.model.layout, memory.forces.inputs
        if not layout.n_thrust + layout.n_torque:
            return np.full(len(own) * len(memory.steps), -1)
        first = [variables.columns(memory.stages[i].node)[layout.thrust.start] for i in memory.steps]
        return np.concatenate([np.where(own >= 0, place + own, -1) for place in first])

    def program_multipliers(self, rows: Array, found: Found) -> tuple[Array, Array]:
        """Multipliers (n_x,) [1/unit of x] of bounds and (n_rows,) [1/unit of the row] of rows; 0 of laws, which nobody loosens.

        rows (m,) [-]: which of those that may be held are in the QP that was solved.
        """
        whole, y = self.memory.whole, np.zeros(len(self.raw))
        layout, levels = whole.row_layout, whole.ranges().levels
        y[rows] = found.y[: len(rows)]
        # What has no place is written behind the last one.
        x, raw, kept = np.zeros(whole.n_x + 1), np.zeros(layout.n_rows + 1), np.zeros(whole.ranges().n_rows)
        x[self._x], x[self._force_x] = found.y[len(rows) :], y[self.raw < 0]
        x[whole.variables.columns(0)[: whole.model.layout.h]] = 0.0
        raw[self.raw] = y
        kept[: len(layout.constraints)] = raw[layout.constraints]
        for level, own in zip(levels, layout.held, strict=True):
            kept[level.frozen] = raw[own]
        return x[:-1], kept

    def z_ranges(self, x_lower: Array, x_upper: Array) -> Array:
        """(2, n) of bounds x_lower and x_upper (n_x,) [unit of x]."""
        none = self._x < 0
        return np.array([np.where(none, -np.inf, x_lower[self._x]), np.where(none, np.inf, x_upper[self._x])])

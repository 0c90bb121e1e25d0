"""Numbers and ranges of a horizon, stage after stage, at the current point: shared by all levels.

A turn takes no time. There the rows count that end a phase, and the length of the steps of the next
phase is chosen: as a control, so that it is a state of the steps that follow and couples nothing
else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from uvms_ocp.codegen.bound_calls import BoundCalls
from uvms_ocp.codegen.compile import content_of
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.stagewise import functions
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import eliminated_blocks
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.program import RowBounds
from uvms_ocp.solvers.stage_qp.problem import FlatSolution
from uvms_ocp.types import Array, Indices

# The stages of a horizon: its steps, the turn from one phase to the next, and the last node.


@dataclass(frozen=True, kw_only=True, slots=True)
class Stage:
    """One stage."""

    node: int
    """Number of the node whose state the stage has."""
    block: int | None
    """Number of the `TermBlock` whose rows count; None for a turn before the first phase."""
    place: int = 0
    """Index of the node in that block."""
    step: bool = False
    """The stage takes time, and has accelerations."""
    starts_phase: int | None = None
    """Phase that begins."""


def horizon_stages(problem: OcpProblem) -> tuple[Stage, ...]:
    """The stages of a problem, the last node last."""
    starts = problem.starts_of_phases().tolist()
    n = len(problem.phases)
    stages: list[Stage] = []
    for i in range(n):
        if i or problem.free_time:
            stages.append(Stage(node=starts[i], block=n + i - 1 if i else None, starts_phase=i))
        stages += [
            Stage(node=node, block=i, place=node - starts[i], step=True)
            for node in range(starts[i], starts[i + 1])
        ]
    return (*stages, Stage(node=starts[n], block=2 * n - 1))


# Where the numbers of a horizon are, stage after stage, at the point that is looked at: shared by
# all levels.


class StageMemory:
    """Points, parameters, rows and gaps of all stages, and the calls that move points and find
    values there.
    """

    def __init__(self, whole: Transcription) -> None:
        """whole: numbers parameters, variables and rows."""
        problem = whole.problem
        self.whole = whole
        self.stages = horizon_stages(problem)
        self.n_levels = len(problem.levels)
        self.tangent = functions.Tangent(model=StageModel(problem, eliminated=True))
        self.forces = functions.force_rows(self.tangent.model)
        self.functions = self._block_functions()
        self.steps = np.array([i for i, stage in enumerate(self.stages) if stage.step])
        n = len(self.stages)
        layout = self.tangent.model.layout
        self.z = np.zeros((n, layout.n_z))
        self.z_from = np.zeros((n, layout.n_z))
        self.n_u = tuple(
            self.tangent.n_u if stage.step else int(self.tangent.free) for stage in self.stages[:-1]
        )
        """(n - 1,) controls of each stage but the last."""
        self.step = np.zeros(n * self.tangent.n_x + sum(self.n_u))
        """States and controls, stage after stage, as those of a QP."""
        self.share, self.water = np.ones(1), np.zeros((len(self.steps), 3))
        self.force, self.force_slope = (
            np.zeros((n, layout.n_v)),
            np.zeros((n, self.tangent.force_slope.nnz())),
        )
        self.gaps = np.zeros((n - 1, self.tangent.n_x))
        """Defects: by how much each stage ends ahead of the next."""
        self.parameters = [
            np.zeros((len(one.block.nodes), one.block.rows.n_parameters)) for one in self.functions
        ]
        self.thrust = np.zeros((len(self.steps), self.tangent.model.actuators.matrix.shape[1]))
        self.torque = np.zeros((len(self.steps), problem.robot.n_joints))
        self.group_sizes = [[group.n for group in self.groups(stage)] for stage in self.stages]
        """Rows of each stage that may be held, group by group."""
        sizes = [sum(own) for own in self.group_sizes]
        self.held = np.zeros(sum(sizes))
        """Rows that may be held, stage after stage: limits of forces, constraints, then those of
        all levels.
        """
        self.held_parts = [
            _split(part, own)
            for part, own in zip(_split(self.held, sizes), self.group_sizes, strict=True)
        ]
        self._residuals = [self._level_rows(i) for i in range(self.n_levels)]
        self.motion, self.motion_linear, moved = functions.motion_functions(self.tangent)
        calls = BoundCalls()
        none = np.zeros(self.tangent.n_u)
        n_x = self.tangent.n_x
        for i, own in enumerate(_split(self.step, [n_x + n_u for n_u in (*self.n_u, 0)])):
            x = own[:n_x]
            u = own[n_x:] if self.stages[i].step else none
            calls.add(moved, [self.z_from[i], x, u, self.share], [self.z[i]])
        self.evaluate, self.move, self.find_inputs = self._evaluation(), calls, self._inputs()

    def residuals(self, level: int) -> Array:
        """Return the residuals of all stages, whose half square is the cost of a level."""
        return self._residuals[level][0]

    def residual_parts(self, level: int) -> list[Array]:
        """Return the residuals of a level, stage by stage."""
        return self._residuals[level][1]

    def function(self, stage: Stage) -> functions.BlockFunctions | None:
        if stage.block is None:
            return None
        return self.functions[stage.block]

    def arguments(self, i: int) -> list[Array]:
        """Return the arguments of the functions of rows at stage i."""
        stage = self.stages[i]
        assert stage.block is not None
        water = self.water[min(stage.node, len(self.water) - 1)]
        return [
            self.z[i],
            self.parameters[stage.block][stage.place],
            water,
            self.force[i],
            self.force_slope[i],
        ]

    def add_forces(self, calls: BoundCalls, *, linear: bool) -> None:
        """Add calls that find the forces, and their slopes, of all stages whose rows depend on
        them.
        """
        for i, stage in enumerate(self.stages):
            function = self.function(stage)
            if function is not None and function.forced:
                z, _, water, *results = self.arguments(i)
                calls.add(self.tangent.forces[linear], [z, water], results[: 1 + linear])

    def _block_functions(self) -> tuple[functions.BlockFunctions, ...]:
        problem = self.whole.problem
        free = self.tangent.free
        n = len(problem.phases)
        return tuple(
            functions.BlockFunctions(
                block=block,
                tangent=self.tangent,
                forces=self.forces if i < n else None,
                extra=int(free and n <= i < 2 * n - 1),
            )
            for i, block in enumerate(eliminated_blocks(self.whole.blocks, self.tangent.model))
        )

    def compile_curvature(self) -> None:
        """Before any clock runs: it takes longest."""
        for function in self.functions:
            _ = self.tangent.model.bend if function.weights else None, function.curvature

    def groups(self, stage: Stage) -> tuple[functions.HeldRows, ...]:
        """Rows of a stage that may be held."""
        function = self.function(stage)
        if function is None:
            return ()
        return function.held

    def _level_rows(self, level: int) -> tuple[Array, list[Array]]:
        of_stages = [self.function(stage) for stage in self.stages]
        sizes = [0 if function is None else function.errors[level].n for function in of_stages]
        flat = np.zeros(sum(sizes))
        return flat, _split(flat, sizes)

    def _evaluation(self) -> BoundCalls:
        calls = BoundCalls()
        self.add_forces(calls, linear=False)
        for i, stage in enumerate(self.stages):
            if stage.step:
                calls.add(self.motion, [self.z[i], self.z[i + 1]], [self.gaps[i]])
            function = self.function(stage)
            if function is not None:
                calls.add(function.values, self.arguments(i), self.row_memory(i))
        return calls

    def row_memory(self, i: int) -> list[Array]:
        """Results of the functions of rows at stage i: residuals, then rows that may be held."""
        return [
            *(self.residual_parts(level)[i] for level in range(self.n_levels)),
            *self.held_parts[i],
        ]

    def _inputs(self) -> BoundCalls:
        calls = BoundCalls()
        model = self.tangent.model
        inputs = [model.z, model.force]
        outputs = [ca.densify(output) for output in model.inputs]
        function = functions.compile_made(
            "inputs", content_of(inputs, outputs), lambda: (inputs, outputs)
        )
        for k, i in enumerate(self.steps):
            calls.add(self.tangent.forces[0], [self.z[i], self.water[k]], [self.force[i]])
        for k, i in enumerate(self.steps):
            calls.add(function, [self.z[i], self.force[i]], [self.thrust[k], self.torque[k]])
        return calls


def _split(flat: Array, sizes: object) -> list[Array]:
    ends = np.cumsum([0, *sizes]).tolist()  # type: ignore[misc]
    return [flat[first:stop] for first, stop in pairwise(ends)]


# From the variables of a program to the points of all stages and back.


class StageVariables:
    """Reads and writes `StageMemory.z`."""

    def __init__(self, memory: StageMemory) -> None:
        self._memory = memory
        self._variables = memory.whole.variables
        self._nodes = np.array([stage.node for stage in memory.stages])
        self._ends = np.array([stage.starts_phase is not None for stage in memory.stages])

    def set_parameters(self, p: Array) -> None:
        """P (n_p,) [unit of the parameter]: those of `Transcription.parameters`."""
        memory = self._memory
        layout = self._memory.whole.parameter_layout
        memory.water[...] = p[layout.water].reshape(-1, 3)
        for block_parameters, place in zip(memory.parameters, layout.terms, strict=True):
            block_parameters[...] = p[place].reshape(block_parameters.shape)

    def read(self, x: Array, p: Array) -> None:
        """Take variables x (n_x,) [unit of x], with the start and the lengths of steps of p (n_p,)
        [unit of the parameter].
        """
        memory = self._memory
        variables = self._variables
        layout = self._memory.tangent.model.layout
        source = variables.model.layout
        n = variables.n_step
        N = variables.N
        steps = x[: N * n].reshape(N, n)
        column = variables.columns(0)
        memory.z[:, : layout.h] = np.vstack([steps[:, : source.h], x[N * n : N * n + source.h]])[
            self._nodes
        ]
        h = steps[:, column[source.h]] if variables.free else p[memory.whole.parameter_layout.steps]
        memory.z[memory.steps, layout.h] = h
        memory.z[memory.steps, layout.a] = steps[:, column[source.a]]
        if source.n_thrust:
            memory.z[memory.steps, layout.null] = (
                steps[:, column[source.thrust]] @ memory.tangent.model.actuators.null
            )
        memory.z[self._nodes == 0, : layout.h] = p[memory.whole.parameter_layout.start]

    def write(self) -> Array:
        """Variables (n_x,) [unit of x] of the points."""
        memory = self._memory
        variables = self._variables
        layout = self._memory.tangent.model.layout
        target = variables.model.layout
        n = variables.n_step
        N = variables.N
        x = np.zeros(variables.n_x)
        z = memory.z[memory.steps]
        column = variables.columns(0)
        steps = x[: N * n].reshape(N, n)
        steps[:, : target.h] = z[:, : layout.h]
        steps[:, column[target.a]] = z[:, layout.a]
        x[N * n : N * n + target.h] = memory.z[-1, : layout.h]
        if variables.free:
            steps[:, column[target.h]] = z[:, layout.h]
            x[N * n + target.h] = z[-1, layout.h]
        if target.n_thrust + target.n_torque:
            memory.find_inputs()
            steps[:, column[target.thrust]] = memory.thrust
            steps[:, column[target.torque]] = memory.torque
        return x


# Where gaps, rows and variables of all stages are to be.


class StageRanges:
    """Ranges of one solve of one level."""

    def __init__(self, places: StageIndices, bounds: RowBounds, level: int, held: Indices) -> None:
        """level: those above it are held, as `bounds` has it. held (m,): the rows of its QP."""
        self._memory = places.memory
        transcription = places.memory.whole
        layout = transcription.row_layout
        levels = transcription.ranges().levels
        raw = np.full((2, layout.n_rows + 1), [[-np.inf], [np.inf]])
        above = [(layout.constraints, slice(0, len(layout.constraints)))]
        above += [(layout.levels[i], levels[i].frozen) for i in range(level)]
        for rows, numbers in above:
            raw[0, rows] = bounds.lower[numbers]
            raw[1, rows] = bounds.upper[numbers]
        forces = places.force_ranges(bounds.x_lower, bounds.x_upper)
        z = places.z_ranges(bounds.x_lower, bounds.x_upper)
        self._own = np.flatnonzero(np.isfinite(z).any(axis=0))
        """(m,) numbers of the variables that have ranges."""
        self._held = held
        self._at = places.z[self._own]
        gaps = np.zeros((2, self._memory.gaps.size))
        rows = np.where(places.raw >= 0, raw[:, places.raw], forces)[:, held]
        self._ends = np.hstack([gaps, rows, z[:, self._own]])
        """(2, n) lower and upper ends of gaps, which are to be 0, then of rows, then of
        variables.
        """
        self._rows = slice(gaps.shape[1], gaps.shape[1] + len(held))

    def _values(self) -> Array:
        memory = self._memory
        return np.concatenate(
            [memory.gaps.reshape(-1), memory.held[self._held], memory.z.reshape(-1)[self._at]]
        )

    def excess(self) -> Array:
        """Return how far gaps, rows and variables (n,) are outside at the point in the memory; NaN
        where one is.
        """
        y = self._values()
        return np.maximum(np.maximum(self._ends[0] - y, y - self._ends[1]), 0.0)

    def weights(self, solution: FlatSolution) -> Array:
        """Return what the rows of `excess` (n,) [1/unit of the row] cost: the size of their
        multipliers.
        """
        n_x = self._memory.tangent.n_x
        y = solution.y[: len(self._held)]
        y_z = solution.y[len(self._held) :][self._own]
        return np.abs(np.concatenate([solution.costate[n_x:], y, y_z]))

    def write(self, flat: Mapping[str, Array]) -> None:
        """Write gaps, and ranges of the step from the point in the memory, into the arrays of a
        QP.
        """
        y = self._values()
        distances = self._ends - y
        first = self._rows.start
        end = self._rows.stop
        flat["b"][:] = y[:first]
        flat["lower"][:], flat["upper"][:] = distances[:, first:end]
        flat["z_lower"][self._own], flat["z_upper"][self._own] = distances[:, end:]


class StageIndices:
    """Indices of every row and every variable of the QP."""

    def __init__(self, memory: StageMemory) -> None:
        self.memory = memory
        self.raw = np.concatenate(
            [np.zeros(0, dtype=int), *[self._row_numbers(i) for i in range(len(memory.stages))]]
        )
        """(n,) raw row of each row that may be held; -1 for limits of forces."""
        forces = memory.forces
        self.force_lower, self.force_upper = (
            np.full(len(self.raw), -np.inf),
            np.full(len(self.raw), np.inf),
        )
        self.force_lower[self.raw < 0] = np.tile(forces.lower, len(memory.steps))
        self.force_upper[self.raw < 0] = np.tile(forces.upper, len(memory.steps))
        self.z, self._x = self._variables()
        self._force_x = self._inputs()

    def _row_numbers(self, i: int) -> Array:
        memory = self.memory
        stage = self.memory.stages[i]
        function = memory.function(stage)
        if function is None:
            return np.zeros(0, dtype=int)
        assert stage.block is not None
        term_rows = memory.whole.row_layout.terms[stage.block][stage.place]
        forces = np.full(len(memory.forces.lower) if stage.step else 0, -1)
        return np.concatenate([forces, *(term_rows[group.numbers] for group in function.held)])

    def _variables(self) -> tuple[Array, Array]:
        """Place of each variable of the QP in the points, and in x; where it has no range the
        latter is -1.
        """
        memory = self.memory
        tangent = self.memory.tangent
        layout = self.memory.tangent.model.layout
        variables = memory.whole.variables
        robot = memory.whole.problem.robot
        straight = np.full(tangent.n_v, -1)
        for joint in robot.joints:
            if joint.n_q == joint.n_v:
                straight[joint.idx_v : joint.idx_v + joint.n_v] = np.arange(
                    joint.q.start, joint.q.stop
                )
        state = np.concatenate([straight, np.arange(layout.v.start, layout.v.stop)])
        places = []
        numbers = []
        for i, stage in enumerate(memory.stages):
            columns = variables.columns(stage.node)
            n_z = memory.z.shape[1]
            entries = np.concatenate([state, np.full(int(tangent.free), -1)])
            if stage.step:
                entries = np.concatenate(
                    [entries, np.arange(layout.a.start, layout.a.stop), np.full(layout.n_null, -1)]
                )
            if stage.starts_phase is None:
                used = entries >= 0
            else:
                used = np.zeros(len(entries), dtype=bool)
            places.append(np.where(entries >= 0, i * n_z + entries, 0))
            numbers.append(np.where(used, columns[np.maximum(entries, 0)], -1))
            if stage.starts_phase is not None and tangent.free:
                places.append(np.array([(i + 1) * n_z + layout.h]))
                numbers.append(columns[[variables.model.layout.h]])
        return np.concatenate(places), np.concatenate(numbers)

    def _inputs(self) -> Array:
        """Place in x of the thrust or torque of each row of forces, step after step; -1 where it
        has none.
        """
        memory = self.memory
        variables = self.memory.whole.variables
        layout = variables.model.layout
        inputs = memory.forces.inputs
        if not layout.n_thrust + layout.n_torque:
            return np.full(len(inputs) * len(memory.steps), -1)
        first = [
            variables.columns(memory.stages[i].node)[layout.thrust.start] for i in memory.steps
        ]
        return np.concatenate([np.where(inputs >= 0, place + inputs, -1) for place in first])

    def program_multipliers(self, rows: Indices, solution: FlatSolution) -> tuple[Array, Array]:
        """Multipliers (n_x,) [1/unit of x] of bounds and (n_rows,) [1/unit of the row] of rows; 0
        of laws, which nobody loosens.

        rows (m,): which of those that may be held are in the QP that was solved.
        """
        transcription = self.memory.whole
        y = np.zeros(len(self.raw))
        layout = transcription.row_layout
        levels = transcription.ranges().levels
        y[rows] = solution.y[: len(rows)]
        # What has no place is written behind the last one.
        x = np.zeros(transcription.n_x + 1)
        raw = np.zeros(layout.n_rows + 1)
        of_program = np.zeros(transcription.ranges().n_rows)
        x[self._x] = solution.y[len(rows) :]
        x[self._force_x] = y[self.raw < 0]
        x[transcription.variables.columns(0)[: transcription.model.layout.h]] = 0.0
        raw[self.raw] = y
        of_program[: len(layout.constraints)] = raw[layout.constraints]
        for level, held_rows in zip(levels, layout.held, strict=True):
            of_program[level.frozen] = raw[held_rows]
        return x[:-1], of_program

    def force_ranges(self, x_lower: Array, x_upper: Array) -> Array:
        """(2, n) of the limits of forces: those that are variables have bounds x_lower and x_upper
        (n_x,) [unit of x].
        """
        result = np.array([self.force_lower, self.force_upper])
        variable = self._force_x >= 0
        rows = np.flatnonzero(self.raw < 0)[variable]
        places = self._force_x[variable]
        result[:, rows] = [x_lower[places], x_upper[places]]
        return result

    def z_ranges(self, x_lower: Array, x_upper: Array) -> Array:
        """(2, n) of bounds x_lower and x_upper (n_x,) [unit of x]."""
        none = self._x < 0
        return np.array(
            [np.where(none, -np.inf, x_lower[self._x]), np.where(none, np.inf, x_upper[self._x])]
        )

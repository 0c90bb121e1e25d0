"""Numbers of a horizon, stage after stage, at the current point: shared by all levels.

Stages are the steps, the turns from one phase to the next, and the last node. A turn takes no time.
There the rows count that end a phase, and the length of the steps of the next phase is chosen: as a
control, so that it is a state of the steps that follow and couples nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from uvms_ocp.codegen.bound_calls import BoundCalls
from uvms_ocp.codegen.cache_entries import content_of
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.stagewise import functions
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import eliminated_blocks
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.types import Array


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
        """(n_steps,) indices of the stages that take time."""
        n = len(self.stages)
        n_steps = len(self.steps)
        layout = self.tangent.model.layout
        self.z = np.zeros((n, layout.n_z))
        """(n, n_z) the point: z of all stages."""
        self.z_from = np.zeros((n, layout.n_z))
        """(n, n_z) the point from which a step leads."""
        self.n_u = self._control_sizes()
        """(n - 1,) controls of each stage but the last."""
        self.step = np.zeros(n * self.tangent.n_x + sum(self.n_u))
        """States and controls, stage after stage, as those of a QP."""
        self.step_length = np.ones(1)
        """Share of the step that is taken."""
        self.water = np.zeros((n_steps, 3))
        """(n_steps, 3) [m/s] velocity of the water."""
        self.force = np.zeros((n, layout.n_v))
        """(n, n_v) [N, N m] generalised forces."""
        self.force_slope = np.zeros((n, self.tangent.force_slope.nnz()))
        """Nonzeros of the derivatives of forces along states and controls."""
        self.gaps = np.zeros((n - 1, self.tangent.n_x))
        """Defects: by how much each stage ends ahead of the next."""
        self.parameters = [
            np.zeros((len(function.block.nodes), function.block.rows.n_parameters))
            for function in self.functions
        ]
        """Parameters of each block of terms (nodes, n_parameters)."""
        self.thrust = np.zeros((n_steps, self.tangent.model.actuators.matrix.shape[1]))
        """(n_steps, n_thrusters) in shares of the limits, as `find_inputs` leaves it."""
        self.torque = np.zeros((n_steps, problem.robot.n_joints))
        """(n_steps, n_joints) in shares of the limits, as `find_inputs` leaves it."""
        self.group_sizes = [_sizes(self.groups(stage)) for stage in self.stages]
        """Rows of each stage that may be held, group by group."""
        n_held = [sum(sizes) for sizes in self.group_sizes]
        self.held = np.zeros(sum(n_held))
        """Rows that may be held, stage after stage: limits of forces, constraints, then those of
        all levels.
        """
        held_parts = []
        for held, sizes in zip(_split(self.held, n_held), self.group_sizes, strict=True):
            held_parts.append(_split(held, sizes))
        self.held_parts = held_parts
        """Views of `held`, for each stage a list of its groups."""
        self._residuals = [self._level_residuals(i) for i in range(self.n_levels)]
        """For each level its residuals, and views of them for each stage."""
        self.motion, self.motion_linear, self._moved = functions.motion_functions(self.tangent)
        self.evaluate = self._evaluation()
        """Find forces, gaps and rows at the point."""
        self.move = self._move_calls()
        """Go from `z_from` by `step_length` times the step."""
        self.find_inputs = self._input_calls()
        """Find thrust and torque at the point."""

    def residuals(self, level: int) -> Array:
        """Return the residuals of all stages, whose half square is the cost of a level."""
        return self._residuals[level][0]

    def residual_parts(self, level: int) -> list[Array]:
        """Return the residuals of a level, stage by stage."""
        return self._residuals[level][1]

    def function(self, stage: Stage) -> functions.BlockFunctions | None:
        """Return the functions of the rows that count at a stage, if there are any."""
        if stage.block is None:
            return None
        return self.functions[stage.block]

    def groups(self, stage: Stage) -> tuple[functions.HeldRows, ...]:
        """Return the groups of rows of a stage that may be held."""
        function = self.function(stage)
        if function is None:
            return ()
        return function.held

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

    def row_memory(self, i: int) -> list[Array]:
        """Return where the functions of rows at stage i write: residuals, then rows that may be
        held.
        """
        residuals = [self.residual_parts(level)[i] for level in range(self.n_levels)]
        return [*residuals, *self.held_parts[i]]

    def add_forces(self, calls: BoundCalls, *, linear: bool) -> None:
        """Add calls that find the forces, and their slopes where `linear`, of all stages whose rows
        depend on them.
        """
        for i, stage in enumerate(self.stages):
            function = self.function(stage)
            if function is not None and function.forced:
                z, _, water, force, force_slope = self.arguments(i)
                if linear:
                    calls.add(self.tangent.forces[1], [z, water], [force, force_slope])
                else:
                    calls.add(self.tangent.forces[0], [z, water], [force])

    def compile_curvature(self) -> None:
        """Compile what curvature takes before any clock runs: it takes longest."""
        for function in self.functions:
            if function.weights:
                _ = self.tangent.model.force_curvature
            _ = function.curvature

    def _block_functions(self) -> tuple[functions.BlockFunctions, ...]:
        """Return the functions of the blocks: the steps of every phase, then their ends."""
        n_phases = len(self.whole.problem.phases)
        result = []
        for i, block in enumerate(eliminated_blocks(self.whole.blocks, self.tangent.model)):
            is_of_steps = i < n_phases
            is_of_turn = n_phases <= i < 2 * n_phases - 1
            function = functions.BlockFunctions(
                block=block,
                tangent=self.tangent,
                forces=self.forces if is_of_steps else None,
                extra=int(self.tangent.free and is_of_turn),
            )
            result.append(function)
        return tuple(result)

    def _control_sizes(self) -> tuple[int, ...]:
        """Return the number of controls of each stage but the last: at a turn the length of the
        steps that follow.
        """
        sizes = []
        for stage in self.stages[:-1]:
            if stage.step:
                sizes.append(self.tangent.n_u)
            else:
                sizes.append(int(self.tangent.free))
        return tuple(sizes)

    def _level_residuals(self, level: int) -> tuple[Array, list[Array]]:
        """Return memory for the residuals of a level, whole and stage by stage."""
        sizes = []
        for stage in self.stages:
            function = self.function(stage)
            sizes.append(0 if function is None else function.errors[level].n)
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

    def _move_calls(self) -> BoundCalls:
        calls = BoundCalls()
        no_controls = np.zeros(self.tangent.n_u)
        n_x = self.tangent.n_x
        sizes = [n_x + n_u for n_u in (*self.n_u, 0)]
        for i, step in enumerate(_split(self.step, sizes)):
            x = step[:n_x]
            u = step[n_x:] if self.stages[i].step else no_controls
            calls.add(self._moved, [self.z_from[i], x, u, self.step_length], [self.z[i]])
        return calls

    def _input_calls(self) -> BoundCalls:
        calls = BoundCalls()
        model = self.tangent.model
        inputs = [model.z, model.force]
        outputs = [ca.densify(output) for output in model.inputs]
        content = content_of(inputs, outputs)
        function = functions.compile_made("inputs", content, lambda: (inputs, outputs))
        for k, i in enumerate(self.steps):
            calls.add(self.tangent.forces[0], [self.z[i], self.water[k]], [self.force[i]])
        for k, i in enumerate(self.steps):
            calls.add(function, [self.z[i], self.force[i]], [self.thrust[k], self.torque[k]])
        return calls


def _sizes(groups: Iterable[functions.HeldRows]) -> list[int]:
    """Return the number of rows of each group."""
    return [group.n for group in groups]


def _split(flat: Array, sizes: Iterable[int]) -> list[Array]:
    """Return views of such `sizes`, one after the other, of an array."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [flat[first:stop] for first, stop in pairwise(ends)]


@dataclass(frozen=True, kw_only=True, slots=True)
class Stage:
    """A stage of a horizon: a step, a turn from one phase to the next, or the last node."""

    node: int
    """Number of the node whose state the stage has."""
    block: int | None
    """Number of the `TermBlock` whose rows count; None for a turn before the first phase."""
    place: int = 0
    """Index of the node in that block."""
    step: bool = False
    """The stage takes time, and has accelerations."""
    starts_phase: int | None = None
    """Number of the phase that begins; None for stages that are no turn."""


def horizon_stages(problem: OcpProblem) -> tuple[Stage, ...]:
    """Return the stages of a problem, the last node last."""
    starts = problem.starts_of_phases().tolist()
    n_phases = len(problem.phases)
    stages: list[Stage] = []
    for i in range(n_phases):
        if i:
            # The rows of the end of the phase before count here.
            stages.append(Stage(node=starts[i], block=n_phases + i - 1, starts_phase=i))
        elif problem.free_time:
            stages.append(Stage(node=starts[i], block=None, starts_phase=i))
        for node in range(starts[i], starts[i + 1]):
            stages.append(Stage(node=node, block=i, place=node - starts[i], step=True))
    last = Stage(node=starts[n_phases], block=2 * n_phases - 1)
    return (*stages, last)

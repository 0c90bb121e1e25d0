"""Where the numbers of a horizon are, stage after stage, at the point that is looked at: shared by all levels."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.ocp.stagewise.bound_calls import BoundCalls
from uvms_ocp.ocp.stagewise.chain import Stage, chain
from uvms_ocp.ocp.stagewise.stage_functions import (
    BlockFunctions,
    RowGroup,
    compiled,
    force_rows,
    motion_functions,
    moved_function,
)
from uvms_ocp.ocp.stagewise.tangent import Tangent
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import term_blocks
from uvms_ocp.ocp.transcription.transcription import Transcription


class StageMemory:
    """Points, parameters, rows and gaps of all stages, and the calls that move points and find values there."""

    def __init__(self, whole: Transcription) -> None:
        """whole: numbers parameters, variables and rows."""
        problem = whole.problem
        self.whole, self.stages = whole, chain(problem)
        self.tangent = Tangent(model=StageModel(problem, eliminated=True))
        self.forces = force_rows(self.tangent.model)
        self.functions = self._block_functions()
        self.steps = np.array([i for i, stage in enumerate(self.stages) if stage.step])
        n, layout = len(self.stages), self.tangent.model.layout
        self.z, self.z_from = np.zeros((n, layout.n_z)), np.zeros((n, layout.n_z))
        self.x_step, self.u_step = np.zeros((n, self.tangent.n_x)), np.zeros((n, self.tangent.n_u))
        self.share, self.water = np.ones(1), np.zeros((len(self.steps), 3))
        self.gaps = np.zeros((n - 1, self.tangent.n_x))
        """By how much each stage ends ahead of the next."""
        self.parameters = [np.zeros((len(one.block.nodes), one.block.rows.n_parameters)) for one in self.functions]
        self.thrust = np.zeros((len(self.steps), self.tangent.model.actuators.matrix.shape[1]))
        self.torque = np.zeros((len(self.steps), problem.robot.n_joints))
        self.held, self.held_parts = self._rows("held")
        """Rows that may be held, stage after stage: limits of forces, constraints, then those of all levels."""
        self._residuals = [self._level_rows(i) for i in range(self.n_levels)]
        self.motion, self.motion_linear = motion_functions(self.tangent)
        self.evaluate, self.move, self.find_inputs = self._evaluation(), self._moves(), self._inputs()

    @property
    def n_levels(self) -> int:
        return len(self.whole.problem.levels)

    def residuals(self, level: int) -> Array:
        """Of all stages, whose half square is the cost of a level."""
        return self._residuals[level][0]

    def residual_parts(self, level: int) -> list[Array]:
        """The same, stage by stage."""
        return self._residuals[level][1]

    def function(self, stage: Stage) -> BlockFunctions | None:
        return None if stage.block is None else self.functions[stage.block]

    def arguments(self, i: int) -> list[Array]:
        """Of the functions of rows at stage i."""
        stage = self.stages[i]
        assert stage.block is not None
        return [self.z[i], self.parameters[stage.block][stage.place], self.water[min(stage.node, len(self.water) - 1)]]

    def _block_functions(self) -> tuple[BlockFunctions, ...]:
        problem, free = self.whole.problem, self.tangent.free
        n = len(problem.phases)
        return tuple(
            BlockFunctions(
                block=block,
                tangent=self.tangent,
                forces=self.forces if i < n else None,
                extra=int(free and n <= i < 2 * n - 1),
            )
            for i, block in enumerate(term_blocks(self.tangent.model))
        )

    def compile_curvature(self) -> None:
        """Before any clock runs: it takes longest."""
        for function in self.functions:
            _ = function.bend, function.curvature

    def groups(self, stage: Stage) -> tuple[RowGroup, ...]:
        """Rows of a stage that may be held."""
        function = self.function(stage)
        return () if function is None else function.held

    def _rows(self, kind: str) -> tuple[Array, list[list[Array]]]:
        sizes = [[group.n for group in self.groups(stage)] for stage in self.stages]
        flat = np.zeros(sum(map(sum, sizes)))
        return flat, [_split(part, own) for part, own in zip(_split(flat, map(sum, sizes)), sizes, strict=True)]

    def _level_rows(self, level: int) -> tuple[Array, list[Array]]:
        found = [self.function(stage) for stage in self.stages]
        sizes = [0 if function is None else function.errors[level].n for function in found]
        flat = np.zeros(sum(sizes))
        return flat, _split(flat, sizes)

    def _evaluation(self) -> BoundCalls:
        calls = BoundCalls()
        for i, stage in enumerate(self.stages):
            if stage.step:
                calls.add(self.motion, [self.z[i], self.z[i + 1]], [self.gaps[i]])
            function = self.function(stage)
            if function is not None:
                calls.add(function.values, self.arguments(i), self.row_memory(i))
        return calls

    def row_memory(self, i: int) -> list[Array]:
        """Results of the functions of rows at stage i: residuals, then rows that may be held."""
        return [*(self.residual_parts(level)[i] for level in range(self.n_levels)), *self.held_parts[i]]

    def _moves(self) -> BoundCalls:
        calls, function = BoundCalls(), moved_function(self.tangent)
        for i in range(len(self.stages)):
            calls.add(function, [self.z_from[i], self.x_step[i], self.u_step[i], self.share], [self.z[i]])
        return calls

    def _inputs(self) -> BoundCalls:
        calls, model = BoundCalls(), self.tangent.model
        function = compiled("inputs", [model.z, model.water], self.tangent.expanded(model.inputs))
        for k, i in enumerate(self.steps):
            calls.add(function, [self.z[i], self.water[k]], [self.thrust[k], self.torque[k]])
        return calls


def _split(flat: Array, sizes: object) -> list[Array]:
    ends = np.cumsum([0, *sizes]).tolist()  # type: ignore[misc]
    return [flat[first:stop] for first, stop in pairwise(ends)]

"""From the variables of a program to the points of all stages and back."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.ocp.stagewise.stage_memory import StageMemory


class StagePoint:
    """Reads and writes `StageMemory.z`."""

    def __init__(self, memory: StageMemory) -> None:
        self._memory, self._variables = memory, memory.whole.variables
        self._nodes = np.array([stage.node for stage in memory.stages])
        self._ends = np.array([stage.turn_to is not None for stage in memory.stages])

    def set_parameters(self, p: Array) -> None:
        """p (n_p,) [unit of the parameter]: those of `Transcription.parameters`."""
        memory, layout = self._memory, self._memory.whole.parameter_layout
        memory.water[...] = p[layout.water].reshape(-1, 3)
        for own, place in zip(memory.parameters, layout.terms, strict=True):
            own[...] = p[place].reshape(own.shape)

    def read(self, x: Array, p: Array) -> None:
        """Take variables x (n_x,) [unit of x], with the start and the lengths of steps of p (n_p,) [unit of the parameter]."""
        memory, variables, layout = self._memory, self._variables, self._memory.tangent.model.layout
        source, n, N = variables.model.layout, variables.n_step, variables.N
        steps, column = x[: N * n].reshape(N, n), variables.columns(0)
        state = np.vstack([steps[:, : source.h], x[N * n : N * n + source.h]])
        memory.z[:, : layout.h] = state[self._nodes]
        h = steps[:, column[source.h]] if variables.free else p[memory.whole.parameter_layout.steps]
        memory.z[memory.steps, layout.h] = h
        memory.z[memory.steps, layout.a] = steps[:, column[source.a]]
        if source.n_thrust:
            memory.z[memory.steps, layout.null] = steps[:, column[source.thrust]] @ memory.tangent.model.actuators.null
        self._set_start(p)

    def _set_start(self, p: Array) -> None:
        memory, layout = self._memory, self._memory.tangent.model.layout
        memory.z[self._nodes == 0, : layout.h] = p[memory.whole.parameter_layout.start]

    def write(self) -> Array:
        """Variables (n_x,) [unit of x] of the points."""
        memory, variables, layout = self._memory, self._variables, self._memory.tangent.model.layout
        target, n, N = variables.model.layout, variables.n_step, variables.N
        x, z, column = np.zeros(variables.n_x), memory.z[memory.steps], variables.columns(0)
        steps = x[: N * n].reshape(N, n)
        steps[:, : target.h], steps[:, column[target.a]] = z[:, : layout.h], z[:, layout.a]
        x[N * n : N * n + target.h] = memory.z[-1, : layout.h]
        if variables.free:
            steps[:, column[target.h]] = z[:, layout.h]
            x[N * n + target.h] = z[-1, layout.h]
        if target.n_thrust + target.n_torque:
            memory.find_inputs()
            steps[:, column[target.thrust]], steps[:, column[target.torque]] = memory.thrust, memory.torque
        return x

"""From the variables of a program to the points of all stages and back."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.stagewise.memory import StageMemory
from uvms_ocp.types import Array


class StageVariables:
    """Reads variables and parameters of a program into a `StageMemory`, and writes variables."""

    def __init__(self, memory: StageMemory) -> None:
        self._memory = memory
        self._variables = memory.whole.variables
        self._nodes = np.array([stage.node for stage in memory.stages])
        """(n,) number of the node of each stage."""

    def set_parameters(self, p: Array) -> None:
        """Take parameters p (n_p,) [unit of the parameter]: those of `Transcription.parameters`."""
        memory = self._memory
        layout = memory.whole.parameter_layout
        memory.water[...] = p[layout.water].reshape(-1, 3)
        for block_parameters, place in zip(memory.parameters, layout.terms, strict=True):
            block_parameters[...] = p[place].reshape(block_parameters.shape)

    def read(self, x: Array, p: Array) -> None:
        """Take variables x (n_x,) [unit of x], with the start and the lengths of steps of p (n_p,)
        [unit of the parameter].
        """
        memory = self._memory
        variables = self._variables
        parameters = memory.whole.parameter_layout
        target = memory.tangent.model.layout
        source = variables.model.layout
        n = variables.n_step
        N = variables.N
        steps = x[: N * n].reshape(N, n)
        last_state = x[N * n : N * n + source.h]
        states = np.vstack([steps[:, : source.h], last_state])
        memory.z[:, : target.h] = states[self._nodes]
        column = variables.columns(0)
        if variables.free:
            memory.z[memory.steps, target.h] = steps[:, column[source.h]]
        else:
            memory.z[memory.steps, target.h] = p[parameters.steps]
        memory.z[memory.steps, target.a] = steps[:, column[source.a]]
        if source.n_thrust:
            thrust = steps[:, column[source.thrust]]
            memory.z[memory.steps, target.null] = thrust @ memory.tangent.model.actuators.null
        memory.z[self._nodes == 0, : target.h] = p[parameters.start]

    def write(self) -> Array:
        """Return the variables (n_x,) [unit of x] of the points."""
        memory = self._memory
        variables = self._variables
        source = memory.tangent.model.layout
        target = variables.model.layout
        n = variables.n_step
        N = variables.N
        x = np.zeros(variables.n_x)
        steps = x[: N * n].reshape(N, n)  # a view
        z = memory.z[memory.steps]
        column = variables.columns(0)
        steps[:, : target.h] = z[:, : source.h]
        steps[:, column[target.a]] = z[:, source.a]
        x[N * n : N * n + target.h] = memory.z[-1, : source.h]
        if variables.free:
            steps[:, column[target.h]] = z[:, source.h]
            x[N * n + target.h] = z[-1, source.h]
        if target.n_thrust + target.n_torque:
            memory.find_inputs()
            steps[:, column[target.thrust]] = memory.thrust
            steps[:, column[target.torque]] = memory.torque
        return x

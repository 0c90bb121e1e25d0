"""The plant's part of a tick: it moves by the last command. Plants of the toolkit are kernels, those
of a user are asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from uvms_ocp.codegen.kernel_layout import arrays_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import Source, Step
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.signals import Command, State
from uvms_ocp.sim import loop_kernels as kernels
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.plant import KinematicPlant, Plant
from uvms_ocp.sim.sensors import NO_ACCELERATION
from uvms_ocp.sim.series_of_objects import SeriesOfObjects

LastCommand = Callable[[], Command]
"""Returns what the controller asked for at the tick before."""


class PlantSteps(Protocol):
    """The plant of a run, as steps of its ticks."""

    def state(self) -> State:
        """Return the true state that the plant has come to. Raises what the surroundings raise."""

    def steps(self, last_command: LastCommand | None) -> list[Step]:
        """Return the steps. last_command: asked before each motion; `None` where kernels of the
        controller write into the plant's memory.
        """

    def begin(self) -> bool:
        """Prepare for ticks, with the faults that there are now; return whether the steps are others
        than before.
        """

    def quiet_ticks(self) -> float:
        """Count the ticks for which `begin` is not needed again."""

    def sources(self) -> dict[str, Source]:
        """Return the telemetry of the plant, in memory."""


class KernelPlant:
    """A plant of the toolkit, which moves as a kernel."""

    def __init__(
        self, loop: kernels.LoopMemory, plant: DynamicPlant | KinematicPlant, dt: float
    ) -> None:
        """dt [s]: control period."""
        self.plant = plant
        self._loop = loop
        self._dt = dt

    def state(self) -> State:
        self.plant.adopt()
        return self.plant.state

    def steps(self, last_command: LastCommand | None) -> list[Step]:
        loop = self._loop
        plant = self.plant
        move: Callable[..., None] = kernels.move_kinematic
        if isinstance(plant, DynamicPlant):
            move = kernels.move_plant
        (kernel,) = bind_kernels(
            (move,), (type(loop), type(plant.memory)), compiled=plant.is_compiled
        )
        moving = Step("move", kernel, (loop, plant.memory))
        if last_command is None:
            return [moving]
        command_of = last_command

        def obey() -> None:
            if loop.started and not loop.ahead:
                plant.ask(command_of())

        return [Step("obey", obey), moving]

    def begin(self) -> bool:
        before = self.plant.memory
        self.plant.begin(self._dt)
        return self.plant.memory is not before

    def quiet_ticks(self) -> float:
        t = self.plant.memory.t
        next_change = math.inf
        for fault in self.plant.faults:
            for change in (fault.onset, fault.end):
                if t < change < next_change:
                    next_change = change
        if next_change == math.inf:
            return math.inf
        return max(1, int((next_change - t) / self._dt))

    def sources(self) -> dict[str, Source]:
        return {**self.plant.telemetry_in_memory()}


class OwnPlant:
    """A plant of a user, which is asked."""

    def __init__(
        self, loop: kernels.LoopMemory, plant: Plant, dt: float, *, accelerates: bool
    ) -> None:
        """dt [s]: control period. accelerates: a kernel reads the acceleration."""
        self._plant = plant
        self._loop = loop
        self._dt = dt
        self._accelerates = accelerates
        self._telemetry = SeriesOfObjects()

    def state(self) -> State:
        return self._plant.state

    def steps(self, last_command: LastCommand | None) -> list[Step]:
        assert last_command is not None
        command_of = last_command
        loop = self._loop
        plant = self._plant
        arrays = arrays_of(loop)

        def move() -> None:
            if loop.started and not loop.ahead:
                plant.step(command_of(), self._dt)
            state = plant.state
            arrays.q[:] = state.q
            arrays.v[:] = state.v
            if state.a is not None:
                arrays.a[:] = state.a
            elif self._accelerates:
                raise InvalidInput(NO_ACCELERATION)
            if not loop.ahead:
                self._telemetry.write(plant.telemetry())

        (begin,) = bind_kernels((kernels.begin_tick,), (type(loop),))
        return [Step("move", move), Step("begin", begin, (loop,))]

    def begin(self) -> bool:
        return False

    def quiet_ticks(self) -> float:
        return math.inf

    def sources(self) -> dict[str, Source]:
        return {**self._telemetry.arrays}

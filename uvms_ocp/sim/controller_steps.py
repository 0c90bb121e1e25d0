"""The controller's part of a tick: an estimate to a command. The toolkit's controllers are kernels, as
far as no task, solver or guide of theirs is in Python; others are asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from uvms_ocp.codegen.kernel_layout import arrays_of, view
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import LOOK, Elapsed, Source, Step
from uvms_ocp.control import DynamicController, KinematicController
from uvms_ocp.control.force.tick import ask_forces
from uvms_ocp.control.velocity.tick import is_blind, is_stopped
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.robot.signals import Command, StateEstimate, unchecked_command
from uvms_ocp.sim import loop_kernels as kernels
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.estimator_steps import EstimatorSteps
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.sim.series_of_objects import SeriesOfObjects


class ControllerSteps(Protocol):
    """The controller of a run, as steps of its ticks."""

    gives: bool
    """True where kernels write what it asks for into the plant's memory."""

    def steps(self) -> list[Step]:
        """Return the steps."""

    def command(self) -> Command:
        """Return what it asked for at the newest tick; of kernels without telemetry."""

    def quiet_ticks(self) -> float:
        """Count the ticks for which `look` is not needed, however little happens."""

    def look(self, ticks: int) -> None:
        """Take note of what kernels have done in so many ticks, the last of which may have ended
        with an event.
        """

    def is_over(self) -> bool:
        """Check whether the run ends with the newest tick."""

    def command_sources(self, *, has_thrusters: bool) -> dict[str, Source]:
        """Return the series of what was asked for, in memory; has_thrusters: also of thrust."""

    def sources(self) -> dict[str, Source]:
        """Return the telemetry, in memory, and the time that the controller took."""


class KernelController:
    """A controller of the toolkit as kernels."""

    def __init__(
        self,
        loop: kernels.LoopMemory,
        controller: DynamicController | KinematicController,
        guarded: GuardedEstimator,
        estimator: EstimatorSteps,
        plant: DynamicPlant | KinematicPlant | None,
    ) -> None:
        """guarded: estimator, whose monitor's memory is read. plant: that of the toolkit which takes
        what this controller asks for; `None` for another one, which is asked to.
        """
        self._loop = loop
        self._controller = controller
        self._kinematic = controller.kinematic
        self._guarded = guarded
        self._estimator = estimator
        self._plant = plant
        self.gives = plant is not None
        self._verdicts = self._copied_verdicts()
        tick = self._kinematic.memory
        self._tick = arrays_of(tick)

    def steps(self) -> list[Step]:
        loop = self._loop
        health = self._guarded.monitor.memory
        tick = self._kinematic.memory
        memories = (loop, health, self._guarded.support, tick)
        (inform,) = bind_kernels((kernels.inform_controller,), map(type, memories))
        own_steps = self._kinematic.steps()
        assert own_steps is not None
        prepare, solve = own_steps
        informing = Step("inform", inform, memories)
        preparing = Step("prepare", prepare[0], prepare[1:])
        solving = Step("solve", solve[0], solve[1:])
        plant = self._plant
        controller = self._controller
        if isinstance(controller, DynamicController):
            force = controller.memory
            hear, ask, end = bind_kernels(
                (kernels.feed_back, ask_forces, kernels.end_force_tick),
                map(type, (loop, tick, force)),
            )
            steps = [
                informing,
                preparing,
                Step("hear_forces", hear, (loop, tick, force)),
                solving,
                Step("ask_forces", ask, (tick, force)),
                Step("force", controller.force.kernel, (force,)),
                Step("end", end, (loop, tick, force)),
            ]
            if isinstance(plant, DynamicPlant):
                memory = plant.memory
                (give,) = bind_kernels(
                    (kernels.give_forces,),
                    (type(force), type(memory)),
                    compiled=plant.is_compiled,
                )
                steps.insert(-1, Step("give", give, (force, memory)))
            return steps
        (end,) = bind_kernels((kernels.end_velocity_tick,), map(type, (loop, tick)))
        steps = [informing, preparing, solving, Step("end", end, (loop, tick))]
        if isinstance(plant, KinematicPlant):
            (give,) = bind_kernels((kernels.give_velocity,), map(type, (tick, plant.memory)))
            steps.insert(-1, Step("give", give, (tick, plant.memory)))
        return steps

    def command(self) -> Command:
        tick = self._kinematic.memory
        command = unchecked_command(
            v=self._tick.command.copy(),
            hold=bool(is_blind(tick)),
            stop=bool(is_stopped(tick)),
            brakes=bool(self._loop.braked),
            finished=self._kinematic.state.over,
        )
        controller = self._controller
        if not isinstance(controller, DynamicController):
            return command
        outputs = controller.force.places()
        return unchecked_command(
            v=command.v,
            hold=command.hold,
            stop=command.stop,
            brakes=command.brakes,
            finished=command.finished,
            thrust=outputs["command"].copy(),
            torque=outputs["torque"].copy(),
        )

    def quiet_ticks(self) -> float:
        return self._kinematic.quiet_ticks

    def look(self, ticks: int) -> None:
        loop = self._loop
        kinematic = self._kinematic
        controller = self._controller
        if loop.stop != LOOK:
            kinematic.look_for_swings(loop.t, ticks)
            return
        estimate = self._estimator.estimate()
        if isinstance(controller, DynamicController):
            n_limits = controller.memory.allocation.count
            limited = tuple(i for i in range(n_limits) if loop.at_limits[i])
            controller.catch_up(estimate, loop.t, ticks, limited)
        else:
            controller.catch_up(estimate, loop.t, ticks)
        loop.verdict = kinematic.watchdog.verdict
        for name, value in self._copied_verdicts().items():
            self._verdicts[name][...] = value

    def is_over(self) -> bool:
        return self._kinematic.state.over

    def command_sources(self, *, has_thrusters: bool) -> dict[str, Source]:
        sources: dict[str, Source] = {"command": self._tick.command}
        if has_thrusters and isinstance(self._controller, DynamicController):
            sources["asked_thrust"] = self._controller.force.places()["command"]
        return sources

    def sources(self) -> dict[str, Source]:
        sources = self._kinematic.series(
            solve_time=Elapsed("solve", "solve"), tick_time=Elapsed("prepare", "solve")
        )
        if isinstance(self._controller, DynamicController):
            sources |= self._controller.force_series() | self._verdicts
        sources["controller_time"] = Elapsed("prepare", "end")
        return sources

    def _copied_verdicts(self) -> dict[str, np.ndarray]:
        """Return copies of the verdicts of the monitor of thrusters and joints."""
        monitor = getattr(self._controller, "monitor", None)
        if monitor is None:
            return {}
        return {name: np.array(value) for name, value in monitor.telemetry().items()}


class OwnController:
    """A controller that is asked: a user's own, or one of the toolkit with a part in Python."""

    gives = False

    def __init__(
        self,
        loop: kernels.LoopMemory,
        controller: Callable[[StateEstimate, float], Command],
        estimator: EstimatorSteps,
    ) -> None:
        self._loop = loop
        self._controller = controller
        self._estimator = estimator
        self._events: Any = getattr(getattr(controller, "kinematic", None), "events", ())
        self._n_events = len(self._events)
        self._command: Command | None = None
        self._v = SeriesOfObjects()
        self._thrust = SeriesOfObjects()
        self._telemetry = SeriesOfObjects()
        self._commanded = view(loop.commanded)

    def steps(self) -> list[Step]:
        return [Step("control", self._control)]

    def command(self) -> Command:
        assert self._command is not None
        return self._command

    def quiet_ticks(self) -> float:
        return math.inf

    def look(self, ticks: int) -> None:
        pass

    def is_over(self) -> bool:
        return self._command is not None and self._command.finished

    def command_sources(self, *, has_thrusters: bool) -> dict[str, Source]:
        thrust = self._thrust.arrays if has_thrusters else {}
        return {**self._v.arrays, **thrust}

    def sources(self) -> dict[str, Source]:
        return {**self._telemetry.arrays}

    def _control(self) -> None:
        loop = self._loop
        estimate = self._estimator.estimate()
        begin = perf_counter()
        command = self._controller(estimate, loop.t)
        spent = perf_counter() - begin
        self._command = command
        self._v.write({"command": command.v})
        thrust: Any = command.thrust
        if thrust is None and self._thrust.arrays:  # such as with the last command of a run
            thrust = 0.0
        if thrust is not None:
            self._thrust.write({"asked_thrust": thrust})
        telemetry = dict(command.telemetry)
        telemetry.setdefault("controller_time", spent)  # one that measures itself knows better
        self._telemetry.write(telemetry)
        loop.started = True
        loop.braked = command.brakes
        if command.v.shape == self._commanded.shape:
            self._commanded[:] = command.v
        if command.finished or len(self._events) > self._n_events:
            self._n_events = len(self._events)
            loop.stop = LOOK

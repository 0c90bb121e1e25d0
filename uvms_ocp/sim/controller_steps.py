"""The controller's part of a tick: an estimate to a command. The toolkit's controllers are kernels, as
far as no task, solver or guide of theirs is in Python; others are asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.codegen.kernel_layout import arrays_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import LOOK, Elapsed, Source, Step
from uvms_ocp.control import DynamicController, KinematicController
from uvms_ocp.control.external import SupervisedController
from uvms_ocp.errors import InvalidInput
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
        self._forces = dict[str, np.ndarray]()
        if isinstance(controller, DynamicController):
            self._forces = controller.force.places()

    def steps(self) -> list[Step]:
        loop = self._loop
        health = self._guarded.monitor.memory
        tick = self._kinematic.memory
        memories = (loop, health, self._guarded.support, tick)
        (inform,) = bind_kernels((kernels.inform_controller,), map(type, memories))
        informing = Step("inform", inform, memories)
        velocity_steps = self._kinematic.steps()
        assert velocity_steps is not None
        *preparing, solving = velocity_steps
        plant = self._plant
        controller = self._controller
        if isinstance(controller, DynamicController):
            force = controller.memory
            hear, end = bind_kernels(
                (kernels.feed_back, kernels.end_force_tick), map(type, (loop, tick, force))
            )
            steps = [
                informing,
                *preparing,
                Step("hear_forces", hear, (loop, tick, force)),
                solving,
                *controller.steps(),
            ]
            if isinstance(plant, DynamicPlant):
                memory = plant.memory
                (give,) = bind_kernels(
                    (kernels.give_forces,),
                    (type(force), type(memory)),
                    compiled=plant.is_compiled,
                )
                steps.append(Step("give", give, (force, memory)))
            return [*steps, Step("end", end, (loop, tick, force))]
        (end,) = bind_kernels((kernels.end_velocity_tick,), map(type, (loop, tick)))
        steps = [informing, *preparing, solving]
        if isinstance(plant, KinematicPlant):
            (give,) = bind_kernels((kernels.give_velocity,), map(type, (tick, plant.memory)))
            steps.append(Step("give", give, (tick, plant.memory)))
        return [*steps, Step("end", end, (loop, tick))]

    def command(self) -> Command:
        command = unchecked_command(
            v=self._tick.command.copy(),
            hold=bool(self._loop.blind),
            stop=bool(self._loop.stopped),
            brakes=bool(self._loop.braked),
            finished=self._kinematic.state.over,
        )
        if not self._forces:
            return command
        thrust = self._forces["command"].copy()
        return replace_unchecked(command, thrust=thrust, torque=self._forces["torque"].copy())

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
        if has_thrusters and self._forces:
            sources["asked_thrust"] = self._forces["command"]
        return sources

    def sources(self) -> dict[str, Source]:
        sources = self._kinematic.series(clocked=True)
        if isinstance(self._controller, DynamicController):
            sources |= self._controller.force_series() | self._verdicts
            sources |= self._controller.load_series()
        sources["controller_time"] = Elapsed("prepare", "end")
        return sources

    def _copied_verdicts(self) -> dict[str, np.ndarray]:
        """Return copies of the verdicts of the monitor of thrusters and joints."""
        monitor = getattr(self._controller, "monitor", None)
        if monitor is None:
            return {}
        return {name: np.array(value) for name, value in monitor.telemetry().items()}


class SupervisedSteps:
    """A user's own controller, which is asked, and the mission that supervises it, as kernels."""

    gives = False

    def __init__(
        self,
        loop: kernels.LoopMemory,
        controller: SupervisedController,
        guarded: GuardedEstimator,
        estimator: EstimatorSteps,
    ) -> None:
        """guarded: estimator, whose monitor's memory is read."""
        self._loop = loop
        self._controller = controller
        self._mission = KernelController(loop, controller.kinematic, guarded, estimator, None)
        self._estimator = estimator
        self._commands = CommandSeries(loop)

    def steps(self) -> list[Step]:
        *following, end = self._mission.steps()
        return [*following, end, Step("control", self._control)]

    def command(self) -> Command:
        return replace_unchecked(self._commands.newest(), finished=self.is_over())

    def quiet_ticks(self) -> float:
        return self._mission.quiet_ticks()

    def look(self, ticks: int) -> None:
        self._mission.look(ticks)

    def is_over(self) -> bool:
        return self._mission.is_over() or self._commands.newest().finished

    def command_sources(self, *, has_thrusters: bool) -> dict[str, Source]:
        return self._commands.sources(has_thrusters=has_thrusters)

    def sources(self) -> dict[str, Source]:
        followed = self._controller.kinematic.series(clocked=True)
        return followed | self._controller.times | self._commands.telemetry()

    def _control(self) -> None:
        command = self._controller.ask(self._estimator.estimate(), self._loop.t)
        self._commands.write(command, command.telemetry)


class OwnController:
    """A controller that is asked: any callable, or one of the toolkit with a guide."""

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
        self._commands = CommandSeries(loop)

    def steps(self) -> list[Step]:
        return [Step("control", self._control)]

    def command(self) -> Command:
        return self._commands.newest()

    def quiet_ticks(self) -> float:
        return math.inf

    def look(self, ticks: int) -> None:
        pass

    def is_over(self) -> bool:
        return self.command().finished

    def command_sources(self, *, has_thrusters: bool) -> dict[str, Source]:
        return self._commands.sources(has_thrusters=has_thrusters)

    def sources(self) -> dict[str, Source]:
        return self._commands.telemetry()

    def _control(self) -> None:
        estimate = self._estimator.estimate()
        begin = perf_counter()
        command = self._controller(estimate, self._loop.t)
        spent = perf_counter() - begin
        telemetry = dict(command.telemetry)
        telemetry.setdefault("controller_time", spent)  # one that measures itself knows better
        self._commands.write(command, telemetry)
        if len(self._events) > self._n_events:
            self._n_events = len(self._events)
            self._loop.stop = LOOK


class CommandSeries:
    """Commands of a controller that is asked, as series in memory, and for the rest of the loop."""

    def __init__(self, loop: kernels.LoopMemory) -> None:
        self._loop = loop
        self._commanded: np.ndarray = arrays_of(loop).commanded
        self._newest: Command | None = None
        self._v = SeriesOfObjects()
        self._thrust = SeriesOfObjects()
        self._telemetry = SeriesOfObjects()

    def newest(self) -> Command:
        """Return the newest command."""
        assert self._newest is not None
        return self._newest

    def write(self, command: Command, telemetry: Mapping[str, Any]) -> None:
        """Take down the command of a tick, and its telemetry."""
        loop = self._loop
        self._newest = command
        self._v.write({"command": command.v})
        thrust: Any = command.thrust
        if thrust is None and self._thrust.arrays:  # such as with the last command of a run
            thrust = 0.0
        if thrust is not None:
            self._thrust.write({"asked_thrust": thrust})
        self._telemetry.write(telemetry)
        loop.started = True
        loop.braked = command.brakes
        if command.v.shape != self._commanded.shape:
            raise InvalidInput(
                f"the command's v has shape {command.v.shape}; give {self._commanded.shape}"
            )
        self._commanded[:] = command.v
        if command.finished:
            loop.stop = LOOK

    def sources(self, *, has_thrusters: bool) -> dict[str, Source]:
        """Return the series of what was asked for; has_thrusters: also of thrust."""
        thrust = self._thrust.arrays if has_thrusters else {}
        return {**self._v.arrays, **thrust}

    def telemetry(self) -> dict[str, Source]:
        """Return the series of the telemetry."""
        return {**self._telemetry.arrays}

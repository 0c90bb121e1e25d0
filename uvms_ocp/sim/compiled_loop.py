"""Simulate the closed loop in machine code where all of its parts are the toolkit's: Python looks
at events, not at ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from uvms_ocp.codegen.kernel_layout import arrays_of, assign, structure_of, view
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import Elapsed, KernelSequence, Step, compiles
from uvms_ocp.control import DynamicController, KinematicController
from uvms_ocp.control.force.tick import ask_forces
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.filter_memory import NUMBER
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.robot.signals import CHANNELS, State
from uvms_ocp.sim import loop_kernels as kernels
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.sim.sampling import N_DRAWN
from uvms_ocp.sim.sensors import SensorSuite

Sources = dict[str, np.ndarray | Elapsed]
"""Arrays of the memory that hold each series of a row."""
Watch = Callable[[float, State], None]
"""Callback with time [s] and true state after events, and every few ticks."""
_FLAGS = ("brakes", "saturated")
_CODES = ("health", "thruster_health", "joint_health")


class CompiledLoop:
    """Plant, sensors, estimator and controller, whose kernels are called one after the other for
    many ticks.
    """

    def __init__(
        self,
        plant: DynamicPlant | KinematicPlant,
        sensors: SensorSuite,
        estimator: GuardedEstimator,
        controller: DynamicController | KinematicController,
        dt: float,
    ) -> None:
        """dt [s]: control period."""
        self._plant = plant
        self._sensors = sensors
        self._estimator = estimator
        self._controller = controller
        self._dt = dt
        robot = controller.kinematic.robot
        width = len(sensors.memory.channels[0].value)
        n_thrusters = len(robot.description.thrusters)
        sizes = {
            "n_q": robot.n_q,
            "n_v": robot.n_v,
            "n_thrusters": n_thrusters,
            "n_measured": width + 1,
        }
        self.memory = structure_of(kernels.LoopMemory, **sizes)()
        """Memory through which the parts pass values to each other."""
        has_range = getattr(estimator.estimator, "has_range", True)
        numbers = [NUMBER[name] for name in CHANNELS]
        assign(
            self.memory,
            dt=dt,
            n_vehicle=robot.n_vehicle,
            number=numbers,
            has_range=has_range,
            range=np.nan,
        )
        self.steps: Sequence[Step] | None = self._steps()
        """Kernels of a tick with their memories; `None` where Python takes part."""

    def run(
        self,
        n_ticks: int,
        recorder: Recorder,
        recorded_channels: Mapping[str, int],
        watch: Watch,
        stops: Sequence[object],
    ) -> None:
        """Run so many ticks, or until the mission is over, the plant diverges, or there are stops.

        recorded_channels: channels whose new readings are recorded, and how many numbers each has.
        """
        memory = self.memory
        plant = self._plant
        kinematic = self._controller.kinematic
        verdicts = self._verdicts()
        sources = self._sources(recorded_channels, verdicts)
        steps = self.steps or ()
        sequence = KernelSequence(steps, _field(memory, "stop"))
        examples = {name: _example(name, source) for name, source in sources.items()}
        sequence.write_rows(sources, recorder.block(examples))
        n_rows = 0  # that are written
        n_watched = 0  # ticks that Python has looked at: one more where the last is to be written
        while n_rows < n_ticks:
            plant.begin(self._dt)
            ending = kinematic.state.over or bool(stops)
            last_waits = n_watched > n_rows
            if ending and n_rows and not last_waits:
                break
            n_possible = min(
                n_ticks - n_rows, recorder.room, kinematic.quiet_ticks, self._ticks_to_fault()
            )
            self._sensors.draw_ahead(n_possible)
            memory.stop = kernels.GO
            n_passes = 1 if ending else n_possible
            written = sequence.run(n_passes, recorder.place, done=last_waits)
            self._sensors.check()
            plant.adopt()
            n_rows += written
            if memory.stop != kernels.DIVERGED and memory.k + 1 > n_watched:
                self._look(memory.k + 1 - n_watched, verdicts)
                n_watched = memory.k + 1
                watch(memory.t, plant.state)
            recorder.filled(written)
            if memory.stop == kernels.DIVERGED:
                return
        if not (stops or kinematic.state.over):
            plant.begin(self._dt)
            move, *memories = steps[0]
            move(*memories)
            plant.adopt()

    def _look(self, ticks: int, verdicts: Mapping[str, np.ndarray]) -> None:
        """Have Python note what kernels have done in so many ticks, the verdicts of `_verdicts`
        included.
        """
        memory = self.memory
        controller = self._controller
        if memory.stop == kernels.GO:
            controller.kinematic.look_for_swings(memory.t, ticks)
            return
        if memory.news:
            self._estimator.monitor.publish(memory.t)
        estimate = self._estimator.estimate()
        if isinstance(controller, DynamicController):
            n_limits = controller.memory.allocation.count
            limited = tuple(i for i in range(n_limits) if memory.at_limits[i])
            controller.catch_up(estimate, memory.t, ticks, limited)
        else:
            controller.catch_up(estimate, memory.t, ticks)
        memory.verdict = controller.kinematic.watchdog.verdict
        for name, value in self._verdicts().items():
            verdicts[name][...] = value

    def _ticks_to_fault(self) -> int:
        """Count the ticks in which the plant's faults stay as they are."""
        t = self._plant.memory.t
        next_change = np.inf
        for fault in self._plant.faults:
            for change in (fault.onset, fault.end):
                if t < change < next_change:
                    next_change = change
        if next_change == np.inf:
            return N_DRAWN
        return max(1, int((next_change - t) / self._dt))

    def _steps(self) -> Sequence[Step] | None:
        """Return the kernels of a tick in their order, each with its memories."""
        m = self.memory
        estimator = self._estimator
        controller = self._controller
        p = self._plant.memory
        monitor = estimator.monitor
        inner = estimator.estimator
        s = self._sensors.memory
        c = controller.kinematic.memory
        h = monitor.memory
        u = estimator.support
        solving = controller.kinematic.steps()
        if solving is None:
            return None
        screen, finish, repeat = monitor.ticks
        has_forces = isinstance(controller, DynamicController)
        move_kernel = kernels.move_plant if has_forces else kernels.move_kinematic
        estimating: list[Step]
        if isinstance(inner, Estimator):
            f = inner.structure
            move, sense, feed, note = bind_kernels(
                (move_kernel, kernels.sense, kernels.feed_filter, kernels.note_estimate),
                map(type, (m, p, s, h, f)),
            )
            estimating = [
                (screen, h),
                (feed, m, s, h, f),
                (inner.tick, f),
                (note, m, h, f),
                (finish, h, u, estimator.outcomes),
            ]
        else:
            move, sense, repeat_range = bind_kernels(
                (move_kernel, kernels.sense, kernels.repeat_range), map(type, (m, p, s, h))
            )
            estimating = [(repeat, h, u, estimator.repeated), (repeat_range, m, h)]
        prepare, solve = solving
        if isinstance(controller, DynamicController):
            F = controller.memory
            inform, feed_back, ask, give = bind_kernels(
                (kernels.inform_controller, kernels.feed_back, ask_forces, kernels.command_plant),
                map(type, (m, h, u, c, F, p)),
            )
            controlling = [
                prepare,
                (feed_back, m, c, F),
                solve,
                (ask, c, F),
                (controller.force.kernel, F),
                (give, m, c, F, p),
            ]
        else:
            inform, give = bind_kernels(
                (kernels.inform_controller, kernels.command_kinematic), map(type, (m, h, u, c, p))
            )
            controlling = [prepare, solve, (give, m, c, p)]
        return [(move, m, p), (sense, m, s, h), *estimating, (inform, m, h, u, c), *controlling]

    def _sources(
        self, recorded_channels: Mapping[str, int], verdicts: Mapping[str, np.ndarray]
    ) -> Sources:
        """Return the series of a row, in the order of `simulate`. verdicts: the copies that
        `_verdicts` has made, which are brought up to date.
        """
        memory = self.memory
        kinematic = self._controller.kinematic
        memory_memory = self._estimator.monitor.memory
        assert self.steps is not None
        controller: Any = kinematic.whole
        tick = arrays_of(kinematic.memory)
        controller = arrays_of(controller)
        step_kernels = [step[0] for step in self.steps]
        first, solver = (step_kernels.index(step[0]) for step in kinematic.steps() or ())
        m = arrays_of(memory)
        estimate = arrays_of(memory_memory.now)
        measured = view(memory.measured)
        sources: Sources = {}
        for name, n in recorded_channels.items():
            require_kept(name, memory_memory.channels[NUMBER[name]].size, n)
            sources[f"measured_{name}"] = measured[NUMBER[name], : n + 1]
        if recorded_channels:
            sources["brakes"] = _field(memory, "braked")
        sources |= {
            "t": _field(memory, "t"),
            "q": m.q,
            "v": m.v,
            "q_estimated": estimate.q,
            "v_estimated": estimate.v,
        }
        sources["altimeter_range"] = view(memory.range)[:1].reshape(())
        if isinstance(self._estimator.estimator, Estimator):
            std = self._estimator.estimator.memory.std[6 - kinematic.robot.n_vehicle :]
            sources |= {"q_std": std, "altimeter_std": view(memory.range)[1:].reshape(())}
        sources["command"] = tick.command
        force_places = {}
        if isinstance(self._controller, DynamicController):
            force_places = self._controller.force.places()
        if force_places:
            sources["asked_thrust"] = force_places["command"]
        if memory_memory.n:
            sources["health"] = view(memory.trusts)[: memory_memory.n]
        sources |= {
            "phase": _field(memory, "phase"),
            "activations": tick.gates,
            "activity": controller.activity,
            "residual": controller.residual,
            "quantities": tick.reported,
            "status": controller.report[:1].reshape(()),
            "viable_share": _field(kinematic.memory, "share"),
            "solve_time": Elapsed(solver, solver),
            "freshness": _field(kinematic.memory, "freshness"),
            "tick_time": Elapsed(first, solver),
        }
        if isinstance(self._controller, DynamicController):
            sources["disturbance"] = force_places["disturbance"]
            sources["wrench"] = force_places["vehicle_force"]
            sources["unreachable"] = force_places["unreachable"]
            sources["saturated"] = _field(self._controller.memory.allocation, "saturated")
            sources |= verdicts
        sources["controller_time"] = Elapsed(first, len(step_kernels) - 1)
        return sources | self._plant.telemetry_in_memory()

    def _verdicts(self) -> dict[str, np.ndarray]:
        """Return copies of the verdicts of the monitor of thrusters and joints."""
        if not isinstance(self._controller, DynamicController):
            return {}
        monitor = self._controller.monitor
        if monitor is None:
            return {}
        return {name: np.array(value) for name, value in monitor.telemetry().items()}


def compiled_loop(
    plant: Any, sensors: Any, estimator: Any, controller: Any, dt: float
) -> CompiledLoop | None:
    """Return the loop of these parts, fresh ones; `None` where one is not the toolkit's, or is to
    ask Python at every tick.
    """
    # The toolkit's sensors come as the bound method `SensorSuite.read`; a user's own may be any
    # callable, and have no suite.
    suite: Any = getattr(sensors, "__self__", None)
    plants = {DynamicController: DynamicPlant, KinematicController: KinematicPlant}
    if plants.get(type(controller)) is not type(plant):
        return None
    if type(suite) is not SensorSuite or type(estimator) is not GuardedEstimator:
        return None
    learns = getattr(controller, "learner", None) is not None
    if learns or not _fit(plant, suite, estimator, controller):
        return None
    inner = estimator.estimator
    if type(inner) is Estimator:
        is_plain = inner.is_plain
    else:
        is_plain = type(inner) is PassThrough and estimator.repeated and suite.is_ideal
    if not is_plain:
        return None
    compiled_faults = {"thruster"} if type(plant) is DynamicPlant else set()
    if any(fault.location.family not in compiled_faults for fault in plant.faults):
        return None
    loop = CompiledLoop(plant, suite, estimator, controller, dt)
    if loop.steps is not None and compiles(loop.steps):
        return loop
    return None


def _fit(plant: Any, suite: SensorSuite, estimator: GuardedEstimator, controller: Any) -> bool:
    """Check that the parts are fresh, of robots of one size: of others Python says what is wrong,
    tick by tick.
    """
    began = estimator.monitor.memory.started or controller.kinematic.memory.mission.started
    if began:
        return False
    robot = controller.kinematic.robot
    for part in (plant.memory, suite.memory, estimator.monitor.memory.now):
        if (len(part.q), len(part.v)) != (robot.n_q, robot.n_v):
            return False
    filter_memory = getattr(estimator.estimator, "structure", None)
    if filter_memory is not None and filter_memory.n_joints != robot.n_joints:
        return False
    if not isinstance(controller, DynamicController):
        return True
    return len(plant.memory.asked_thrust) == len(controller.memory.outputs.command)


def require_kept(name: str, size: int, n: int) -> None:
    """Raise `InvalidInput` unless so many numbers of a channel are to be kept as it has."""
    if size != n:
        raise InvalidInput(f"{name} has {size} numbers, {n} are to be kept of it")


def _field(memory: Any, name: str) -> np.ndarray:
    """Return a number in a memory as an array () on the same place."""
    kinds = dict(type(memory)._fields_)
    array_type = kinds[name] * 1
    offset = getattr(type(memory), name).offset
    return np.ctypeslib.as_array(array_type.from_buffer(memory, offset)).reshape(())


def _example(name: str, source: np.ndarray | Elapsed) -> Any:
    """Return a number of the type that records have it in."""
    if isinstance(source, Elapsed):
        return 0.0
    if name in _FLAGS:
        return source.astype(np.bool_)
    if name in _CODES:
        return source.astype(np.int8)
    if name == "status" or source.dtype == np.int32:
        return source.astype(np.int64)
    return source.copy()

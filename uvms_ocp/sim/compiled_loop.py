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
        kept: Mapping[str, int],
        watch: Watch,
        stops: Sequence[object],
    ) -> None:
        """Run so many ticks, or until the mission is over, the plant diverges, or there are stops.

        kept: channels whose new readings are recorded, and how many numbers each has.
        """
        memory = self.memory
        plant = self._plant
        kinematic = self._controller.kinematic
        verdicts = self._verdicts()
        sources = self._sources(kept, verdicts)
        steps = self.steps or ()
        sequence = KernelSequence(steps, _field(memory, "stop"))
        sequence.write_rows(
            sources,
            recorder.block({name: _example(name, source) for name, source in sources.items()}),
        )
        # written, and ticks that Python has looked at: one more where the last is still to be
        # written
        rows = 0
        n_watched = 0
        while rows < n_ticks:
            plant.begin(self._dt)
            ending = kinematic.state.over or bool(stops)
            waits = n_watched > rows
            if ending and rows and not waits:
                break
            n_possible = min(
                n_ticks - rows, recorder.room, kinematic.quiet_ticks, self._ticks_to_fault()
            )
            self._sensors.draw_ahead(n_possible)
            memory.stop = kernels.GO
            written = sequence.run(1 if ending else n_possible, recorder.place, done=waits)
            self._sensors.check()
            plant.adopt()
            rows += written
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
        memory, controller = self.memory, self._controller
        if memory.stop == kernels.GO:
            controller.kinematic.look_for_swings(memory.t, ticks)
            return
        if memory.news:
            self._estimator.monitor.publish(memory.t)
        estimate = self._estimator.estimate()
        if isinstance(controller, DynamicController):
            limited = tuple(
                i for i in range(controller.memory.allocation.count) if memory.at_limits[i]
            )
            controller.catch_up(estimate, memory.t, ticks, limited)
        else:
            controller.catch_up(estimate, memory.t, ticks)
        memory.verdict = controller.kinematic.watchdog.verdict
        for name, value in self._verdicts().items():
            verdicts[name][...] = value

    def _ticks_to_fault(self) -> int:
        """Ticks in which the plant's faults stay as they are."""
        t = self._plant.memory.t
        edges = [
            edge
            for fault in self._plant.faults
            for edge in (fault.onset, fault.end)
            if t < edge < np.inf
        ]
        if edges:
            return max(1, int((min(edges) - t) / self._dt))
        return N_DRAWN

    def _steps(self) -> Sequence[Step] | None:
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
        begin = (
            kernels.move_plant
            if isinstance(controller, DynamicController)
            else kernels.move_kinematic,
            kernels.sense,
        )
        estimating: list[Step]
        if isinstance(inner, Estimator):
            f = inner.structure
            move, sense, feed, note = bind_kernels(
                (*begin, kernels.feed_filter, kernels.note_estimate), map(type, (m, p, s, h, f))
            )
            estimating = [
                (screen, h),
                (feed, m, s, h, f),
                (inner.tick, f),
                (note, m, h, f),
                (finish, h, u, estimator.outcomes),
            ]
        else:
            move, sense, ranged = bind_kernels(
                (*begin, kernels.repeat_range), map(type, (m, p, s, h))
            )
            estimating = [(repeat, h, u, estimator.repeated), (ranged, m, h)]
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

    def _sources(self, kept: Mapping[str, int], verdicts: Mapping[str, np.ndarray]) -> Sources:
        """Series of a row, in the order of `simulate`. verdicts: as `_verdicts`, which are brought
        up to date.
        """
        memory = self.memory
        kinematic = self._controller.kinematic
        h = self._estimator.monitor.memory
        assert self.steps is not None
        controller: Any = kinematic.whole
        tick = arrays_of(kinematic.memory)
        controller = arrays_of(controller)
        names = [step[0] for step in self.steps]
        first, solver = (names.index(step[0]) for step in kinematic.steps() or ())
        for name, n in kept.items():
            require_kept(name, h.channels[NUMBER[name]].size, n)
        m = arrays_of(memory)
        estimate = arrays_of(h.now)
        measured = view(memory.measured)
        sources: Sources = {
            f"measured_{name}": measured[NUMBER[name], : n + 1] for name, n in kept.items()
        }
        sources |= {"brakes": _field(memory, "braked")} if kept else {}
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
        if not isinstance(self._controller, DynamicController):
            force_places = {}
        else:
            force_places = self._controller.force.places()
        sources |= {"asked_thrust": force_places["command"]} if force_places else {}
        sources |= {"health": view(memory.trusts)[: h.n]} if h.n else {}
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
            forces = {
                "disturbance": "disturbance",
                "wrench": "vehicle_force",
                "unreachable": "unreachable",
            }
            sources |= {name: force_places[part] for name, part in forces.items()}
            sources["saturated"] = _field(self._controller.memory.allocation, "saturated")
            sources |= verdicts
        sources["controller_time"] = Elapsed(first, len(names) - 1)
        return sources | self._plant.telemetry_in_memory()

    def _verdicts(self) -> dict[str, np.ndarray]:
        """Copies of what the monitor of thrusters and joints tells."""
        monitor = (
            self._controller.monitor if isinstance(self._controller, DynamicController) else None
        )
        if monitor is None:
            return {}
        return {name: np.array(value) for name, value in monitor.telemetry().items()}


def compiled_loop(
    plant: Any, sensors: Any, estimator: Any, controller: Any, dt: float
) -> CompiledLoop | None:
    """Return the loop of these parts, fresh ones; `None` where one is not the toolkit's, or is to
    ask Python at every tick.
    """
    suite: Any = getattr(sensors, "__self__", None)
    learns = getattr(controller, "learner", None) is not None
    kinds = {DynamicController: DynamicPlant, KinematicController: KinematicPlant}
    ours = (
        kinds.get(type(controller)) is type(plant)
        and type(suite) is SensorSuite
        and type(estimator) is GuardedEstimator
    )
    if not ours or learns or not _fit(plant, suite, estimator, controller):
        return None
    inner = estimator.estimator
    families = {fault.location.family for fault in plant.faults}
    if type(inner) is Estimator:
        plain = inner.is_plain
    else:
        plain = type(inner) is PassThrough and estimator.repeated and suite.is_ideal
    if not plain or not families <= ({"thruster"} if type(plant) is DynamicPlant else set()):
        return None
    loop = CompiledLoop(plant, suite, estimator, controller, dt)
    if loop.steps is not None and compiles(loop.steps):
        return loop
    return None


def _fit(plant: Any, suite: SensorSuite, estimator: GuardedEstimator, controller: Any) -> bool:
    """Return whether the parts are fresh, of robots of one size: of others Python says what is
    wrong, tick by tick.
    """
    robot = controller.kinematic.robot
    filtered = getattr(estimator.estimator, "structure", None)
    sizes = {
        (len(part.q), len(part.v))
        for part in (plant.memory, suite.memory, estimator.monitor.memory.now)
    }
    began = estimator.monitor.memory.started or controller.kinematic.memory.mission.started
    right = (
        not began
        and sizes == {(robot.n_q, robot.n_v)}
        and (filtered is None or filtered.n_joints == robot.n_joints)
    )
    forces = isinstance(controller, DynamicController)
    return right and not (
        forces and len(plant.memory.asked_thrust) != len(controller.memory.outputs.command)
    )


def require_kept(name: str, size: int, n: int) -> None:
    """Raise `InvalidInput` unless so many numbers of a channel are to be kept as it has."""
    if size != n:
        raise InvalidInput(f"{name} has {size} numbers, {n} are to be kept of it")


def _field(memory: Any, name: str) -> np.ndarray:
    """A number in a memory as an array () on the same place."""
    kinds = dict(type(memory)._fields_)
    return np.ctypeslib.as_array(
        (kinds[name] * 1).from_buffer(memory, getattr(type(memory), name).offset)
    ).reshape(())


def _example(name: str, source: np.ndarray | Elapsed) -> Any:
    """A number of the type that records have it in."""
    if isinstance(source, Elapsed):
        return 0.0
    kinds = dict.fromkeys(_FLAGS, np.bool_) | dict.fromkeys(_CODES, np.int8) | {"status": np.int64}
    return source.astype(kinds.get(name, np.int64 if source.dtype == np.int32 else source.dtype))

"""One tick of a closed loop as data: its steps in their order, each with the memories that it works
on, and the series of a record that its memories hold.

    plant          move                     true state
    sensors        sense                    readings
    estimator      begin_screening, screen, feed_filter, filter, note_estimate, judge, note_health
                                            estimate, and the trust in each channel
    controller     inform, prepare, hear_forces, solve, ask_forces, force, give, end
                                            command, which the plant hears

Each of the four parts is the toolkit's, whose steps are kernels, or is asked: then one step is a
function of Python, and those of the other parts stay machine code. Steps in Python are

    obey           give a plant of the toolkit what a controller that is asked commands
    move           ask a plant, and begin: count the tick of the state that it has come to
    sense, estimate, control            ask sensors, an estimator, a controller
    ask_goals      ask tasks for goals that no kernel evaluates
    carry_load, learn_load              before and after force, where a load is learnt

Where readings are passed on as they are, repeat and repeat_range stand for the filter's steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from uvms_ocp.codegen.kernel_layout import arrays_of, assign, number_in_memory, structure_of
from uvms_ocp.codegen.sequence import Source, Step
from uvms_ocp.control import DynamicController, KinematicController
from uvms_ocp.control.external import SupervisedController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.filter_memory import NUMBER
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.signals import Command
from uvms_ocp.sim.controller_steps import (
    ControllerSteps,
    KernelController,
    OwnController,
    SupervisedSteps,
)
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.estimator_steps import EstimatorSteps, KernelEstimator, OwnEstimator
from uvms_ocp.sim.loop_kernels import LoopMemory
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.sim.plant_steps import KernelPlant, OwnPlant, PlantSteps
from uvms_ocp.sim.sensor_steps import (
    KernelSensors,
    OwnSensors,
    SensorSteps,
    readings_in_memory,
)
from uvms_ocp.sim.sensors import SensorSuite

_TAKEN_BY: dict[type, type] = {DynamicController: DynamicPlant, KinematicController: KinematicPlant}
"""Plant of the toolkit that takes what a controller of the toolkit asks for."""


class Tick:
    """The tick of a run."""

    def __init__(
        self,
        *,
        plant: Any,
        sensors: Any,
        estimator: Any,
        controller: Any,
        dt: float,
        kept_readings: Mapping[str, int],
    ) -> None:
        """plant, sensors, estimator, controller: as `simulate` takes them. dt [s]: control period.
        kept_readings: channels whose new readings are recorded, and how many numbers each has.
        """
        as_kernels = _AsKernels.of(plant, sensors, estimator, controller)
        loop = _loop_memory(plant, estimator, controller, as_kernels)
        loop.dt = dt
        self.memory = loop
        """Memory through which the parts pass values to each other."""
        self._arrays = arrays_of(loop)
        self._kept_readings = kept_readings
        self._monitor: HealthMonitor | None = None
        if isinstance(estimator, GuardedEstimator):
            self._monitor = estimator.monitor
        if kept_readings and self._monitor is None:
            raise InvalidInput(
                "readings are kept by the monitor of a GuardedEstimator; give one, or keep none"
            )
        self.plant: PlantSteps
        if as_kernels.plant:
            self.plant = KernelPlant(loop, plant, dt)
        else:
            accelerates = as_kernels.sensors and sensors.__self__.reads_acceleration
            self.plant = OwnPlant(loop, plant, dt, accelerates=accelerates)
        self.sensors: SensorSteps
        if as_kernels.sensors:
            self.sensors = KernelSensors(loop, sensors.__self__, estimator.monitor.memory)
        else:
            self.sensors = OwnSensors(loop, sensors, self.plant, self._monitor)
        self.estimator: EstimatorSteps
        if as_kernels.estimator:
            self.estimator = KernelEstimator(loop, estimator)
        else:
            self.estimator = OwnEstimator(loop, estimator, self.sensors)
        self.controller: ControllerSteps
        if as_kernels.controller and isinstance(controller, SupervisedController):
            self.controller = SupervisedSteps(loop, controller, estimator, self.estimator)
        elif as_kernels.controller:
            taking_plant = plant if as_kernels.gives else None
            self.controller = KernelController(
                loop, controller, estimator, self.estimator, taking_plant
            )
        else:
            self.controller = OwnController(loop, controller, self.estimator)

    def steps(self) -> list[Step]:
        """Return the steps in their order."""
        return [
            *self.motion(),
            *self.sensors.steps(),
            *self.estimator.steps(self._command_before),
            *self.controller.steps(),
        ]

    def motion(self) -> list[Step]:
        """Return the first of them, by which the plant moves."""
        last_command = None if self.controller.gives else self.controller.command
        return self.plant.steps(last_command)

    def sources(self) -> dict[str, Source]:
        """Return the series of a row, once a tick has told those of parts that are asked.

        Raises `InvalidInput` for telemetry under a name that the loop records.
        """
        loop = self.memory
        sources = dict[str, Source]()
        if self._monitor is not None and self._kept_readings:
            sources = readings_in_memory(loop, self._monitor, self._kept_readings)
            sources["brakes"] = number_in_memory(loop, "braked")
        sources |= {"t": number_in_memory(loop, "t"), "q": self._arrays.q, "v": self._arrays.v}
        sources |= self.estimator.sources()
        plant_telemetry = self.plant.sources()
        sources |= self.controller.command_sources(has_thrusters="thrust" in plant_telemetry)
        sources |= self.estimator.health_sources()
        telemetry = self.controller.sources()
        doubled = sorted(sources.keys() & telemetry.keys())
        if doubled:
            raise InvalidInput(f"telemetry {doubled} is what the loop records; rename it")
        return sources | telemetry | plant_telemetry

    def _command_before(self) -> Command | None:
        """Return the command of the tick before; `None` at the first."""
        if not self.memory.started:
            return None
        return self.controller.command()


class _AsKernels(NamedTuple):
    """Which parts of a tick run as kernels; the others are asked."""

    plant: bool = False
    sensors: bool = False
    estimator: bool = False
    controller: bool = False
    gives: bool = False
    """The kernels of the controller write into the memory of the plant."""

    @classmethod
    def of(cls, plant: Any, sensors: Any, estimator: Any, controller: Any) -> _AsKernels:
        """Look at the parts. Those that are not fresh, or of robots of other sizes than the rest,
        are asked: tick by tick they say what is wrong.
        """
        is_guarded = type(estimator) is GuardedEstimator
        # The toolkit's sensors come as the bound method `SensorSuite.read`; a user's own may be any
        # callable, and have no suite.
        suite: Any = getattr(sensors, "__self__", None)
        if type(suite) is not SensorSuite:
            suite = None
        has_controller = is_guarded and _has_kernels(controller)
        if not is_guarded or not _fit(plant, suite, estimator, controller, has_controller):
            return cls(plant=type(plant) in _TAKEN_BY.values())
        has_estimator = _is_plain(estimator, suite)
        has_plant = type(plant) in _TAKEN_BY.values()
        return cls(
            plant=has_plant,
            sensors=has_estimator and suite is not None,
            estimator=has_estimator,
            controller=has_controller,
            gives=has_plant and has_controller and _TAKEN_BY.get(type(controller)) is type(plant),
        )


def _has_kernels(controller: Any) -> bool:
    """Check that a controller is one of the toolkit, or is supervised by it, without a guide, which
    looks at every tick.
    """
    kinds = (*_TAKEN_BY, SupervisedController)
    return type(controller) in kinds and controller.kinematic.guide is None


def _is_plain(estimator: GuardedEstimator, suite: SensorSuite | None) -> bool:
    """Check that kernels alone make the estimate."""
    inner = estimator.estimator
    if type(inner) is Estimator:
        return inner.is_plain
    is_ideal = suite is not None and suite.is_ideal
    return type(inner) is PassThrough and estimator.repeated is not None and is_ideal


def _fit(
    plant: Any,
    suite: SensorSuite | None,
    estimator: GuardedEstimator,
    controller: Any,
    has_controller: bool,
) -> bool:
    """Check that the parts are fresh, and of robots of one size."""
    if estimator.monitor.memory.started:
        return False
    if suite is not None and len(suite.memory.channels) != len(estimator.monitor.memory.channels):
        return False
    robot = estimator.robot
    sizes = [(len(plant.state.q), len(plant.state.v))]
    if suite is not None:
        sizes.append((len(suite.memory.q), len(suite.memory.v)))
    if any(size != (robot.n_q, robot.n_v) for size in sizes):
        return False
    inner = estimator.estimator
    if isinstance(inner, Estimator) and inner.structure.n_joints != robot.n_joints:
        return False
    if not has_controller:
        return True
    steered = controller.kinematic.robot
    if controller.kinematic.memory.mission.started:
        return False
    if (steered.n_q, steered.n_v) != (robot.n_q, robot.n_v):
        return False
    if not isinstance(plant, DynamicPlant) or not isinstance(controller, DynamicController):
        return True
    return len(plant.memory.asked_thrust) == len(controller.memory.outputs.command)


def _loop_memory(plant: Any, estimator: Any, controller: Any, as_kernels: _AsKernels) -> LoopMemory:
    """Make the memory of the loop, of the sizes of the parts."""
    dimensions = Dimensions(n_q=len(plant.state.q), n_v=len(plant.state.v), n_thrusters=1)
    if as_kernels.controller:
        n_thrusters = len(controller.kinematic.robot.description.thrusters)
        dimensions = replace(dimensions, n_thrusters=n_thrusters)
    n_measured = 1
    if isinstance(estimator, GuardedEstimator):
        n_measured += max(channel.size for channel in estimator.monitor.memory.channels)
        dimensions = replace(dimensions, n_channels=len(estimator.monitor.numbers))
    loop = structure_of(LoopMemory, dimensions, n_measured=n_measured)()
    assign(loop, number=[NUMBER[name] for name in CHANNELS], range=np.nan)
    if isinstance(estimator, GuardedEstimator):
        loop.n_vehicle = estimator.robot.n_vehicle
        loop.has_range = getattr(estimator.estimator, "has_range", True)
    return loop

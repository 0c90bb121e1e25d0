"""Plants, sensors, estimators, controllers and faults of a user: what they have to be, and checks
of what they return.

A maker is called with the scenario and builds what takes long to build, so that a step only steps:
an instance with settings, a function, or a class whose constructor takes the scenario. What it
makes runs as Python beside what is compiled, fresh in every run: what it remembers belongs to that
run, and what it draws it draws from `scenario.seed`. A maker that can be pickled, a class or a
value of a class that can be imported, goes to the workers of studies. Shapes and numbers are
checked at every tick; what does not fit raises `InvalidInput` with the name of the part. Records
and reports name all parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from uvms_ocp.control.external import require_numbers
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.filter_memory import NUMBER
from uvms_ocp.estimation.health import channel_state, guarded_estimator
from uvms_ocp.record.meta_values import PLANTS, UNIT_NORM_TOLERANCE, FaultMeta
from uvms_ocp.record.tables import SERIES
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.robot.signals import (
    CHANNELS,
    Command,
    Reading,
    Readings,
    SensorSpecs,
    State,
    StateEstimate,
    unchecked_state,
)
from uvms_ocp.sim.faults import Fault, is_active, plain
from uvms_ocp.sim.loop import Controller, Sensors, StateEstimator
from uvms_ocp.sim.plant import EFFORTS, Plant
from uvms_ocp.types import Array

# What was given for a part: a value of the toolkit's or what makes one of a user's own, and what is
# known of it beforehand.


def part_name(maker: Any) -> str:
    """Name of the part that it makes, as records have it: the name of a function or class, of
    anything else that of its class.
    """
    if isinstance(maker, partial):
        return part_name(maker.func)
    return str(getattr(maker, "__name__", type(maker).__name__)).strip("<>")


def plant_name(plant: Any) -> str:
    """Return the name of a plant of the toolkit."""
    if isinstance(plant, str):
        return plant
    return part_name(plant)


def require_plant(plant: Any) -> None:
    """Raise `NameNotFound` for an unknown name, `InvalidInput` for a maker that does not tell what
    its plant takes.
    """
    if isinstance(plant, str):
        require_known("plant", plant, PLANTS)
    elif not isinstance(getattr(plant, "takes_forces", None), bool):
        allowed = "give it True for thrust and torque, False for velocities alone"
        raise InvalidInput(f"plant {part_name(plant)} has no takes_forces; {allowed}")


def takes_forces(plant: Any) -> bool:
    """True for a plant that takes thrust and torque, and not velocities alone."""
    if isinstance(plant, str):
        return plant == "dynamic"
    return bool(plant.takes_forces)


def specs_of(sensors: Any) -> SensorSpecs:
    """Return the specifications of the sensors. Raises `InvalidInput` for a maker without."""
    if isinstance(sensors, SensorSpecs):
        return sensors
    specs = getattr(sensors, "specs", None)
    if not isinstance(specs, SensorSpecs):
        allowed = "give it what to expect of them, such as IDEAL_SENSORS"
        raise InvalidInput(f"sensors {part_name(sensors)} have no specs, a SensorSpecs; {allowed}")
    return specs


def require_simulated(faults: Iterable[Fault], plant: Any, sensors: Any) -> None:
    """Raise `InvalidInput` for a fault of a user's own plant or sensors that these do not have of
    themselves.
    """
    for fault in faults:
        channel = fault.location.channel
        maker, fault_name = (sensors, channel) if channel else (plant, fault.location.family)
        is_users = not isinstance(maker, str | SensorSpecs)
        if is_users and fault_name not in getattr(maker, "simulated_faults", ()):
            whose = f"{'sensors' if channel else 'plant'} {part_name(maker)}"
            problem = f"{fault}: {whose} has no {fault_name!r} in its simulated_faults"
            raise InvalidInput(f"{problem}; add it and simulate it, or leave it out")


# Makers, values of a scenario that build a part for each run.


class PlantMaker(Protocol):
    """Maker of a plant, for ``Scenario(plant=...)`` where it is none of the names ``dynamic`` and
    ``kinematic``.

    It may have an attribute ``simulated_faults``, a tuple of ``thruster``, ``joint``, ``current`` and ``payload``:
    the faults that its plant has of itself when `scenario.toolkit_faults` lists them; others are
    refused, those of sensors are none of its business. Campaigns vary `scenario.plant_robot` and
    `scenario.environment`, and of a maker that is a dataclass every float by its name, such as
    ``parts.plant.rate``: what a plant does not read is not varied.
    """

    takes_forces: bool
    """True where commands carry thrust and torque, from the controller's dynamic layer; else
    velocities alone.
    """

    def __call__(self, scenario: Any) -> Plant:
        """The plant of a `Scenario`, at its start and at rest."""


class Disturbance(Protocol):
    """Fault injected into one run, asked from its onset to its end."""

    def readings(self, readings: Readings, t: float) -> Readings:
        """Return the readings that arrive at time t [s]; the same object where nothing is wrong,
        others are new readings.
        """

    def command(self, command: Command, t: float) -> Command:
        """Return the command that arrives at the plant at time t [s]. The record keeps the one
        given.
        """


class FaultMaker(Protocol):
    """Among ``Scenario(faults=...)``, beside each `Fault`: what goes wrong between the parts."""

    onset: float
    """[s], 0 or more."""
    end: float
    """[s] from which all is well again; inf: never."""

    def __call__(self, scenario: Any) -> Disturbance:
        """The fault in a run of a `Scenario`."""


class SensorsMaker(Protocol):
    """Maker of sensors, for ``Scenario(sensors=...)`` where it is no `SensorSpecs`.

    It may have an attribute ``simulated_faults``, a tuple of channels: the faults that its sensors have of
    themselves when `scenario.toolkit_faults` lists them; others are refused. Campaigns vary
    `scenario.real_sensors`, the true ones where they differ from `specs`; nominal delays are those
    of the toolkit's sensors alone.
    """

    @property
    def specs(self) -> SensorSpecs:
        """Specifications that estimator, monitor and pre-flight expect."""

    def __call__(self, scenario: Any) -> Sensors:
        """The sensors of a `Scenario`: a callable ``(State, t) -> Readings`` of the true state at
        time t [s].

        A reading that is the same object as at the tick before is no new one. Values may be nan:
        that is a sensor which fails, and the monitor deals with it. Of channels that `specs` has,
        readings of the shapes of `Readings`.
        """


class EstimatorMaker(Protocol):
    """Maker of an estimator, for ``Scenario(estimator=...)``."""

    def __call__(self, scenario: Any) -> StateEstimator:
        """The estimator of a `Scenario`: a callable ``(Readings, t, command) -> StateEstimate`` at
        time t [s].

        `command` has been acting since the last call, `None` at the first. A monitor stands around
        it: readings that cannot be true are kept from it, and age and health of its measurements
        are the monitor's. One that has `outcomes` and `inflate_velocity_variance`, as
        `uvms_ocp.control.Estimator` does, is heard by the monitor too.
        """


class ControllerMaker(Protocol):
    """Maker of a controller, for ``Scenario(controller=...)``."""

    def __call__(self, scenario: Any) -> Controller:
        """The controller of a `Scenario`: a callable ``(StateEstimate, t) -> Command`` at time t
        [s].

        The command has thrust and torque where the plant takes forces. `SupervisedController`
        follows the mission beside it.
        """


# Somebody else's estimator, whose measurements are looked at before anyone relies on them.

_OURS = (PassThrough, Estimator)


def watched_estimator(made: Any, robot: Robot, name: str) -> StateEstimator:
    """It, watched unless it is the toolkit's own; one that tells of gates of its own still does."""
    if type(made) in _OURS:
        return made
    return (
        WatchedGates if isinstance(made, guarded_estimator.GatedEstimator) else WatchedEstimator
    )(made, robot, name)


class WatchedEstimator:
    """A callable ``(Readings, t, command) -> StateEstimate`` that asks another one."""

    def __init__(self, estimator: Any, robot: Robot, name: str) -> None:
        """name: what messages call it."""
        self._wrapped = estimator
        self._robot = robot
        self._whose = f"the measurement of estimator {name}"
        self._name = name

    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        """Their measurement at time t [s]. Raises `InvalidInput` for one that no controller can
        take.
        """
        estimate = self._wrapped(readings, t, command)
        if not isinstance(estimate, StateEstimate):
            raise InvalidInput(
                f"estimator {self._name} returned {type(estimate).__name__}; return a StateEstimate"
            )
        require_state(self._whose, self._robot, q=estimate.q, v=estimate.v, std=estimate.std)
        return estimate


class WatchedGates(WatchedEstimator):
    """Watched estimator that reports which readings it refuses."""

    def __init__(self, estimator: Any, robot: Robot, name: str) -> None:
        """Set up as `WatchedEstimator`. Raises `InvalidInput` for outcomes that the monitor cannot
        share.
        """
        super().__init__(estimator, robot, name)
        self.outcomes: Array = estimator.outcomes
        """(9, 4) [s, -, -, -] theirs, see `GatedEstimator.outcomes`."""
        shape = (len(NUMBER), 4)
        actual_shape = np.shape(self.outcomes)
        if (
            actual_shape != shape
            or self.outcomes.dtype != float
            or not self.outcomes.flags.c_contiguous
        ):
            raise InvalidInput(
                f"outcomes of estimator {name} of shape {actual_shape}; give {shape}, floats row by row"
            )

    def inflate_velocity_variance(self, *, rests: bool = False) -> None:
        """Pass it on."""
        self._wrapped.inflate_velocity_variance(rests=rests)


def require_state(
    whose: str, robot: Robot, *, q: np.ndarray, v: np.ndarray, **others: np.ndarray | None
) -> None:
    """Raise `InvalidInput` unless q (n_q,) [m, rad] is normalized, and v (n_v,) [m/s, rad/s] and
    others there are finite.
    """
    require_numbers(whose, "q", q, (robot.n_q,))
    for name, value in {
        "v": v,
        **{name: value for name, value in others.items() if value is not None},
    }.items():
        require_numbers(whose, name, value, (robot.n_v,))
    if not pin.isNormalized(robot.model, q, UNIT_NORM_TOLERANCE):
        raise InvalidInput(
            f"{whose} has q with an attitude or a turning joint not of norm 1; normalize it"
        )


# Somebody else's plant, whose state and telemetry are looked at before they are recorded.

_REAL = "biuf"
_MAYBE_UNKNOWN = "thruster_energy"


class WatchedPlant(Plant):
    """Another one, asked."""

    def __init__(self, plant: Any, robot: Robot, name: str) -> None:
        """name: what messages call it. Raises `InvalidInput` for what is no `Plant`, or one that
        begins with a wrong state.
        """
        missing = [item for item in ("state", "step", "telemetry") if not hasattr(plant, item)]
        if missing:
            raise InvalidInput(
                f"plant {name} made {type(plant).__name__} without {', '.join(missing)}; make a"
                " Plant"
            )
        self._wrapped = plant
        self._robot = robot
        self._name = name
        n_thrusters = len(robot.description.thrusters)
        n_joints = robot.n_joints
        self._shapes: dict[str, tuple[int, ...]] = dict(
            zip(EFFORTS, ((n_thrusters,), (n_joints,), (n_thrusters,), ()), strict=True),
            contact=(len(skid_points(robot)),),
            current=(3,),
        )
        self.state = self._right(plant.state)

    def step(self, command: Command, dt: float) -> None:
        """Theirs, by dt [s]. Raises `InvalidInput` for a state that cannot be."""
        self._wrapped.step(command, dt)
        self.state = self._right(self._wrapped.state)

    def telemetry(self) -> dict[str, Any]:
        """Theirs. Raises `InvalidInput` for what cannot be recorded, or not under that name."""
        telemetry = self._wrapped.telemetry()
        if not isinstance(telemetry, dict):
            raise InvalidInput(
                f"telemetry of plant {self._name} is {type(telemetry).__name__}; give a dict, empty"
                " for none"
            )
        efforts = [name for name in EFFORTS if name in telemetry]
        if efforts and len(efforts) < len(EFFORTS):
            raise InvalidInput(
                f"telemetry of plant {self._name} has {efforts[0]!r}; give all of"
                f" {', '.join(EFFORTS)}, or none"
            )
        return {name: self._recorded(name, value) for name, value in telemetry.items()}

    def _right(self, state: Any) -> State:
        if not isinstance(state, State):
            raise InvalidInput(
                f"state of plant {self._name} is {type(state).__name__}; give a State"
            )
        require_state(
            f"the state of plant {self._name}", self._robot, q=state.q, v=state.v, a=state.a
        )
        return state

    def _recorded(self, name: str, value: Any) -> np.ndarray:
        whose = f"telemetry of plant {self._name}"
        array = np.asarray(value)
        if array.dtype.kind not in _REAL or array.ndim > 1:
            raise InvalidInput(
                f"{whose} has {name} of shape {array.shape} and type {array.dtype}; give numbers"
                " (n,), or one"
            )
        if name not in self._shapes:
            if name in SERIES:
                raise InvalidInput(
                    f"{whose} has {name!r}, which means something else in records; rename it"
                )
            return array
        if name == _MAYBE_UNKNOWN:
            known_values = array[~np.isnan(array)]
        else:
            known_values = array
        if array.shape != self._shapes[name] or not np.isfinite(known_values).all():
            problem = (
                f"of shape {array.shape}" if array.shape != self._shapes[name] else "not finite"
            )
            raise InvalidInput(
                f"{whose} has {name} {problem}; give finite numbers of shape {self._shapes[name]}"
            )
        return array.astype(float)


# Somebody else's sensors, whose readings are looked at before the monitor sees them.

_all = attrgetter(*CHANNELS)


class WatchedSensors:
    """A callable ``(State, t) -> Readings`` that asks another one."""

    def __init__(self, sensors: Any, robot: Robot, specs: SensorSpecs, name: str) -> None:
        """specs: which channels to expect. name: what messages call them. Raises `InvalidInput` for
        what cannot be called.
        """
        if not callable(sensors):
            raise InvalidInput(
                f"sensors {name} made {type(sensors).__name__}; make a callable (State, t) ->"
                " Readings"
            )
        self._wrapped: Callable[[State, float], Readings] = sensors
        self._name = name
        self._sizes = channel_state.sizes_of(robot)
        self._expected = {channel for channel in CHANNELS if getattr(specs, channel) is not None}
        self._seen: dict[str, Reading[Any] | None] = dict.fromkeys(CHANNELS)

    def __call__(self, state: State, t: float) -> Readings:
        """Their readings of the true state at time t [s]. Raises `InvalidInput` for what is no
        reading of that channel.
        """
        # Copied: nobody who writes to a reading reaches the true state.
        readings = self._wrapped(unchecked_state(q=state.q.copy(), v=state.v.copy(), a=state.a), t)
        if not isinstance(readings, Readings):
            raise InvalidInput(
                f"sensors {self._name} returned {type(readings).__name__}; return Readings"
            )
        for channel, reading in zip(CHANNELS, _all(readings), strict=True):
            if reading is not None and reading is not self._seen[channel]:
                self._require(channel, reading)
                self._seen[channel] = reading
        return readings

    def _require(self, channel: str, reading: Reading[Any]) -> None:
        if channel not in self._expected:
            raise InvalidInput(
                f"sensors {self._name} read {channel}, which their specs leave out; add it to them"
            )
        shape = np.shape(reading.value)
        right = self._sizes[channel]
        if shape != right:
            raise InvalidInput(
                f"sensors {self._name} read {channel} of shape {shape}; give {right}"
            )


# Faults of a user's own, between the toolkit's parts or others: on what sensors tell and on what
# the plant is told.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InjectedFault:
    """A fault, made for one run."""

    maker: Any
    made: Disturbance

    def active(self, t: float) -> bool:
        """Check that it is there at time t [s]."""
        return is_active(self.maker.onset, self.maker.end, t)

    def command(self, command: Command, t: float) -> Command:
        """Return the command that arrives at time t [s]. Raises `InvalidInput` for one that the
        plant cannot take.
        """
        changed = self.made.command(command, t)
        name = part_name(self.maker)
        if not isinstance(changed, Command):
            raise InvalidInput(
                f"fault {name} returned {type(changed).__name__} for a command; return a Command"
            )
        for item in ("v", "thrust", "torque"):
            original = getattr(command, item)
            if original is not None:
                require_numbers(
                    f"the command of fault {name}", item, getattr(changed, item), original.shape
                )
        return changed


class FaultyPlant(Plant):
    """A plant that does not hear all that it is told."""

    def __init__(self, plant: Plant, struck: Sequence[InjectedFault]) -> None:
        self._plant = plant
        self._struck = tuple(struck)
        self._t = 0.0
        self.state = plant.state

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s], by what is left of the command."""
        for fault in self._struck:
            if fault.active(self._t):
                command = fault.command(command, self._t)
        self._plant.step(command, dt)
        self._t += dt
        self.state = self._plant.state

    def telemetry(self) -> dict[str, Any]:
        """Return the telemetry of the plant."""
        return self._plant.telemetry()


def inject_faults(scenario: Any, plant: Plant, sensors: Sensors) -> tuple[Plant, Sensors]:
    """Plant and sensors of a run with the own faults of a scenario between them and the others."""
    makers = [fault for fault in scenario.faults if not isinstance(fault, Fault)]
    if not makers:
        return plant, sensors
    struck = [InjectedFault(maker=maker, made=maker(scenario)) for maker in makers]

    def read(state: State, t: float) -> Readings:
        readings = sensors(state, t)
        for fault in struck:
            if fault.active(t):
                readings = fault.made.readings(readings, t)
            else:
                readings = readings
        return readings

    names = " and ".join(map(part_name, makers))
    return FaultyPlant(plant, struck), WatchedSensors(
        read, scenario.robot, scenario.specs, f"with fault {names}"
    )


def require_fault(fault: Any) -> None:
    """Raise `InvalidInput` for what is neither a `Fault` nor makes one of a user's own with an
    onset before its end.
    """
    if isinstance(fault, Fault):
        return
    times: list[Any] = [getattr(fault, name, None) for name in ("onset", "end")]
    (onset, end) = times
    numbers = all(isinstance(t, int | float | np.floating) for t in times)
    if not (callable(fault) and numbers and 0.0 <= onset < end):
        problem = f"faults: {part_name(fault)} with onset = {onset} s, end = {end} s"
        raise InvalidInput(
            f"{problem}; give a Fault, or what makes one, with times from 0 on, the end last, inf for"
            " never"
        )


def fault_meta(fault: Any) -> FaultMeta:
    """Metadata of a fault for the record."""
    if np.isfinite(fault.end):
        end = float(fault.end)
    else:
        end = None
    if isinstance(fault, Fault):
        return FaultMeta(
            text=str(fault), target=fault.target, kind=fault.kind, t=fault.onset, end=end
        )
    name = part_name(fault)
    text = f"{name}@{plain(float(fault.onset))}" + ("" if end is None else f"-{plain(end)}")
    return FaultMeta(text=text, target=name, kind="own", t=float(fault.onset), end=end)

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

from collections.abc import Iterable
from functools import partial
from typing import Any, Protocol

from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.record.meta_values import PLANTS
from uvms_ocp.robot.signals import (
    Command,
    Readings,
    SensorSpecs,
)
from uvms_ocp.sim.faults import Fault
from uvms_ocp.sim.loop import Controller, Sensors, StateEstimator
from uvms_ocp.sim.plant import Plant


def part_name(maker: Any) -> str:
    """Return the name of the part that a maker makes, as records have it: that of a function or
    class, or of the class of anything else.
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
    """Check for a plant that takes thrust and torque, and not velocities alone."""
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
        kind = "plant"
        maker = plant
        fault_name = fault.location.family
        if channel:
            kind = "sensors"
            maker = sensors
            fault_name = channel
        is_users = not isinstance(maker, str | SensorSpecs)
        if is_users and fault_name not in getattr(maker, "simulated_faults", ()):
            whose = f"{kind} {part_name(maker)}"
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
        """Return the plant of a `Scenario`, at its start and at rest."""


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
    """Maker of a user's own fault between the parts, for ``Scenario(faults=...)`` beside each
    `Fault`.
    """

    onset: float
    """[s] time from which the fault is there, 0 or more."""
    end: float
    """[s] Time from which all is well again; inf: never."""

    def __call__(self, scenario: Any) -> Disturbance:
        """Return the fault in a run of a `Scenario`."""


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
        """Return the sensors of a `Scenario`: a callable ``(State, t) -> Readings`` of the true
        state at time t [s].

        A reading that is the same object as at the tick before is no new one. Values may be nan:
        that is a sensor which fails, and the monitor deals with it. Of channels that `specs` has,
        readings of the shapes of `Readings`.
        """


class EstimatorMaker(Protocol):
    """Maker of an estimator, for ``Scenario(estimator=...)``."""

    def __call__(self, scenario: Any) -> StateEstimator:
        """Return the estimator of a `Scenario`: a callable ``(Readings, t, command) ->
        StateEstimate`` at time t [s].

        `command` has been acting since the last call, `None` at the first. A monitor stands around
        it: readings that cannot be true are kept from it, and age and health of its measurements
        are the monitor's. One that has ``outcomes`` and ``inflate_velocity_variance``, as
        `uvms_ocp.control.Estimator` does, is heard by the monitor too.
        """


class ControllerMaker(Protocol):
    """Maker of a controller, for ``Scenario(controller=...)``."""

    def __call__(self, scenario: Any) -> Controller:
        """Return the controller of a `Scenario`: a callable ``(StateEstimate, t) -> Command`` at
        time t [s].

        The command has thrust and torque where the plant takes forces. `SupervisedController`
        follows the mission beside it.
        """

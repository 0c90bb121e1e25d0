"""Plants, sensors, estimators, controllers and faults of a user: protocols that they implement, and
checks.

A maker is called with the scenario before each run and returns the part for that run: a function, a
class whose constructor takes the scenario, or an instance with settings. Whatever takes long is
built there, so that a step only steps. The part runs as Python beside compiled code; it may keep
state, since no other run uses it, and draws random numbers from `scenario.seed`. A maker that can
be pickled, a class or a value of a class that can be imported, goes to the workers of studies.
Shapes and numbers are checked at every tick; those that do not fit raise `InvalidInput` with the
name of the part. Records and reports name all parts.
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
    """Return the name of a maker, as records have it: of a function or class its own, of any other
    value that of its class.
    """
    if isinstance(maker, partial):
        return part_name(maker.func)
    return str(getattr(maker, "__name__", type(maker).__name__)).strip("<>")


def plant_name(plant: Any) -> str:
    """Return the name of a plant of the toolkit or of a maker."""
    if isinstance(plant, str):
        return plant
    return part_name(plant)


def require_plant(plant: Any) -> None:
    """Raise `NameNotFound` for an unknown name, `InvalidInput` for a maker without
    ``takes_forces``.
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
    """Return the specifications of sensors. Raises `InvalidInput` for a maker without ``specs``."""
    if isinstance(sensors, SensorSpecs):
        return sensors
    specs = getattr(sensors, "specs", None)
    if not isinstance(specs, SensorSpecs):
        allowed = "give it what to expect of them, such as IDEAL_SENSORS"
        raise InvalidInput(f"sensors {part_name(sensors)} have no specs, a SensorSpecs; {allowed}")
    return specs


def require_simulated(faults: Iterable[Fault], plant: Any, sensors: Any) -> None:
    """Raise `InvalidInput` for a fault that a user's own plant or sensors do not simulate."""
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

    It may have an attribute ``simulated_faults``, a tuple of ``thruster``, ``joint``, ``current``
    and ``payload``: the faults that its plant simulates where `scenario.toolkit_faults` lists them;
    others of the plant are refused. Campaigns vary `scenario.plant_robot` and
    `scenario.environment`, which only act if the plant reads them, and every float of a maker that
    is a dataclass by its name, such as ``parts.plant.rate``.
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
        """Return the readings that arrive at time t [s]; the same object where nothing is wrong:
        another one counts as new readings.
        """

    def command(self, command: Command, t: float) -> Command:
        """Return the command that arrives at the plant at time t [s]. The record keeps the original
        one.
        """


class FaultMaker(Protocol):
    """Maker of a user's own fault between the parts, for ``Scenario(faults=...)`` beside each
    `Fault`.
    """

    onset: float
    """[s] time at which the fault begins, 0 or more."""
    end: float
    """[s] time at which the fault ends; inf: never."""

    def __call__(self, scenario: Any) -> Disturbance:
        """Return the fault in a run of a `Scenario`."""


class SensorsMaker(Protocol):
    """Maker of sensors, for ``Scenario(sensors=...)`` where it is no `SensorSpecs`.

    It may have an attribute ``simulated_faults``, a tuple of channels: its sensors simulate faults of
    these where `scenario.toolkit_faults` lists them; others are refused. Campaigns vary
    `scenario.real_sensors`, the true specifications where they differ from `specs`; nominal delays
    exist for the toolkit's sensors alone.
    """

    @property
    def specs(self) -> SensorSpecs:
        """Specifications that estimator, monitor and pre-flight expect."""

    def __call__(self, scenario: Any) -> Sensors:
        """Return the sensors of a `Scenario`: a callable ``(State, t) -> Readings`` of the true
        state at time t [s].

        Channels of `specs` have readings of the shapes of `Readings`. A reading that is the same
        object as at the tick before is no new one. Values of a sensor that fails may be nan, which
        the monitor deals with.
        """


class EstimatorMaker(Protocol):
    """Maker of an estimator, for ``Scenario(estimator=...)``."""

    def __call__(self, scenario: Any) -> StateEstimator:
        """Return the estimator of a `Scenario`: a callable ``(Readings, t, command) ->
        StateEstimate`` at time t [s].

        `command` has been acting since the last call, `None` at the first. A monitor keeps readings
        that cannot be true from the estimator, and gives the age and health of measurements. It
        also uses ``outcomes`` and ``inflate_velocity_variance`` of an estimator that has both, as
        `uvms_ocp.control.Estimator` does.
        """


class ControllerMaker(Protocol):
    """Maker of a controller, for ``Scenario(controller=...)``."""

    def __call__(self, scenario: Any) -> Controller:
        """Return the controller of a `Scenario`: a callable ``(StateEstimate, t) -> Command`` at
        time t [s].

        The command has thrust and torque where the plant takes forces. A `SupervisedController`
        around it follows the mission.
        """

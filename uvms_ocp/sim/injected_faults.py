"""Faults that users write: they stand between sensors, controller and plant, and change readings and
commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.control.external import require_numbers
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.meta_values import FaultMeta
from uvms_ocp.robot.signals import (
    Command,
    Readings,
    State,
)
from uvms_ocp.sim.faults import Fault, is_active, plain
from uvms_ocp.sim.loop import Sensors
from uvms_ocp.sim.own_parts import Disturbance, part_name
from uvms_ocp.sim.plant import Plant
from uvms_ocp.sim.watched_sensors import WatchedSensors


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InjectedFault:
    """A user's fault in one run."""

    maker: Any
    """Value of the scenario that makes the fault, with its `onset` and `end` [s]."""
    disturbance: Disturbance
    """Changes of readings and commands, while the fault is there."""

    def active(self, t: float) -> bool:
        """Check whether the fault is there at time t [s]."""
        return is_active(self.maker.onset, self.maker.end, t)

    def command(self, command: Command, t: float) -> Command:
        """Return the command that arrives at time t [s]. Raises `InvalidInput` for one that the
        plant cannot take.
        """
        changed = self.disturbance.command(command, t)
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
    """A plant behind faults, which change its commands."""

    def __init__(self, plant: Plant, injected_faults: Sequence[InjectedFault]) -> None:
        self._plant = plant
        self._faults = tuple(injected_faults)
        self._t = 0.0
        self.state = plant.state

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s], with the command as active faults change it."""
        for fault in self._faults:
            if fault.active(self._t):
                command = fault.command(command, self._t)
        self._plant.step(command, dt)
        self._t += dt
        self.state = self._plant.state

    def telemetry(self) -> dict[str, Any]:
        """Return the telemetry of the plant."""
        return self._plant.telemetry()


def inject_faults(scenario: Any, plant: Plant, sensors: Sensors) -> tuple[Plant, Sensors]:
    """Return plant and sensors of a run with the user's faults of a scenario around them."""
    makers = [fault for fault in scenario.faults if not isinstance(fault, Fault)]
    if not makers:
        return plant, sensors
    injected_faults = [InjectedFault(maker=maker, disturbance=maker(scenario)) for maker in makers]

    def read(state: State, t: float) -> Readings:
        readings = sensors(state, t)
        for fault in injected_faults:
            if fault.active(t):
                readings = fault.disturbance.readings(readings, t)
        return readings

    names = " and ".join(part_name(maker) for maker in makers)
    faulty_sensors = WatchedSensors(read, scenario.robot, scenario.specs, f"with fault {names}")
    return FaultyPlant(plant, injected_faults), faulty_sensors


def require_fault(fault: Any) -> None:
    """Raise `InvalidInput` for a value that is neither a `Fault` nor a `FaultMaker` with an onset
    before its end.
    """
    if isinstance(fault, Fault):
        return
    onset: Any = getattr(fault, "onset", None)
    end: Any = getattr(fault, "end", None)
    are_numbers = all(isinstance(t, int | float | np.floating) for t in (onset, end))
    if not (callable(fault) and are_numbers and 0.0 <= onset < end):
        problem = f"faults: {part_name(fault)} with onset = {onset} s, end = {end} s"
        raise InvalidInput(
            f"{problem}; give a Fault, or what makes one, with times from 0 on, the end last, inf for"
            " never"
        )


def fault_meta(fault: Any) -> FaultMeta:
    """Return the metadata of a fault for the record."""
    end = float(fault.end) if np.isfinite(fault.end) else None
    if isinstance(fault, Fault):
        return FaultMeta(
            text=str(fault), target=fault.target, kind=fault.kind, t=fault.onset, end=end
        )
    name = part_name(fault)
    text = f"{name}@{plain(float(fault.onset))}"
    if end is not None:
        text += f"-{plain(end)}"
    return FaultMeta(text=text, target=name, kind="own", t=float(fault.onset), end=end)

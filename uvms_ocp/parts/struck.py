"""Faults of a user's own, between the toolkit's parts or others: on what sensors tell and on what the plant is told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.control.watched import require_numbers
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.meta_values import FaultMeta
from uvms_ocp.model.state import Command, Readings, State
from uvms_ocp.parts.given import part_name
from uvms_ocp.parts.makers import Disturbance
from uvms_ocp.parts.watched_sensors import WatchedSensors
from uvms_ocp.sim.faults.fault import Fault, is_on, plain
from uvms_ocp.sim.loop import Sensors
from uvms_ocp.sim.plant import Plant


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Struck:
    """A fault, made for one run."""

    maker: Any
    made: Disturbance

    def active(self, t: float) -> bool:
        """Whether it is there at time t [s]."""
        return is_on(self.maker.onset, self.maker.end, t)

    def command(self, command: Command, t: float) -> Command:
        """What is left of a command at time t [s]. Raises `InvalidInput` for one that the plant cannot take."""
        left = self.made.command(command, t)
        name = part_name(self.maker)
        if not isinstance(left, Command):
            raise InvalidInput(f"fault {name} returned {type(left).__name__} for a command; return a Command")
        for item in ("v", "thrust", "torque"):
            if (asked := getattr(command, item)) is not None:
                require_numbers(f"the command of fault {name}", item, getattr(left, item), asked.shape)
        return left


class StruckPlant(Plant):
    """A plant that does not hear all that it is told."""

    def __init__(self, plant: Plant, struck: Sequence[Struck]) -> None:
        self._plant, self._struck, self._t = plant, tuple(struck), 0.0
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
        """That of the plant."""
        return self._plant.telemetry()


def struck_parts(scenario: Any, plant: Plant, sensors: Sensors) -> tuple[Plant, Sensors]:
    """Plant and sensors of a run with the own faults of a scenario between them and the others."""
    makers = [fault for fault in scenario.faults if not isinstance(fault, Fault)]
    if not makers:
        return plant, sensors
    struck = [Struck(maker=maker, made=maker(scenario)) for maker in makers]
    names = " and ".join(map(part_name, makers))
    heard = WatchedSensors(_hearing(sensors, struck), scenario.robot, scenario.specs, f"with fault {names}")
    return StruckPlant(plant, struck), heard


def _hearing(sensors: Sensors, struck: Sequence[Struck]) -> Callable[[State, float], Readings]:
    def read(state: State, t: float) -> Readings:
        readings = sensors(state, t)
        for fault in struck:
            readings = fault.made.readings(readings, t) if fault.active(t) else readings
        return readings

    return read


def require_fault(fault: Any) -> None:
    """Raise `InvalidInput` for what is neither a `Fault` nor makes one of a user's own with an onset before its end."""
    if isinstance(fault, Fault):
        return
    times: list[Any] = [getattr(fault, name, None) for name in ("onset", "end")]
    (onset, end), numbers = times, all(isinstance(t, int | float | np.floating) for t in times)
    if not (callable(fault) and numbers and 0.0 <= onset < end):
        given = f"faults: {part_name(fault)} with onset = {onset} s, end = {end} s"
        raise InvalidInput(
            f"{given}; give a Fault, or what makes one, with times from 0 on, the end last, inf for never"
        )


def told(fault: Any) -> FaultMeta:
    """What a record tells of a fault."""
    end = float(fault.end) if np.isfinite(fault.end) else None
    if isinstance(fault, Fault):
        return FaultMeta(text=str(fault), target=fault.target, kind=fault.kind, t=fault.onset, end=end)
    name = part_name(fault)
    text = f"{name}@{plain(float(fault.onset))}" + ("" if end is None else f"-{plain(end)}")
    return FaultMeta(text=text, target=name, kind="own", t=float(fault.onset), end=end)

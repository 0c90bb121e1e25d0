"""What was given for a part: a value of the toolkit's or what makes one of a user's own, and what is known of it beforehand."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.sensing import SensorSpecs
from uvms_ocp.sim.faults.fault import Fault

PLANTS = ("dynamic", "kinematic")
"""Of the toolkit, by name."""


def part_name(maker: Any) -> str:
    """What records call the part that it makes: the name of a function or class, of anything else that of its class."""
    if isinstance(maker, partial):
        return part_name(maker.func)
    return str(getattr(maker, "__name__", type(maker).__name__)).strip("<>")


def plant_name(plant: Any) -> str:
    """Of one of the toolkit's the name that it goes by."""
    return plant if isinstance(plant, str) else part_name(plant)


def require_plant(plant: Any) -> None:
    """Raise `NameNotFound` for an unknown name, `InvalidInput` for a maker that does not tell what its plant takes."""
    if isinstance(plant, str):
        if plant not in PLANTS:
            raise NameNotFound("plant", plant, PLANTS)
    elif not isinstance(getattr(plant, "takes_forces", None), bool):
        allowed = "give it True for thrust and torque, False for velocities alone"
        raise InvalidInput(f"plant {part_name(plant)} has no takes_forces; {allowed}")


def takes_forces(plant: Any) -> bool:
    """Whether it takes thrust and torque, or velocities alone."""
    return plant == "dynamic" if isinstance(plant, str) else bool(plant.takes_forces)


def specs_of(sensors: Any) -> SensorSpecs:
    """What to expect of the sensors. Raises `InvalidInput` for a maker that does not tell."""
    specs = sensors if isinstance(sensors, SensorSpecs) else getattr(sensors, "specs", None)
    if not isinstance(specs, SensorSpecs):
        allowed = "give it what to expect of them, such as IDEAL_SENSORS"
        raise InvalidInput(f"sensors {part_name(sensors)} have no specs, a SensorSpecs; {allowed}")
    return specs


def require_suffered(faults: Iterable[Fault], plant: Any, sensors: Any) -> None:
    """Raise `InvalidInput` for a fault of a user's own plant or sensors that these do not have of themselves."""
    for fault in faults:
        channel = fault.strikes.channel
        maker, what = (sensors, channel) if channel else (plant, fault.strikes.family)
        own = not isinstance(maker, str | SensorSpecs)
        if own and what not in getattr(maker, "suffers", ()):
            whose = f"{'sensors' if channel else 'plant'} {part_name(maker)}"
            raise InvalidInput(
                f"{fault}: {whose} has no {what!r} in its suffers; add it and simulate it, or leave it out"
            )

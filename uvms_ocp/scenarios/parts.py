"""Parts that scenarios share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from uvms_ocp.exceptions import NameNotFound
from uvms_ocp.mission.conditions import Below, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import unactuated_axes
from uvms_ocp.sim.currents import Current, StillWater, UniformCurrent
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.velocity import UnderActuation


def current_field(given: Current | Sequence[float] | None) -> Current:
    """A field as it is, or the uniform one of a velocity (3,) [m/s] in W; still water for `None`."""
    if given is None:
        return StillWater()
    return UniformCurrent(given) if isinstance(given, Sequence | np.ndarray) else given


def underactuation(robot: Robot) -> list[Task]:
    """The task that reckons with the axes out of the thrusters' reach; none if there are no such axes."""
    axes = unactuated_axes(robot)
    return [UnderActuation(axes=axes)] if axes else []


def full_order(robot: Robot, order: Sequence[str] | None) -> tuple[str, ...] | None:
    """The user's order; what cannot be driven comes first whatever the order."""
    return None if order is None else (*(task.name for task in underactuation(robot)), *order)


def always_underactuated(robot: Robot, phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    """The phases with the task of `underactuation` always on."""
    gates = on(*(task.name for task in underactuation(robot)))
    return tuple(replace(phase, gates={**gates, **phase.gates}) for phase in phases)


def on(*names: str) -> dict[str, float]:
    """Gates of a phase: these tasks fully on."""
    return dict.fromkeys(names, 1.0)


def approach_phase() -> Phase:
    """Phase A: the small vehicle comes near its way point, before its tool acts in phase B."""
    near = Below(quantity="PC.position_error", limit=0.2)
    turned = Below(quantity="PC.orientation_error", limit=0.2)
    return Phase(
        name="A",
        title="approach",
        gates=on("JL", "MAC", "HA", "PC", "MP"),
        transitions=(Transition(to="B", when=(near, turned)),),
    )


def override(tasks: list[Task], overrides: Mapping[str, Mapping[str, Any]]) -> list[Task]:
    """Tasks with fields replaced; raises `NameNotFound` for an unknown task or field."""
    by_name = {task.name: task for task in tasks}
    for name, changes in overrides.items():
        if name not in by_name:
            raise NameNotFound("task", name, by_name)
        allowed = [field.name for field in fields(by_name[name])]
        for field_name in changes:
            if field_name not in allowed:
                raise NameNotFound(f"field of task {name}", field_name, allowed)
        by_name[name] = replace(by_name[name], **changes)
    return list(by_name.values())

"""Parts that scenarios share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from uvms_ocp.exceptions import NameNotFound
from uvms_ocp.mission.abort import Abort
from uvms_ocp.mission.conditions import ABORT, Below, Transition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import unactuated_axes
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.velocity import UnderActuation


def mission_of(
    robot: Robot,
    tasks: Sequence[Task],
    phases: Sequence[Phase],
    *,
    order: Sequence[str] | None = None,
    overrides: Mapping[str, Mapping[str, Any]] | None = None,
    abort: Abort | None = None,
) -> Mission:
    """The mission of these tasks and phases; axes out of the thrusters' reach are reckoned with first, and always.

    order: task names, highest priority first, instead of the order of the classes. overrides: fields of tasks by name.
    Raises `NameNotFound` for an unknown task or field, and `InvalidInput` for an order that does not name every task.
    """
    first = _underactuation(robot)
    names = tuple(task.name for task in first)
    listed = override([*first, *tasks], overrides) if overrides else [*first, *tasks]
    mission = Mission(
        hierarchy=Hierarchy(listed, None if order is None else (*names, *order)), phases=tuple(phases), abort=abort
    )
    return with_gates(mission, on(*names))


def with_gates(mission: Mission, gates: Mapping[str, float]) -> Mission:
    """The mission with these gates [-] in every phase that does not set them itself, that of its abort too."""
    phases = tuple(replace(phase, gates={**gates, **phase.gates}) for phase in mission.all_phases)
    n = len(mission.phases)
    abort = None if mission.abort is None else replace(mission.abort, phase=phases[n])
    return replace(mission, phases=phases[:n], abort=abort)


def abort_phase(*names: str, arrived: float = 0.3, hold: float = 2.0) -> Abort:
    """A climb to a safe altitude, where it is held: the vehicle by PC, the arm towards the posture of MP, if it is named.

    names: of the tasks that are on beside PC, such as those that keep the robot safe. arrived [m] and hold [s]: how near to
    that altitude, and for how long.
    """
    there = Below(quantity="PC.position_error", limit=arrived)
    phase = Phase(
        name="climb",
        title="abort",
        gates=on("PC", *names),
        transitions=(Transition(to=ABORT, when=(there,), hold=hold),),
    )
    return Abort(phase=phase)


def _underactuation(robot: Robot) -> list[Task]:
    axes = unactuated_axes(robot)
    return [UnderActuation(axes=axes)] if axes else []


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

"""Parameters that the controller knows: goals that do not move, numbers of tasks and gains, and
numbers of a user's own parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.campaign.distributions import Parameter, real_numbers
from uvms_ocp.campaign.place_parameters import AXES
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.mission.mission import Mission
from uvms_ocp.scenario.part_factories import maker_of
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import Hierarchy, JointTracking


def objective_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters that the controller knows: goals and tasks."""
    for task in scenario.mission.hierarchy.tasks:
        goal = getattr(task, "goal", None)
        prefix = f"goals.{task.name}"
        # The posture of an arm of three joints is no point in W.
        is_point = (
            isinstance(goal, np.ndarray)
            and goal.shape == (3,)
            and not isinstance(task, JointTracking)
        )
        if isinstance(goal, pin.SE3) or is_point:
            for axis, name in AXES:
                meaning = f"added to {name} of the goal of {task.name}, in W"
                apply = partial(_with_goal, task.name, axis)
                yield Parameter(f"{prefix}.{name}", "m", meaning, apply)
        if isinstance(goal, pin.SE3):
            meaning = f"turn of the goal of {task.name} about z of W"
            yield Parameter(f"{prefix}.yaw", "rad", meaning, partial(_with_goal, task.name, 3))
        for name in real_numbers(task):
            apply = partial(_with_number, task.name, name)
            yield Parameter(
                f"tasks.{task.name}.{name}",
                "as there",
                f"{name} of {task.name}, as its class has it",
                apply,
            )
    if scenario.takes_forces:
        for name in [item.name for item in fields(VelocityGains)]:
            meaning = f"{name} of VelocityGains"
            yield Parameter(f"gains.{name}", "as there", meaning, partial(_with, "gains", name))


def _with_goal(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    """Shift the goal of the task itself and of the phases that give it a goal of their own."""
    mission = _changed(
        scenario.mission, name, lambda task: task.with_goal(_shifted(task.goal, axis, value))
    )
    phases = list(mission.phases)
    for k, phase in enumerate(phases):
        if name in phase.goals:
            phases[k] = replace(
                phase, goals={**phase.goals, name: _shifted(phase.goals[name], axis, value)}
            )
    return replace(scenario, mission=replace(mission, phases=tuple(phases)))


def _shifted(goal: Any, axis: int, value: float) -> Any:
    if not isinstance(goal, pin.SE3):
        if callable(goal):
            return goal
        return goal + value * np.eye(3)[axis]
    if axis < len(AXES):
        return pin.SE3(goal.rotation, goal.translation + value * np.eye(3)[axis])
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, value) @ goal.rotation, goal.translation)


def _with_number(name: str, field: str, scenario: Scenario, value: float) -> Scenario:
    return replace(
        scenario,
        mission=_changed(scenario.mission, name, lambda task: replace(task, **{field: value})),
    )


def _changed(mission: Mission, name: str, change: Any) -> Mission:
    """Return the mission with another task in the place of that name; the order stays."""
    tasks = list(mission.hierarchy.tasks)
    order = tuple(task.name for task in tasks)
    tasks[order.index(name)] = change(tasks[order.index(name)])
    return replace(mission, hierarchy=Hierarchy(tasks, order))


def own_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters such as ``parts.plant.rate``, of every own part that is made by a dataclass
    with real numbers.
    """
    for part, name in scenario.own_parts.items():
        maker: Any = maker_of(part, getattr(scenario, part))
        is_value = is_dataclass(maker) and not isinstance(maker, type)
        if not is_value:
            continue
        for item in real_numbers(maker):
            meaning = f"{item} of {name}, as its class has it"
            yield Parameter(f"parts.{part}.{item}", "as there", meaning, partial(_with, part, item))


def _with(part: str, name: str, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with another number of one of its parts, or of what makes it."""
    part_value = getattr(scenario, part)
    if part == "gains":
        maker: Any = part_value
    else:
        maker = maker_of(part, part_value)
    return replace(scenario, **{part: replace(maker, **{name: value})})

"""Parameters of the mission: goals that do not move, numbers of tasks, gains of the velocity loop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.campaign.variations.parameter import Parameter, real_numbers
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.mission.mission import Mission
from uvms_ocp.scenario import Scenario
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.task import Task

_OFFSETS = ("x", "y", "z")


def objective_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """What the controller is told, and so knows."""
    for task in scenario.mission.hierarchy.tasks:
        goal = getattr(task, "goal", None)
        if isinstance(goal, pin.SE3) or _is_point(task, goal):
            for axis, name in enumerate(_OFFSETS):
                meaning = f"added to {name} of the goal of {task.name}, in W"
                apply = partial(_with_goal, task.name, axis)
                yield Parameter(name=f"goals.{task.name}.{name}", unit="m", meaning=meaning, apply=apply)
        if isinstance(goal, pin.SE3):
            meaning = f"turn of the goal of {task.name} about z of W"
            yield Parameter(
                name=f"goals.{task.name}.yaw", unit="rad", meaning=meaning, apply=partial(_with_goal, task.name, 3)
            )
        for name in real_numbers(task):
            meaning = f"{name} of {task.name}, as its class has it"
            apply = partial(_with_number, task.name, name)
            yield Parameter(name=f"tasks.{task.name}.{name}", unit="as there", meaning=meaning, apply=apply)
    if scenario.takes_forces:
        for item in fields(VelocityGains):
            meaning = f"{item.name} of VelocityGains"
            yield Parameter(
                name=f"gains.{item.name}", unit="as there", meaning=meaning, apply=partial(_gain, item.name)
            )


def _is_point(task: Task, goal: Any) -> bool:
    """In W; the posture of an arm of three joints is none."""
    return isinstance(goal, np.ndarray) and goal.shape == (3,) and not isinstance(task, JointTracking)


def _with_goal(name: str, axis: int, scenario: Scenario, value: float) -> Scenario:
    """Of the task itself and of the phases that give it a goal of their own."""
    mission = _changed(scenario.mission, name, lambda task: task.with_goal(_shifted(task.goal, axis, value)))
    phases = tuple(
        replace(phase, goals={**phase.goals, name: _shifted(phase.goals[name], axis, value)})
        if name in phase.goals
        else phase
        for phase in mission.phases
    )
    return replace(scenario, mission=replace(mission, phases=phases))


def _shifted(goal: Any, axis: int, value: float) -> Any:
    if not isinstance(goal, pin.SE3):
        return goal if callable(goal) else goal + value * np.eye(3)[axis]
    if axis < len(_OFFSETS):
        return pin.SE3(goal.rotation, goal.translation + value * np.eye(3)[axis])
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, value) @ goal.rotation, goal.translation)


def _with_number(name: str, field: str, scenario: Scenario, value: float) -> Scenario:
    return replace(scenario, mission=_changed(scenario.mission, name, lambda task: replace(task, **{field: value})))


def _changed(mission: Mission, name: str, change: Any) -> Mission:
    """The mission with another task in the place of that name; the order stays."""
    tasks = [change(task) if task.name == name else task for task in mission.hierarchy.tasks]
    order = tuple(task.name for task in mission.hierarchy.tasks)
    return replace(mission, hierarchy=Hierarchy(tasks, order))


def _gain(name: str, scenario: Scenario, value: float) -> Scenario:
    return replace(scenario, gains=replace(scenario.gains, **{name: value}))

"""Digests of the robot, the start and the mission of a scenario, by which a saved plan is
recognised.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.mission.mission import Mission
from uvms_ocp.robot import Robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks.task import Task

_MOMENTS = (0.0, 1.0, 7.0)  # [s] at which goals are looked at
_DIGITS = 9
_PLAIN = (bool, int, float, str, tuple)


@checked
def mission_digests(scenario: Scenario) -> dict[str, str]:
    """Return digests of the robot, the start and the mission of a scenario, by these names."""
    return {
        "robot": _digest(_of_robot(scenario.robot)),
        "start": _digest([_rounded(scenario.start)]),
        "mission": _digest(_of_mission(scenario.mission)),
    }


def _digest(parts: list[str] | Iterator[str]) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _of_robot(robot: Robot) -> Iterator[str]:
    yield from (robot.name, *robot.model.names)
    for inertia, placement in zip(robot.model.inertias, robot.model.jointPlacements, strict=True):
        yield _rounded(inertia.toDynamicParameters())
        yield _rounded(placement.homogeneous)
    yield from (_rounded(getattr(robot.limits, item.name)) for item in fields(robot.limits))
    yield repr(robot.description.thrusters)


def _of_mission(mission: Mission) -> Iterator[str]:
    for index, phase in enumerate(mission.phases):
        yield from (phase.name, repr(sorted(phase.activations.items())), repr(phase.transitions))
        for task in mission.tasks_of(index):
            if task.name in phase.on:
                yield from _of_task(task)


def _of_task(task: Task) -> Iterator[str]:
    yield type(task).__name__
    values = {item.name: getattr(task, item.name) for item in fields(task)}
    yield from (f"{name}={value!r}" for name, value in values.items() if isinstance(value, _PLAIN))
    yield from (_rounded(task.reference(t)) for t in _MOMENTS)


def _rounded(values: np.ndarray) -> str:
    rounded = np.round(np.asarray(values, dtype=float), _DIGITS) + 0.0
    return np.array2string(rounded, threshold=rounded.size + 1)

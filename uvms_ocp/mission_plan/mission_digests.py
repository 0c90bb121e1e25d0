"""Digests of the robot, the start and the mission of a scenario, by which a saved plan is
recognised.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import fields

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.mission.mission import Mission
from uvms_ocp.robot import Robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks.task import Task

_SAMPLE_TIMES = (0.0, 1.0, 7.0)  # [s] at which goals are evaluated
_DECIMALS = 9  # of numbers, so that rounding errors change no digest
_PLAIN_TYPES = (bool, int, float, str, tuple)  # of fields whose text is their value


@checked
def mission_digests(scenario: Scenario) -> dict[str, str]:
    """Return digests of the robot, the start and the mission of a scenario, by these names."""
    return {
        "robot": _digest(_of_robot(scenario.robot)),
        "start": _digest([_rounded(scenario.start)]),
        "mission": _digest(_of_mission(scenario.mission)),
    }


def _digest(texts: Iterable[str]) -> str:
    """Return the first digits of the hash of texts."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


def _of_robot(robot: Robot) -> Iterator[str]:
    """Yield what a motion depends on: bodies, joints, limits and thrusters."""
    yield robot.name
    yield from robot.model.names
    for inertia, placement in zip(robot.model.inertias, robot.model.jointPlacements, strict=True):
        yield _rounded(inertia.toDynamicParameters())
        yield _rounded(placement.homogeneous)
    for limit in fields(robot.limits):
        yield _rounded(getattr(robot.limits, limit.name))
    yield repr(robot.description.thrusters)


def _of_mission(mission: Mission) -> Iterator[str]:
    """Yield the phases, their transitions, and the tasks that are on in each."""
    for index, phase in enumerate(mission.phases):
        yield phase.name
        yield repr(sorted(phase.activations.items()))
        yield repr(phase.transitions)
        for task in mission.tasks_of(index):
            if task.name in phase.on:
                yield from _of_task(task)


def _of_task(task: Task) -> Iterator[str]:
    """Yield the kind of a task, its plain fields, and its goal at a few times."""
    yield type(task).__name__
    for item in fields(task):
        value = getattr(task, item.name)
        if isinstance(value, _PLAIN_TYPES):
            yield f"{item.name}={value!r}"
    for t in _SAMPLE_TIMES:
        yield _rounded(task.reference(t))


def _rounded(values: np.ndarray) -> str:
    """Write numbers (...) with `_DECIMALS`, and -0 as 0."""
    rounded = np.round(np.asarray(values, dtype=float), _DECIMALS) + 0.0
    return np.array2string(rounded, threshold=rounded.size + 1)

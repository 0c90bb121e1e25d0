"""What tells one mission from another: digests that a saved plan is checked by."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model.robot import Robot
from uvms_ocp.scenario import Scenario
from uvms_ocp.tasks.task import Task

_MOMENTS = (0.0, 1.0, 7.0)  # [s] at which goals are looked at
_DIGITS = 9
_PLAIN = (bool, int, float, str, tuple)


@checked
def digests(scenario: Scenario) -> dict[str, str]:
    """Of the robot, the start and the mission of a scenario, by these names."""
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
    limits = robot.limits
    for item in fields(limits):
        yield _rounded(getattr(limits, item.name))
    yield repr(robot.description.thrusters)


def _of_mission(mission: Mission) -> Iterator[str]:
    for index, phase in enumerate(mission.phases):
        yield from (phase.name, repr(sorted(phase.gates.items())), repr(phase.transitions))
        for task in mission.tasks_of(index):
            if phase.gates.get(task.name, 0.0) > 0:
                yield from _of_task(task)


def _of_task(task: Task) -> Iterator[str]:
    yield type(task).__name__
    for item in fields(task):
        value = getattr(task, item.name)
        if isinstance(value, _PLAIN):
            yield f"{item.name}={value!r}"
    for t in _MOMENTS:
        yield _rounded(task.reference(t))


def _rounded(values: np.ndarray) -> str:
    return np.array2string(np.round(np.asarray(values, dtype=float), _DIGITS) + 0.0, threshold=np.inf)  # type: ignore[arg-type]

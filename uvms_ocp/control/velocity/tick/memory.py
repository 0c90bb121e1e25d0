"""The memory of a tick in Python: made once, with what never changes, and seen as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.control.navigation.degraded import ALTIMETER, CHANNELS, write_modes
from uvms_ocp.control.navigation.last_known import echo_sizes
from uvms_ocp.control.navigation.watchdog import Watchdog
from uvms_ocp.control.velocity.climb import climb_sizes
from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.control.velocity.tick.layout import TickMemory
from uvms_ocp.functions.kernels.layout import structure_of, view
from uvms_ocp.mission.mission import Mission, write_mission
from uvms_ocp.mission.progress import sizes_of
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.task import Task


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TickArrays:
    """Arrays of a `TickMemory`, on the same memory, and what they are there."""

    q: np.ndarray
    """(n_q,) [m, rad]"""
    v: np.ndarray
    """(n_v,) [m/s, rad/s]"""
    gates: np.ndarray
    """(n_tasks,) [-]"""
    echo: np.ndarray
    """(1,) [m]"""
    previous: np.ndarray
    """(n_v,) [m/s, rad/s]"""
    change: np.ndarray
    """(n_v,) [m/s, rad/s]"""
    solved: np.ndarray
    """(n_v,) [m/s, rad/s]"""
    quantities: np.ndarray
    """(n_quantities,) [their units]"""
    reported: np.ndarray
    """(n_quantities,) [their units]"""
    told: np.ndarray
    """(n_quantities,) [their units]"""
    last_told: np.ndarray
    """(n_quantities,) [their units]"""
    command: np.ndarray
    """(n_v,) [m/s, rad/s]"""


def tick_memory(
    robot: Robot, mission: Mission, problem: LevelsProblem, watchdog: Watchdog, sizes: Mapping[str, Any]
) -> Any:
    """A `TickMemory` at rest, before the first measurement; what tells of distress, echoes, limits and goals is not in it yet.

    sizes: as `rule_sizes` and `track_sizes` tell them.
    """
    tasks, names = mission.hierarchy.tasks, problem.quantity_names
    known = {
        **sizes,
        "n_tasks": len(tasks),
        "n_quantities": len(names),
        "n_channels": len(problem.rests_on),
        "n_parameters": problem.function.size1_in("parameters"),
        **climb_sizes(robot, mission),
        **echo_sizes(robot, altimeter_of(robot, tasks)),
        **sizes_of(mission.all_phases),
    }
    memory = structure_of(TickMemory, **known)()
    write_mission(memory.mission, mission, names)
    memory.climb.altitude = math.nan if mission.abort is None else mission.abort.altitude
    memory.hold_after, memory.stop_after = watchdog.hold_after, watchdog.stop_after
    memory.pace, memory.near = 1.0, True
    view(memory.place)[:] = robot.configuration()
    write_modes(memory.restriction)
    view(memory.last_told)[:] = math.nan
    view(memory.velocity_limit)[:] = robot.limits.velocity
    _write_restraint(memory.restraint, robot, problem.step)
    memory.altimeter = [*problem.rests_on].index(ALTIMETER)
    for k, (channel, rests) in enumerate(problem.rests_on.items()):
        memory.channel[k] = CHANNELS.index(channel)
        view(memory.rests_on)[k, : len(names)] = rests
    for i, task in enumerate(tasks):
        memory.reads_altitude[i], memory.rest_altitude[i] = task.needs_altimeter, task.rest_altitude
        memory.lands[i] = task.needs_altimeter and task.equality
    return memory


def arrays_of(memory: Any, problem: LevelsProblem) -> TickArrays:
    """The arrays of a `TickMemory`, which has room for one of each where there is none."""
    n_tasks, n_quantities = problem.function.size1_in("gates"), len(problem.quantity_names)
    sizes = {"gates": n_tasks, **dict.fromkeys(("quantities", "reported", "told", "last_told"), n_quantities)}
    names = TickArrays.__dataclass_fields__
    return TickArrays(**{name: view(getattr(memory, name))[: sizes.get(name)] for name in names})


def inputs_of(memory: Any, arrays: TickArrays, problem: LevelsProblem) -> tuple[np.ndarray, ...]:
    """Of the levels function, in its order."""
    parameters = view(memory.goals.values)[: problem.function.size1_in("parameters")]
    return (arrays.q, arrays.v, arrays.previous, arrays.change, arrays.echo, parameters, arrays.gates)


def _write_restraint(memory: Any, robot: Robot, step: np.ndarray) -> None:
    view(memory.step)[:] = step
    memory.has_vehicle = bool(robot.n_vehicle)
    for i in range(robot.n_v):
        memory.is_joint[i] = i >= robot.n_vehicle


def altimeter_of(robot: Robot, tasks: Sequence[Task]) -> str | None:
    """The frame that tasks on altitude name, or that of the robot's file."""
    named = (getattr(task, "frame", None) for task in tasks if task.needs_altimeter)
    return next(filter(None, named), robot.description.altimeter)

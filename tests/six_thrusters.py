"""The vehicle that most people own: two vertical thrusters abeam, so that nobody drives pitch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import uvms_ocp as uo
from uvms_ocp.control.force.thruster_lag import thruster_lag
from uvms_ocp.control.force.tick_functions import ForceLaws
from uvms_ocp.control.force.velocity_law import VelocityLaw
from uvms_ocp.control.velocity.goals import task_parameters
from uvms_ocp.control.velocity.levels import LevelsProblem, build_levels
from uvms_ocp.control.velocity.swing import N_PASSIVE
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.level import Level, row_slices
from uvms_ocp.tasks import Hierarchy, Task


def unit_laws(robot: Robot, dt: float) -> ForceLaws:
    """Force laws with gains of 1; dt [s]."""
    gain = np.ones(robot.n_v)
    velocity = VelocityLaw(dynamics=cached_dynamics(robot).symbolic, K_p=gain, reset=gain, dt=dt)
    return ForceLaws(
        robot=robot, velocity=velocity, lag=thruster_lag(robot, lead=4.0, dt=dt), lift=100.0
    )


_PROBLEMS: dict[tuple[Robot, tuple[str, ...]], LevelsProblem] = {}
_TEMPLATES = Path(str(uo.__file__)).parent / "scenario" / "templates"


def six_thrusters() -> Robot:
    """The robot that `new-robot` writes, its four lift thrusters merged into two abeam of twice the
    thrust.
    """
    robot = uo.load_robot(
        urdf=_TEMPLATES / "robot.urdf", hydrodynamics=_TEMPLATES / "hydrodynamics.yaml"
    )
    level = robot.description.thrusters[:4]
    lift = robot.description.thrusters[4]
    doubled = {"minimum": 2 * lift.minimum, "maximum": 2 * lift.maximum, "power": None}
    left = lift.model_copy(update={"name": "lift_left", "position": (0.0, 0.2, 0.0), **doubled})
    right = lift.model_copy(update={"name": "lift_right", "position": (0.0, -0.2, 0.0), **doubled})
    description = checked_copy(robot.description, thrusters=(*level, left, right))
    return replace(robot, description=description)


def command_of(robot: Robot, tasks: Sequence[Task], q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n_v,) [m/s, rad/s] at q (n_q,) and v (n_v,) from rest, with all tasks on."""
    names = tuple(task.name for task in tasks)
    hierarchy = Hierarchy(tasks, list(names))
    if (robot, names) not in _PROBLEMS:  # goals are parameters
        _PROBLEMS[robot, names] = build_levels(robot, hierarchy, 0.005)
    problem = _PROBLEMS[robot, names]
    parameters = np.concatenate(
        [task_parameters(task, task.reference(0.0), q) for task in hierarchy.tasks]
    )
    zeros = np.zeros(robot.n_v)
    outputs = problem.function(
        q, v, np.zeros(N_PASSIVE), zeros, zeros, 5.0, parameters, np.ones(len(tasks))
    )
    pairs = zip(problem.function.name_out(), outputs, strict=True)
    parts = {name: np.array(output) for name, output in pairs}
    levels = []
    for rows in row_slices(problem.sizes):
        level = Level(
            jacobian=parts["J"][rows],
            lower=parts["lower"][rows, 0],
            upper=parts["upper"][rows, 0],
            gate=parts["gate"][rows, 0],
        )
        levels.append(level)
    return LexicographicActiveSet(compiled=False).solve(levels).v

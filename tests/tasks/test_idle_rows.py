"""Rows that ask for nothing new change nothing that any task of the registry commands, whichever
solver finds it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from more_rows import as_it_is, extended, with_a_row_of_zeros, with_its_last_row_twice
from task_registry import REGISTRY

import uvms_ocp as uo
from uvms_ocp.cli.options import SOLVERS
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.robot.signals import StateEstimate
from uvms_ocp.tasks import JointLimits, JointTracking
from uvms_ocp.tasks.task import Task

DT = 0.02
TICKS = 25


def alone(task: Task, solver: str, changed: Callable[[Task], Task]) -> np.ndarray:
    """(n, n_v) [m/s, rad/s] that a task commands beside the limits of joints."""
    robot = uo.load_robot("bluerov2_alpha5")
    tasks = [JointLimits(), changed(task)] if task.name != "JL" else [changed(task)]
    for_ever = uo.Transition(to=uo.DONE, when=(uo.Above(quantity="phase.time", limit=1e3),))
    phase = uo.Phase(
        name="go", activations={task.name: 1.0 for task in tasks}, transitions=(for_ever,)
    )
    mission = uo.Mission(hierarchy=uo.Hierarchy(tasks), phases=(phase,))
    control = KinematicController(robot=robot, mission=mission, solver=SOLVERS[solver](), dt=DT)
    q = robot.configuration(position=(0.0, 0.0, -5.0), rpy=(0.1, 0.5, 0.7))
    v = np.zeros(robot.n_v)
    rows = []
    for k in range(TICKS):
        v = control(StateEstimate(q=q, v=v, altimeter_range=0.8), k * DT).v.copy()
        rows.append(v)
        q = pin.integrate(robot.model, q, v * DT)
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("name", REGISTRY)
def test_idle_rows_change_nothing_that_a_task_commands(name: str, solver: str) -> None:
    task = REGISTRY[name].task
    task = replace(task, joints=("joint2", "joint4")) if isinstance(task, JointTracking) else task
    usual = alone(task, solver, as_it_is)
    for more in (with_a_row_of_zeros, with_its_last_row_twice):
        extended_run = alone(task, solver, partial(extended, more=more))
        np.testing.assert_allclose(
            extended_run, usual, atol={"icat": 1e-2}.get(solver, 1e-4), err_msg=more.__name__
        )

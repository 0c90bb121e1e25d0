"""Robots and solvers of the registries command the same in any world, by any clock and however rows
are written: their laws.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from more_rows import as_it_is, extended, with_a_row_of_zeros, with_its_last_row_twice

import uvms_ocp as uo
from uvms_ocp.cli.options import SOLVERS
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.robot.loading import list_robots
from uvms_ocp.robot.signals import StateEstimate
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.tasks import (
    HorizontalAttitude,
    JointLimits,
    MinimumAltitude,
    ToolPosition,
    VehiclePose,
)
from uvms_ocp.tasks.task import Rows, Task

DT = 0.02
TICKS = 25
STATUSES = tuple(Status)
CASES = {  # X_NW of the new world N, and by how much [s] its clock is ahead
    "moved by 1 km": (pin.SE3(np.eye(3), np.array([800.0, -600.0, 0.0])), 0.0),
    "half turned": (pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.zeros(3)), 0.0),
    "turned once around": (pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2 * np.pi), np.zeros(3)), 0.0),
    "a clock of 1e3 s": (pin.SE3.Identity(), 1e3),
    "Unix time": (pin.SE3.Identity(), 1.76e9),
}
START = uo.pose_at((0.0, 0.0, -5.0), (0.0, 0.1, 0.7))
GOAL = uo.pose_at((0.4, -0.3, -5.2), (0.0, 0.0, -2.9))


def mission(
    robot: uo.Robot, X_NW: pin.SE3, tool: np.ndarray, changed: Callable[[Task], Task]
) -> uo.Mission:
    tasks: list[Task] = [JointLimits()]
    if robot.n_vehicle:
        if robot.description.altimeter:
            tasks.append(MinimumAltitude())
        tasks += [HorizontalAttitude(), VehiclePose(goal=X_NW * GOAL)]
    if robot.n_joints and robot.tools:
        tasks.append(ToolPosition(goal=pin.SE3(np.eye(3), X_NW.act(tool))))
    if not robot.n_joints:
        tasks = tasks[1:]
    tasks = [changed(task) for task in tasks]
    last = tasks[-1].name
    end = uo.Transition(to=uo.DONE, when=(uo.Below(quantity=f"{last}.position_error", limit=1e-9),))
    phase = uo.Phase(name="go", activations={task.name: 1.0 for task in tasks}, transitions=(end,))
    return uo.Mission(hierarchy=uo.Hierarchy(tasks), phases=(phase,))


def commands(
    robot: uo.Robot,
    solver: str,
    X_NW: pin.SE3,
    ahead: float,
    changed: Callable[[Task], Task] = as_it_is,
) -> np.ndarray:
    """(n, n_v) [m/s, rad/s] on the way, until the solver calls one inexact; a fixed base is its own
    world.
    """
    X_world = pin.SE3.Identity()
    q = robot.configuration().copy()
    q_at_start = q.copy()
    if robot.n_vehicle:
        X_world = X_NW
        q[:7] = pin.SE3ToXYZQUAT(X_world * START)
        q_at_start[:7] = pin.SE3ToXYZQUAT(START)
    tool = np.zeros(3)
    if robot.tools:
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q_at_start)
        tool = data.oMf[robot.frame_id(robot.tools[0])].translation + np.array([0.2, 0.1, -0.05])
    control = KinematicController(
        robot=robot, mission=mission(robot, X_world, tool, changed), solver=SOLVERS[solver](), dt=DT
    )
    v = np.zeros(robot.n_v)
    rows = []
    for k in range(TICKS):
        echo = q[2] + 20.0 if robot.n_vehicle else np.nan
        command = control(StateEstimate(q=q, v=v, altimeter_range=echo), ahead + k * DT)
        if STATUSES[command.telemetry["status"]] is Status.INEXACT:
            break
        v = command.v.copy()
        rows.append(v)
        q = pin.integrate(robot.model, q, v * DT)
    return np.array(rows)


@pytest.mark.sampled
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("name", list_robots())
def test_the_same_is_commanded_in_any_world_and_by_any_clock(name: str, solver: str) -> None:
    robot = uo.load_robot(name)
    usual = commands(robot, solver, pin.SE3.Identity(), 0.0)
    assert np.abs(usual).max() > 0.01
    for case, (X_NW, ahead) in CASES.items():
        moved = commands(robot, solver, X_NW, ahead)
        n = min(len(moved), len(usual))
        exact = 1e-6
        if solver == "lexqp":
            # A cascade of QPs, each solved to a tolerance that the next inherits.
            exact = 1e-4
            assert n >= 5
        else:
            assert n == TICKS
        # Velocities change by 1 m/s2 and more within the resolution of a clock.
        allowed = exact + 50.0 * np.spacing(ahead)
        assert np.abs(moved[:n] - usual[:n]).max() <= allowed, case


@pytest.mark.sampled
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("girona_maris7_full", with_a_row_of_zeros),
        ("bluerov2_six_alpha5", with_a_row_of_zeros),
        ("bluerov2_six_alpha5", with_its_last_row_twice),
        ("planar5", with_its_last_row_twice),
    ],
)
def test_rows_that_ask_for_nothing_new_change_nothing(
    name: str, solver: str, more: Callable[[Rows, Task], Rows]
) -> None:
    """In every task at once."""
    robot = uo.load_robot(name)
    X_identity = pin.SE3.Identity()
    usual, moved = (
        commands(robot, solver, X_identity, 0.0, changed)
        for changed in (as_it_is, lambda task: extended(task, more))
    )
    n = min(len(moved), len(usual))
    assert n >= (5 if solver == "lexqp" else TICKS)
    assert np.abs(usual).max() > 0.01
    np.testing.assert_allclose(
        moved[:n], usual[:n], atol={"lexqp": 1e-4, "icat": 1e-2}.get(solver, 1e-6)
    )

"""Laws of receding-horizon control on the physical plant."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.control.nmpc import Nmpc
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.robot import Robot, load_robot
from uvms_ocp.model.state import Measurement, State
from uvms_ocp.planning import (
    At,
    Effort,
    HessianKind,
    OcpLevel,
    OcpPhase,
    OcpProblem,
    Smoothness,
    TaskTerm,
)
from uvms_ocp.sim import DynamicPlant, Environment, FlatSeafloor, GustyCurrent, UniformCurrent
from uvms_ocp.tasks import ToolPose

CURRENT = np.array([0.3, 0.0, 0.0])


def tool_pose(robot: Robot, q: np.ndarray) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id("tool")].copy()


def station_keeping(robot: Robot, duration: float | tuple[float, float] = 3.0) -> OcpProblem:
    joints = [0.0, -0.6, 0.0, -1.2, 0.0, -0.6, 0.0]
    q = robot.configuration(position=(0, 0, -5), rpy=(0, 0, 0.5), joints=joints)
    task = ToolPose(goal=tool_pose(robot, q))
    terms = (TaskTerm(task=task, at=At.PATH, weight=10.0), TaskTerm(task=task, weight=3.0))
    return OcpProblem(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        phases=(OcpPhase(duration=duration, n_steps=20),),
        levels=(OcpLevel(name="hold", terms=(*terms, Effort(), Smoothness(weight=0.3))),),
        current=CURRENT,
        hessian=HessianKind.GAUSS_NEWTON,
    )


def test_the_tool_stays_within_two_centimetres_in_a_gusty_current() -> None:
    robot = load_robot("girona_maris7_full")
    problem = station_keeping(robot)
    current = GustyCurrent(base=UniformCurrent(CURRENT), sigma=0.05, seed=1)
    environment = Environment(seafloor=FlatSeafloor(z=-40), current=current)
    plant = DynamicPlant(robot, problem.start.q, dynamics=robot_dynamics(robot), environment=environment)
    nmpc, dt, goal = Nmpc(problem, time_limit=10.0), 1 / 200, tool_pose(robot, problem.start.q)
    worst = 0.0
    for i in range(600):
        measurement = Measurement(q=plant.state.q, v=plant.state.v, altimeter_range=10.0)
        plant.step(nmpc(measurement, i * dt), dt)
        error = tool_pose(robot, plant.state.q).translation - goal.translation
        worst = max(worst, float(np.linalg.norm(error)))
    assert worst < 0.02
    assert len(nmpc.statistics.solve_times) == 59
    assert nmpc.statistics.rejected <= 6


def test_misuse_is_refused() -> None:
    robot = load_robot("girona_maris7_full")
    with pytest.raises(InvalidInput, match="dt <= period"):
        Nmpc(station_keeping(robot), dt=0.1, period=0.05)
    with pytest.raises(InvalidInput, match="fixed durations"):
        Nmpc(station_keeping(robot, duration=(1.0, 3.0)))

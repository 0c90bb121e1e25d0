"""Laws of receding-horizon control on the physical plant."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.control.nmpc import Nmpc
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem
from uvms_ocp.ocp.terms import At, Effort, Smoothness, TaskTerm
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import IDEAL_SENSORS, State
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.loop import simulate
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.solvers.nlp.options import SqpOptions
from uvms_ocp.tasks.goals import PoseGoal, PoseReference, evaluate_pose
from uvms_ocp.tasks.pose import ToolPose

CURRENT = np.array([0.3, 0.0, 0.0])
JOINTS = [0.0, -0.6, 0.0, -1.2, 0.0, -0.6, 0.0]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def start_of(robot: Robot) -> np.ndarray:
    return robot.configuration(position=(0, 0, -5), rpy=(0, 0, 0.5), joints=JOINTS)


def tool_pose(robot: Robot, q: np.ndarray) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id("tool")].copy()


def circle(robot: Robot, *, radius: float = 0.3, speed: float = 0.1) -> PoseReference:
    """From where the tool is, at the full speed [m/s] after 2 s."""
    first = tool_pose(robot, start_of(robot))

    def at(t: float) -> tuple[pin.SE3, np.ndarray]:
        if t > 2:
            way = speed * (t - 1)
            rate = speed
        else:
            way = speed * t * t / 4
            rate = speed * t / 2
        s = np.sin(way / radius)
        c = np.cos(way / radius)
        moved = first.translation + radius * np.array([s, 1 - c, 0.0])
        return pin.SE3(first.rotation, moved), rate * np.array([c, s, 0.0, 0.0, 0.0, 0.0])

    return at


def following(
    robot: Robot, goal: PoseGoal, duration: float | tuple[float, float] = 3.0, **options: Any
) -> OcpProblem:
    task = ToolPose(goal=goal)
    terms = (TaskTerm(task=task, at=At.PATH, weight=100.0), TaskTerm(task=task, weight=9.0))
    levels = (OcpLevel(name="follow", terms=(*terms, Effort(), Smoothness(weight=0.09))),)
    return OcpProblem(
        robot=robot,
        start=State(q=start_of(robot), v=np.zeros(robot.n_v)),
        phases=(OcpPhase(duration=duration, n_steps=20),),
        current=CURRENT,
        **({"levels": levels} | options),
    )


class Stopwatch:
    """A clock that moves on by a millisecond whenever it is read, and now and then by a tenth of a
    second.
    """

    def __init__(self, nth: int) -> None:
        self.readings = 0
        self.nth = nth
        self.time = 0.0

    def __call__(self) -> float:
        self.readings += 1
        self.time += 1e-3 if self.readings % self.nth else 0.1
        return self.time


def largest_error(robot: Robot, nmpc: Nmpc, goal: PoseGoal, seconds: float) -> float:
    """Largest distance [m] of the tool from its goal, in a current of 0.3 m/s with gusts."""
    current = GustyCurrent(base=UniformCurrent(CURRENT), sigma=0.05, seed=1)
    environment = Environment(seafloor=FlatSeafloor(z=-40), current=current)
    dt = 1 / 200
    record = simulate(
        plant=DynamicPlant(
            robot, start_of(robot), dynamics=robot_dynamics(robot), environment=environment
        ),
        sensors=SensorSuite(robot, environment.seafloor, IDEAL_SENSORS).read,
        estimator=PassThrough(robot),
        controller=nmpc,
        dt=dt,
        duration=seconds - dt,
    ).series()
    places = [tool_pose(robot, q).translation for q in record["q"]]
    goals = [evaluate_pose("goal", goal, float(t))[0].translation for t in record["t"]]
    return float(np.linalg.norm(np.subtract(places, goals), axis=1).max())


@pytest.mark.slow
def test_the_tool_keeps_its_station_in_a_gusty_current(robot: Robot) -> None:
    goal = tool_pose(robot, start_of(robot))
    nmpc = Nmpc(following(robot, goal), clock=lambda: 0.0)
    assert largest_error(robot, nmpc, goal, 4.0) < 0.02
    assert len(nmpc.statistics.solve_times) == 80
    assert nmpc.statistics.rejected == 0


@pytest.mark.slow
def test_the_tool_follows_a_moving_goal_in_a_gusty_current(robot: Robot) -> None:
    goal = circle(robot)
    nmpc = Nmpc(following(robot, goal), clock=lambda: 0.0)
    assert largest_error(robot, nmpc, goal, 8.0) < 0.02
    assert nmpc.statistics.rejected <= 1


@pytest.mark.slow
def test_strict_priority_of_the_tool_follows_more_closely_than_a_sum(robot: Robot) -> None:
    goal = circle(robot)
    tool = OcpLevel(
        name="tool", terms=(TaskTerm(task=ToolPose(goal=goal), at=At.PATH, weight=100.0),)
    )
    cheap = OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09)))
    strict = Nmpc(following(robot, goal, levels=(tool, cheap)), clock=lambda: 0.0)
    summed = Nmpc(following(robot, goal), clock=lambda: 0.0)
    assert largest_error(robot, strict, goal, 3.0) < 0.7 * largest_error(robot, summed, goal, 3.0)


@pytest.mark.slow
def test_the_plan_that_is_flown_can_be_looked_at(robot: Robot) -> None:
    """It begins where the robot is, at its beginning, and it is what commands follow."""
    goal = tool_pose(robot, start_of(robot))
    nmpc = Nmpc(following(robot, goal), clock=lambda: 0.0)
    assert nmpc.prediction is None
    largest_error(robot, nmpc, goal, 0.5)
    prediction = nmpc.prediction
    assert prediction is not None
    assert 0.3 < prediction.begin <= 0.5
    q, v, _ = prediction.trajectory.state_at(robot.model, 0.0)
    np.testing.assert_array_equal(q, prediction.trajectory.q[0])
    off = np.abs(pin.difference(robot.model, start_of(robot), q))
    assert off[:3].max() < 0.05, "the vehicle keeps its place [m]"
    assert off[3:].max() < 0.2
    assert np.isfinite(v).all()


def test_while_a_plan_is_late_the_last_one_goes_on(robot: Robot) -> None:
    goal = circle(robot)
    nmpc = Nmpc(following(robot, goal), clock=Stopwatch(7))
    assert largest_error(robot, nmpc, goal, 4.0) < 0.02
    assert 15 <= nmpc.statistics.missed < len(nmpc.statistics.solve_times) < 65


def test_plans_that_are_not_solved_to_the_end_are_flown_as_what_the_robot_makes_of_them(
    robot: Robot,
) -> None:
    goal = circle(robot)
    nmpc = Nmpc(
        following(robot, goal),
        clock=lambda: 0.0,
        options=SqpOptions(max_steps=1, accuracy=1e-5),
    )
    assert largest_error(robot, nmpc, goal, 4.0) < 0.02
    assert nmpc.statistics.rejected == 0


def test_plans_are_made_20_times_a_second_and_tracked_200_times_as_the_benchmark_says() -> None:
    defaults = {name: parameter.default for name, parameter in signature(Nmpc).parameters.items()}
    assert (defaults["dt"], defaults["period"]) == (1 / 200, 1 / 20)


def test_misuse_is_refused(robot: Robot) -> None:
    goal = tool_pose(robot, start_of(robot))
    with pytest.raises(InvalidInput, match="dt <= period"):
        Nmpc(following(robot, goal), dt=0.1, period=0.05)
    with pytest.raises(InvalidInput, match="fixed durations"):
        Nmpc(following(robot, goal, duration=(1.0, 3.0)))
    with pytest.raises(InvalidInput, match="leave periodic out"):
        Nmpc(replace(following(robot, goal), periodic=True))
    with pytest.raises(NameNotFound, match="hpipm"):
        SqpOptions(plugin="ipopt")
    with pytest.raises(InvalidInput, match="accuracy"):
        SqpOptions(accuracy=0.0)

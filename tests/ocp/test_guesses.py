"""Where the optimiser starts from decides how long it takes, not where the tool reach ends up."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from reaches import patient, reach

from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.trajectory import Trajectory, guess_through
from uvms_ocp.planning import collision_scene, coordinates
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.request import tool_goal
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import StateEstimate
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits
from uvms_ocp.tasks.pose import ToolPose
from uvms_ocp.trajectories import min_snap

pytestmark = pytest.mark.slow

DURATION = 8.0
WAYS = ("hierarchy", "minimum snap", "last solution")
SAME = {"ipopt": 1e-6, "stagewise": 0.01}  # of the cost: there are optima beside each other


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


@pytest.fixture(scope="module")
def start(robot: Robot) -> np.ndarray:
    return robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))


@pytest.fixture(scope="module")
def goal(robot: Robot, start: np.ndarray) -> pin.SE3:
    tool = Kinematics(robot, start).pose("tool")
    return pin.SE3(
        pin.rpy.rpyToMatrix(0.2, 0.1, 0.3) @ tool.rotation,
        tool.translation + np.array([1.0, -0.5, -0.6]),
    )


@pytest.fixture(scope="module")
def planner(robot: Robot, start: np.ndarray, goal: pin.SE3, plugin: str) -> Planner:
    return patient(reach(robot, duration=DURATION), plugin)


@pytest.fixture(scope="module")
def plan(planner: Planner) -> Plan:
    return planner.plan()


def rollout(planner: Planner, goal: pin.SE3) -> Trajectory:
    """What the velocity hierarchy does in the time of the plan."""
    robot = planner.problem.robot
    dt = 1 / 50
    tasks = [JointLimits(), ToolPose(goal=goal, gain_linear=0.8, gain_angular=0.8)]
    phase = Phase(name="reach", transitions=(), activations={task.name: 1.0 for task in tasks})
    mission = Mission(hierarchy=Hierarchy(tasks), phases=(phase,))
    controller = KinematicController(
        robot=robot, mission=mission, solver=LexicographicActiveSet(), dt=dt
    )
    plant = KinematicPlant(robot, planner.problem.start.q)
    times = np.arange(0.0, DURATION + dt, dt)
    configurations = [plant.state.q]
    for t in times[:-1]:
        measurement = StateEstimate(q=plant.state.q, v=plant.state.v, altimeter_range=30.0)
        plant.step(controller(measurement, float(t)), dt)
        configurations.append(plant.state.q)
    error = Kinematics(robot, plant.state.q).pose("tool").translation - goal.translation
    assert np.linalg.norm(error) < 0.02
    return guess_through(planner.problem, times, np.array(configurations))


def snap(planner: Planner, goal: pin.SE3) -> Trajectory:
    """The smoothest curve to a posture of inverse kinematics."""
    robot = planner.problem.robot
    q = planner.problem.start.q
    planned = coordinates(robot, reference=q)
    x = planned.x(q)
    end = tool_goal(CoalDistances(collision_scene(planned, [])), "tool", goal, x)
    assert end is not None
    times, values = min_snap(np.stack([x, end]), np.array([0.0, DURATION])).trajectory.sample(0.1)
    return guess_through(planner.problem, times, planned.configurations(values[:, 0]))


@pytest.mark.parametrize("way", WAYS)
def test_every_guess_leads_to_the_same_optimum(
    way: str, planner: Planner, goal: pin.SE3, plan: Plan
) -> None:
    guess: Trajectory | Plan
    guess = (
        plan
        if way == "last solution"
        else rollout(planner, goal)
        if way == "hierarchy"
        else snap(planner, goal)
    )
    again = planner.plan(guess=guess)
    assert plan.status is again.status is OcpStatus.SOLVED
    assert again.levels[0].residual < 1e-5
    assert again.levels[1].residual ** 2 == pytest.approx(
        plan.levels[1].residual ** 2, rel=SAME[planner.options.plugin]
    )
    assert again.iterations <= (1 if way == "last solution" else 60)

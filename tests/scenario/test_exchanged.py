"""The order in which equals are listed decides nothing: tasks that share no axis, thrusters,
obstacles, faults, terms.
"""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pytest

import uvms_ocp as uo
from uvms_ocp.cli.options import SOLVERS
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.request import OcpRequest, solve_ocp
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm
from uvms_ocp.planning.request import PlanRequest, PostureGoal, plan_path
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.robot.signals import State
from uvms_ocp.scenario.cases import reach
from uvms_ocp.tasks import HorizontalAttitude, JointLimits, JointTracking, VehiclePose


@pytest.fixture(scope="module")
def robot() -> uo.Robot:
    return uo.load_robot("bluerov2_alpha5")


def hovering(robot: uo.Robot, order: tuple[str, ...], solver: str) -> uo.Scenario:
    pose = VehiclePose(goal=uo.pose_at((0.4, -0.3, -5.2), (0.0, 0.0, 0.5)))
    arm = JointTracking(joints=robot.joint_names[:2], goal=robot.home[:2] + 0.3)
    tasks = [JointLimits(), HorizontalAttitude(), pose, arm]
    end = uo.Transition(to=uo.DONE, when=(uo.Below(quantity="PC.position_error", limit=0.05),))
    phase = uo.Phase(name="go", activations={task.name: 1.0 for task in tasks}, transitions=(end,))
    return uo.Scenario(
        name="hover",
        robot=robot,
        mission=uo.Mission(hierarchy=uo.Hierarchy(tasks, order=order), phases=(phase,)),
        environment=uo.Environment(seafloor=uo.FlatSeafloor(z=-40.0)),
        start=robot.configuration(position=(0.0, 0.0, -5.0)),
        plant="kinematic",
        dt=0.02,
        duration=3.0,
        solver=SOLVERS[solver](),
    )


@pytest.mark.sampled
@pytest.mark.parametrize("solver", SOLVERS)
def test_tasks_that_share_no_axis_command_the_same_in_either_order(
    robot: uo.Robot, solver: str
) -> None:
    orders = ("JL", "HA", "PC", "MP"), ("JL", "HA", "MP", "PC")
    first_v, second_v = (hovering(robot, order, solver).run()["v"] for order in orders)
    assert np.abs(first_v).max() > 0.1
    np.testing.assert_allclose(second_v, first_v, atol=1e-9 if solver == "active_set" else 1e-4)


FAULTS = ("thruster2:dead@1", "altimeter:frozen@0.5", "joint2:jam@1.5")


@pytest.mark.slow
def test_thrusters_and_faults_may_be_listed_in_any_order(robot: uo.Robot) -> None:
    """Of another thruster first: its thrust, and no motion."""
    thrusters = robot.description.thrusters
    turned = replace(robot, description=checked_copy(robot.description, thrusters=thrusters[::-1]))
    usual = reach(robot=robot, dt=0.02, duration=3.0).run()
    turned_run = reach(robot=turned, dt=0.02, duration=3.0).run()
    np.testing.assert_allclose(turned_run["q"], usual["q"], atol=1e-6)
    np.testing.assert_allclose(turned_run["thrust"][:, ::-1], usual["thrust"], atol=1e-3)
    first_values, second_values = (
        reach(robot=robot, dt=0.02, duration=3.0, noise=True, faults=f).run()
        for f in (FAULTS, FAULTS[::-1])
    )
    np.testing.assert_array_equal(first_values["q"], second_values["q"])


BALLS = tuple(
    obstacle(name, coal.Sphere(0.1), at)
    for name, at in {"a": (0.6, -0.6, -5.1), "b": (0.5, 0.9, -4.9)}.items()
)


@pytest.mark.slow
def test_obstacles_may_be_listed_in_any_order(robot: uo.Robot) -> None:
    start = robot.configuration(position=(0.0, 0.0, -5.0))
    goal = PostureGoal(position=(1.2, 0.3, -5.2), rpy=(0.0, 0.0, 0.8))
    curves = []
    costs = []
    for balls in (BALLS, BALLS[::-1]):
        curve = plan_path(PlanRequest(robot=robot, start=start, goal=goal, obstacles=balls)).plan
        assert curve is not None
        curves.append(curve.trajectory.evaluate(np.linspace(0.0, curve.trajectory.end, 50)))
        plan = solve_ocp(
            OcpRequest(robot=robot, start=start, goal=goal, obstacles=balls, n_steps=10)
        ).plan
        costs.append(plan.levels[-1].residual)
    np.testing.assert_allclose(*curves, atol=1e-4)
    assert costs[0] == pytest.approx(costs[1], rel=1e-5)


def planned(robot: uo.Robot, turned: bool) -> OcpProblem:
    arm = JointTracking(joints=robot.joint_names[:1], goal=robot.home[:1] + 0.2)
    goals = (TaskTerm(task=VehiclePose(goal=uo.pose_at((0.6, 0.1, -5.1)))), TaskTerm(task=arm))
    costs = (Effort(), Smoothness(weight=0.09))
    way = -1 if turned else 1
    levels = [
        OcpLevel(name="goal", terms=goals[::way]),
        OcpLevel(name="effort", terms=costs[::way]),
    ]
    start = State(q=robot.configuration(position=(0.0, 0.0, -5.0)), v=np.zeros(robot.n_v))
    return single_phase(
        robot=robot, start=start, duration=5.0, n_steps=10, levels=levels, constraints=(AtRest(),)
    )


@pytest.mark.slow
def test_terms_of_a_level_may_be_listed_in_any_order(robot: uo.Robot) -> None:
    plans = [Planner(planned(robot, turned)).plan() for turned in (False, True)]
    assert all(plan.status.usable for plan in plans)
    assert plans[0].levels[-1].residual == pytest.approx(plans[1].levels[-1].residual, rel=1e-6)
    np.testing.assert_allclose(plans[0].trajectory.v, plans[1].trajectory.v, atol=1e-4)

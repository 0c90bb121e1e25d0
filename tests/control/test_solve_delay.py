"""Laws of when a plan that is made beside begins: where the vehicle will be once it is there."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm

from uvms_ocp.control.force.computed_torque import TrackingGains, feedback_gains
from uvms_ocp.control.replanning import HOLD, Replanner, ReplanningRequest
from uvms_ocp.control.solve_workers import SolveDelay
from uvms_ocp.ocp.problem import HessianKind, OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, TaskTerm
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import State
from uvms_ocp.tasks.pose import ToolPosition


def reach() -> OcpProblem:
    robot = load_robot("planar5")
    tool = ToolPosition(goal=pin.SE3(np.eye(3), np.array([0.5, 0.5, 0.0])))
    return single_phase(
        robot=robot,
        start=State(q=robot.configuration(joints=[0.3] * robot.n_joints), v=np.zeros(robot.n_v)),
        duration=1.0,
        n_steps=5,
        levels=[
            OcpLevel(name="tool", terms=(TaskTerm(task=tool, at=At.PATH, weight=10.0), Effort()))
        ],
        hessian=HessianKind.GAUSS_NEWTON,
    )


def left_of(error: np.ndarray, seconds: float, problem: OcpProblem) -> tuple[np.ndarray, ...]:
    """Errors of position and rate (n_v,) [rad, rad/s] that are left of as large ones of both, by the
    closed form of the law that tracks.
    """
    k, d = feedback_gains(problem.robot, TrackingGains())
    over_time = [expm(seconds * np.array([[0.0, 1.0], [-k[i], -d[i]]])) for i in range(len(k))]
    states = [
        transition @ [start, start] for transition, start in zip(over_time, error, strict=True)
    ]
    return tuple(np.transpose(states))


@pytest.mark.sampled
@pytest.mark.parametrize("delay", [0.004, 0.05, 0.11])
def test_a_plan_begins_where_the_robot_will_be_by_then(delay: float) -> None:
    """Near the present plan, by what tracking leaves of the distance that was measured."""
    problem = reach()
    replanner = Replanner(problem, options=None, time_limit=np.inf, clock=lambda: 0.0)
    first = replanner(
        ReplanningRequest(state=problem.start, t=0.0, in_use=HOLD, begin=0.0, delay=delay)
    ).planned
    assert first is not None
    model = problem.robot.model
    t = 0.1
    q, v, _ = first.trajectory.state_at(model, t)
    apart = 1e-3 * np.arange(problem.robot.n_v)
    measured = State(q=pin.integrate(model, q, apart), v=v + apart)
    plan = replanner(
        ReplanningRequest(state=measured, t=t, in_use=first.number, begin=first.begin, delay=delay)
    ).planned
    assert plan is not None
    assert plan.begin == pytest.approx(t + delay)
    q, v, _ = first.trajectory.state_at(model, t + delay)
    error = pin.difference(model, q, plan.trajectory.q[0])
    q_error, v_error = left_of(apart, delay, problem)
    np.testing.assert_allclose(error, q_error, rtol=0.02, atol=1e-9)
    np.testing.assert_allclose(plan.trajectory.v[0] - v, v_error, rtol=0.1, atol=1e-9)


def test_the_longest_solve_counts_at_once_and_is_forgotten_slowly() -> None:
    delay = SolveDelay(0.05)
    delay.count(0.08)
    longest = delay.seconds
    assert 0.08 < longest < 0.082
    for _ in range(10):
        delay.count(0.01)
    assert 0.03 < delay.seconds < longest
    for _ in range(100):
        delay.count(0.01)
    assert delay.seconds == pytest.approx(0.01, abs=2e-3)

"""Laws of optimal control problems: goals within all limits, priorities, warm starts, and what is
refused.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from horizon.tracking import tracked
from reaches import CHEAP, PATIENCE, patient, reach, tool_goal

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel
from uvms_ocp.ocp.terms import AtRest, TaskTerm
from uvms_ocp.ocp.trajectory import guess_through
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.plan_replay import tracking_error
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.solvers.stage_qp import StageQp, StageQpOptions, StageQpSolver, StageQpStatus
from uvms_ocp.tasks.pose import VehiclePose
from uvms_ocp.tasks.vehicle_velocity import NullVelocity, UnderActuation


@pytest.mark.sampled
def test_the_tool_reaches_its_goal_within_all_limits(
    robot: Robot, planner_of_each: Planner
) -> None:
    plan = planner_of_each.plan()
    assert plan.status is OcpStatus.SOLVED
    assert plan.iterations <= 60
    assert plan.levels[0].residual < 1e-5
    trajectory = plan.trajectory
    limits = robot.limits
    assert (np.abs(trajectory.v) <= limits.velocity + 1e-6).all()
    assert (np.abs(trajectory.a) <= limits.acceleration + 1e-6).all()
    assert (np.abs(trajectory.torque) <= limits.effort + 1e-4).all()
    assert plan.peak_thrust <= 150 + 1e-4
    assert (trajectory.q[:, 7:] <= limits.position_upper + 1e-6).all()
    assert (trajectory.q[:, 7:] >= limits.position_lower - 1e-6).all()
    np.testing.assert_allclose(np.linalg.norm(trajectory.q[:, 3:7], axis=1), 1.0, atol=1e-12)


@pytest.mark.sampled
def test_a_warm_solve_of_the_same_problem_needs_no_iterations(planner_of_each: Planner) -> None:
    first = planner_of_each.plan()
    again = planner_of_each.plan(guess=first)
    assert again.iterations <= 1
    np.testing.assert_allclose(again.trajectory.q, first.trajectory.q, atol=1e-5)


@pytest.mark.slow
def test_no_rounding_decides_whether_a_qp_is_solved_without_a_compiler(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[StageQp]()
    solve = StageQpSolver.solve_flat

    def kept(solver: StageQpSolver, qp: StageQp, *near: object, **options: object) -> object:
        asked.append(copied(qp))
        return solve(solver, qp, *near, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(StageQpSolver, "solve_flat", kept)
    patient(reach(robot), "stagewise").plan()
    monkeypatch.undo()
    solver = StageQpSolver(asked[0].shape, StageQpOptions(compiled=False))
    rng = np.random.default_rng(0)
    for _ in range(10):
        qp = copied(asked[0])
        for name in ("dynamics", "J"):
            qp.flat[name][:] *= 1.0 + np.finfo(float).eps * rng.standard_normal(len(qp.flat[name]))
        found = solver.solve(qp)
        assert (found.status, found.iterations) == (StageQpStatus.SOLVED, 1)


def copied(qp: StageQp) -> StageQp:
    other = StageQp(qp.shape)
    for name, values in qp.flat.items():
        other.flat[name][:] = values
    return other


@pytest.mark.sampled
def test_a_guess_through_configurations_leads_to_the_same_plan(
    robot: Robot, planner_of_each: Planner
) -> None:
    first = planner_of_each.plan()
    guess = guess_through(planner_of_each.problem, first.trajectory.t, first.trajectory.q)
    again = planner_of_each.plan(guess=guess)
    assert again.levels[1].residual == pytest.approx(first.levels[1].residual, rel=1e-4)


@pytest.mark.sampled
def test_a_plan_is_carried_out_to_millimetres(robot: Robot, plugin: str) -> None:
    plan = patient(reach(robot, n_steps=40), plugin).plan()
    environment = Environment(seafloor=FlatSeafloor(z=-40))
    record = tracked(robot, plan.trajectory, environment, dt=1 / 200, duration=2 * plan.duration)
    assert record["t"][-1] == pytest.approx(plan.duration)
    found = tracking_error(plan.trajectory, record["t"], record["q"], robot=robot, frame="tool")
    assert found.end_position < 5e-3
    assert found.end_orientation < 1e-2


@pytest.mark.slow
def test_the_higher_level_wins_where_two_goals_exclude_each_other(
    robot: Robot, plugin: str
) -> None:
    problem = reach(robot)
    q = problem.start.q
    stay = TaskTerm(task=VehiclePose(goal=pin.SE3(pin.Quaternion(q[3:7]).matrix(), q[:3])))
    far = TaskTerm(task=tool_goal(robot, q, (3.0, 0.0, 0.0)))
    first = replace(
        problem,
        levels=(
            OcpLevel(name="vehicle", terms=(stay,)),
            OcpLevel(name="tool", terms=(far,)),
            CHEAP,
        ),
    )
    second = replace(first, levels=(first.levels[1], first.levels[0], CHEAP))
    options = NlpOptions(time_limit=PATIENCE, max_iterations=100, plugin=plugin)
    vehicle_first = Planner(first, options).plan(diagnose=False)
    tool_first = Planner(second, options).plan(diagnose=False)
    assert vehicle_first.levels[0].residual < 1e-5 < 1.0 < vehicle_first.levels[1].residual
    assert tool_first.levels[0].residual < 1e-5 < 1.0 < tool_first.levels[1].residual


@pytest.mark.slow
def test_a_clearance_is_kept_on_the_way(robot: Robot, plugin: str) -> None:
    ball = Ball(frame="base_link", radius=0.9)
    obstacle = Ball(centre=(2.0, 0.6, -5.0), radius=0.5)
    clearance = BallClearance(robot_balls=(ball,), obstacles=(obstacle,), margin=0.1)
    plan = patient(
        reach(robot, shift=(3.0, 1.0, 0.0), duration=16.0, constraints=(AtRest(), clearance)),
        plugin,
    ).plan()
    assert plan.status is OcpStatus.SOLVED
    distance = np.linalg.norm(plan.trajectory.q[:, :3] - obstacle.centre, axis=1)
    assert distance.min() >= 0.9 + 0.5 + 0.1 - 1e-5


@pytest.mark.slow
def test_a_plan_is_saved_as_text_and_as_arrays(planner: Planner, tmp_path: Path) -> None:
    plan = planner.plan()
    text = json.loads(plan.save(tmp_path / "plan.json").read_text())
    arrays = np.load(plan.save(tmp_path / "plan.npz"))
    assert text["status"] == "solved"
    assert text["levels"][0]["name"] == "tool"
    np.testing.assert_array_equal(arrays["q"], plan.trajectory.q)
    np.testing.assert_allclose(text["thrust"], plan.trajectory.thrust)


def test_misuse_is_refused(robot: Robot) -> None:
    with pytest.raises(InvalidInput, match="time > 0"):
        reach(robot, duration=-1.0)
    with pytest.raises(InvalidInput, match="give a whole number >= 1"):
        reach(robot, n_steps=0)
    with pytest.raises(InvalidInput, match="three finite numbers"):
        reach(robot, current=np.array([np.nan, 0, 0]))
    for nothing in ("phases", "levels"):
        with pytest.raises(InvalidInput, match="needs phases and levels"):
            replace(reach(robot), **{nothing: ()})
    with pytest.raises(InvalidInput, match="share a name"):
        replace(reach(robot), phases=2 * reach(robot).phases)
    with pytest.raises(InvalidInput, match="no residual over a horizon"):
        Transcription(reach(robot, constraints=(TaskTerm(task=UnderActuation(axes=(3,))),)))
    with pytest.raises(NameNotFound, match="phase"):
        reach(robot, constraints=(TaskTerm(task=NullVelocity(), phase="landing"),))

"""Laws of optimal control problems: derivatives, dynamics, priorities, and verdicts with reasons."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.control.navigation.estimator import PassThrough
from uvms_ocp.control.receding.plan_tracking import PlanTracker, mismatch
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.limits import Limits
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS
from uvms_ocp.model.state import State
from uvms_ocp.model.thrusters import thruster_matrix
from uvms_ocp.model.water.hydrodynamics import Water
from uvms_ocp.ocp.first_step import impossible_start
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import (
    Actuation,
    HessianKind,
    Integrator,
    OcpLevel,
    OcpProblem,
    single_phase,
)
from uvms_ocp.ocp.terms import AtRest, Ball, BallClearance, Effort, Smoothness, TaskTerm
from uvms_ocp.ocp.trajectory import hold, through
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.loop import simulate
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.solvers.nlp.lexicographic_nlp import NlpOptions
from uvms_ocp.tasks.pose import ToolPose, VehiclePose
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.velocity import NullVelocity, UnderActuation

CHEAP = OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.3)))


PATIENCE = 600.0  # [s] for other programs on the machine must not decide a verdict


def patient(problem: OcpProblem) -> Planner:
    return Planner(problem, NlpOptions(time_limit=PATIENCE))


def tool_goal(robot: Robot, q: np.ndarray, shift: tuple[float, float, float]) -> Task:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    X_WT = data.oMf[robot.frame_id("tool")]
    turn = pin.rpy.rpyToMatrix(0.2, 0.1, 0.3)
    return ToolPose(goal=pin.SE3(turn @ X_WT.rotation, X_WT.translation + np.array(shift)))


def reach(robot: Robot, *, shift: tuple[float, float, float] = (1.0, -0.5, -0.6), **options: object) -> OcpProblem:
    q = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))
    tool = OcpLevel(name="tool", terms=(TaskTerm(task=tool_goal(robot, q, shift)),))
    chosen = {
        "start": State(q=q, v=np.zeros(robot.n_v)),
        "duration": 8.0,
        "n_steps": 20,
        "levels": [tool, CHEAP],
        "constraints": (AtRest(),),
    }
    return single_phase(robot=robot, **(chosen | options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


@pytest.fixture(scope="module")
def weightless(robot: Robot) -> Robot:
    model = pin.Model(robot.model)
    model.gravity = pin.Motion.Zero()
    return replace(robot, model=model)


@pytest.fixture(scope="module")
def planner(robot: Robot) -> Planner:
    return patient(reach(robot))


DRY: dict[str, object] = {"water": False, "limited": False, "actuation": Actuation.WRENCH}
"""Nothing limits the forces, so that they are no variables."""


@pytest.mark.parametrize("options", [{}, DRY, DRY | {"integrator": Integrator.EULER}], ids=["wet", "dry", "euler"])
@pytest.mark.parametrize("plugin", ["ipopt", "fatrop"])
def test_derivatives_equal_finite_differences(robot: Robot, plugin: str, options: dict[str, object]) -> None:
    transcription = Transcription(reach(robot, n_steps=3, **options), plugin=plugin)
    rng, p = np.random.default_rng(1), transcription.parameters()
    x = transcription.pack(hold(transcription.problem)) + 0.05 * rng.standard_normal(transcription.n_x)
    d, e = rng.standard_normal(transcription.n_x), 1e-6
    for level in transcription.program.nlps:
        functions = level.functions
        lam = rng.standard_normal(len(level.rows))

        def slope(at: np.ndarray, functions: dict = functions, lam: np.ndarray = lam) -> np.ndarray:
            J = functions["nlp_jac_g"](at, p)[1].full()
            return np.array(functions["nlp_grad_f"].call([at, p])[-1]).ravel() + J.T @ lam

        f, g = functions["nlp_f"], functions["nlp_g"]
        total = [float(f(at, p)) + lam @ np.array(g(at, p)).ravel() for at in (x + e * d, x - e * d)]
        assert (total[0] - total[1]) / (2 * e) == pytest.approx(slope(x) @ d, rel=1e-6)
        H = functions["nlp_hess_l"].call([x, p, 1.0, lam])[-1].full()
        H = H if plugin == "fatrop" else np.triu(H) + np.triu(H, 1).T
        np.testing.assert_allclose((slope(x + e * d) - slope(x - e * d)) / (2 * e), H @ d, atol=1e-5)


def test_the_tool_reaches_its_goal_within_all_limits(robot: Robot, planner: Planner) -> None:
    plan = planner.plan()
    assert plan.status is OcpStatus.SOLVED
    assert plan.iterations <= 60
    assert plan.levels[0].residual < 1e-5
    trajectory, limits = plan.trajectory, robot.limits
    assert (np.abs(trajectory.v) <= limits.velocity + 1e-6).all()
    assert (np.abs(trajectory.a) <= limits.acceleration + 1e-6).all()
    assert (np.abs(trajectory.torque) <= limits.effort + 1e-4).all()
    assert plan.peak_thrust <= 150 + 1e-4
    assert (trajectory.q[:, 7:] <= limits.position_upper + 1e-6).all()
    assert (trajectory.q[:, 7:] >= limits.position_lower - 1e-6).all()
    np.testing.assert_allclose(np.linalg.norm(trajectory.q[:, 3:7], axis=1), 1.0, atol=1e-8)


def test_forces_are_those_of_the_motion_in_the_middle_of_every_step(robot: Robot) -> None:
    problem = reach(robot, n_steps=10, current=np.array([0.2, -0.1, 0.0]))
    trajectory = patient(problem).plan().trajectory
    dynamics, matrix = robot_dynamics(robot), thruster_matrix(robot)
    for k, h in enumerate(np.diff(trajectory.t)):
        q, v, a = trajectory.state_at(robot.model, trajectory.t[k] + h / 2)
        wanted = dynamics.inverse_dynamics(q, v, a, Water(velocity=problem.current))
        given = np.concatenate([matrix @ trajectory.thrust[k], trajectory.torque[k]])
        np.testing.assert_allclose(given, wanted, atol=1e-3)


def test_forces_that_are_no_variables_are_those_of_the_motion(weightless: Robot) -> None:
    trajectory = patient(reach(weightless, n_steps=10, **DRY)).plan().trajectory
    data = weightless.model.createData()
    for k, h in enumerate(np.diff(trajectory.t)):
        wanted = pin.rnea(weightless.model, data, *trajectory.state_at(weightless.model, trajectory.t[k] + h / 2))
        given = np.concatenate([trajectory.thrust[k], trajectory.torque[k]])
        np.testing.assert_allclose(given, wanted, atol=1e-8)


def test_plans_with_and_without_forces_as_variables_are_the_same(weightless: Robot) -> None:
    unlimited = {field.name: np.full_like(getattr(weightless.limits, field.name), np.inf) for field in fields(Limits)}
    unlimited["position_lower"] = -unlimited["position_lower"]
    free = replace(weightless, limits=Limits(**unlimited))
    problems = [reach(free, n_steps=10, **DRY | {"limited": limited}) for limited in (False, True)]
    without, with_forces = (patient(problem).plan().trajectory for problem in problems)
    np.testing.assert_allclose(without.q, with_forces.q, atol=1e-5)
    np.testing.assert_allclose(without.thrust, with_forces.thrust, atol=1e-2)


def test_a_semi_implicit_step_moves_with_the_new_velocity_under_the_forces_of_the_old_state(weightless: Robot) -> None:
    trajectory = patient(reach(weightless, n_steps=10, **DRY, integrator=Integrator.EULER)).plan().trajectory
    data = weightless.model.createData()
    for k, h in enumerate(np.diff(trajectory.t)):
        given = np.concatenate([trajectory.thrust[k], trajectory.torque[k]])
        a = pin.aba(weightless.model, data, trajectory.q[k], trajectory.v[k], given)
        v = trajectory.v[k] + h * a
        np.testing.assert_allclose(trajectory.v[k + 1], v, atol=1e-7)
        np.testing.assert_allclose(
            trajectory.q[k + 1], pin.integrate(weightless.model, trajectory.q[k], h * v), atol=1e-7
        )


def test_both_solvers_find_the_same_cost(robot: Robot, planner: Planner) -> None:
    ipopt = planner.plan()
    fatrop = Planner(reach(robot), NlpOptions(time_limit=PATIENCE, plugin="fatrop")).plan()
    assert fatrop.status is OcpStatus.SOLVED
    assert fatrop.levels[1].residual ** 2 == pytest.approx(ipopt.levels[1].residual ** 2, rel=1e-6)


def test_gauss_newton_finds_the_same_cost_as_the_exact_hessian(robot: Robot, planner: Planner) -> None:
    exact = planner.plan()
    # Without the curvature of the dynamics convergence is linear.
    loose = NlpOptions(time_limit=PATIENCE, convergence=1e-6)
    gauss_newton = Planner(reach(robot, hessian=HessianKind.GAUSS_NEWTON), loose).plan()
    assert gauss_newton.status is OcpStatus.SOLVED
    assert gauss_newton.levels[1].residual ** 2 == pytest.approx(exact.levels[1].residual ** 2, rel=1e-3)


def test_a_warm_solve_of_the_same_problem_needs_no_iterations(planner: Planner) -> None:
    first = planner.plan()
    again = planner.plan(guess=first)
    assert again.iterations <= 1
    np.testing.assert_allclose(again.trajectory.q, first.trajectory.q, atol=1e-5)


def test_a_guess_through_configurations_leads_to_the_same_plan(robot: Robot, planner: Planner) -> None:
    first = planner.plan()
    guess = through(planner.problem, first.trajectory.t, first.trajectory.q)
    again = planner.plan(guess=guess)
    assert again.levels[1].residual == pytest.approx(first.levels[1].residual, rel=1e-4)


def test_a_plan_is_carried_out_to_millimetres(robot: Robot) -> None:
    plan = patient(reach(robot, n_steps=40)).plan()
    dynamics, environment, dt = robot_dynamics(robot), Environment(seafloor=FlatSeafloor(z=-40)), 1 / 200
    record = simulate(
        plant=DynamicPlant(robot, plan.trajectory.q[0], dynamics=dynamics, environment=environment),
        sensors=SensorSuite(robot, environment.seafloor, IDEAL_SENSORS).read,
        estimator=PassThrough(robot),
        controller=PlanTracker(plan.trajectory, robot, dynamics, dt=dt),
        dt=dt,
        duration=2 * plan.duration,
    ).freeze({})
    assert record["t"][-1] == pytest.approx(plan.duration)
    found = mismatch(plan.trajectory, record["t"], record["q"], robot=robot, frame="tool")
    assert found.end_position < 5e-3
    assert found.end_orientation < 1e-2


def test_the_higher_level_wins_where_two_goals_exclude_each_other(robot: Robot) -> None:
    problem = reach(robot)
    q = problem.start.q
    stay = TaskTerm(task=VehiclePose(goal=pin.SE3(pin.Quaternion(q[3:7]).matrix(), q[:3])))
    far = TaskTerm(task=tool_goal(robot, q, (3.0, 0.0, 0.0)))
    first = replace(
        problem, levels=(OcpLevel(name="vehicle", terms=(stay,)), OcpLevel(name="tool", terms=(far,)), CHEAP)
    )
    second = replace(first, levels=(first.levels[1], first.levels[0], CHEAP))
    options = NlpOptions(time_limit=PATIENCE, max_iterations=100)
    vehicle_first = Planner(first, options).plan(diagnose=False)
    tool_first = Planner(second, options).plan(diagnose=False)
    assert vehicle_first.levels[0].residual < 1e-5 < 1.0 < vehicle_first.levels[1].residual
    assert tool_first.levels[0].residual < 1e-5 < 1.0 < tool_first.levels[1].residual


def test_a_horizon_that_is_too_short_says_how_long_it_should_be(planner: Planner, robot: Robot) -> None:
    plan = planner.plan(reach(robot, duration=1.2))
    assert plan.status is OcpStatus.TOO_SHORT
    assert "level 'tool' is missed by" in plan.reason
    assert "would do" in plan.reason


def test_a_goal_out_of_reach_of_a_fixed_arm_is_unreachable() -> None:
    robot = load_robot("planar5")
    q = robot.configuration()
    goal = TaskTerm(task=tool_goal(robot, q, (0.0, 0.0, 2.0)))
    problem = single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=4.0,
        n_steps=10,
        levels=[OcpLevel(name="tool", terms=(goal,)), OcpLevel(name="effort", terms=(Effort(),))],
        water=False,
    )
    plan = patient(problem).plan()
    assert plan.status is OcpStatus.UNREACHABLE
    assert "more time does not help" in plan.reason
    assert np.isfinite(plan.trajectory.q).all()


def test_a_start_inside_an_obstacle_is_reported_at_once(robot: Robot) -> None:
    ball = Ball(frame="base_link", radius=0.9)
    clearance = BallClearance(robot_balls=(ball,), obstacles=(Ball(centre=(0.5, 0.0, -5.0), radius=0.3),))
    plan = patient(reach(robot, constraints=(AtRest(), clearance))).plan()
    assert plan.status is OcpStatus.OBSTRUCTED
    assert "clearance is broken by" in plan.reason


def test_a_clearance_is_kept_on_the_way(robot: Robot) -> None:
    ball = Ball(frame="base_link", radius=0.9)
    obstacle = Ball(centre=(2.0, 0.6, -5.0), radius=0.5)
    clearance = BallClearance(robot_balls=(ball,), obstacles=(obstacle,), margin=0.1)
    plan = patient(reach(robot, shift=(3.0, 1.0, 0.0), duration=16.0, constraints=(AtRest(), clearance))).plan()
    assert plan.status is OcpStatus.SOLVED
    distance = np.linalg.norm(plan.trajectory.q[:, :3] - obstacle.centre, axis=1)
    assert distance.min() >= 0.9 + 0.5 + 0.1 - 1e-5


def test_a_start_that_is_too_fast_for_the_limits_is_proven_impossible(planner: Planner, robot: Robot) -> None:
    tumbling = np.zeros(robot.n_v)
    tumbling[4] = 5.0
    plan = planner.plan(replace(planner.problem, start=State(q=planner.problem.start.q, v=tumbling)))
    assert plan.status is OcpStatus.INFEASIBLE
    assert "pitch rate starts at 5" in plan.reason
    assert plan.iterations == 0
    assert np.isfinite(plan.trajectory.q).all()


def test_a_joint_that_runs_into_its_stop_is_proven_impossible(planner: Planner, robot: Robot) -> None:
    q, v, joint = planner.problem.start.q.copy(), np.zeros(robot.n_v), 3
    q[7 + joint] = robot.limits.position_upper[joint] - 1e-3
    v[6 + joint] = robot.limits.velocity[6 + joint]
    plan = planner.plan(replace(planner.problem, start=State(q=q, v=v)))
    assert plan.status is OcpStatus.INFEASIBLE
    assert "'joint4'" in plan.reason
    assert "first step" in plan.reason


def test_the_limits_of_the_first_step_condemn_no_start_that_has_a_plan(planner: Planner, robot: Robot) -> None:
    moving = np.zeros(robot.n_v)
    moving[0], moving[9] = 0.3, 0.2
    problem = replace(planner.problem, start=State(q=planner.problem.start.q, v=moving))
    assert planner.plan(problem).status is OcpStatus.SOLVED
    assert impossible_start(problem) is None


def test_a_current_that_thrusters_cannot_hold_against_names_level_and_constraint(robot: Robot) -> None:
    problem = reach(robot, current=np.array([3.0, 0.0, 0.0]), n_steps=10)
    plan = Planner(problem, NlpOptions(time_limit=10.0)).plan()
    assert plan.status in (OcpStatus.INFEASIBLE, OcpStatus.UNFINISHED)
    assert "level 'tool'" in plan.reason
    assert "broken by" in plan.reason
    assert "loosen" in plan.advice
    assert np.isfinite(plan.trajectory.q).all()


@pytest.mark.parametrize("limit", [0.02, 0.6])
def test_the_time_limit_holds_for_the_whole_plan_without_a_nan(robot: Robot, planner: Planner, limit: float) -> None:
    far = TaskTerm(task=tool_goal(robot, planner.problem.start.q, (100.0, 0.0, 0.0)))
    problem = reach(robot, levels=[OcpLevel(name="tool", terms=(far,)), CHEAP])
    plan = Planner(problem, NlpOptions(time_limit=limit, max_iterations=3000)).plan()
    assert plan.status in (OcpStatus.UNFINISHED, OcpStatus.MISSED, OcpStatus.TOO_SHORT)
    assert plan.solve_time < limit + 2.0
    assert np.isfinite(plan.trajectory.q).all()


def test_a_limit_of_iterations_is_no_proof_of_infeasibility(robot: Robot) -> None:
    plan = Planner(reach(robot), NlpOptions(time_limit=PATIENCE, max_iterations=3)).plan()
    assert plan.status is OcpStatus.UNFINISHED
    assert "iteration limit" in plan.reason


def test_a_missed_goal_is_not_called_unreachable_before_more_time_was_tried(planner: Planner, robot: Robot) -> None:
    assert planner.plan(reach(robot, duration=1.2), diagnose=False).status is OcpStatus.MISSED


def test_the_magnus_integrator_follows_constant_acceleration_more_closely(robot: Robot) -> None:
    q, rng = robot.configuration(), np.random.default_rng(3)
    v, a, h = 0.5 * rng.standard_normal(robot.n_v), 0.5 * rng.standard_normal(robot.n_v), 0.5
    exact = q
    for i in range(2000):
        exact = pin.integrate(robot.model, exact, (v + (i + 0.5) * h / 2000 * a) * h / 2000)
    errors = []
    for kind in Integrator:
        problem = reach(robot, n_steps=1, integrator=kind)
        moved = np.array(ca.DM(StageModel(problem).moved(ca.SX(q), ca.SX(v), ca.SX(a), ca.SX(h)))).ravel()
        errors.append(np.linalg.norm(pin.difference(robot.model, exact, moved)))
    assert errors[1] < 0.1 * errors[0]


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
    with pytest.raises(InvalidInput, match="at least 1"):
        reach(robot, n_steps=0)
    with pytest.raises(InvalidInput, match="three finite numbers"):
        reach(robot, current=np.array([np.nan, 0, 0]))
    with pytest.raises(InvalidInput, match="no residual over a horizon"):
        Transcription(reach(robot, constraints=(TaskTerm(task=UnderActuation(axes=(3,))),)))
    with pytest.raises(NameNotFound, match="phase"):
        reach(robot, constraints=(TaskTerm(task=NullVelocity(), phase="landing"),))

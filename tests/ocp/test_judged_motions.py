"""Laws of the judge: motions that are known to be wrong are called so, and optima are called optima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reaches import patient, reach

from uvms_ocp.ocp.first_order_gain import LinearizedMotion
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, AtRest, Effort, Posture, Smoothness, residual_term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.verdict import TOLERANCES, Verdict, judge_motion
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import IPOPT, PLUGINS, NlpOptions

N = 10
TURN = 0.4  # [rad]
JOINT = 1


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot("planar5")


def turning(arm: Robot, *, by: float = TURN, **options: object) -> OcpProblem:
    """One joint is to be turned, at rest in the end, with least effort."""
    q = arm.configuration()
    goal = float(q[JOINT]) + by
    turn = residual_term("turn", lambda stage: stage.tick.q[JOINT] - goal, at=At.END)
    chosen = {
        "duration": 2.0,
        "n_steps": N,
        "levels": [
            OcpLevel(name="turn", terms=(turn,)),
            OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.1))),
        ],
        "constraints": (AtRest(),),
        "water": False,
    }
    start = State(q=q, v=np.zeros(arm.n_v))
    return single_phase(robot=arm, start=start, **(chosen | options))  # type: ignore[arg-type]


@pytest.fixture(scope="module", params=PLUGINS)
def planner(arm: Robot, request: pytest.FixtureRequest) -> Planner:
    return patient(turning(arm), str(request.param))


@pytest.fixture(scope="module")
def plan(planner: Planner) -> Plan:
    return planner.plan(diagnose=False)


def judged(planner: Planner, trajectory: Trajectory) -> Verdict:
    transcription = planner.transcription
    return judge_motion(planner.problem, trajectory, transcription=transcription)


@pytest.mark.sampled
def test_optima_of_every_solver_are_accepted(plan: Plan) -> None:
    assert plan.status is OcpStatus.SOLVED, plan.reason
    assert plan.verdict is not None
    assert plan.verdict.levels[1].gain < 1e-5 * plan.verdict.levels[1].residual


def test_the_optimum_of_ipopt_at_its_finest_has_no_gain(arm: Robot) -> None:
    options = NlpOptions(plugin=IPOPT, convergence=1e-10)
    planner = Planner(turning(arm), options)
    verdict = judged(planner, planner.plan(diagnose=False).trajectory)
    assert verdict.status is OcpStatus.SOLVED
    assert verdict.report.levels[1].gain < 1e-5 * verdict.report.levels[1].residual


def test_a_motion_that_costs_more_than_need_be_is_not_optimal(plan: Plan, planner: Planner) -> None:
    """It keeps all and meets its goal: the optimum of other weights."""
    problem = planner.problem
    heavy = OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=30.0)))
    smoother = planner.plan(replace(problem, levels=(problem.levels[0], heavy)), diagnose=False)
    verdict = judged(planner, smoother.trajectory)
    assert verdict.status is OcpStatus.IMPROVABLE, verdict.reason
    assert verdict.status.usable
    assert "one more step would lower its residual" in verdict.reason
    assert plan.verdict is not None
    effort = verdict.report.levels[1]
    truly = effort.residual - plan.verdict.levels[1].residual
    assert truly > TOLERANCES.gain * effort.residual
    assert effort.gain == pytest.approx(truly, rel=0.5)


def test_a_motion_that_forces_do_not_make_is_broken(plan: Plan, planner: Planner) -> None:
    path = plan.trajectory
    torque = path.torque.copy()
    torque[3, JOINT] += 0.01 * planner.problem.robot.limits.effort[JOINT]
    verdict = judged(planner, replace(path, torque=torque))
    assert verdict.status is OcpStatus.BROKEN
    assert "forces" in verdict.reason


def test_a_motion_that_jumps_is_broken(plan: Plan, planner: Planner) -> None:
    path = plan.trajectory
    q = path.q.copy()
    q[4, JOINT] += 1e-3
    verdict = judged(planner, replace(path, q=q))
    assert verdict.status is OcpStatus.BROKEN
    assert "motion" in verdict.reason


def test_a_goal_that_is_missed_is_told_with_by_how_much(plan: Plan, planner: Planner) -> None:
    problem = turning(planner.problem.robot, by=TURN + 0.02)
    verdict = judge_motion(problem, plan.trajectory)
    assert verdict.status is OcpStatus.MISSED
    assert verdict.report.levels[0].residual == pytest.approx(0.02, rel=1e-3)
    assert verdict.missed == 0


@pytest.mark.sampled
@pytest.mark.parametrize("beyond", [-1e-3, 1e-3])
def test_a_range_that_is_left_between_nodes_alone_is_broken(
    plan: Plan, planner: Planner, beyond: float
) -> None:
    """What the row adds to the joint is 0 at nodes and largest in the middle of steps."""
    path = plan.trajectory
    model = planner.problem.robot.model
    moments = np.linspace(0.0, path.t[-1], 50 * N + 1)
    joint = np.array([path.state_at(model, t)[0][JOINT] for t in moments])
    rows = joint + 0.5 * np.sin(np.pi * N * moments / path.t[-1]) ** 2
    limit = float(rows.max()) - beyond
    period = float(path.t[-1]) / N

    def wave(t: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.5 * np.sin(np.pi * t / period) ** 2]), np.zeros(1)

    term = residual_term(
        "wave",
        lambda stage, parameters: stage.tick.q[JOINT] + parameters[0],
        lower=-np.inf,
        upper=limit,
        at=At.PATH,
        parameters=wave,
    )
    problem = planner.problem
    verdict = judge_motion(replace(problem, constraints=(*problem.constraints, term)), path)
    if beyond > 0.0:
        assert verdict.status is OcpStatus.BROKEN
        assert "wave (row 0) is broken by" in verdict.reason
        assert "between nodes" in verdict.reason
    else:
        assert not verdict.broken


def test_a_plan_beyond_a_limit_is_called_broken_drawn_and_saved(
    plan: Plan, planner: Planner, tmp_path: object
) -> None:
    path = plan.trajectory
    q = path.q.copy()
    q[5, JOINT] = planner.problem.robot.limits.position_upper[JOINT] + 2e-3
    bad = replace(plan, trajectory=replace(path, q=q))
    verdict = judged(planner, bad.trajectory)
    assert verdict.status is OcpStatus.BROKEN
    assert "joint limits" in "; ".join(item.name for item in verdict.broken)
    record = bad.to_record()
    assert record["x"][:, JOINT].max() > planner.problem.robot.limits.position_upper[JOINT] + 1e-3


def test_gradients_are_those_of_differences(plan: Plan, planner: Planner) -> None:
    motion = LinearizedMotion(
        transcription=planner.transcription,
        problem=planner.problem,
        trajectory=plan.trajectory,
        t0=0.0,
    )
    rng = np.random.default_rng(1)
    way = rng.normal(size=motion.transcription.n_x)
    _, gradient, _ = motion.cost(1)
    p = motion.transcription.parameters(planner.problem)
    step = 1e-5
    ahead, back = (
        motion.transcription.costs(motion.x + sign * step * way, p)[1] for sign in (1.0, -1.0)
    )
    assert gradient @ way == pytest.approx((ahead - back) / (2.0 * step), rel=1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize("n_steps", [(10, 10), (20, 20), (5, 40)])
def test_the_residual_of_a_motion_does_not_depend_on_its_steps(
    arm: Robot, n_steps: tuple[int, int]
) -> None:
    """Held 0.1 rad from a posture: the mean over time, with even and uneven steps."""
    q = arm.configuration()
    away = q.copy()
    away[JOINT] += 0.1
    posture = OcpLevel(name="posture", terms=(Posture(q=away),))
    phases = tuple(OcpPhase(name=f"{i}", n_steps=n, duration=1.0) for i, n in enumerate(n_steps))
    problem = replace(turning(arm, levels=[posture]), phases=phases)
    steps = sum(n_steps)
    t = problem.nominal_times()
    held = Trajectory(
        t=t,
        q=np.tile(q, (steps + 1, 1)),
        v=np.zeros((steps + 1, arm.n_v)),
        a=np.zeros((steps, arm.n_v)),
        thrust=np.zeros((steps, 0)),
        torque=np.zeros((steps, arm.n_joints)),
    )
    width = arm.limits.position_upper[JOINT] - arm.limits.position_lower[JOINT]
    verdict = judge_motion(problem, held)
    # The first step counts less: its node is given.
    first = np.diff(t)[0] / t[-1]
    expected = 0.1 / width * (1.0 - first / 2.0) ** 0.5
    assert verdict.report.levels[0].residual == pytest.approx(expected, abs=0.1 / width * first)


def test_verdicts_come_back_from_files(plan: Plan, tmp_path: object) -> None:
    for name in ("plan.json", "plan.npz"):
        path = plan.save(f"{tmp_path}/{name}")
        assert Plan.load(path).verdict == plan.verdict


@pytest.mark.slow
def test_a_sign_of_quaternions_says_nothing(robot: Robot) -> None:
    planner = patient(reach(robot, n_steps=N))
    plan = planner.plan(diagnose=False)
    q = plan.trajectory.q.copy()
    q[N // 2 :, 3:7] *= -1.0
    verdict = judged(planner, replace(plan.trajectory, q=q))
    assert plan.verdict is not None
    assert verdict.status is plan.status is OcpStatus.SOLVED
    assert verdict.report.levels[1].gain == pytest.approx(plan.verdict.levels[1].gain, abs=1e-8)

"""Laws of plans that are called solved: planning again from them finds nothing that costs less, and
the conditions of optimality hold at them, without the damping and the steps that led there.

Vehicles without an arm whose pitch no thruster drives: rows of the wrench that none makes bend.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from reaches import PATIENCE

from uvms_ocp.ocp import (
    AtRest,
    Effort,
    OcpLevel,
    OcpProblem,
    OcpStatus,
    Plan,
    Planner,
    Smoothness,
    TaskTerm,
    Term,
    hold_guess,
    single_phase,
)
from uvms_ocp.ocp.stagewise.level_qp import StageLevelQp
from uvms_ocp.ocp.stagewise.levels import StagewisePoint
from uvms_ocp.ocp.stagewise.program import StagewiseProgram
from uvms_ocp.ocp.stagewise.sqp import StageSqp
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers import NlpOptions, NlpStatus
from uvms_ocp.solvers.stage_qp.problem import FlatSolution
from uvms_ocp.tasks import ToolPosition, VehiclePose
from uvms_ocp.types import Array

GAIN = 1e-2  # share of the cost that planning again may find
STEPS = (12, 16, 24, 40)
BY_STAGES = NlpOptions(time_limit=PATIENCE, plugin="stagewise")


def straight_way(seed: int, n_steps: int, costs: tuple[Term, ...] | None = None) -> OcpProblem:
    """A way of about a metre in still water, with a turn."""
    robot = load_robot("bluerov2")
    rng = np.random.default_rng(seed)
    duration = float(rng.uniform(6, 10))
    q = robot.configuration(position=(0, 0, -5), rpy=(0, 0, rng.uniform(-1, 1)))
    return way(
        robot,
        q=q,
        duration=duration,
        n_steps=n_steps,
        goal=goal_from(robot, q, rng, turn=0.6),
        costs=costs or (Effort(), Smoothness(weight=0.09)),
    )


def drawn_way(seed: int, robot: Robot) -> OcpProblem:
    """A way through water that stands or flows, to a pose or a place."""
    rng = np.random.default_rng(seed)
    n_steps = int(rng.choice(STEPS))
    duration = float(rng.uniform(5, 12))
    q = robot.configuration(position=(0, 0, -5), rpy=(0, 0, rng.uniform(-3, 3)))
    goal = goal_from(robot, q, rng, turn=0.9)
    current = rng.uniform(-0.2, 0.2, 3) * rng.integers(2)
    effort_alone = bool(rng.integers(2))
    costs: tuple[Term, ...] = (Effort(),) if effort_alone else (Effort(), Smoothness(weight=0.09))
    return way(
        robot,
        q=q,
        duration=duration,
        n_steps=n_steps,
        goal=goal,
        costs=costs,
        current=current,
        position_only=bool(rng.integers(2)),
    )


def goal_from(robot: Robot, q: Array, rng: np.random.Generator, *, turn: float) -> pin.SE3:
    """A pose up to 1.5 m ahead of that of q, turned by up to `turn` [rad]."""
    data = robot.model.createData()
    frame = robot.frame_id("base_link")
    pin.framesForwardKinematics(robot.model, data, q)
    start = data.oMf[frame]
    offset = rng.uniform([-1.2, -0.8, -0.6], [1.5, 0.8, 0.6])
    yaw = pin.rpy.rpyToMatrix(0, 0, rng.uniform(-turn, turn))
    return pin.SE3(start.rotation @ yaw, start.translation + start.rotation @ offset)


def way(
    robot: Robot,
    *,
    q: Array,
    duration: float,
    n_steps: int,
    goal: pin.SE3,
    costs: tuple[Term, ...],
    current: Array | None = None,
    position_only: bool = False,
) -> OcpProblem:
    """From rest at q (n_q,) to rest at the goal, at least cost."""
    pose = VehiclePose(goal=goal)
    place = ToolPosition(goal=goal, frame="base_link")
    return single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=duration,
        n_steps=n_steps,
        current=np.zeros(3) if current is None else current,
        constraints=(AtRest(),),
        levels=[
            OcpLevel(name="goal", terms=(TaskTerm(task=place if position_only else pose),)),
            OcpLevel(name="cost", terms=costs),
        ],
    )


def assert_nothing_is_cheaper(planner: Planner, plan: Plan) -> None:
    """Planning again from a solved plan, cold, gains less than `GAIN`."""
    again = planner.plan(guess=plan.trajectory)
    assert plan.status is again.status is OcpStatus.SOLVED, plan.reason
    assert plan.result is not None
    assert again.result is not None
    before, after = (one.result.level_residuals[-1] ** 2 for one in (plan, again))
    assert after >= (1 - GAIN) * before


@pytest.mark.sampled
@pytest.mark.parametrize("from_hold", [False, True])
@pytest.mark.parametrize(
    ("seed", "n_steps"), [(8805, 12), (8805, 16), (8805, 24), (8809, 40), (8817, 12)]
)
def test_planning_again_from_a_solved_plan_finds_nothing_cheaper(
    seed: int, n_steps: int, from_hold: bool
) -> None:
    problem = straight_way(seed, n_steps)
    planner = Planner(problem, BY_STAGES)
    plan = planner.plan(guess=hold_guess(problem) if from_hold else None)
    assert_nothing_is_cheaper(planner, plan)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bluerov2", "without quadratic drag"])
@pytest.mark.parametrize("seed", range(15))
def test_planning_again_from_a_solved_plan_of_a_drawn_way_finds_nothing_cheaper(
    seed: int, name: str
) -> None:
    robot = load_robot("bluerov2")
    if name != "bluerov2":
        robot = without_quadratic_drag(robot)
    problem = drawn_way(seed, robot)
    planner = Planner(problem, BY_STAGES)
    for guess in (None, hold_guess(problem)):
        assert_nothing_is_cheaper(planner, planner.plan(guess=guess))


def without_quadratic_drag(robot: Robot) -> Robot:
    """The same robot in water whose drag is linear."""
    links = [replace(link, quadratic_drag=np.zeros((6, 6))) for link in robot.hydrodynamics]
    return replace(robot, hydrodynamics=tuple(links))


@pytest.mark.sampled
@pytest.mark.parametrize(("duration", "small"), [(8.0, 1e-6), (60.0, 1e-4)])
def test_a_cost_in_other_units_has_the_same_minimum(duration: float, small: float) -> None:
    """Neither damping nor a tolerance may be in units in which costs are usually about 1."""
    least = [least_cost(weight, duration) for weight in (1.0, small)]
    assert least[1] == pytest.approx(least[0], rel=1e-3)


def least_cost(weight: float, duration: float) -> float:
    """Cost over its weight of a plan from standing still."""
    robot = load_robot("bluerov2")
    q = robot.configuration(position=(0, 0, -5), rpy=(0, 0, 0.4))
    problem = way(
        robot,
        q=q,
        duration=duration,
        n_steps=16,
        goal=goal_from(robot, q, np.random.default_rng(8805), turn=0.6),
        costs=(Effort(weight=weight), Smoothness(weight=0.09 * weight)),
    )
    plan = Planner(problem, BY_STAGES).plan(guess=hold_guess(problem))
    assert plan.status is OcpStatus.SOLVED
    assert plan.result is not None
    return float(plan.result.level_residuals[-1] ** 2) / weight


@pytest.fixture(params=[(8805, 12), (8805, 24)])
def damped(request: pytest.FixtureRequest) -> OcpProblem:
    """Ways whose steps from standing still have to be cut or corrected."""
    return straight_way(*request.param)


@pytest.mark.sampled
def test_damping_never_outweighs_the_largest_curvature(
    damped: OcpProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares: list[float] = []
    bounds: list[float] = []
    iterate = StageSqp._iterate

    def watched(self: StageSqp, merit: object) -> object:
        bounds.append(largest_curvature(self._level))
        end = iterate(self, merit)  # type: ignore[arg-type]
        bounds.append(largest_curvature(self._level))
        shares.append(self._damping / max(bounds))
        return end

    monkeypatch.setattr(StageSqp, "_iterate", watched)
    plan = Planner(damped, BY_STAGES).plan(guess=hold_guess(damped))
    assert plan.status is OcpStatus.SOLVED
    assert shares
    assert max(shares) <= 1.0


def largest_curvature(level: StageLevelQp) -> float:
    """Largest diagonal entry of the Hessian of Gauss and Newton."""
    return max(float((J**2).sum(axis=0).max(initial=0.0)) for J in level.qp.J)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [8805, 8809, 8817])
@pytest.mark.parametrize("n_steps", [12, 24])
def test_the_conditions_of_optimality_hold_at_a_solved_plan_without_damping(
    seed: int, n_steps: int
) -> None:
    """Told by NumPy from the slopes of the program, not by the solver of QPs."""
    problem = straight_way(seed, n_steps)
    planner = Planner(problem, BY_STAGES)
    plan = planner.plan(guess=hold_guess(problem))
    assert plan.result is not None
    assert plan.result.level_status[-1] is NlpStatus.SOLVED
    point = plan.result.points[-1]
    assert isinstance(point, StagewisePoint)
    assert point.solution is not None
    program = planner._nlp.program
    assert isinstance(program, StagewiseProgram)
    level = program.levels.level(len(problem.levels) - 1)
    program.levels.go_to(point.x, planner.transcription.parameters(problem))
    level.linearize()
    assert stationarity(level, point.solution) <= planner.options.convergence


def stationarity(level: StageLevelQp, solution: FlatSolution) -> float:
    """Largest entry of the gradient of the Lagrangian at the point where a level is linearised,
    but for the start, which is given.
    """
    qp = level.qp
    n_z = qp.shape.n_z
    n_c = qp.shape.n_c
    n_x = qp.shape.n_x
    costates = np.split(solution.costate, np.cumsum(n_x)[:-1])
    rows = np.split(solution.y[: sum(n_c)], np.cumsum(n_c)[:-1])
    bounds = np.split(solution.y[sum(n_c) :], np.cumsum(n_z)[:-1])
    residuals = level.memory.residual_parts(level.level)
    worst = 0.0
    for k in range(len(n_z)):
        gradient = qp.J[k].T @ residuals[k] + qp.C[k].T @ rows[k] + bounds[k]
        if k:
            gradient[: n_x[k]] -= costates[k]
        if k + 1 < len(n_z):
            gradient += qp.dynamics[k].T @ costates[k + 1]
        free = gradient[n_x[0] :] if k == 0 else gradient
        worst = max(worst, float(np.abs(free).max(initial=0.0)))
    return worst

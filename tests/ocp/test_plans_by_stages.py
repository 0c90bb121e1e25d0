"""Laws of problems that are solved stage by stage: the same optimum as IPOPT, derivatives, and what
is infeasible.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from reaches import CHEAP, PATIENCE, patient, reach
from tiny_robots import TINY, robot_of

from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import Actuation, Integrator, OcpLevel, OcpPhase, OcpProblem, single_phase
from uvms_ocp.ocp.stagewise.functions import BlockFunctions, Tangent, force_rows
from uvms_ocp.ocp.terms import AtRest, Duration, Effort
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import term_blocks
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions

pytestmark = pytest.mark.slow

DRY: dict[str, object] = {"water": False, "limited": False, "actuation": Actuation.WRENCH}


def stagewise(problem: OcpProblem, **options: object) -> Planner:
    return Planner(problem, NlpOptions(time_limit=PATIENCE, plugin="stagewise", **options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def weightless(robot: Robot) -> Robot:
    model = pin.Model(robot.model)
    model.gravity = pin.Motion.Zero()
    return replace(robot, model=model)


@pytest.fixture(scope="module")
def stage_planner(robot: Robot) -> Planner:
    return stagewise(reach(robot))


def test_the_tool_reach_has_the_optimum_of_ipopt(stage_planner: Planner, planner: Planner) -> None:
    ours = stage_planner.plan()
    theirs = planner.plan()
    assert ours.status is OcpStatus.SOLVED
    assert ours.levels[0].residual < 1e-6
    assert ours.levels[1].residual ** 2 == pytest.approx(theirs.levels[1].residual ** 2, rel=1e-6)
    np.testing.assert_allclose(ours.trajectory.q, theirs.trajectory.q, atol=1e-3)


def test_what_it_finds_keeps_the_constraints_of_the_sparse_program(
    stage_planner: Planner, planner: Planner
) -> None:
    plan = stage_planner.plan()
    broken = planner.transcription.violations(plan.result.x, planner.transcription.parameters())
    assert max(broken.values()) < 1e-6
    lower, upper = planner.transcription.bounds()
    assert (plan.result.x >= lower - 1e-6).all()
    assert (plan.result.x <= upper + 1e-6).all()


def test_a_moved_start_is_solved_from_the_last_plan_in_fewer_iterations(
    stage_planner: Planner, robot: Robot
) -> None:
    cold = stage_planner.plan()
    problem = stage_planner.problem
    q = pin.integrate(robot.model, problem.start.q, np.array([0.02, *np.zeros(robot.n_v - 1)]))
    moved = replace(problem, start=State(q=q, v=problem.start.v))
    warm = stage_planner.plan(moved, guess=cold)
    assert warm.status is OcpStatus.SOLVED
    assert warm.iterations < cold.iterations


@pytest.mark.parametrize("integrator", list(Integrator))
def test_every_integrator_gives_the_optimum_of_ipopt_without_water(
    weightless: Robot, integrator: Integrator
) -> None:
    problem = reach(weightless, n_steps=8, integrator=integrator, **DRY)
    ours = stagewise(problem, convergence=1e-7).plan()
    theirs = Planner(problem, NlpOptions(time_limit=PATIENCE, convergence=1e-7)).plan(
        guess=ours.trajectory
    )
    assert ours.status is theirs.status is OcpStatus.SOLVED
    assert ours.levels[1].residual == pytest.approx(theirs.levels[1].residual, rel=1e-4)


def test_an_arm_without_a_vehicle_is_solved_in_the_least_time_as_by_ipopt() -> None:
    robot = load_robot("planar5")
    problem = OcpProblem(
        robot=robot,
        start=State(q=robot.configuration(), v=np.full(robot.n_v, 0.1)),
        phases=(OcpPhase(n_steps=6, duration=(0.5, 6.0)),),
        levels=(OcpLevel(name="time", terms=(Duration(), Effort(weight=1e-2))),),
        constraints=(AtRest(),),
        water=False,
    )
    ours = stagewise(problem).plan()
    theirs = Planner(problem, NlpOptions(time_limit=PATIENCE)).plan()
    assert ours.status is theirs.status is OcpStatus.SOLVED
    assert ours.duration == pytest.approx(theirs.duration, rel=1e-3)


def test_an_arm_of_one_joint_is_solved_as_by_ipopt() -> None:
    robot = robot_of(TINY["fixed base, no thrusters"])
    start = State(q=robot.configuration(), v=np.full(robot.n_v, 0.3))
    problem = single_phase(
        robot=robot, start=start, duration=2.0, n_steps=6, levels=[CHEAP], constraints=(AtRest(),)
    )
    ours = stagewise(problem).plan()
    theirs = patient(problem, "ipopt").plan()
    assert ours.status is theirs.status is OcpStatus.SOLVED
    assert ours.levels[0].residual == pytest.approx(theirs.levels[0].residual, rel=1e-4)


@pytest.mark.parametrize("options", [{}, DRY, {"n_steps": 2}], ids=["wet", "dry", "short"])
def test_derivatives_of_stages_equal_differences_on_the_manifold(
    robot: Robot, options: dict[str, object]
) -> None:
    problem = reach(robot, **({"n_steps": 3} | options))
    tangent = Tangent(model=StageModel(problem, eliminated=True))
    model = tangent.model
    rng = np.random.default_rng(2)
    e = 1e-6
    function = BlockFunctions(
        block=term_blocks(model)[0], tangent=tangent, forces=force_rows(model), extra=0
    )
    n = tangent.n_x + tangent.n_u
    layout = model.layout
    z = 0.1 * rng.standard_normal(layout.n_z)
    z[layout.q] = problem.start.q
    z[layout.h] = 0.4
    s = np.ones(function.block.rows.n_parameters)
    u = np.array([0.1, -0.2, 0.05])
    step = ca.SX.sym("step", n)
    moved = ca.Function("moved", [model.z, step], [tangent.moved(step)])
    groups = len(function.held) + len(function.errors) - 1
    force, slope = tangent.forces[1](z, u)
    found = function.linear.call([z, s, u, force, slope])
    d = rng.standard_normal(n)
    ends = [
        values_of(tangent, function, np.array(moved(z, sign * e * d)).ravel(), s, u)
        for sign in (1.0, -1.0)
    ]
    for value, J, ahead, behind in zip(found[:groups], found[groups:], *ends, strict=False):
        slope = (np.array(ahead) - np.array(behind)).ravel() / (2 * e)
        np.testing.assert_allclose(np.array(J).T @ d, slope, atol=1e-5)
        assert value.numel() == len(slope)


def values_of(
    tangent: Tangent, function: BlockFunctions, z: np.ndarray, s: np.ndarray, u: np.ndarray
) -> list[ca.DM]:
    """Rows at z with the forces there."""
    return list(
        function.values.call(
            [z, s, u, tangent.forces[0](z, u), np.zeros(tangent.force_slope.shape)]
        )
    )


@pytest.mark.parametrize("options", [{}, {"integrator": Integrator.EULER}], ids=["middle", "euler"])
def test_curvature_of_stages_is_the_second_difference_on_the_manifold(
    robot: Robot, options: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "uvms_ocp.ocp.stagewise.functions.compiled_from",
        lambda name, content, make, *modules: make(),
    )
    tangent = Tangent(model=StageModel(reach(robot, **({"n_steps": 3} | options)), eliminated=True))
    model = tangent.model
    rng = np.random.default_rng(3)
    e = 1e-3
    function = BlockFunctions(
        block=term_blocks(model)[0], tangent=tangent, forces=force_rows(model), extra=0
    )
    z = 0.1 * rng.standard_normal(model.layout.n_z)
    s = np.ones(function.block.rows.n_parameters)
    u = np.full(3, 0.1)
    z[model.layout.q], z[model.layout.h] = model.problem.start.q, 0.4
    after = z + 0.01 * rng.standard_normal(len(z))
    step = ca.SX.sym("step", tangent.n_x + tangent.n_u)
    after[model.layout.q] = model.problem.start.q
    assert function.weights is not None
    y, r = (rng.standard_normal(function.weights.numel_in(i)) for i in (5, 6))
    costates = rng.standard_normal(tangent.n_x)
    d = rng.standard_normal(step.numel())
    here = (z, s, u, *tangent.forces[1](z, u))
    bent = tangent.step_curvature(
        z,
        after,
        costates,
        model.force_curvature(z[: model.n_motion], u, function.weights(*here, y, r)),
    )
    H = function.curvature(*here, y, r, bent)
    moved = ca.Function("moved", [model.z, step], [tangent.moved(step)])
    motion = ca.Function("motion", [model.z], [tangent.motion(ca.SX(ca.DM(after)))])
    n_errors = len(function.errors)

    def value(share: float) -> float:
        there = np.array(moved(z, share * d)).ravel()
        rows = [np.array(part).ravel() for part in values_of(tangent, function, there, s, u)]
        held = np.concatenate(rows[n_errors:-1])
        errors = np.concatenate(rows[:n_errors])
        return float(y @ held + r @ errors + costates @ np.array(motion(there)).ravel())

    second = (value(e) - 2 * value(0.0) + value(-e)) / e**2
    assert float(d @ np.array(H) @ d) == pytest.approx(second, rel=1e-4)


def test_a_current_that_thrusters_cannot_hold_against_is_named_infeasible(robot: Robot) -> None:
    plan = stagewise(reach(robot, current=np.array([3.0, 0.0, 0.0]), n_steps=8)).plan()
    assert plan.status is OcpStatus.INFEASIBLE
    assert "broken by" in plan.reason
    assert plan.iterations < 100


def test_it_works_without_a_compiler(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "uvms_ocp.ocp.stagewise.functions.compiled_from",
        lambda name, content, make, *modules: make(),
    )
    q = load_robot("planar5")
    problem = single_phase(
        robot=q,
        start=State(q=q.configuration(), v=np.full(q.n_v, 0.1)),
        duration=2.0,
        n_steps=4,
        levels=[OcpLevel(name="effort", terms=(Effort(),))],
        constraints=(AtRest(),),
        water=False,
    )
    assert stagewise(problem).plan().status is OcpStatus.SOLVED

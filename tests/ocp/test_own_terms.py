"""Laws of what a user adds: own residuals, starts that are free, motions that close, obstacles that
move, records of all.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
import pytest
from reaches import CHEAP, patient, reach

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import Actuation, Integrator, OcpLevel, OcpPhase, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, TaskTerm, Term, residual_term
from uvms_ocp.ocp.trajectory import intervals_of
from uvms_ocp.record.record import Record
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.scenario import replay
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks.pose import ToolPosition
from uvms_ocp.viz import plot, show
from uvms_ocp.viz.plan_figures import PLAN_FIGURES

pytestmark = pytest.mark.slow

SEA = Environment(seafloor=FlatSeafloor(z=-40))


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot("planar5")


def on_arm(
    arm: Robot, *constraints: Term, levels: tuple[OcpLevel, ...] = (), **options: Any
) -> OcpProblem:
    cheap = OcpLevel(name="effort", terms=(Effort(),))
    start = State(q=arm.configuration(), v=np.zeros(arm.n_v))
    chosen = {"duration": 2.0, "n_steps": 6, "constraints": constraints, "water": False}
    return single_phase(robot=arm, start=start, levels=(*levels, cheap), **(chosen | options))  # type: ignore[arg-type]


def test_an_error_in_a_residual_is_told_with_the_name_of_its_term(arm: Robot) -> None:
    def rows(stage: object) -> ca.SX:
        return {}["speed"]

    term = residual_term("my speed", rows)
    with pytest.raises(
        InvalidInput, match=r"term 'my speed': its residual raised KeyError: 'speed'"
    ) as raised:
        Planner(on_arm(arm, term))
    assert isinstance(raised.value.__cause__, KeyError)
    assert "\n" not in str(raised.value)


def test_two_levels_of_one_name_are_refused(arm: Robot) -> None:
    with pytest.raises(
        InvalidInput, match=r"levels \['effort', 'effort'\] share a name; give each its own"
    ):
        on_arm(arm, levels=(OcpLevel(name="effort", terms=(Effort(),)),))


@pytest.mark.parametrize("integrator", Integrator)
def test_a_motion_between_nodes_goes_through_them(integrator: Integrator) -> None:
    """Whatever the integrator makes of an acceleration, a step ends where the next one begins."""
    bluerov = load_robot("bluerov2_alpha5")
    dt = 1e-9
    turn = residual_term("turn", lambda stage: stage.tick.velocity[5] - 0.5)
    given = on_arm(bluerov, levels=(OcpLevel(name="turn", terms=(turn,)),), integrator=integrator)
    path = Planner(given).plan().trajectory
    assert np.abs(path.a[:, 5]).max() > 0.05
    for k in range(1, len(path.a)):
        before = path.state_at(bluerov.model, path.t[k] - dt)[0]
        assert np.abs(pin.difference(bluerov.model, before, path.q[k])).max() < 1e-7


# --- own rows -----------------------------------------------------------------------------------------


def test_an_own_residual_is_reached_and_an_own_constraint_kept(arm: Robot) -> None:
    half = residual_term("half", lambda stage: stage.tick.q[0] - 0.5)
    slow = residual_term(
        "slow", lambda stage: stage.tick.velocity[0], lower=-0.35, upper=0.35, at=At.PATH
    )
    plan = Planner(on_arm(arm, slow, levels=(OcpLevel(name="go", terms=(half,)),))).plan()
    assert plan.status is OcpStatus.SOLVED
    assert plan.trajectory.q[-1, 0] == pytest.approx(0.5, abs=1e-5)
    assert np.abs(plan.trajectory.v[:, 0]).max() == pytest.approx(0.35, abs=1e-3)


def test_an_own_cost_on_inputs_is_no_goal(arm: Robot) -> None:
    jerky = residual_term(
        "gentle", lambda stage: stage.acceleration, at=At.PATH, goal=False, inputs=True
    )
    push = residual_term("push", lambda stage: stage.tick.q[0] - 0.5)
    plan = Planner(on_arm(arm, push, levels=(OcpLevel(name="gentle", terms=(jerky,)),))).plan()
    assert plan.status is OcpStatus.SOLVED
    assert plan.levels[0].residual > 0.1


def test_parameters_of_an_own_term_are_given_anew_to_a_kept_planner(arm: Robot) -> None:
    def at(place: Any) -> OcpProblem:
        rows = residual_term("there", lambda stage, goal: stage.tick.q[:2] - goal, parameters=place)
        return on_arm(arm, levels=(OcpLevel(name="go", terms=(rows,)),))

    planner = Planner(at(np.array([0.1, 0.1])))
    for place in ([0.3, -0.2], [0.0, 0.4]):
        np.testing.assert_allclose(
            planner.plan(at(np.array(place))).trajectory.q[-1, :2], place, atol=1e-5
        )
    moving = planner.plan(at(lambda t: (np.array([0.1 * t, 0.0]), np.zeros(2))), t0=1.0)
    np.testing.assert_allclose(moving.trajectory.q[-1, :2], [0.3, 0.0], atol=1e-5)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "a number": (
        {"rows": lambda stage: 3.0},
        r"gave float of shape \(\); give a column \(m, 1\) of casadi.SX",
    ),
    "numpy": ({"rows": lambda stage: np.zeros(2)}, "gave ndarray"),
    "MX": ({"rows": lambda stage: ca.MX.sym("x")}, "gave MX"),
    "a row": ({"rows": lambda stage: stage.tick.q.T}, r"SX of shape \(1, 5\)"),
    "nothing": ({"rows": lambda stage: ca.SX(0, 1)}, r"SX of shape \(0, 1\)"),
    "silent inputs": ({"rows": lambda stage: stage.torque}, "give inputs=True"),
    "bounds of another size": (
        {"rows": lambda stage: stage.tick.q[:2], "lower": np.zeros(3)},
        "or 2 of them",
    ),
    "swapped bounds": (
        {"rows": lambda stage: stage.tick.q, "lower": 1.0, "upper": 0.0},
        "are swapped",
    ),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_in_an_own_term_is_told_with_its_name(arm: Robot, mistake: str) -> None:
    fields, message = WRONG[mistake]
    with pytest.raises(InvalidInput, match=f"^mine: .*{message}"):
        Planner(on_arm(arm, residual_term("mine", **fields)))


@pytest.mark.filterwarnings("ignore")
def test_rows_that_are_no_number_at_the_start_are_named(arm: Robot) -> None:
    q = ca.DM(arm.configuration())
    for rows in (
        lambda stage: ca.sqrt(stage.tick.q[0] - 1),
        lambda stage: ca.sqrt(ca.sumsqr(stage.tick.q - q)),
    ):
        plan = Planner(on_arm(arm, residual_term("mine", rows, upper=np.inf))).plan()
        assert plan.status is OcpStatus.UNFINISHED
        assert "not a number: at the start mine" in plan.reason


# --- starts -------------------------------------------------------------------------------------------


def swing(robot: Robot, **options: Any) -> OcpProblem:
    """The tool to one side and to the other."""
    q = robot.configuration(position=(0, 0, -5)) if robot.n_vehicle else robot.configuration()
    tool = Kinematics(robot, q).pose("tool").translation

    def side(x: float, phase: str) -> Term:
        goal = pin.SE3(np.eye(3), tool + np.array([x, 0.0, 0.0]))
        return TaskTerm(task=ToolPosition(goal=goal), phase=phase)

    return OcpProblem(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        phases=tuple(OcpPhase(name=name, n_steps=6, duration=4.0) for name in ("out", "back")),
        levels=(OcpLevel(name="sides", terms=(side(0.3, "out"), side(-0.3, "back"))), CHEAP),
        **options,
    )


def apart(robot: Robot, plan: Plan) -> float:
    """Largest difference of the last state to the first."""
    q = plan.trajectory.q
    v = plan.trajectory.v
    return max(np.abs(pin.difference(robot.model, q[0], q[-1])).max(), np.abs(v[-1] - v[0]).max())


@pytest.mark.parametrize("name", ["planar5", "girona_maris7_full"])
def test_a_periodic_motion_ends_in_its_first_state(name: str) -> None:
    robot = load_robot(name)
    water = bool(robot.n_vehicle)
    free = np.full(2 * robot.n_v, np.inf)
    plan = patient(swing(robot, water=water, periodic=True, start_freedom=free)).plan()
    assert plan.status is OcpStatus.SOLVED, plan.reason
    assert apart(robot, plan) < 1e-6
    np.testing.assert_allclose(
        np.linalg.norm(plan.trajectory.q[:, 3:7], axis=1)[: 13 * water], 1.0, atol=1e-7
    )
    fixed = patient(swing(robot, water=water)).plan()
    assert fixed.status is OcpStatus.SOLVED
    assert apart(robot, fixed) > 0.1


def test_a_start_is_free_as_far_as_it_says(arm: Robot) -> None:
    freedom = np.zeros(2 * arm.n_v)
    freedom[0] = 0.2
    freedom[arm.n_v] = np.inf
    push = residual_term("push", lambda stage: stage.tick.q[0] - 0.5)
    problem = replace(
        on_arm(arm, levels=(OcpLevel(name="go", terms=(push,)),)), start_freedom=freedom
    )
    plan = Planner(problem).plan()
    moved = plan.trajectory.q[0] - problem.start.q
    assert plan.status is OcpStatus.SOLVED
    assert moved[0] <= 0.2 + 1e-6
    assert plan.trajectory.v[0, 0] > 0.05, "already under way"
    np.testing.assert_allclose(moved[1:], 0.0, atol=1e-7)
    np.testing.assert_allclose(plan.trajectory.v[0, 1:], 0.0, atol=1e-7)


def test_terms_on_the_path_hold_at_a_free_start_too(arm: Robot) -> None:
    wall = residual_term("wall", lambda stage: stage.tick.q[0], lower=0.1, upper=np.inf, at=At.PATH)
    plan = Planner(replace(on_arm(arm, wall), start_freedom=np.full(2 * arm.n_v, np.inf))).plan()
    assert plan.status is OcpStatus.SOLVED, plan.reason
    assert plan.trajectory.q[:, 0].min() >= 0.1 - 1e-6


def test_freedoms_that_are_none_are_refused(arm: Robot) -> None:
    for freedom in (np.zeros(3), np.full(2 * arm.n_v, -1.0), np.full(2 * arm.n_v, np.nan)):
        with pytest.raises(InvalidInput, match=r"start_freedom|NaN"):
            replace(on_arm(arm), start_freedom=freedom)
    with pytest.raises(InvalidInput, match="use plugin='ipopt'"):
        Planner(replace(on_arm(arm), periodic=True), NlpOptions(plugin="stagewise"))


# --- obstacles that move ------------------------------------------------------------------------------


def test_an_obstacle_that_moves_is_kept_clear_of_where_it_is(arm: Robot) -> None:
    tool = Kinematics(arm, arm.configuration()).pose("tool").translation

    def crossing(t: float) -> tuple[np.ndarray, np.ndarray]:
        velocity = np.array([0.0, -0.5, 0.0])
        return tool + np.array([0.0, 1.0, 0.0]) + t * velocity, velocity

    clear = BallClearance(
        robot_balls=(Ball(frame="tool", radius=0.05),),
        obstacles=(Ball(centre=crossing, radius=0.2),),
    )
    plan = Planner(on_arm(arm, clear, duration=3.0, n_steps=15)).plan()
    assert plan.status is OcpStatus.SOLVED, plan.reason
    way = [Kinematics(arm, q).pose("tool").translation for q in plan.trajectory.q]
    gaps = [
        np.linalg.norm(p - crossing(t)[0]) - 0.25
        for p, t in zip(way, plan.trajectory.t, strict=True)
    ]
    assert min(gaps) >= 0.05 - 1e-5
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() > 0.1, "it gave way"
    last = plan.surroundings.obstacles[0]
    np.testing.assert_allclose(last.position, crossing(3.0)[0])
    with pytest.raises(InvalidInput, match="only obstacles move on their own"):
        BallClearance(robot_balls=(Ball(centre=crossing, radius=0.1),), obstacles=())


# --- what becomes of a plan ---------------------------------------------------------------------------


def test_every_plan_is_a_record_with_figures_and_a_scene(
    arm: Robot, planner: Planner, tmp_path: Path
) -> None:
    wrench = reach(planner.problem.robot, actuation=Actuation.WRENCH, n_steps=4)
    plans = (planner.plan(), Planner(on_arm(arm)).plan(), patient(wrench).plan(diagnose=False))
    for plan in plans:
        record = plan.to_record()
        record.save(tmp_path / "record.npz")
        loaded = Record.load(tmp_path / "record.npz")
        push = "wrench" if plan.trajectory.of_wrench and plan.robot.n_vehicle else "thrust"
        np.testing.assert_array_equal(loaded[push], record[push])
        np.testing.assert_allclose(record["q"][-1], plan.trajectory.q[-1], atol=1e-6)
        tool = Kinematics(plan.robot, record["q"][7]).pose("tool")
        np.testing.assert_allclose(record["tool"][7, :3], tool.translation, atol=1e-12)
        if plan.energy is not None:
            taken = record["thruster_energy"][-1].sum() + record["joint_energy"][-1]
            assert taken == pytest.approx(plan.energy, rel=1e-9)
        figures = plot(plan)
        assert len(figures) >= 2
        for figure in figures:
            plt.close(figure)
        assert len(show(plan).html) == len(show(record, plan.robot).html), (
            "but for identifiers drawn anew"
        )


def test_a_plan_is_replayed_in_the_plant_within_10_mm(planner: Planner, tmp_path: Path) -> None:
    plan = planner.plan()
    flight = replay(plan, SEA)
    assert flight.mismatch.position < 0.01
    assert flight.mismatch.end_position < 0.01
    flight.record.save(tmp_path / "flight.npz")
    assert len(Record.load(tmp_path / "flight.npz")) == len(flight.record)
    assert flight.record["t"][-1] == pytest.approx(plan.duration, abs=0.006)
    blind = replay(plan, SEA, feedback=False)
    assert blind.mismatch.end_position > flight.mismatch.end_position
    plant = DynamicPlant(
        plan.robot, plan.trajectory.q[0], dynamics=robot_dynamics(plan.robot), environment=SEA
    )
    again = replay(plan, plant)
    np.testing.assert_array_equal(again.record["q"], flight.record["q"])


def test_a_plan_below_the_sea_floor_is_told_when_it_is_replayed(planner: Planner) -> None:
    plan = planner.plan()
    assert replay(plan, SEA).record.run_meta.alarms == ()
    shallow = Environment(seafloor=FlatSeafloor(z=float(plan.trajectory.q[0, 2]) + 0.5))
    (alarm,) = replay(plan, shallow).record.run_meta.alarms
    assert "m below the sea floor (seafloor - " in alarm.text


def test_a_plan_of_a_wrench_has_nothing_to_replay(planner: Planner) -> None:
    wrench = patient(reach(planner.problem.robot, actuation=Actuation.WRENCH, n_steps=4)).plan(
        diagnose=False
    )
    with pytest.raises(InvalidInput, match=r"plan with Actuation\.THRUSTERS"):
        replay(wrench, SEA)


def test_a_planned_wrench_is_recorded_as_one_and_names_no_thruster(planner: Planner) -> None:
    plan = patient(reach(planner.problem.robot, actuation=Actuation.WRENCH, n_steps=4)).plan(
        diagnose=False
    )
    record = plan.to_record()
    assert "thrust" not in record.series
    assert plan.peak_thrust is plan.summary()["peak_thrust"] is None
    steps = intervals_of(plan.trajectory.t, record["t"])
    assert np.array_equal(record["wrench"], plan.trajectory.thrust[steps])
    figure = PLAN_FIGURES["efforts"](record)
    assert [axis.get_ylabel() for axis in figure.axes[:2]] == ["force [N]", "moment [N m]"]
    assert not any(
        "thruster1" in text.get_text()
        for axis in figure.axes
        for text in axis.get_legend().get_texts()
    )


def test_a_plan_of_an_arm_without_water_is_replayed_on_a_kinematic_plant_as_it_stands(
    arm: Robot,
) -> None:
    plan = Planner(on_arm(arm)).plan()
    flight = replay(plan, KinematicPlant(arm, plan.trajectory.q[0]))
    assert flight.mismatch.position < 1e-6

"""The kernels of a tick: the same in C and in Python, through sound ticks, doubted and lost
channels, and distress.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from compiler import needs_compiler

from uvms_ocp.control.velocity.abort import ActuationFeedback
from uvms_ocp.control.velocity.ascent import ascent_goal
from uvms_ocp.control.velocity.goals import mission_parameters
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.control.velocity.tick import prepare_tick, solve_and_finish
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Above, Below, Phase, Transition
from uvms_ocp.mission.progress import activations_at
from uvms_ocp.record.meta_values import ABORT
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.robot.signals import ChannelHealth, StateEstimate, Trust
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import VehiclePose

DT = 0.02
CHANNELS = (
    "position",
    "altimeter_range",
    "joint_positions",
    "linear_velocity",
    "attitude",
    "angular_velocity",
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return case1(plant="kinematic", dt=DT)


def babble(scenario: Scenario, n: int) -> list[tuple[StateEstimate, ActuationFeedback]]:
    """Measurements near the start; channels are doubted and lost and good again, echoes come and
    go.
    """
    rng = np.random.default_rng(3)
    at_rest = np.zeros(scenario.robot.n_v)
    telemetry = []
    for k in range(n):
        bad = {CHANNELS[k // 40 % 5]: Trust(int(k % 40 > 20) + int(k % 40 > 30))}
        if 205 < k < 225:
            bad |= {"attitude": Trust.SUSPECT, "angular_velocity": Trust.SUSPECT}
        health = tuple(
            ChannelHealth(channel=name, trust=bad.get(name, Trust.GOOD)) for name in CHANNELS
        )
        measurement = StateEstimate(
            q=scenario.start
            + np.concatenate([rng.normal(0.0, 0.01, 3), np.zeros(len(scenario.start) - 3)]),
            v=at_rest + rng.normal(0.0, 0.01, len(at_rest)),
            altimeter_range=np.nan if k % 7 == 0 else 4.0 + float(rng.normal(0.0, 0.1)),
            age=1.0 if 150 < k < 160 else 0.0,
            health=health,
        )
        telemetry.append(
            (
                measurement,
                ActuationFeedback(push=0.2, short=k % 3 == 0, jammed=(7,) if k > 100 else ()),
            )
        )
    return telemetry


def meet(control: KinematicController, feedback: ActuationFeedback) -> None:
    """What the force layer met in the tick before."""
    control.note_feedback(feedback)
    memory = control.memory
    memory.distress.short = feedback.short
    memory.distress.push = feedback.push
    for axis in range(control.robot.n_v):
        memory.jammed[axis] = axis in feedback.jammed


def twins(
    build: Callable[[], KinematicController], monkeypatch: pytest.MonkeyPatch
) -> tuple[KinematicController, ...]:
    """Two controllers, the second with kernels in Python."""
    quick = build()
    bound: list[object] = []
    with monkeypatch.context() as without:
        for room in ("kinematic", "tick"):
            name = f"uvms_ocp.control.velocity.{room}.bind_memory"
            without.setattr(name, lambda memory, kernels: bound.extend(kernels) or kernels)
        slow = build()
    assert slow.prepare is prepare_tick
    assert quick.prepare is not prepare_tick
    assert solve_and_finish in bound
    return quick, slow


@needs_compiler
def test_a_controller_whose_kernels_are_python_gives_the_same_bits(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick, slow = twins(scenario.controller, monkeypatch)
    fed = babble(scenario, 260)
    for k, (measurement, feedback) in enumerate(fed):
        for control in (quick, slow):
            meet(control, feedback)
        first = quick(measurement, k * DT)
        second = slow(measurement, k * DT)
        np.testing.assert_array_equal(first.v, second.v)
        for name in ("quantities", "activations", "freshness"):
            np.testing.assert_array_equal(first.telemetry[name], second.telemetry[name])
        assert (first.hold, first.stop, first.brakes) == (second.hold, second.stop, second.brakes)
        assert quick.state.held_since == slow.state.held_since
    assert [event.reason for event in quick.events] == [event.reason for event in slow.events]
    assert quick.pending() == slow.pending()


def test_what_babble_feeds_meets_every_branch(scenario: Scenario) -> None:
    """Otherwise the test above would say less than it seems to."""
    control = scenario.controller()
    met = set()
    for k, (measurement, feedback) in enumerate(babble(scenario, 260)):
        meet(control, feedback)
        tick = control.observe(measurement, k * DT)
        command = control.command(tick)
        less = tick.restriction
        met |= {
            name
            for name in ("no_descent", "joints_held", "hold", "blind", "attitude_open")
            if getattr(less, name)
        }
        met |= {name for name, so in (("slow", less.speed < 1.0), ("held", command.hold)) if so}
    assert {"no_descent", "joints_held", "hold", "attitude_open", "slow", "held"} <= met


def test_a_channel_that_is_good_again_holds_nothing_back_and_is_told_no_longer(
    scenario: Scenario,
) -> None:
    control = scenario.controller()
    told = []
    for k, trust in enumerate(
        (Trust.GOOD, Trust.LOST, Trust.GOOD, Trust.SUSPECT, Trust.LOST, Trust.GOOD)
    ):
        health = (ChannelHealth(channel="position", trust=trust, since=k * DT),)
        control(replace(measured(scenario), health=health), k * DT)
        told.append("; position " in control.pending())
        assert told[-1] == (trust is not Trust.GOOD), k
    assert sum(told) == 3


def going_to_and_fro(scenario: Scenario) -> Mission:
    """Two phases that lead to each other, at most three times, as what they wait for is never
    near.
    """
    never = Above(quantity="PC.position_error", limit=0.1)
    arrival = Transition(to="B", when=(never,), hold=0.1, retries=3)
    back = (
        Transition(to="A", when=(Below(quantity="PC.position_error", limit=0.01), never)),
        replace(arrival, to="A"),
    )
    phases = (
        Phase(name="A", activations={"PC": 1.0}, transitions=(arrival,)),
        Phase(
            name="B",
            activations={"PC": 1.0, "HA": 0.5},
            transitions=back,
            goals={"PC": pose_at((0.0, 0.0, -5.0))},
        ),
    )
    return replace(scenario.mission, phases=phases, ramp=0.3)


@needs_compiler
def test_transitions_are_those_of_the_mission_alone_in_c_and_in_python(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = going_to_and_fro(scenario)
    quick, slow = twins(replace(scenario, mission=mission).controller, monkeypatch)
    state = mission.start()
    alone = []
    for k in range(50):
        for control in (quick, slow):
            control(measured(scenario), k * DT)
        state, event = mission.step(state, k * DT, quick.quantities)
        alone += [] if event is None else [event]
        for control in (quick, slow):
            np.testing.assert_array_equal(
                control.state.activations_before, state.activations_before
            )
            for name in ("phase", "since", "held_since", "fired", "aborted", "completed"):
                assert getattr(control.state, name) == getattr(state, name), name
    assert [event.target for event in alone] == ["B", "A", "B", "A", "B", "A", ABORT]
    assert quick.events == slow.events == alone
    assert state.aborted.startswith("3 retries are used up: PC.position_error")


@needs_compiler
def test_giving_up_is_that_of_the_mission_alone_in_c_and_in_python(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert scenario.mission.abort is not None
    mission = replace(
        scenario.mission,
        abort=replace(scenario.mission.abort, stall_after=0.3, time_limit=0.4, altitude=6.0),
    )
    controls = twins(replace(scenario, mission=mission).controller, monkeypatch)
    for k in range(50):
        commands = [control(measured(scenario), k * DT) for control in controls]
        np.testing.assert_array_equal(commands[0].v, commands[1].v)
    for control in controls:
        assert [event.target for event in control.events] == ["climb", ABORT]
        stalled, late = control.events
        before, climbing = control.left
        goal = ascent_goal(control.memory.ascent)
        began, event = mission.abandon(before, stalled.t, stalled.reason, goal)
        assert event == stalled
        assert (began.phase, began.since, began.abort_reason) == (
            climbing.phase,
            climbing.since,
            climbing.abort_reason,
        )
        np.testing.assert_array_equal(
            mission.references(began, 1.0)[mission.hierarchy.index("PC")][:3], goal.translation
        )
        assert mission.abandon(climbing, late.t, late.reason, goal)[1] == late
        assert control.state.aborted == stalled.reason
        assert 1.0 < goal.translation[2] - scenario.start[2] < 3.0


def test_a_climb_is_towards_a_goal_that_rests_and_the_goals_of_kernels_are_those_of_the_mission(
    scenario: Scenario,
) -> None:
    assert scenario.mission.abort is not None
    mission = replace(
        scenario.mission, abort=replace(scenario.mission.abort, stall_after=0.1, altitude=6.0)
    )
    control = replace(scenario, mission=mission).controller()
    at = measured(scenario)
    gates = np.ones(mission.n_tasks)
    phases = set()
    for k in range(10):
        before = control.state
        control(at, k * DT)
        expected = mission_parameters(mission, before, k * DT, gates=gates, q=at.q, motion=None)
        np.testing.assert_array_equal(control.memory.goals.values, expected)
        phases.add(mission.all_phases[control.memory.mission.phase].name)
    assert "climb" in phases
    np.testing.assert_array_equal(
        mission.references(control.state, 1.0)[mission.hierarchy.index("PC")][12:], 0.0
    )


def towards_a_ball(robot: Robot) -> KinematicController:
    """With a collision model of its own: coal begins a search where its last one ended."""
    ball = Obstacle(
        name="ball", shape=coal.Sphere(0.4), X_WO=pin.SE3(np.eye(3), np.array([1.9, 0.3, 0.1]))
    )
    tasks = (
        Clearance(model=CollisionModel(robot, [ball], self_collision=False)),
        VehiclePose(goal=pose_at((4.0, 0.0, 0.0)), gain_linear=2.0),
    )
    reached = Transition(to="done", when=(Below(quantity="PC.position_error", limit=0.01),))
    phase = Phase(name="A", activations={"CL": 1.0, "PC": 1.0}, transitions=(reached,))
    mission = Mission(hierarchy=Hierarchy(tasks), phases=(phase,))
    return KinematicController(robot=robot, mission=mission, solver=LexicographicActiveSet(), dt=DT)


@pytest.mark.slow
@needs_compiler
def test_distances_and_their_limits_in_python_give_the_same_bits(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = scenario.robot
    quick, slow = twins(lambda: towards_a_ball(robot), monkeypatch)
    q = robot.configuration()
    v = np.zeros(robot.n_v)
    moving = 0
    for k in range(250):
        measurement = StateEstimate(q=q, v=v, altimeter_range=5.0)
        first = quick(measurement, k * DT)
        second = slow(measurement, k * DT)
        np.testing.assert_array_equal(first.v, second.v)
        np.testing.assert_array_equal(quick.memory.goals.values, slow.memory.goals.values)
        moving += quick.memory.nearest.moves
        v = first.v
        q = pin.integrate(robot.model, q, v * DT)
    assert moving > 20
    assert 0.09 < quick.quantities["CL.clearance"] < 0.3


def test_gates_of_a_mission_without_memory_are_those_of_the_controller(scenario: Scenario) -> None:
    control = scenario.controller()
    mission = scenario.mission
    for t in (3.0, 3.0, 3.07, 3.2, 8.0):
        tick = control.observe(measured(scenario), t)
        np.testing.assert_array_equal(tick.gates, mission.activations(mission.start(3.0), t))
    gates = [0.0] * mission.n_tasks
    activations_at(control.memory.mission, 3.1, gates)
    np.testing.assert_allclose(gates, 0.5 * np.array([row["A"] for row in mission.table()]))


def measured(scenario: Scenario) -> StateEstimate:
    return StateEstimate(q=scenario.start, v=np.zeros(scenario.robot.n_v), altimeter_range=4.0)


def test_quantities_are_unknown_before_the_first_tick(scenario: Scenario) -> None:
    control: KinematicController = scenario.controller()
    assert set(control.quantities) == set(control.problem.quantity_names)
    assert all(np.isnan(value) for value in control.quantities.values())

"""What sends a mission into its abort phase beside lost sensors, and that phase on the dynamic
plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from broken_sensors import BrokenSensors
from compiler import long_without_compiler
from scaled_robots import scaled_reach

from uvms_ocp.codegen.kernel_layout import assign, doubles, structure_of
from uvms_ocp.control.velocity.abort import (
    AbortMemory,
    AbortMonitor,
    AbortReason,
    ActuationFeedback,
    abort_reason,
)
from uvms_ocp.control.velocity.ascent import AscentMemory, aim_ascent, ascent_functions, ascent_goal
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.mission.mission import write_mission
from uvms_ocp.mission.phase import Abort
from uvms_ocp.mission.progress import MissionMemory, quantities_read, with_phases, write_state
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.shapes.hull import lowest_point, skid_points
from uvms_ocp.robot.signals import ChannelHealth, Command, Readings, StateEstimate, Trust
from uvms_ocp.robot.size import size
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.rough_seafloor import HeightField
from uvms_ocp.tasks import Hierarchy

DT = 0.02


@pytest.fixture(scope="module")
def still() -> Scenario:
    return case1(plant="kinematic", dt=DT)


def with_abort(scenario: Scenario, **changes: float) -> Scenario:
    assert scenario.mission.abort is not None
    mission = replace(scenario.mission, abort=replace(scenario.mission.abort, **changes))
    return replace(scenario, mission=mission)


def reasons(
    scenario: Scenario,
    feedback: ActuationFeedback,
    seconds: float,
    *,
    error: float = 1.0,
    rate: float = 0.0,
    course: Callable[[float], float] | None = None,
    health: tuple[ChannelHealth, ...] = (),
    clearance: float = np.nan,
) -> list[str]:
    """At every tick of phase A, where every quantity is `error`, which falls with `rate` [1/s], or
    follows a course of time [s].
    """
    control = scenario.kinematic_controller()
    mission = scenario.mission
    names = quantities_read(mission.all_phases)
    quantities = Dimensions(n_quantities=len(names))
    dimensions = with_phases(quantities, mission.all_phases, mission.n_tasks)
    phases = structure_of(MissionMemory, dimensions)()
    memory = structure_of(AbortMemory, dimensions)()
    write_mission(phases, mission, names)
    distress = AbortMonitor(mission, scenario.robot, memory)
    assign(memory, short=feedback.short, push=feedback.push, spent=feedback.spent)
    memory.fault = bool(feedback.fault)
    measured = StateEstimate(
        q=scenario.start, v=np.zeros(scenario.robot.n_v), altimeter_range=3.0, health=health
    )
    reasons = []
    for k in range(round(seconds / DT)):
        value = error * np.exp(-rate * k * DT) if course is None else course(k * DT)
        quantities = dict.fromkeys(control.problem.quantity_names, value)
        tick = control.observe(measured, k * DT)
        write_state(phases, tick.mission)
        values = [quantities[name] for name in names]
        ended = bool(tick.restriction.abort)
        why = abort_reason(
            memory, phases, tick.t, tick.gates.tolist(), values, False, ended, clearance
        )
        reasons.append(distress.describe(AbortReason(why), tick, quantities, feedback))
    return reasons


def first(reasons: list[str]) -> float:
    """[s] when there was a reason."""
    return DT * next(k for k, reason in enumerate(reasons) if reason)


def test_each_reason_needs_its_time_and_says_what_it_was(still: Scenario) -> None:
    mission = with_abort(still, contact_after=0.5, thrust_after=1.0, stall_after=2.0)
    pushed = reasons(mission, ActuationFeedback(push=0.31, short=True), 0.7)
    assert first(pushed) == pytest.approx(0.5, abs=3 * DT)
    assert "31 % of the thrusters' lift" in pushed[-1]
    short = reasons(
        mission, ActuationFeedback(push=0.29, short=True, at_limits="thruster2, thruster5"), 1.2
    )
    assert first(short) == pytest.approx(1.0, abs=3 * DT)
    assert short[-1].endswith("limits for 1 s (thruster2, thruster5)")
    stalled = reasons(mission, ActuationFeedback(), 2.2)
    assert first(stalled) == pytest.approx(2.0, abs=3 * DT)
    assert stalled[-1] == "stall: PC.position_error = 1 not < 0.1, no nearer for 2 s"


def test_hull_or_arm_in_the_floor_that_is_seen_ends_the_mission(still: Scenario) -> None:
    """Before, only a force told, and only while a minimum altitude was asked for."""
    depth = min(size(still.robot.model) / 8, 0.03)
    sunk = reasons(still, ActuationFeedback(), 0.7, clearance=-1.01 * depth)
    assert first(sunk) == pytest.approx(0.5, abs=3 * DT)
    assert sunk[-1] == f"hull or arm {depth:.2g} m in the floor that the altimeter shows, or deeper"
    for clearance in (-0.99 * depth, np.nan):
        assert not any(reasons(still, ActuationFeedback(), 0.7, clearance=clearance))


@pytest.mark.parametrize(
    ("trust", "silent", "ends"),
    [
        (Trust.GOOD, False, True),
        (Trust.GOOD, True, False),
        (Trust.SUSPECT, False, False),
        (Trust.LOST, True, False),
    ],
)
def test_a_floor_that_nobody_sees_ends_no_mission(
    still: Scenario, trust: Trust, silent: bool, ends: bool
) -> None:
    """Before, the floor that is assumed in doubt, which rises with the way, ended every long
    way.
    """
    control = still.kinematic_controller()
    echo = 3.0
    q = still.robot.configuration(
        position=(0.0, 0.0, -36.0), rpy=(0.0, 0.5, 0.0)
    ).copy()  # the hull reaches below the altimeter
    bad = (
        (ChannelHealth(channel="altimeter_range", trust=trust),) if trust is not Trust.GOOD else ()
    )
    why = set()
    for k in range(120):
        health = ()
        if k >= 10:
            q[0] = q[0] + 0.3
            q[2] = q[2] - 0.05
            echo = np.nan if silent else max(0.02, echo - 0.1)
            health = bad
        measured = StateEstimate(
            q=q.copy(), v=np.zeros(still.robot.n_v), altimeter_range=echo, health=health
        )
        control(measured, k * DT)
        why.add(AbortReason(control.memory.why))
    assert (AbortReason.FLOOR in why) is ends
    assert control.memory.height[0] < control.memory.beam.floor


def test_how_deep_the_floor_is_does_not_depend_on_where_the_world_begins(still: Scenario) -> None:
    """Before, an altimeter that the task alone names was taken for at the origin of the world."""
    robot = replace(still.robot, description=checked_copy(still.robot.description, altimeter=None))
    tasks = [
        replace(task, frame="altimeter") if task.needs_altimeter else task
        for task in still.mission.hierarchy.tasks
    ]
    mission = replace(still.mission, hierarchy=Hierarchy(tasks, [task.name for task in tasks]))
    memory = replace(still, robot=robot, mission=mission).kinematic_controller().memory
    heights = []
    for x in (0.0, 100.0):
        memory.lowest(doubles(robot.configuration(position=(x, 0.0, -9.0))), memory.height)
        heights.append(memory.height[0])
    assert heights[1] == pytest.approx(heights[0], abs=1e-9)


@pytest.mark.slow
def test_an_arm_that_works_downhill_is_not_in_the_floor() -> None:
    target = np.array([12.2025, 37.3748])
    hill = {
        "centres": target[None] - [3.0, 0.0],
        "heights": np.array([0.6]),
        "radii": np.array([6.0]),
    }
    z = -40.0 - HeightField(z=0.0, **hill).height(*target)
    scenario = case1(plant="dynamic", dt=DT, noise=True)
    environment = replace(scenario.environment, seafloor=HeightField(z=z, **hill))
    record = replace(scenario, environment=environment).run()
    assert "D" in [event.target for event in record.run_meta.events]
    assert "in the floor" not in cause_of_end(record)["text"]


def test_the_lowest_point_is_that_of_hull_joints_and_tool(still: Scenario) -> None:
    robot = still.robot
    rng = np.random.default_rng(4)
    data = robot.model.createData()
    lowest = lowest_point(robot)
    for _ in range(20):
        q = robot.configuration(
            position=(1.0, 2.0, -9.0), rpy=tuple(rng.uniform(-2.0, 2.0, 3))
        ).copy()
        q[robot.joint_q] = rng.uniform(robot.limits.position_lower, robot.limits.position_upper)
        pin.framesForwardKinematics(robot.model, data, q)
        points = [data.oMi[k].translation for k in range(2, robot.model.njoints)]
        points += [
            data.oMf[robot.frame_id("tool")].translation,
            *(data.oMi[1].act(point) for point in skid_points(robot)),
        ]
        assert float(lowest(q)) == pytest.approx(min(point[2] for point in points), abs=1e-9)
        altimeter = data.oMf[robot.frame_id("altimeter")].translation
        fallen = [point[2] + 0.3 * np.linalg.norm(point[:2] - altimeter[:2]) for point in points]
        assert float(lowest_point(robot, 0.3, "altimeter")(q)) == pytest.approx(
            min(fallen), abs=1e-9
        )


def test_an_error_that_grows_at_the_thrusters_limits_ends_the_mission_at_once(
    still: Scenario,
) -> None:
    """Within two spans of its time; not where it shrinks, hardly grows, or thrust is left to bring
    it back.
    """
    short = ActuationFeedback(short=True)
    fled = reasons(still, short, 11.0, rate=-0.05)
    assert 5.0 < first(fled) < 10.0 + 3 * DT
    assert fled[-1].startswith("runaway: PC.position_error = 1.")
    assert fled[-1].endswith("not < 0.1, and farther than 5 s ago, with thrusters at their limits")
    for feedback, rate in ((short, 0.01), (short, -0.001), (ActuationFeedback(), -0.05)):
        assert not any(reasons(still, feedback, 11.0, rate=rate))


@pytest.mark.parametrize("period", [2.0, 4.0, 7.0, 10.0])
@pytest.mark.parametrize("decay", [0.0, 0.05])
def test_an_error_that_swings_near_the_goal_does_not_run_away(
    still: Scenario, period: float, decay: float
) -> None:
    """Farther from trough to crest for seconds, with thrusters at their limits, and never farther
    than the crests before.
    """

    def swing(t: float) -> float:
        return 0.3 + 0.15 * np.exp(-decay * t) * np.sin(2 * np.pi * t / period)

    short = ActuationFeedback(short=True)
    swung = reasons(with_abort(still, thrust_after=100.0), short, 40.0, course=swing)
    assert not any(swung)


@pytest.mark.parametrize("length", [0.2, 1.0, 5.0])
def test_the_crests_of_a_swing_are_remembered_for_a_robot_of_any_size(length: float) -> None:
    """Of large robots they were forgotten before the swing was back at them: one of 40 s, of a robot
    five times as large as the shipped one, was an error that runs away.
    """
    scenario = scaled_reach("bluerov2_alpha5", length)
    period = math.sqrt(length)
    short = ActuationFeedback(short=True)
    patient = with_abort(scenario, thrust_after=1e3, stall_after=1e3)
    for swing_period in (10.0, 14.0, 18.0):

        def swing(t: float, swing_period: float = swing_period * period) -> float:
            return length * (1.0 + 0.5 * np.cos(2 * np.pi * t / swing_period))

        assert not any(reasons(patient, short, 60.0 * period, course=swing)), swing_period


def test_an_error_that_grows_as_it_swings_runs_away(still: Scenario) -> None:
    def flight(t: float) -> float:
        return 0.3 + 0.05 * np.sin(np.pi * t) + 0.1 * max(t - 10.0, 0.0)

    short = ActuationFeedback(short=True)
    fled = reasons(with_abort(still, thrust_after=100.0), short, 25.0, course=flight)
    assert 10.0 < first(fled) < 22.0
    assert fled[-1].startswith("runaway: ")


def test_a_stall_says_once_for_all_sensors_why_they_hold_it_back(still: Scenario) -> None:
    mission = with_abort(still, stall_after=1.0)
    why = "0.05 s later than its delay is said to be, allowed 0.025 s"
    late = [
        ChannelHealth(channel=name, trust=Trust.SUSPECT, why=why) for name in ("position", "depth")
    ]
    stalled = reasons(mission, ActuationFeedback(), 1.2, health=tuple(late))[-1]
    assert stalled.startswith("stall: PC.position_error = 1 not < 0.1, no nearer for 1 s; ")
    assert f"end no phase: {why} (depth, position); see to them" in stalled


@pytest.mark.parametrize(("error", "rate"), [(1.0, 0.05), (0.05, 0.0)])
def test_a_mission_that_comes_nearer_or_waits_for_nothing_is_not_stalled(
    still: Scenario, error: float, rate: float
) -> None:
    assert not any(
        reasons(
            with_abort(still, stall_after=1.0), ActuationFeedback(), 4.0, error=error, rate=rate
        )
    )
    assert any(
        reasons(with_abort(still, stall_after=1.0), ActuationFeedback(), 4.0, error=1.0, rate=0.001)
    )


@pytest.mark.parametrize("beyond", [1e-3, 30.0])
def test_a_robot_that_takes_its_joints_for_beyond_their_limits_still_climbs(
    still: Scenario, beyond: float
) -> None:
    yaw = 2.5
    q = still.robot.configuration(position=(1.0, 2.0, -9.0), rpy=(0.3, -0.4, yaw)).copy()
    q[still.robot.joint_q] = still.robot.limits.position_upper + beyond
    functions = ascent_functions(still.robot, still.mission, None)
    memory = structure_of(AscentMemory, **functions)(altitude=2.5)
    for floor, rise in ((np.nan, 2.5), (q[2] - 1.0, 1.5), (q[2] - 3.0, 0.0)):
        aim_ascent(memory, doubles(q), floor)
        goal = ascent_goal(memory)
        np.testing.assert_allclose(goal.translation - q[:3], [0.0, 0.0, rise], atol=1e-12)
        np.testing.assert_allclose(goal.rotation, pin.rpy.rpyToMatrix(0.0, 0.0, yaw), atol=1e-12)


def test_pushing_counts_only_while_a_minimum_altitude_is_asked_for(still: Scenario) -> None:
    landing = replace(still.mission, phases=still.mission.phases[2:])
    mission = with_abort(replace(still, mission=landing), contact_after=0.1)
    assert not any(reasons(mission, ActuationFeedback(push=1.0), 0.5))


class High(PassThrough):
    """An altimeter that tells 5 m too much, which nobody notices."""

    def __call__(
        self, readings: Readings, t: float, command: Command | None = None
    ) -> StateEstimate:
        measured = super().__call__(readings, t, command)
        return replace(measured, altimeter_range=measured.altimeter_range + 5.0)


def steps(scenario: Scenario, record: Record) -> float:
    """Largest change of the command in a tick, as a share of what accelerations allow."""
    change = np.abs(np.diff(record["command"], axis=0, prepend=0.0))
    return float((change / (scenario.robot.limits.acceleration * scenario.dt)).max())


@pytest.mark.slow
@long_without_compiler
def test_a_vehicle_that_its_altimeter_sends_into_the_floor_feels_it_and_climbs() -> None:
    start = pose_at((10.0, 37.5, -38.8))
    below = pose_at((10.4, 37.45, -39.9))
    scenario = replace(
        case1(dt=DT, start=start, way_point=below), estimator=lambda scenario: High(scenario.robot)
    )
    record = scenario.run()
    cause = cause_of_end(record)
    assert cause["kind"] == "aborted"
    assert cause["text"].startswith("contact or rising water: pushed up by")
    assert record["q"][-1, 2] > record["q"][:, 2].min() + 2.6
    assert steps(scenario, record) <= 1.0 + 1e-6


@long_without_compiler
def test_thrusters_at_their_limits_for_too_long_end_the_mission() -> None:
    scenario = with_abort(case1(dt=DT, current=(2.0, 0.0, 0.0)), thrust_after=1.0, time_limit=1.0)
    report = summarize(scenario.run())
    why = "thrust: the thrusters have been at their limits for 1 s (thruster1, thruster4)"
    assert not report["completed"]
    assert report["cause"] == {
        "kind": "aborted",
        "text": f"{why}; phase climb: 1 s were not enough for it",
    }
    assert report["pending"] == f"given up, {why}"
    assert report["phases"][-1]["name"] == "climb"


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(("lost", "phase"), [("altimeter_range", 2), ("joint_positions", 3)])
def test_in_water_a_lost_channel_leads_up_with_the_arm_held(
    monkeypatch: pytest.MonkeyPatch, lost: str, phase: int
) -> None:
    """The mission begins with the phase in question: landing low above the floor, the tool on its
    way.
    """
    scenario = case1(dt=DT, start=pose_at((10.7, 37.25, -39.2), (0.0, 0.0, 0.15)))
    scenario = replace(
        scenario, mission=replace(scenario.mission, phases=scenario.mission.phases[phase:])
    )
    monkeypatch.setattr(
        Scenario,
        "estimator",
        lambda self: BrokenSensors(robot=self.robot, channels=(lost,), start=2.0),
    )
    record = scenario.run()
    cause = cause_of_end(record)
    after = record["t"] > 4.0
    assert cause["text"].startswith(f"{lost} lost: broken by a test since 2.0 s")
    assert record["q"][-1, 2] > -40.0 + 3.0 - 0.35
    z = record["q"][record["t"] >= 2.0, 2]
    assert z.min() > z[0] - 0.03
    if lost == "joint_positions":
        assert np.abs(record["v"][after][:, 6:]).max() < 0.01
    assert steps(scenario, record) <= 1.0 + 1e-6


@long_without_compiler
def test_existing_missions_keep_their_reasons_to_themselves(still: Scenario) -> None:
    """What they ask of an abort is generous: Case 1 never comes near it."""
    assert isinstance(still.mission.abort, Abort)
    assert still.run().run_meta.events[-1].target == "done"

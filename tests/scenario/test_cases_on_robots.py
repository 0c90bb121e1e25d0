"""The paper's cases on the arms of other robots, and vehicles that lack an axis or an arm."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler

import uvms_ocp as uo
from uvms_ocp.campaign.run_metrics import run_metrics
from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.robot.loading import list_robots, load_robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.scenario.cases import case1, case2, obstacle_field, reach
from uvms_ocp.scenario.options import mission_of, phase_of, run_options
from uvms_ocp.scenario.preflight import Severity
from uvms_ocp.scenario.preflight.arm_reach import ArmReach
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import Alignment, MinimumAltitude, ToolPosition, VehiclePose
from uvms_ocp.types import Point

WET = [name for name in list_robots() if load_robot(name).description.thrusters]
ARMED = [name for name in WET if load_robot(name).n_joints]
CLASS = "bluerov2_alpha5"
LEANS = "bluerov2_six_alpha5"


@pytest.mark.sampled
@pytest.mark.parametrize("name", [name for name in ARMED if name != LEANS])
def test_every_arm_reaches_the_target_of_case_1(name: str) -> None:
    (finding,) = case1(robot=name).check().of_check("reachability")
    assert finding.severity is Severity.NOTE


@pytest.mark.parametrize("name", ["girona_maris7", "girona_maris7_full"])
def test_the_arm_of_the_paper_has_the_way_point_of_the_paper(name: str) -> None:
    scenario = case1(robot=name)
    assert scenario.markers["way point"] == (10.8, 37.45, -38.0)
    assert np.array_equal(scenario.robot.joint_values(scenario.start), scenario.robot.home)


@pytest.mark.slow
@pytest.mark.parametrize("name", [CLASS, "bluerov2_two_alpha5"])
@pytest.mark.parametrize("case", [case1, case2])
@pytest.mark.parametrize("current", [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (-0.2, 0.0, 0.0)])
def test_the_cases_of_the_paper_fly_on_a_small_vehicle(
    current: Point, case: Callable[..., Scenario], name: str
) -> None:
    report = uo.summarize(case(robot=name, current=current).run())
    assert report["completed"]
    assert report["tool_position_error_m"] < 1e-3


@pytest.mark.slow
def test_pre_flight_reckons_with_the_pitch_that_the_arm_gives_a_vehicle_which_no_thruster_pitches() -> (
    None
):
    scenario = case1(robot=LEANS)
    (finding,) = scenario.check().of_check("reachability")
    assert finding.severity is Severity.ERROR
    record = scenario.run()
    missing = record["quantities"][:, record.meta.quantities.index("T.position_error")].min()
    assert missing == pytest.approx(finding.figures["missing_likely_m"], abs=0.01)


def test_the_slope_of_a_reach_holds_where_the_vehicle_leans_after_its_arm() -> None:
    robot = load_robot(LEANS)
    arm = ArmReach(robot, "tool", leans=True)
    goal = uo.pose_at((0.5, 0.1, -0.3))
    stance = uo.pose_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.7))
    joints = np.array([1.0, 1.5, 0.8, 0.3])

    def error(joints: np.ndarray) -> np.ndarray:
        return arm._error(stance, goal, joints)[0]

    slope = arm._error(stance, goal, joints)[1]
    measured = np.column_stack(
        [(error(joints + h) - error(joints - h)) / 2e-5 for h in 1e-5 * np.eye(len(joints))]
    )
    assert slope == pytest.approx(measured, abs=1e-5)
    rigid = ArmReach(robot, "tool")._error(stance, goal, joints)[1]
    assert np.abs(slope - rigid).max() > 0.01


def test_case_1_asks_an_arm_of_few_joints_for_no_orientation_and_a_pose_is_refused_with_the_way_out() -> (
    None
):
    scenario = case1(robot=CLASS)
    assert not any(
        "orientation" in condition.quantity
        for phase in scenario.mission.phases
        for condition in phase.conditions
    )
    tool = uo.tasks.ToolPose(goal=uo.pose_at((12.2025, 37.3748, -39.886), (np.pi, 0.0, 0.0)))
    tasks = [tool if task.name == "T" else task for task in scenario.mission.hierarchy.tasks]
    hierarchy = uo.Hierarchy(tasks, scenario.mission.hierarchy.names)
    scenario = replace(scenario, mission=replace(scenario.mission, hierarchy=hierarchy))
    (finding,) = scenario.check().of_check("reachability")
    assert finding.severity is Severity.ERROR
    assert finding.text.endswith("ask for that, by ToolPosition, or use an arm of more joints")


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["bluerov2", "torpedo_auv"])
def test_a_vehicle_without_arm_is_refused_what_needs_one_and_swims_past_obstacles(
    name: str,
) -> None:
    with pytest.raises(
        InvalidInput, match=rf"{name} has no tool that joints move; allowed: a robot with an arm"
    ):
        case1(robot=name)
    assert obstacle_field(robot=name).check().accepted


def test_a_scenario_of_a_tool_says_how_a_robot_gets_one() -> None:
    with pytest.raises(FrameNotFound, match=r"`tool: LINK` in hydrodynamics\.yaml names it"):
        reach(robot="torpedo_auv")


PLACES = ((0.0, 0.0, -6.0), (6.0, 2.0, -8.0), (6.0, 9.0, -7.0), (-1.0, 6.0, -8.0))


def tour(**options: object) -> Scenario:
    """Way points one after the other, each with the heading of its leg: turn the bow there, then
    go.
    """
    run = run_options({"robot": "torpedo_auv", "duration": 200.0, **options}, seabed=-15.0)
    goals = []
    for place, next_place in pairwise(PLACES):
        heading = math.atan2(next_place[1] - place[1], next_place[0] - place[0])
        goals.append(uo.pose_at(next_place, (0.0, 0.0, heading)))
    aligned = uo.Below(quantity="AT.misalignment", limit=0.07)
    arrived = uo.Below(quantity="PC.position_error", limit=0.3)
    phases = []
    for k, goal in enumerate(goals):
        at = goal.translation
        phases.append(phase_of(f"T{k}", "turn", ("MAC", "AT"), f"A{k}", aligned, hold=1.0, AT=at))
        to = f"T{k + 1}" if k + 1 < len(goals) else uo.DONE
        phases.append(phase_of(f"A{k}", "swim", ("MAC", "AT", "PC"), to, arrived, PC=goal, AT=at))
    tasks = [MinimumAltitude(), Alignment(goal=goals[0].translation), VehiclePose(goal=goals[0])]
    return run.scenario(
        name="tour",
        mission=mission_of(run.robot, tasks, phases),
        start=run.start(uo.pose_at(PLACES[0])),
        markers={},
    )


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(
    "options",
    [
        {},
        *(
            pytest.param(given, marks=pytest.mark.slow)
            for given in ({"current": (0.1, -0.1, 0.0)}, {"noise": True})
        ),
    ],
)
def test_a_torpedo_flies_way_points_that_lie_anywhere(options: dict[str, object]) -> None:
    scenario = tour(**options)
    report = scenario.check()
    assert report.accepted
    (note,) = report.of_check("axes without thrust")
    assert note.text == "no thruster drives sway, roll: PC ask for the other axes alone"
    record = scenario.run()
    assert record.run_meta.completed
    tilt = [pin.rpy.matrixToRpy(pin.Quaternion(q).matrix())[:2] for q in record.series["q"][:, 3:7]]
    assert np.abs(tilt).max() < 0.2


def test_a_torpedo_is_refused_a_goal_beside_it_that_it_does_not_turn_to() -> None:
    run = run_options({"robot": "torpedo_auv"}, seabed=-15.0)
    arrived = uo.Below(quantity="PC.position_error", limit=0.3)
    phases = [
        phase_of("A", "ahead", ("MAC", "PC"), "B", arrived, PC=uo.pose_at((4.0, 0.0, -6.0))),
        phase_of("B", "beside", ("MAC", "PC"), uo.DONE, arrived, PC=uo.pose_at((6.0, 2.0, -6.0))),
    ]
    tasks = [MinimumAltitude(), VehiclePose(goal=uo.pose_at((4.0, 0.0, -6.0)))]
    start = run.start(uo.pose_at((0.0, 0.0, -6.0)))
    report = run.scenario(
        name="beside", mission=mission_of(run.robot, tasks, phases), start=start, markers={}
    ).check()
    (finding,) = (
        candidate for candidate in report.of_check("forces") if candidate.severity is Severity.ERROR
    )
    assert finding.phase == "B"
    assert "2.00 m beside where the vehicle is then, and no thruster drives sway" in finding.text


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["both", "first"])
def test_a_summary_has_the_errors_of_every_tool_by_its_name(kind: str) -> None:
    run = run_options(
        {"robot": "bluerov2_two_alpha5", "plant": "kinematic", "duration": 0.5}, seabed=-15.0
    )
    goals = {"port_tool": (0.6, 0.1, -6.1), "starboard_tool": (0.9, -0.1, -6.3)}
    used = dict(list(goals.items())[: 1 if kind == "first" else 2])
    tasks = [
        ToolPosition(name=f"TP{k}", frame=tool, goal=uo.pose_at(goal))
        for k, (tool, goal) in enumerate(used.items())
    ]
    never = uo.Below(quantity="TP0.position_error", limit=1e-9)
    phase = phase_of("A", "reach", [task.name for task in tasks], uo.DONE, never)
    start = run.start(uo.pose_at((0.0, 0.0, -6.0)))
    scenario = run.scenario(
        name="both", mission=mission_of(run.robot, tasks, [phase]), start=start, markers={}
    )
    ball = obstacle("ball", coal.Sphere(0.1), (0.7, -0.6, -6.2))
    scenario = replace(scenario, environment=replace(scenario.environment, obstacles=(ball,)))
    record = scenario.run()
    figures = run_metrics(scenario, record)
    report = uo.summarize(record)
    end = uo.Kinematics(run.robot, record.series["q"][-1])
    assert list(report["tools"]) == list(used)
    for tool, goal in used.items():
        error = np.linalg.norm(end.pose(tool).translation - goal)
        assert report["tools"][tool] == {
            "position": pytest.approx(error, abs=2e-3),
            "orientation": None,
        }
    assert report["tool_position_error_m"] == report["tools"]["port_tool"]["position"]
    assert ("starboard_tool: position error" in str(report)) == (kind == "both")
    for tool in goals:
        assert figures[f"tool_position_error_m[{tool}]"] == report["tools"].get(tool, {}).get(
            "position"
        )
    near_clearance, far_clearance = (
        figures[f"clearance_m[{tool}]"] for tool in ("starboard_tool", "port_tool")
    )
    assert figures["clearance_m"] <= near_clearance
    assert far_clearance > near_clearance + 0.1


@pytest.mark.parametrize(
    ("current", "accepted"),
    [((0.2, 0.0, 0.0), True), ((0.0, 0.02, 0.0), True), ((0.0, 0.2, 0.0), False)],
)
def test_a_current_that_carries_a_vehicle_where_no_thruster_drives_it_is_refused(
    current: tuple[float, float, float], accepted: bool
) -> None:
    run = run_options({"robot": "torpedo_auv", "current": current}, seabed=-15.0)
    goal = uo.pose_at((4.0, 0.0, -6.0))
    phase = phase_of(
        "A", "ahead", ("MAC", "PC"), uo.DONE, uo.Below(quantity="PC.position_error", limit=0.3)
    )
    mission = mission_of(run.robot, [MinimumAltitude(), VehiclePose(goal=goal)], [phase])
    report = run.scenario(
        name="ahead", mission=mission, start=run.start(uo.pose_at((0.0, 0.0, -6.0))), markers={}
    ).check()
    assert report.accepted == accepted
    assert accepted or "1.60 m along sway, and no thruster drives that" in report.errors[0].text

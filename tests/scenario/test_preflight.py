"""Pre-flight: what cannot work is refused with figures before anything moves."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.robot.signals import SensorSpecs
from uvms_ocp.robot.static_balance import with_trim
from uvms_ocp.scenario.cases.case1 import case1, case1_unreachable
from uvms_ocp.scenario.cases.transit import FIELD, obstacle_field
from uvms_ocp.scenario.options import mission_of, phase_of, run_options
from uvms_ocp.scenario.preflight.findings import Finding, PreflightReport, Severity
from uvms_ocp.scenario.preflight.phase_forecast import forecast, main_path
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.tasks import VehiclePose


def with_phases(scenario: Scenario, phases: Sequence[Phase]) -> Scenario:
    return replace(scenario, mission=replace(scenario.mission, phases=tuple(phases)))


def activations(scenario: Scenario, phase: str, **changes: float) -> Scenario:
    phases = [
        replace(item, activations={**item.activations, **changes}) if item.name == phase else item
        for item in scenario.mission.phases
    ]
    return with_phases(scenario, phases)


def texts(report: PreflightReport, severity: Severity) -> str:
    return " | ".join(finding.text for finding in report.findings if finding.severity is severity)


@pytest.fixture(scope="module")
def refused() -> PreflightReport:
    return case1_unreachable(plant="kinematic").check()


@pytest.mark.sampled
@pytest.mark.parametrize("plant", ["kinematic", "dynamic"])
def test_case_1_is_accepted_without_a_warning(plant: str) -> None:
    report = case1(plant=plant).check()
    assert report.accepted
    assert not report.warnings


def test_a_vehicle_that_rests_on_its_side_is_told_by_how_much() -> None:
    level = case1(robot=load_robot("girona_maris7"), plant="dynamic")
    lead = TrimBody(name="lead", mass=8.0, volume=0.0, position=(0.0, 0.8, 0.0))
    listing = replace(level, robot=with_trim(level.robot, [lead]))
    (finding,) = listing.check().of_check("attitude at rest")
    assert finding.severity is Severity.WARNING
    assert 0.1 < abs(finding.figures["roll_rad"]) == pytest.approx(finding.figures["tilt_rad"])
    assert "HA is on, and its goal" in finding.text


def test_a_mission_that_waits_for_less_tilt_than_there_will_be_is_refused() -> None:
    level = case1(robot=load_robot("girona_maris7"), plant="dynamic")
    lead = TrimBody(name="lead", mass=8.0, volume=0.0, position=(0.0, 0.8, 0.0))
    first, *later_phases = level.mission.phases
    wait = Transition(to=later_phases[0].name, when=(Below(quantity="HA.tilt", limit=0.05),))
    waiting = with_phases(level, (replace(first, transitions=(wait,)), *later_phases))
    (finding,) = (
        replace(waiting, robot=with_trim(level.robot, [lead])).check().of_check("attitude at rest")
    )
    assert (finding.severity, finding.phase) == (Severity.ERROR, first.name)


@pytest.mark.slow
def test_an_unreachable_goal_is_refused_with_the_distance_missing(refused: PreflightReport) -> None:
    (finding,) = refused.errors
    assert finding.check == "reachability"
    assert (
        0.15 < finding.figures["missing_best_m"] < 0.35 < finding.figures["missing_worst_m"] < 0.45
    )
    assert "misses the goal" in finding.text


def test_the_distances_agree_with_an_independent_optimum(refused: PreflightReport) -> None:
    """Random search polished by Nelder-Mead on the tool error, from the two ends of the ball of the
    way point.
    """
    scenario = case1_unreachable(plant="kinematic")
    target = np.array([12.2025, 37.3748, -39.886])
    way_point = np.array([10.2, 37.5])
    towards = (target[:2] - way_point) / np.linalg.norm(target[:2] - way_point)
    figures = refused.errors[0].figures
    for sign, key in ((1.0, "missing_best_m"), (-1.0, "missing_worst_m")):
        xy = way_point + sign * 0.1 * towards
        yaw = float(np.arctan2(*(target[:2] - xy)[::-1]))
        independent = independent_optimum(scenario, pose_at((*xy, -39.5), (0.0, 0.0, yaw)), target)
        assert figures[key] == pytest.approx(independent, rel=0.1)


def independent_optimum(scenario: Scenario, X_WB: pin.SE3, target: np.ndarray) -> float:
    """Position distance missing [m] at the best posture found."""
    robot = scenario.robot
    model = robot.model
    data = robot.model.createData()
    frame = robot.frame_id("tool")
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    base = pin.SE3ToXYZQUAT(X_WB)
    goal = pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0)

    def error(joints: np.ndarray) -> tuple[float, float]:
        q = np.concatenate([base, np.clip(joints, lower, upper)])
        pin.framesForwardKinematics(model, data, q)
        X = data.oMf[frame]
        return np.linalg.norm(X.translation - target), np.linalg.norm(pin.log3(goal.T @ X.rotation))

    def cost(joints: np.ndarray) -> float:
        return float(np.hypot(*error(joints)))

    rng = np.random.default_rng(3)
    samples = rng.uniform(lower, upper, (3000, 7))
    best = sorted(samples, key=cost)[:5]
    options = {"maxiter": 2500, "adaptive": True, "xatol": 1e-6, "fatol": 1e-8}
    polished = [minimize(cost, start, method="Nelder-Mead", options=options).x for start in best]
    return float(error(min(polished, key=cost))[0])


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("start_x", "severity", "completes"),
    [(8.5, Severity.ERROR, False), (13.5, Severity.WARNING, True)],
)
def test_the_side_from_which_the_vehicle_comes_decides(
    start_x: float, severity: Severity, completes: bool
) -> None:
    """It stops where it enters the ball of its way point: near enough coming over the target, too
    far from behind.
    """
    options = {
        "way_point": pose_at((10.53, 37.47, -38.0)),
        "start": pose_at((start_x, 37.4, -37.0)),
    }
    scenario = case1(plant="kinematic", dt=0.02, duration=60.0, **options)
    (finding,) = scenario.check().of_check("reachability")
    assert finding.severity is severity
    assert finding.figures["missing_best_m"] < 1e-3 < finding.figures["missing_worst_m"]
    assert scenario.run().meta.completed is completes


def test_the_suggested_way_point_is_accepted(refused: PreflightReport) -> None:
    suggested = refused.errors[0].figures["suggested_way_point"]
    assert (
        case1(plant="kinematic", way_point=pose_at(tuple(suggested), (0.0, -0.06, 0.5)))
        .check()
        .accepted
    )


def test_a_seabed_at_39_m_keeps_the_vehicle_out_of_its_way_point() -> None:
    report = case1(plant="kinematic", seabed=-39.0, target=(12.2025, 37.3748, -38.886)).check()
    (finding,) = report.of_check("minimum altitude")
    assert finding.severity is Severity.ERROR
    assert finding.figures["kept_away_m"] == pytest.approx(0.33, abs=0.01)
    assert "outside the ball of 0.1 m" in finding.text


@pytest.mark.slow
def test_a_seabed_above_the_goals_is_refused_for_every_cause() -> None:
    report = case1(seabed=-39.0).check()
    assert {finding.check for finding in report.errors} >= {"minimum altitude", "goal"}
    (goal,) = report.of_check("goal")
    assert goal.phase == "D"
    assert goal.text.startswith(
        "the goal of T, z = -39.886 m, is 0.89 m below the seafloor, z = -39 m"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "task"),
    [({"way_point": pose_at((10.0, 37.0, -41.0))}, "PC"), ({"target": (12.0, 37.0, -40.5)}, "T")],
)
def test_a_goal_below_the_floor_is_refused(options: dict[str, Any], task: str) -> None:
    (finding,) = case1(plant="kinematic", **options).check().of_check("goal")
    assert finding.severity is Severity.ERROR
    assert f"the goal of {task}" in finding.text


@pytest.mark.slow
def test_a_moving_goal_that_dives_below_the_floor_is_refused() -> None:
    def dive(t: float) -> tuple[pin.SE3, np.ndarray]:
        return pose_at((12.2, 37.37, -39.8 - 0.1 * t), (np.pi, 0.0, 0.0)), np.array(
            [0, 0, -0.1, 0, 0, 0]
        )

    assert "below the seafloor" in texts(
        case1(plant="kinematic", tool_goal=dive).check(), Severity.ERROR
    )


def test_a_way_point_a_little_below_the_minimum_altitude_is_a_warning() -> None:
    report = case1(plant="kinematic", way_point=pose_at((10.8, 37.45, -38.72))).check()
    assert report.accepted
    assert "MAC keeps the vehicle 0.05 m above" in texts(report, Severity.WARNING)


def test_a_current_beyond_the_thrusters_is_refused() -> None:
    assert case1(current=(0.5, 0.0, 0.0)).check().accepted
    report = case1(current=(2.5, 0.0, 0.0)).check()
    (finding,) = (
        candidate for candidate in report.of_check("forces") if candidate.severity is Severity.ERROR
    )
    axes = re.findall(r"(\d+) N(?: m)? of (surge|sway|heave|roll|pitch|yaw)", finding.text)
    assert {"surge"} <= {axis for _, axis in axes}
    assert np.hypot.reduce([float(short) for short, _ in axes]) == pytest.approx(
        finding.figures["missing_N"], abs=2.0
    )


def test_what_drag_makes_up_for_is_told_and_not_refused_and_the_vehicle_gives_way_as_slowly_as_is_said() -> (
    None
):
    def held(speed: float, **options: Any) -> Scenario:
        run = run_options(
            {"robot": "bluerov2", "current": (speed, 0.0, 0.0), "duration": 30.0, **options},
            seabed=-15.0,
        )
        never = Below(quantity="PC.position_error", limit=1e-9)
        phase = phase_of("A", "hold", ("PC",), DONE, never, PC=pose_at((0.0, 0.0, -6.0)))
        mission = mission_of(run.robot, [VehiclePose(goal=pose_at((0.0, 0.0, -6.0)))], [phase])
        return run.scenario(
            name="held", mission=mission, start=run.start(pose_at((0.0, 0.0, -6.0))), markers={}
        )

    def forces(speed: float) -> Finding:
        return next(
            candidate
            for candidate in held(speed).check().of_check("forces")
            if "missing_N" in candidate.figures
        )

    enough = 0.1
    short = 4.0
    while short - enough > 1e-4:
        middle = 0.5 * (enough + short)
        enough, short = (
            (enough, middle)
            if "more than the thrusters give" in forces(middle).text
            else (middle, short)
        )
    assert forces(short).severity is Severity.WARNING
    assert "gives way by at most 5 mm/s" in forces(short).text
    assert forces(1.05 * short).severity is Severity.ERROR
    record = held(short).run()
    assert np.abs(record.series["v"][-1000:, :3]).max() < 5e-3


def test_a_current_on_the_plant_without_water_is_a_warning() -> None:
    report = case1(plant="kinematic", current=(0.2, 0.0, 0.0)).check()
    assert report.accepted
    assert "ignores the current of 0.2 m/s" in texts(report, Severity.WARNING)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("x", "place"), [(0.3, "the start"), (11.2, "the place where the vehicle is likeliest to stop")]
)
def test_an_obstacle_where_the_robot_stands_is_refused(x: float, place: str) -> None:
    around = (*FIELD, obstacle("rock", coal.Sphere(0.3), (x, 0.0, -37.0)))
    (finding,) = obstacle_field(plant="kinematic", obstacles=around).check().of_check("obstacles")
    assert finding.severity is Severity.ERROR
    assert finding.text.startswith(place)
    assert "rock - " in finding.text
    assert not obstacle_field(plant="kinematic").check().of_check("obstacles")


@pytest.mark.slow
def test_standing_still_and_going_to_a_way_point_at_once_is_a_contradiction() -> None:
    report = activations(case1(plant="kinematic"), "A", NR=1.0).check()
    assert "PC is on but has no freedom left" in texts(report, Severity.ERROR)


def test_landing_below_the_minimum_altitude_is_a_contradiction() -> None:
    report = activations(case1(plant="kinematic"), "C", MAC=1.0).check()
    assert "LA aims at 0.15 m while MAC keeps 1 m" in texts(report, Severity.ERROR)


def test_a_phase_in_which_nothing_acts_is_refused() -> None:
    report = activations(case1(plant="kinematic"), "A", PC=0.0).check()
    assert "phase 'A' has no acting task" in texts(report, Severity.ERROR)


def test_a_phase_that_waits_for_a_task_that_is_off_is_a_warning() -> None:
    report = activations(case1(plant="kinematic"), "C", AT=0.0).check()
    assert "waits for AT.misalignment, but task AT is off" in texts(report, Severity.WARNING)


def test_a_phase_that_nothing_leads_to_is_a_warning_and_one_without_exit_an_error() -> None:
    scenario = case1(plant="kinematic")
    lost = Phase(
        name="X",
        activations={"PC": 1.0},
        transitions=(Transition(to="X", when=(Below(quantity="HA.tilt", limit=1.0),)),),
    )
    report = with_phases(scenario, (*scenario.mission.phases, lost)).check()
    assert "no transition leads to phase 'X'" in texts(report, Severity.WARNING)
    assert "cannot end from phase 'X'" in texts(report, Severity.ERROR)


def test_a_start_below_the_minimum_altitude_is_a_warning() -> None:
    report = case1(plant="kinematic", start=pose_at((8.5, 38.5, -39.2))).check()
    assert "below MAC's 1 m" in texts(report, Severity.WARNING)


def test_the_forecast_of_the_landing_is_where_the_vehicle_lands() -> None:
    """Against a run: the likeliest place, much nearer than the ball of the way point is wide."""
    scenario = case1(plant="kinematic")
    record = scenario.run()
    landed = record["q"][-1]
    stances = forecast(scenario.setup())[-1].stances
    positions = np.array([stance.position for stance in stances])
    assert np.linalg.norm(positions[0, :2] - landed[:2]) < 0.03
    assert positions[0, 2] == pytest.approx(landed[2], abs=0.01)
    yaw = float(pin.rpy.matrixToRpy(pin.Quaternion(landed[3:7]).matrix())[2])
    assert stances[0].yaw == pytest.approx(yaw, abs=0.1)


def test_the_main_path_skips_back_steps() -> None:
    def phase(name: str, *targets: str) -> Phase:
        nearly_level = (Below(quantity="HA.tilt", limit=1.0),)
        return Phase(
            name=name,
            activations={},
            transitions=tuple(Transition(to=to, when=nearly_level) for to in targets),
        )

    assert main_path([phase("A", "B"), phase("B", "A", "C"), phase("C", "A", DONE)]) == [0, 1, 2]


def test_a_report_is_json() -> None:
    report = case1(plant="kinematic").check().to_dict()
    assert json.loads(json.dumps(report)) == report


def test_checks_do_not_depend_on_the_solver_or_leave_traces() -> None:
    scenario = case1(plant="kinematic")
    before: Mission = scenario.mission
    first: dict[str, Any] = scenario.check().to_dict()
    assert scenario.check().to_dict() == first
    assert scenario.mission is before


def late(**delays: float) -> Scenario:
    """Case 1 whose sensors are late by so much [s], as everybody knows."""
    specs = {
        name: replace(getattr(SensorSpecs(), name), delay=delay) for name, delay in delays.items()
    }
    return replace(case1(), sensors=replace(SensorSpecs(), **specs))


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("delays", "severity"),
    [
        ({}, None),
        ({"linear_velocity": 1.0, "position": 1.0, "depth": 1.0}, None),
        ({"joint_positions": 0.15, "angular_velocity": 0.15, "attitude": 0.15}, None),
        ({"joint_positions": 0.2}, Severity.WARNING),
        ({"joint_positions": 0.3}, Severity.ERROR),
        ({"angular_velocity": 0.5, "attitude": 0.5}, Severity.ERROR),
    ],
    ids=str,
)
def test_delays_that_the_loops_do_not_bear_are_told(
    delays: dict[str, float], severity: Severity | None
) -> None:
    findings = late(**delays).check().of_check("delays")
    assert [finding.severity for finding in findings] == ([] if severity is None else [severity])
    for finding in findings:
        assert (
            f"{finding.figures['delay_s']:.3g} s late, allowed {finding.figures['allowed_s']:.2g} s"
            in finding.text
        )
        assert finding.figures["allowed_s"] < finding.figures["swings_from_s"]


@pytest.mark.slow
def test_what_is_refused_for_its_delays_swings_and_what_is_allowed_does_not() -> None:
    allowed = late(joint_positions=0.3).check().of_check("delays")[0].figures["allowed_s"]
    calm, wild = (
        replace(late(joint_positions=delay), duration=8.0).run() for delay in (0.99 * allowed, 0.5)
    )
    joints = [np.abs(record["v"][-600:, 6:]).max() for record in (calm, wild)]
    assert joints[0] < 0.1 < 0.5 < joints[1]


def test_the_plant_of_velocities_and_a_controller_of_ones_own_have_no_loops_to_judge() -> None:
    assert not replace(late(joint_positions=0.5), plant="kinematic").check().of_check("delays")

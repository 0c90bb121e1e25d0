"""Pre-flight and the check of a robot know what a valid file can leave out, and say whose it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from tiny_robots import (
    LEVEL,
    OPEN,
    STANDING,
    TINY,
    WEIGHTLESS,
    Tiny,
    heading_with_roll,
    robot_of,
    scenario_of,
)

from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.limits import ASSUMED_ACCELERATION, ASSUMED_VELOCITY
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import with_trim
from uvms_ocp.robot.thrusters import largest_wrench
from uvms_ocp.scenario.options import abort_phase
from uvms_ocp.scenario.preflight.findings import Severity
from uvms_ocp.scenario.preflight.robot_check import check_robot
from uvms_ocp.scenario.scenario import Scenario


def _said(scenario: Scenario) -> str:
    return "\n".join(
        f"{finding.severity.value}: {finding.text}" for finding in scenario.check().findings
    )


def test_a_hull_that_starts_in_the_floor_is_refused_with_the_link_that_is_lowest() -> None:
    robot = robot_of(STANDING)
    scenario = scenario_of(robot, "dynamic")
    assert "error: the hull starts 1.10 m inside the floor, lowest with link stand" in _said(
        scenario
    )
    assert not scenario.check().accepted
    above = scenario_of(robot_of(TINY["one wet link"]), "dynamic")
    assert "inside the floor" not in _said(above)


def test_a_link_that_moves_without_inertia_is_refused_by_name() -> None:
    robot = robot_of(WEIGHTLESS)
    text = "no inertia about its axis: link propeller behind joint 'propeller_joint'"
    assert f"error: {text}" in _said(scenario_of(robot, "dynamic"))
    assert text not in _said(scenario_of(robot, "kinematic"))  # which moves nothing by forces
    assert any(text in finding.text for finding in check_robot(robot).findings)


def test_an_inertia_of_no_body_is_refused_by_the_mission_as_by_the_check_of_the_robot() -> None:
    robot = robot_of(TINY["one wet link"])
    model = robot.model.copy()
    model.inertias[1] = pin.Inertia(20.0, np.zeros(3), np.diag([1.0, 1.0, 5.0]))
    robot = replace(robot, model=model)
    assert not check_robot(robot).usable
    scenario = scenario_of(robot, "dynamic")
    assert "error: link" in _said(scenario)
    assert "principal moments 1 1 5 kg m2" in _said(scenario)
    assert not scenario.check().accepted
    assert scenario_of(robot, "kinematic").check().of_check("inertia") == ()


@pytest.mark.parametrize("plant", ["dynamic", "kinematic"])
def test_a_z_axis_that_points_down_is_told_by_the_mission_as_by_the_check_of_the_robot(
    plant: str,
) -> None:
    robot = robot_of(TINY["one wet link"])
    model = robot.model.copy()
    above = pin.SE3(np.eye(3), np.array([0.0, 0.0, 5.0]))
    model.addFrame(pin.Frame("rov_dvl", 1, 1, above, pin.FrameType.BODY))
    robot = replace(robot, model=model)
    text = "does z point down? rov_dvl would be on top of the hull"
    assert any(text in finding.text for finding in check_robot(robot).findings)
    assert f"warning: {text}" in _said(scenario_of(robot, plant))


def test_joints_without_limits_are_given_those_of_a_published_arm_which_is_said_once() -> None:
    robot = robot_of(OPEN)
    np.testing.assert_array_equal(robot.limits.velocity[6:], ASSUMED_VELOCITY)
    np.testing.assert_array_equal(robot.limits.acceleration[6:], ASSUMED_ACCELERATION)
    assert (
        _said(scenario_of(robot, "dynamic")).count(
            "no limit of velocity or effort for joint turn0, turn1"
        )
        == 1
    )
    told = [finding for finding in check_robot(robot).findings if "Gao2022" in finding.text]
    assert len(told) == 1


def test_what_a_file_limits_stays_as_it_is() -> None:
    robot = robot_of(TINY["endless and not"])
    np.testing.assert_array_equal(robot.limits.velocity[6:], 0.7)
    assert np.isinf(robot.limits.acceleration[6:]).all()


def test_a_joint_without_range_is_held_and_named() -> None:
    robot = robot_of(TINY["a joint without range"])
    assert "joint sonar_joint has no range" in _said(scenario_of(robot, "dynamic"))
    record = scenario_of(robot, "kinematic", duration=2.0).run()
    np.testing.assert_allclose(record["q"][:, -1], 0.0, atol=1e-12)


@pytest.mark.sampled
@pytest.mark.parametrize(("depth", "refused"), [(5.0, False), (6.0, True)])
def test_a_vehicle_that_nothing_drives_up_or_down_is_refused_a_goal_at_another_depth(
    depth: float, refused: bool
) -> None:
    scenario = scenario_of(robot_of(TINY["no lift"]), "dynamic", depth=depth)
    assert ("no thruster drives heave" in _said(scenario)) == refused
    with_lift = scenario_of(robot_of(TINY["one wet link"]), "dynamic", depth=depth)
    assert "no thruster drives heave" not in _said(with_lift)


def _lift_ahead(lead: float) -> Robot:
    """Return a vehicle whose lift comes with a pitch, from a single thruster 1 m ahead, in trim but for
    lead [kg].
    """
    near = tuple((x / 2, y / 2, z, u, v, w) for x, y, z, u, v, w in LEVEL)
    thrusters = (*near, *near, *near, (1.0, 0.0, 0.0, 0, 0, 1))
    robot = robot_of(Tiny(joints=(), thrusters=thrusters, in_trim=True))
    if lead == 0.0:
        return robot
    body = TrimBody(name="lead", position=(0.0, 0.0, 0.0), mass=lead, volume=0.0)
    return with_trim(robot, [body])


@pytest.mark.parametrize(("lead", "refused"), [(0.0, False), (0.003, False), (0.01, True)])
def test_a_goal_up_or_down_is_refused_where_weight_does_not_hold_the_vehicle_near_it(
    lead: float, refused: bool
) -> None:
    """Weight bears the pitch that comes with its lift: it arrives, and was refused as though nothing
    lifted it. Out of trim it comes to rest elsewhere.
    """
    scenario = scenario_of(_lift_ahead(lead), "dynamic", depth=5.5)
    (severity,) = (
        finding.severity
        for finding in scenario.check().findings
        if "PC waits for a goal 0.50 m above or below" in finding.text
    )
    assert severity is (Severity.ERROR if refused else Severity.WARNING)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("thrusters", "said"),
    [
        ((*LEVEL, (0.0, 0.2, 0.1, 0, 0, 1), (0.0, -0.2, 0.1, 0, 0, 1)), ""),
        ((*LEVEL, (0.2, 0.2, 0.1, 0, 0, 1), (-0.2, -0.2, 0.1, 0, 0, 1)), ""),
        (
            ((0.0, 0.0, 0.0, 1, 0, 0), (0.0, 0.0, 0.0, 0, 1, 0), (0.0, 0.0, 0.0, 0, 0, 1)),
            "no thruster drives yaw, and nothing rights it",
        ),
        (heading_with_roll(0.3), ""),
        (heading_with_roll(0.9), ""),
        (heading_with_roll(-0.9), ""),
        (
            heading_with_roll(1.1),
            "no thruster drives roll, which takes 1.1 rad of yaw along for each of its own: they are no two axes",
        ),
    ],
)
def test_free_motions_that_weight_rights_are_accepted_and_others_refused(
    thrusters: tuple[tuple[float, ...], ...], said: str
) -> None:
    findings = (
        scenario_of(robot_of(Tiny(thrusters=thrusters)), "dynamic")
        .check()
        .of_check("axes without thrust")
    )
    errors = " ".join(finding.text for finding in findings if finding.severity is Severity.ERROR)
    assert said in errors
    assert bool(errors) == bool(said)


def test_nothing_is_divided_by_a_lift_that_is_not_there() -> None:
    robot = robot_of(TINY["no lift"])
    assert largest_wrench(robot)[2] == 0.0
    tilted = tuple((x, y, z, 1.0, 0.0, 1e-9) for x, y, z, *_ in TINY["no lift"].thrusters)
    assert largest_wrench(robot_of(Tiny(thrusters=tilted)))[2] == 0.0


@pytest.mark.slow
def test_without_lift_no_push_is_taken_for_contact() -> None:
    scenario = scenario_of(robot_of(TINY["no lift"]), "dynamic", duration=6.0)
    mission = replace(scenario.mission, abort=abort_phase("JL", "MP"))
    record = replace(scenario, mission=mission).run()
    assert not [alarm.text for alarm in record.run_meta.alarms if "pushed up" in alarm.text]
    assert float(record["t"][-1]) > 5.0

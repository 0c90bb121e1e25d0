"""Pre-flight and the check of a robot call nothing good that is wrong, whatever a search says."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler

from uvms_ocp.robot.limits import from_joint_values
from uvms_ocp.robot.loading import load_robot, robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.preflight.arm_reach import REACHED, ArmReach, ReachResult
from uvms_ocp.scenario.preflight.robot_check import RobotVerdict, check_robot_files
from uvms_ocp.scenario.scenario import Scenario

ROBOT = "bluerov2_alpha5"
HOMES = (3.05, 1.6, 0.6, 0.0)  # [rad] of its joints


@long_without_compiler
def test_a_time_limit_that_cannot_be_kept_is_told_and_one_that_was_kept_is_not() -> None:
    def told(scenario: Scenario) -> bool:
        return bool(scenario.check().of_check("time"))

    scenario = case1(plant="kinematic", dt=0.02)
    record = scenario.run()
    assert record.run_meta.completed
    flown = float(record["t"][-1])
    assert not told(replace(scenario, duration=flown))
    (finding,) = replace(scenario, duration=2.0).check().of_check("time")
    assert 2.0 < finding.figures["least_s"] < flown
    assert not replace(scenario, duration=2.0).run().run_meta.completed


def missing(robot: Robot, X_WB: pin.SE3, goal: pin.SE3, joints: np.ndarray) -> float:
    """[m, rad] of the tool from a goal, by Pinocchio alone."""
    q = pin.neutral(robot.model)
    q[:7] = pin.SE3ToXYZQUAT(X_WB)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, from_joint_values(robot.model, joints, q))
    error = pin.log6(data.oMf[robot.frame_id("tool")].actInv(goal))
    return float(max(np.linalg.norm(error.linear), np.linalg.norm(error.angular)))


@pytest.mark.sampled
@pytest.mark.parametrize("lies", [False, True])
def test_a_goal_is_reached_by_the_posture_that_is_given_whatever_the_search_says(
    lies: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot(ROBOT)
    rng = np.random.default_rng(0)
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    if lies:
        anywhere = lambda *_: lower + (upper - lower) * rng.random(len(lower))  # noqa: E731
        monkeypatch.setattr(ArmReach, "_minimise", anywhere)
    reach = ArmReach(robot, "tool")
    X_WB = pin.SE3(np.eye(3), np.array([1.0, 2.0, -3.0]))
    n_reached = 0
    for _ in range(20):
        posture = lower + (upper - lower) * rng.random(len(lower))
        q = pin.neutral(robot.model)
        q[:7] = pin.SE3ToXYZQUAT(X_WB)
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, from_joint_values(robot.model, posture, q))
        result: ReachResult = reach.solve(X_WB, data.oMf[robot.frame_id("tool")].copy())
        goal = data.oMf[robot.frame_id("tool")].copy()
        is_inside = bool(((lower <= result.joints) & (result.joints <= upper)).all())
        if result.reached:
            n_reached += 1
            assert is_inside
            assert missing(robot, X_WB, goal, result.joints) < 1.5 * REACHED
    assert n_reached == 0 if lies else n_reached > 10


def changed(
    folder: Path, file: str, pattern: str, new: str | Callable[[re.Match[str]], str]
) -> Path:
    """A copy of the robot's files in which what matches is another text."""
    copy = folder / "robot"
    shutil.copytree(robot_folder(ROBOT), copy)
    text = (copy / file).read_text(encoding="utf-8")
    new_text = re.sub(pattern, new, text)
    assert new_text != text
    (copy / file).write_text(new_text, encoding="utf-8")
    return copy


def held(width: float) -> Callable[[re.Match[str]], str]:
    """Limits in which joints stay at home."""
    joint = count()

    def limit(match: re.Match[str]) -> str:
        home = HOMES[next(joint)]
        return f'<limit lower="{home - width}" upper="{home + width}"'

    return limit


LIMITS = '<limit lower="[^"]*" upper="[^"]*"'
WRONG = {
    "an inertia that no body has": ("robot.urdf", 'ixx="0.26"', 'ixx="26"', "inertias"),
    "no velocity": ("robot.urdf", 'velocity="[^"]*"', 'velocity="0"', "limits"),
    "no force": ("robot.urdf", 'effort="[^"]*"', 'effort="0"', "limits"),
    "a hull that is too light": ("hydrodynamics.yaml", "volume: 0.0134", "volume: 0.02", "trim"),
    "joints without a range": ("robot.urdf", LIMITS, held(0.0), "joints"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_robot_file_with_one_thing_wrong_is_not_called_ok_for_it(
    fault: str, tmp_path: Path
) -> None:
    file, pattern, new, subject = WRONG[fault]
    sound = check_robot_files(robot_folder(ROBOT))
    broken = check_robot_files(changed(tmp_path, file, pattern, new))

    def doubts(report: object) -> int:
        n_doubts = 0
        for finding in report.findings:  # type: ignore[attr-defined]
            is_good = finding.verdict is RobotVerdict.GOOD
            n_doubts += finding.subject == subject and not is_good
        return n_doubts

    assert sound.usable
    assert doubts(broken) > doubts(sound)


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("width", [0.0, 1e-3])
def test_a_mission_with_an_arm_that_is_locked_is_refused(width: float, tmp_path: Path) -> None:
    robot = load_robot(changed(tmp_path, "robot.urdf", LIMITS, held(width)))
    report = case1(robot=robot, plant="kinematic").check()
    assert not report.accepted
    assert any(error.check == "reachability" for error in report.errors)

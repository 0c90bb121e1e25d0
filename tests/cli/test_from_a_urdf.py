"""From a stranger's URDF to a mission that is accepted, without a line edited: arms none to two,
thrusters all, some or none.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp import OcpRequest, solve_ocp
from uvms_ocp.planning import CoalDistances, PostureGoal, collision_scene, coordinates
from uvms_ocp.planning.request import PlanRequest, plan_path
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.static_balance import static_residual

BODY = (
    "<inertial>{at}<mass value='{m}'/><inertia ixx='{i}' ixy='0' ixz='0' iyy='{i}' iyz='0'"
    " izz='{i}'/></inertial>"
)


def link(name: str, mass: float, at: str = "<origin xyz='0.15 0 0'/>", shape: str = "") -> str:
    return (
        "<link"
        f" name='{name}'>{BODY.format(m=mass, i=0.01 * mass, at=at) if mass else ''}{shape}</link>"
    )


def joint(parent: str, child: str, kind: str, xyz: str, axis: str = "0 1 0") -> str:
    limit = (
        "<limit lower='-1.5' upper='1.5' velocity='0.7' effort='9'/>" if kind == "revolute" else ""
    )
    return (
        f"<joint name='{child}_joint' type='{kind}'><parent link='{parent}'/><child"
        f" link='{child}'/><origin xyz='{xyz}'/><axis xyz='{axis}'/>{limit}</joint>"
    )


HULL = link(
    "rov/hull", 30, "", "<collision><geometry><box size='0.7 0.5 0.4'/></geometry></collision>"
)


def arm(side: str, y: float) -> str:
    upper = f"{side}_upper"
    fore = f"{side}_fore"
    parts = link(upper, 0.5) + link(fore, 0.4) + link(f"{side}_nozzle", 0)
    parts += joint("rov/hull", upper, "revolute", f"0.35 {y} -0.1") + joint(
        upper, fore, "revolute", "0.3 0 0"
    )
    return parts + joint(fore, f"{side}_nozzle", "fixed", "0.3 0 0")


def fan(name: str, xyz: str, axis: str) -> str:
    return link(name, 0.05, "") + joint("rov/hull", name, "continuous", xyz, axis)


AHEAD = "".join(fan(f"fan_{k}", f"-0.3 {y} 0", "1 0 0") for k, y in enumerate((-0.2, 0.2)))
SIDEWAYS = fan("fan_2", "0.2 0 0", "0 1 0") + fan("fan_3", "-0.2 0 0", "0 1 0")
UP = "".join(
    fan(f"fan_{k + 4}", f"{x} {y} 0.1", "0 0 1")
    for k, (x, y) in enumerate(((0.2, 0), (-0.2, 0.2), (-0.2, -0.2)))
)
EYE = link("altimeter", 0) + joint("rov/hull", "altimeter", "fixed", "0 0 -0.2")
GIMBAL = link("gimbal", 0.2) + joint("rov/hull", "gimbal", "revolute", "-0.3 0 0", "0 0 1")
OVER = joint("rov/hull", "base_link", "fixed", "0 0 0' rpy='3.14159265 0 0")
FIXED = (
    "<robot name='r'><link name='world'/><joint name='w' type='fixed'><parent link='world'/><child"
    " link='rov/hull'/></joint>"
)
STRANGERS = {
    "one arm, all thrusters, an altimeter": HULL + arm("left", 0.1) + AHEAD + SIDEWAYS + UP + EYE,
    "two arms, no altimeter": HULL + arm("left", 0.1) + arm("right", -0.1) + AHEAD + SIDEWAYS + UP,
    "no arm": HULL + AHEAD + SIDEWAYS + UP + EYE,
    "no vertical thrust": HULL + AHEAD + EYE,
    "no thrust abeam": HULL + AHEAD + UP + EYE,
    "no thrusters": HULL + arm("left", 0.1),
    "a planar joint": HULL
    + link("sled", 1)
    + joint("rov/hull", "sled", "planar", "0.3 0 0", "0 0 1")
    + AHEAD
    + SIDEWAYS
    + UP,
    "a gimbal": HULL
    + AHEAD
    + SIDEWAYS
    + UP
    + GIMBAL
    + fan("fan_9", "-0.1 0 0", "1 0 0").replace("rov/hull", "gimbal"),
    "base_link turned over": HULL
    + link("base_link", 0)
    + OVER
    + arm("left", 0.1)
    + AHEAD
    + SIDEWAYS
    + UP,
    "joints called as axes and links": (HULL + arm("left", 0.1) + AHEAD)
    .replace("left_upper_joint", "x")
    .replace("e_joint", "e"),
    "fixed base": FIXED.removeprefix("<robot name='r'>") + HULL + arm("left", 0.1),
}


def told(*words: str) -> str:
    result = CliRunner().invoke(app, list(words))
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.sampled
@pytest.mark.parametrize("kind", STRANGERS)
def test_a_urdf_becomes_a_mission_that_is_accepted(kind: str, tmp_path: Path) -> None:
    source = tmp_path / "theirs.urdf"
    robot = tmp_path / "mine"
    mission = tmp_path / "m.py"
    source.write_text(f"<robot name='r'>{STRANGERS[kind]}</robot>", encoding="utf-8")
    questions = told("new-robot", "--from", str(source), str(robot))
    assert ("altimeter: no link" in questions) == (
        "altimeter" not in STRANGERS[kind] and kind != "fixed base"
    )
    assert ("thrusters: no link" in questions) == (kind == "no thrusters")
    assert "usable" in told("check-robot", str(robot))
    told("new-mission", str(mission), "--robot", str(robot))
    assert "accepted" in told("check", str(mission))
    text = mission.read_text(encoding="utf-8")
    tools = {
        "two arms, no altimeter": 2,
        "no arm": 0,
        "no vertical thrust": 0,
        "no thrust abeam": 0,
    }
    assert text.count(" ToolPosition(") == tools.get(kind, "gimbal" not in kind)
    assert (" MinimumAltitude(threshold" in text) == ("altimeter" in STRANGERS[kind])
    assert (" VehiclePose(" in text) == (kind != "fixed base")
    assert (" Alignment(" in text) == (
        kind in ("no vertical thrust", "no thrust abeam", "joints called as axes and links")
    )
    proposed_robot = load_robot(
        urdf=robot / "robot.urdf", hydrodynamics=robot / "hydrodynamics.yaml"
    )
    assert [water.frame for water in proposed_robot.hydrodynamics if water.by_flow] == [
        name for name in ("rov/hull",) if proposed_robot.n_vehicle
    ]
    assert len(proposed_robot.description.thrusters) == STRANGERS[kind].count("continuous")
    assert ("joint gimbal_joint: turns thrusters" in questions) == (kind == "a gimbal")
    assert ("frame=" in text.partition("VehiclePose(")[2].partition("\n")[0]) == (
        kind == "base_link turned over"
    )
    varied = (tmp_path / "m_variations.py").read_text(encoding="utf-8")
    parameters = told("campaign", str(mission), "--parameters", "--json")
    assert all(f'"{name}"' in parameters for name in re.findall(r'Variation\("([^"]+)"', varied))
    if proposed_robot.n_vehicle:
        force, moment = static_residual(proposed_robot, proposed_robot.configuration())
        assert abs(force) < 0.05
        assert abs(moment).max() < 0.05


def test_every_proposal_is_marked_and_options_answer_questions(tmp_path: Path) -> None:
    source = tmp_path / "theirs.urdf"
    robot = tmp_path / "mine"
    hook = link("hook", 0) + joint("left_fore", "hook", "fixed", "0.3 0 0.1")
    source.write_text(
        f"<robot name='r'>{HULL}{arm('left', 0.1)}{hook}{AHEAD}</robot>", encoding="utf-8"
    )
    assert "tool: any of hook, left_nozzle; choose by" in told(
        "new-robot", "--from", str(source), str(robot)
    )
    assert "tool" not in yaml.safe_load((robot / "hydrodynamics.yaml").read_text(encoding="utf-8"))
    other_folder = tmp_path / "other"
    assert "tool: any" not in told(
        "new-robot", "--from", str(source), str(other_folder), "--tool", "hook"
    )
    lines = (other_folder / "hydrodynamics.yaml").read_text(encoding="utf-8").splitlines()
    assert "tool: hook # as you said" in lines
    own = [
        line
        for line in lines
        if line and not line.startswith((" ", "#")) and not line.startswith("tool:")
    ]
    assert all("# proposed" in line for line in own)


def test_fingers_stay_together_and_what_has_no_range_stays_where_it_is(tmp_path: Path) -> None:
    source = tmp_path / "theirs.urdf"
    robot = tmp_path / "mine"
    fingers = link("finger_0", 0.05) + joint("left_fore", "finger_0", "revolute", "0.3 0 0")
    second_finger = link("finger_1", 0.05) + joint("left_fore", "finger_1", "revolute", "0.3 0 0")
    second_finger = second_finger.replace(
        "<limit", "<mimic joint='finger_0_joint' multiplier='-1' offset='0.2'/><limit"
    )
    transponder = link("transponder", 0.1) + joint("rov/hull", "transponder", "revolute", "0 0 0.3")
    transponder = transponder.replace("lower='-1.5' upper='1.5'", "lower='0' upper='0'")
    weightless = link("fan_9", 0) + joint("rov/hull", "fan_9", "continuous", "0 0 0.2", "0 0 1")
    body = HULL + arm("left", 0.1) + fingers + second_finger + transponder + AHEAD + weightless
    source.write_text(f"<robot name='r'>{body}</robot>", encoding="utf-8")
    output = told("new-robot", "--from", str(source), str(robot))
    assert "moves on its own" not in output
    content = yaml.safe_load((robot / "hydrodynamics.yaml").read_text(encoding="utf-8"))
    assert "mimic" not in content["loading"]
    assert {"transponder_joint", "fan_9_joint"} <= content["loading"]["lock"].keys()
    assert content["tool"] == "left_nozzle"
    proposed_robot = load_robot(
        urdf=robot / "robot.urdf", hydrodynamics=robot / "hydrodynamics.yaml"
    )
    assert proposed_robot.joint_names == ("left_upper_joint", "left_fore_joint", "finger_0_joint")
    assert proposed_robot.leading_joints == ("finger_0_joint",)
    assert "fan_9_joint" in proposed_robot.thruster_names
    kinematics = Kinematics(
        proposed_robot, proposed_robot.configuration(joints={"finger_0_joint": 0.3})
    )
    turned = kinematics.pose("finger_0").actInv(kinematics.pose("finger_1"))
    np.testing.assert_allclose(
        pin.rpy.matrixToRpy(turned.rotation), [0.0, 0.2 - 0.6, 0.0], atol=1e-12
    )


@pytest.mark.parametrize(
    ("name", "mass", "said"),
    [("finger", 0.05, "fingers that mimic none"), ("drawn", 0, "moves nothing that has a mass")],
)
def test_joints_that_are_held_are_told_and_move_once_they_are_not(
    name: str, mass: float, said: str, tmp_path: Path
) -> None:
    source = tmp_path / "theirs.urdf"
    robot = tmp_path / "mine"
    ends = "".join(
        link(f"{name}_{k}", mass) + joint("left_fore", f"{name}_{k}", "revolute", f"0.3 {y} 0")
        for k, y in ((0, 0.1), (1, -0.1))
    )
    source.write_text(
        f"<robot name='r'>{HULL}{arm('left', 0.1)}{ends}{AHEAD}</robot>", encoding="utf-8"
    )
    questions = " ".join(told("new-robot", "--from", str(source), str(robot)).split())
    assert f"joint {name}_0_joint, {name}_1_joint: {said}" in questions
    file = robot / "hydrodynamics.yaml"
    edited_robot = load_robot(urdf=robot / "robot.urdf", hydrodynamics=file)
    assert edited_robot.joint_names == ("left_upper_joint", "left_fore_joint")
    text = file.read_text(encoding="utf-8")
    file.write_text(re.sub(rf"{name}_\d_joint: 0.0,? ?", "", text), encoding="utf-8")
    if mass:
        freed = load_robot(urdf=robot / "robot.urdf", hydrodynamics=file)
        assert freed.joint_names == (
            *edited_robot.joint_names,
            f"{name}_0_joint",
            f"{name}_1_joint",
        )


def test_a_joint_called_as_an_axis_of_the_vehicle_is_another_axis(tmp_path: Path) -> None:
    (tmp_path / "theirs.urdf").write_text(
        f"<robot name='r'>{STRANGERS['joints called as axes and links']}</robot>", encoding="utf-8"
    )
    told("new-robot", "--from", str(tmp_path / "theirs.urdf"), str(tmp_path / "mine"))
    robot = load_robot(
        urdf=tmp_path / "mine" / "robot.urdf",
        hydrodynamics=tmp_path / "mine" / "hydrodynamics.yaml",
    )
    goal = PostureGoal(position=(0.3, 0.0, 0.0), joints={"x": 0.2})
    planned = coordinates(robot)
    end = goal.as_coordinates(CoalDistances(collision_scene(planned, ())), seed=0)
    axes = dict(zip(planned.names, end.tolist(), strict=True))
    assert len(axes) == planned.n_axes
    assert (axes["x"], axes["joint x"]) == (0.3, 0.2)


def test_what_is_physically_wrong_is_said_with_the_proposal(tmp_path: Path) -> None:
    source = tmp_path / "theirs.urdf"
    thin = HULL.replace("izz='0.3'", "izz='0.7'")
    source.write_text(f"<robot name='r'>{thin}{AHEAD}</robot>", encoding="utf-8")
    assert "inertias: link 'rov/hull'" in told(
        "new-robot", "--from", str(source), str(tmp_path / "mine")
    )


def test_options_of_reading_are_written_into_the_mission(tmp_path: Path) -> None:
    source = tmp_path / "theirs.urdf"
    mission = tmp_path / "m.py"
    source.write_text(f"<robot name='r'>{HULL}{arm('left', 0.1)}{AHEAD}</robot>", encoding="utf-8")
    told(
        "new-mission",
        str(mission),
        "--robot",
        str(source),
        "--lock",
        "fan_0_joint",
        "--lock",
        "fan_1_joint",
        "--tool",
        "left_fore",
    )
    assert (
        "lock={'fan_0_joint': 0.0, 'fan_1_joint': 0.0}, tool=['left_fore'])"
        in mission.read_text(encoding="utf-8")
    )
    assert "accepted" in told("check", str(mission))


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ((), "dvl: no link of the vehicle is called one"),
        (("dvl",), ""),
        (("dvl_a", "dvl_b"), "dvl: any of dvl_a, dvl_b; --dvl LINK"),
    ],
)
def test_a_velocity_log_is_found_where_there_is_one_and_listed_where_there_are_more(
    names: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    source = tmp_path / "theirs.urdf"
    logs = "".join(
        link(name, 0) + joint("rov/hull", name, "fixed", f"0 {k} -0.2")
        for k, name in enumerate(names)
    )
    loose = link("dvl_wrist", 0) + joint("left_fore", "dvl_wrist", "fixed", "0.1 0 0")
    source.write_text(
        f"<robot name='r'>{HULL}{arm('left', 0.1)}{loose}{AHEAD}{logs}</robot>", encoding="utf-8"
    )
    questions = " ".join(told("new-robot", "--from", str(source), str(tmp_path / "mine")).split())
    assert said in questions
    assert ("dvl:" in questions) == bool(said)


def test_a_vehicle_without_thrusters_is_planned_by_the_way_that_plan_ocp_names(
    tmp_path: Path,
) -> None:
    source = tmp_path / "theirs.urdf"
    place = tmp_path / "mine"
    source.write_text(f"<robot name='r'>{HULL}</robot>", encoding="utf-8")
    told("new-robot", "--from", str(source), str(place))
    robot = load_robot(urdf=place / "robot.urdf", hydrodynamics=place / "hydrodynamics.yaml")
    questions = {
        "robot": robot,
        "start": robot.configuration(),
        "goal": PostureGoal(position=(0.5, 0.0, 0.0)),
    }
    with pytest.raises(
        InvalidInput, match=r"give some in hydrodynamics\.yaml, plan without forces by `plan curve`"
    ):
        solve_ocp(OcpRequest(**questions))
    assert plan_path(PlanRequest(**questions)).plan is not None

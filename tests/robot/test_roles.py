"""Tasks name roles, files name links as they like: roles are found where there is no doubt, and
asked for where there is.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.roles import find_roles
from uvms_ocp.scenario.preflight.robot_check import check_robot_files

BODY = (
    "<inertial>{at}<mass value='{m}'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0'"
    " izz='1'/></inertial>"
)
LIMIT = "<limit lower='-1' upper='1' velocity='1' effort='9'/>"


def link(name: str, mass: float = 1.0, at: str = "<origin xyz='0.2 0 0'/>") -> str:
    return f"<link name='{name}'>{BODY.format(m=mass, at=at) if mass else ''}</link>"


def joint(parent: str, child: str, kind: str = "revolute", name: str = "") -> str:
    limit = LIMIT if kind in ("revolute", "prismatic") else ""
    return (
        f"<joint name='{name or f'{parent}_to_{child}'}' type='{kind}'><parent"
        f" link='{parent}'/><child link='{child}'/><origin xyz='0.3 0 0.1'/><axis xyz='0 1"
        f" 0'/>{limit}</joint>"
    )


ARM = link("upper") + link("fore") + joint("hull", "upper") + joint("upper", "fore")
TIP = link("nozzle", 0) + joint("fore", "nozzle", "fixed")
FAN = link("fan", 0.1, "") + joint("hull", "fan", "continuous")
EYE = link("pan_camera", 0.1) + joint("hull", "pan_camera")
FINGERS = (
    link("finger_l") + link("finger_r") + joint("fore", "finger_l") + joint("fore", "finger_r")
)
HELD = link("transponder") + joint("hull", "transponder").replace("'-1' upper='1'", "'0' upper='0'")
LIGHT_FAN = link("fan_2", 0) + joint("hull", "fan_2", "continuous")
SECOND = link("left") + joint("hull", "left")


def loaded(folder: Path, *parts: str, water: str = "", **options: object) -> Robot:
    (folder / "robot.urdf").write_text(
        f"<robot name='r'>{link('hull', 30, '')}{''.join(parts)}</robot>", encoding="utf-8"
    )
    (folder / "hydrodynamics.yaml").write_text(water or "base: free_flyer\n", encoding="utf-8")
    return load_robot(
        urdf=folder / "robot.urdf", hydrodynamics=folder / "hydrodynamics.yaml", **options
    )


@pytest.mark.parametrize(
    ("parts", "tools"),
    [
        ((ARM,), ["fore"]),
        ((ARM, TIP), ["nozzle"]),
        ((TIP, ARM, FAN, EYE), ["nozzle"]),
        ((ARM, FINGERS, FAN), ["fore"]),
        (
            (ARM, TIP, link("force_sensor", 0) + joint("nozzle", "force_sensor", "fixed")),
            ["nozzle"],
        ),
        ((ARM, TIP, link("tcp", 0) + joint("fore", "tcp", "fixed")), ["tcp"]),
        ((ARM, link("jaw_1", 0.1) + joint("fore", "jaw_1", "fixed")), ["fore"]),
        (
            (
                ARM,
                link("jaws", 0.1)
                + joint("fore", "jaws", "fixed")
                + link("jaw_l")
                + joint("jaws", "jaw_l"),
            ),
            ["jaws"],
        ),
        ((ARM, link("jaws_tool", 0) + joint("fore", "jaws_tool", "fixed")), ["jaws_tool"]),
        ((ARM, TIP, HELD), ["nozzle"]),
        ((HELD,), []),
        ((FAN, EYE), []),
        ((), []),
    ],
)
def test_the_tool_is_the_end_of_the_only_chain_whatever_its_name(
    parts: tuple[str, ...], tools: list[str], tmp_path: Path
) -> None:
    robot = loaded(tmp_path, *parts)
    roles = find_roles(robot.model, free_flyer=True)
    assert [name for chain in roles.tools for name in chain] == tools
    assert robot.has_frame("tool") == bool(tools)
    if tools:
        kinematics = Kinematics(robot, robot.configuration())
        assert kinematics.pose("tool") == kinematics.pose(tools[0])
        np.testing.assert_array_equal(kinematics.jacobian("tool"), kinematics.jacobian(tools[0]))


@pytest.mark.parametrize(
    "parts", [(ARM, TIP, SECOND), (ARM, TIP, link("hook", 0) + joint("fore", "hook", "fixed"))]
)
def test_of_several_candidates_none_is_guessed_and_all_are_listed(
    parts: tuple[str, ...], tmp_path: Path
) -> None:
    robot = loaded(tmp_path, *parts)
    assert not robot.has_frame("tool")
    text = next(
        finding.text for finding in check_robot_files(tmp_path).findings if "tool" in finding.text
    )
    assert "nozzle" in text
    assert "choose by `tool:` in hydrodynamics.yaml, or --tool LINK" in text
    assert loaded(tmp_path, *parts, tool="nozzle").has_frame("tool")
    chosen = loaded(tmp_path, *parts, water="tool: nozzle\n")
    assert chosen.tools == ("nozzle",)


def test_propellers_sensors_and_fingers_are_told_apart(tmp_path: Path) -> None:
    roles = find_roles(
        loaded(tmp_path, ARM, FAN, LIGHT_FAN, EYE, FINGERS, HELD).model, free_flyer=True
    )
    assert roles.propellers == ("hull_to_fan", "hull_to_fan_2")
    assert roles.held == ("hull_to_transponder",)
    assert roles.sensors == ("hull_to_pan_camera",)
    assert sorted(roles.fingers) == ["fore_to_finger_l", "fore_to_finger_r"]


def test_the_base_is_the_root_and_what_hangs_on_it_by_default_hangs_there(tmp_path: Path) -> None:
    thruster = (
        "{name: t, position: [1, 0, 0], direction: [1, 0, 0], minimum: -1, maximum: 1,"
        " time_constant: 0.1}"
    )
    robot = loaded(
        tmp_path,
        ARM,
        water=(
            f"thrusters: [{thruster}]\ntrim: [{{name: f, position: [0, 0, 1], mass: 1, volume:"
            " 1}]\n"
        ),
    )
    kinematics = Kinematics(robot, robot.configuration(position=(1.0, 2.0, 3.0)))
    assert kinematics.pose("base_link") == kinematics.pose("hull")


def test_what_hangs_on_a_link_hangs_there_when_a_role_takes_its_name(tmp_path: Path) -> None:
    ball = "{name: ball, link: tool, position: [0, 0, 0], mass: 2, volume: 0}"
    rack = link("tool") + joint("hull", "tool", "fixed")
    robot = loaded(tmp_path, ARM, rack, water=f"tool: fore\ntrim: [{ball}]\n")
    with_ball = robot.model.inertias[1].mass
    assert with_ball == pytest.approx(30 + 1 + 2)


def test_a_role_that_is_stated_wins_over_a_link_of_its_name(tmp_path: Path) -> None:
    robot = loaded(
        tmp_path, ARM, TIP, link("tool", 0) + joint("hull", "tool", "fixed"), water="tool: nozzle\n"
    )
    kinematics = Kinematics(robot, robot.configuration())
    assert kinematics.pose("tool") == kinematics.pose("nozzle")
    assert "tool_of_urdf" in robot.frame_names


def test_roles_of_links_that_are_not_there_are_refused_together(tmp_path: Path) -> None:
    with pytest.raises(
        RobotDataError,
        match=r"base_link: 'x' is not in the URDF; the root is hull; and tool: 'y'.*: nozzle",
    ):
        loaded(tmp_path, ARM, TIP, water="base_link: x\ntool: y\n")

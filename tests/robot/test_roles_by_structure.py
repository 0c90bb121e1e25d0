"""Roles come from what a mechanism is; names break ties and overrule nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from uvms_ocp.robot.proposal import RobotProposal, propose


def link(name: str, mass: float = 1.0, at: str = "0.1 0 0") -> str:
    if not mass:
        return f"<link name='{name}'/>"
    moment = 0.01 * mass
    return (
        f"<link name='{name}'><inertial><origin xyz='{at}'/><mass value='{mass}'/>"
        f"<inertia ixx='{moment}' ixy='0' ixz='0' iyy='{moment}' iyz='0' izz='{moment}'/>"
        "</inertial></link>"
    )


def joint(
    parent: str, child: str, kind: str = "revolute", xyz: str = "0.2 0 0", axis: str = "0 1 0"
) -> str:
    limit = ""
    if kind in ("revolute", "prismatic"):
        limit = "<limit lower='-0.5' upper='0.5' velocity='0.7' effort='9'/>"
    return (
        f"<joint name='{child}_j' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"<origin xyz='{xyz}'/><axis xyz='{axis}'/>{limit}</joint>"
    )


def part(parent: str, child: str, kind: str = "revolute", mass: float = 1.0, **where: str) -> str:
    return link(child, mass) + joint(parent, child, kind, **where)


def fixed(parent: str, child: str, xyz: str = "0.2 0 0") -> str:
    return link(child, 0) + joint(parent, child, "fixed", xyz)


def fixed_thrusters(word: str = "thruster") -> str:
    places = ("-0.3 0.2 0", "-0.3 -0.2 0", "0.3 0.2 0", "0.3 -0.2 0")
    return "".join(fixed("hull", f"{word}_{k}", xyz) for k, xyz in enumerate(places))


def spinning(word: str, parent: str = "hull", xyz: str = "-0.4 0 0", n: int = 1) -> str:
    text = ""
    for k in range(n):
        name = f"{word}_{k}"
        text += link(name, 0.05, "0 0 0") + joint(
            parent, name, "continuous", xyz.replace("0 0", f"{0.3 * k} 0"), "1 0 0"
        )
    return text


HULL = link("hull", 30.0, "0 0 0")
ARM = part("hull", "a") + part("a", "b") + part("b", "c")
TCP = fixed("c", "tcp")
JAWS = part("c", "rs2_210", mass=0.05) + part("c", "rs2_211", mass=0.05)
MOUNTED = "".join(
    fixed("hull", f"thruster_{k}_mount", f"{x} 0.2 0")
    + fixed(f"thruster_{k}_mount", f"thruster_{k}")
    for k, x in enumerate((-0.3, 0.3))
)
DUCTED = fixed("hull", "thruster_0", "-0.3 0.2 0") + spinning("propeller", "thruster_0", "0.02 0 0")
SLIDERS = "".join(
    part("hull", f"pack_{k}", "prismatic", xyz=f"0 {0.1 * k} 0", axis="1 0 0") for k in range(4)
)
CALLED_BY_JOINT = fixed_thrusters("part")
for number in range(4):
    CALLED_BY_JOINT = CALLED_BY_JOINT.replace(f"part_{number}_j", f"thruster_{number}_j")
ARM_JOINTS = ("a_j", "b_j", "c_j")
CASES: dict[str, tuple[str, int, tuple[str, ...], tuple[str, ...]]] = {
    # parts, thrusters, tools, joints that move
    "an arm": (ARM + TCP + fixed_thrusters(), 4, ("tcp",), ARM_JOINTS),
    "an arm without names": (ARM + fixed_thrusters(), 4, ("c",), ARM_JOINTS),
    "propellers that spin": (spinning("propeller", n=3) + ARM, 3, ("c",), ARM_JOINTS),
    "propellers without a name": (spinning("part", n=3) + ARM, 3, ("c",), ARM_JOINTS),
    "a blade on the arm": (
        ARM + TCP + spinning("cutter_blade", "c", "0.2 0 0") + fixed_thrusters(),
        4,
        ("tcp",),
        ARM_JOINTS,
    ),
    "a blade on an arm without tcp": (
        ARM + spinning("rotor", "c", "0.2 0 0") + fixed_thrusters(),
        4,
        ("c",),
        ARM_JOINTS,
    ),
    "a propeller astern and tunnels": (
        spinning("propeller") + fixed_thrusters() + ARM,
        5,
        ("c",),
        ARM_JOINTS,
    ),
    "a propeller in its duct": (DUCTED + ARM, 1, ("c",), ARM_JOINTS),
    "mounts of thrusters": (MOUNTED + ARM, 2, ("c",), ARM_JOINTS),
    "joints called thrusters": (CALLED_BY_JOINT + ARM, 4, ("c",), ARM_JOINTS),
    "fingers without names": (ARM + TCP + JAWS + fixed_thrusters(), 4, ("tcp",), ARM_JOINTS),
    "fingers and no tcp": (ARM + JAWS + fixed_thrusters(), 4, ("c",), ARM_JOINTS),
    "one jaw below tcp": (
        ARM + TCP + part("c", "part_7", mass=0.05) + fixed_thrusters(),
        4,
        ("tcp",),
        ARM_JOINTS,
    ),
    "a rack called tool": (
        ARM + fixed("c", "grasp") + fixed("hull", "tool", "0 0 1") + fixed_thrusters(),
        4,
        ("grasp",),
        ARM_JOINTS,
    ),
    "ballast that slides": (ARM + TCP + SLIDERS + fixed_thrusters(), 4, ("tcp",), ARM_JOINTS),
    "ballast and no arm": (SLIDERS + fixed_thrusters(), 4, (), ()),
    "one ballast by name": (
        part("hull", "trim_weight", "prismatic", axis="1 0 0") + fixed_thrusters(),
        4,
        (),
        (),
    ),
    "a probe that slides": (
        part("hull", "probe", "prismatic", axis="0 0 1") + fixed_thrusters(),
        4,
        ("probe",),
        ("probe_j",),
    ),
    "a thruster that is pointed": (
        part("hull", "pod", axis="0 0 1") + spinning("propeller", "pod") + fixed_thrusters() + ARM,
        5,
        ("c",),
        ARM_JOINTS,
    ),
    "two arms, the longer first": (
        part("hull", "u") + ARM + TCP + fixed_thrusters(),
        4,
        ("tcp", "u"),
        ("a_j", "b_j", "c_j", "u_j"),
    ),
    "an endless wrist": (
        ARM + part("c", "d", "continuous", axis="1 0 0") + fixed_thrusters(),
        4,
        ("d",),
        (*ARM_JOINTS, "d_j"),
    ),
    "limits that stand for none": (
        spinning("part", n=3).replace(
            "type='continuous'>",
            "type='revolute'><limit lower='-1e12' upper='1e12' velocity='9' effort='9'/>",
        )
        + ARM,
        3,
        ("c",),
        ARM_JOINTS,
    ),
    "a camera that turns": (
        ARM + TCP + part("hull", "camera", mass=0.1) + fixed_thrusters(),
        4,
        ("tcp",),
        ARM_JOINTS,
    ),
}


def chain(parent: str, *links: str, mass: float = 1.0) -> str:
    """Return links that hang on each other by joints that turn."""
    text = ""
    for name in links:
        text += part(parent, name, mass=mass)
        parent = name
    return text


def joints_of(*links: str) -> tuple[str, ...]:
    return tuple(f"{name}_j" for name in links)


SONAR = tuple(f"sonar_manipulator_{k}" for k in range(4))
LIGHT = ("light_arm/shoulder", "light_arm/elbow", "light_arm/wrist")
MIXED = ("sonar_shoulder", "camera_elbow", "light_wrist")
THRUSTER = tuple(f"thruster_side_arm_{k}" for k in range(3))
BLADE = tuple(f"blade_arm_{k}" for k in range(3))
JAWS_ALONE = ("jaw_base_yaw", "jaw_base_pitch", "jaw_base_roll")
CAMERA = tuple(f"cam_arm_{k}" for k in range(4))
ROV_ARM = tuple(f"sensor_rov/arm_{k}" for k in range(3))
MISLEADING: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    # parts, tools, joints that move
    "a sonar manipulator": (chain("hull", *SONAR), SONAR[-1:], SONAR),
    "a light arm": (chain("hull", *LIGHT), LIGHT[-1:], LIGHT),
    "a light arm with a gripper": (
        chain("hull", *LIGHT) + fixed(LIGHT[-1], "light_arm/gripper"),
        ("light_arm/gripper",),
        LIGHT,
    ),
    "a light arm with two jaws": (
        chain("hull", *LIGHT) + part(LIGHT[-1], "light_arm/l") + part(LIGHT[-1], "light_arm/r"),
        LIGHT[-1:],
        LIGHT,
    ),
    "an arm of links called otherwise, sensors all": (chain("hull", *MIXED), MIXED[-1:], MIXED),
    "an arm with the prefix of a vehicle": (chain("hull", *ROV_ARM), ROV_ARM[-1:], ROV_ARM),
    "an arm beside thrusters": (chain("hull", *THRUSTER), THRUSTER[-1:], THRUSTER),
    "an arm called a blade": (chain("hull", *BLADE), BLADE[-1:], BLADE),
    "an arm of two joints called screws": (
        chain("hull", "screw_axis_1", "screw_axis_2"),
        ("screw_axis_2",),
        ("screw_axis_1", "screw_axis_2"),
    ),
    "an arm of joints called jaws": (chain("hull", *JAWS_ALONE), JAWS_ALONE[-1:], JAWS_ALONE),
    "a camera arm with a piston": (
        chain("hull", *CAMERA) + part(CAMERA[1], "piston", "prismatic", mass=0.1),
        CAMERA[-1:],
        CAMERA,
    ),
    "a wrist called a finger, which carries two": (
        chain("hull", "upper", "fore", "finger_wrist")
        + part("finger_wrist", "p_1", mass=0.05)
        + part("finger_wrist", "p_2", mass=0.05),
        ("finger_wrist",),
        ("upper", "fore", "finger_wrist"),
    ),
    "a claw that turns, with its jaws": (
        chain("hull", "upper", "fore", "claw_rotate")
        + part("claw_rotate", "jaw_1", mass=0.05)
        + part("claw_rotate", "jaw_2", mass=0.05),
        ("claw_rotate",),
        ("upper", "fore", "claw_rotate"),
    ),
    "three fingers of three joints": (
        chain("hull", "a", "b", "c")
        + "".join(chain("c", f"q_{k}", f"r_{k}", f"t_{k}", mass=0.05) for k in range(3)),
        ("c",),
        ("a", "b", "c"),
    ),
}
PREFIXES = ("", "sensor_rov/", "camera_boat/", "ins/", "thruster_rov_", "tool.")


def proposed(folder: Path, parts: str, prefix: str = "") -> RobotProposal:
    text = f"<robot name='r'>{HULL}{parts}</robot>"
    for word in ("name", "link"):
        text = text.replace(f"{word}='", f"{word}='{prefix}")
    text = text.replace(f"<robot name='{prefix}r'", "<robot name='r'")
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    return propose(folder / "robot.urdf", base="free_flyer")


@pytest.mark.parametrize("kind", CASES)
def test_roles_are_those_of_the_structure(kind: str, tmp_path: Path) -> None:
    parts, n_thrusters, tools, joints = CASES[kind]
    robot = proposed(tmp_path, parts).robot
    assert len(robot.thruster_names) == n_thrusters
    assert robot.tools == tools
    assert sorted(robot.joint_names) == sorted(joints)


@pytest.mark.parametrize("prefix", PREFIXES)
@pytest.mark.parametrize("kind", ["an arm", "fingers without names"])
def test_a_prefix_that_all_names_share_says_nothing(prefix: str, kind: str, tmp_path: Path) -> None:
    parts, n_thrusters, tools, joints = CASES[kind]
    robot = proposed(tmp_path, parts, prefix).robot
    assert len(robot.thruster_names) == n_thrusters
    assert robot.tools == tuple(prefix + name for name in tools)
    assert robot.joint_names == tuple(prefix + name for name in joints)


@pytest.mark.parametrize("kind", MISLEADING)
def test_names_of_an_arm_do_not_lock_it(kind: str, tmp_path: Path) -> None:
    parts, tools, links = MISLEADING[kind]
    robot = proposed(tmp_path, parts + fixed_thrusters()).robot
    assert robot.tools == tools
    assert robot.joint_names == joints_of(*links)
    assert len(robot.thruster_names) == 4


def test_an_arm_of_three_joints_that_ends_in_sensors_is_asked(tmp_path: Path) -> None:
    pan = chain("hull", "c_pan", "c_tilt", "c_roll") + fixed("c_roll", "stereo_camera")
    for parts in (pan, chain("hull", *MIXED), chain("hull", *LIGHT)):
        questions = proposed(tmp_path, ARM + TCP + parts + fixed_thrusters()).questions
        assert any("taken for an arm, and ends in what is called" in line for line in questions)
    gripper = chain("hull", *LIGHT) + fixed(LIGHT[-1], "light_arm/tcp")
    questions = proposed(tmp_path, gripper + fixed_thrusters()).questions
    assert not any("taken for an arm" in line for line in questions)


@pytest.mark.parametrize(
    ("links", "is_asked"),
    [
        (("camera_arm_1", "camera_arm_2"), True),
        (("light_wrist",), True),
        (("camera_1", "camera_2"), False),
        (("alarm_light",), False),
    ],
)
def test_sensors_that_are_called_an_arm_too_are_asked_beside_an_arm(
    links: tuple[str, ...], is_asked: bool, tmp_path: Path
) -> None:
    proposal = proposed(tmp_path, ARM + TCP + chain("hull", *links) + fixed_thrusters())
    assert proposal.robot.joint_names == ARM_JOINTS
    asked = any(f"{links[0]}_j" in question for question in proposal.questions)
    assert asked == is_asked


def test_a_single_joint_called_a_finger_may_be_a_wrist(tmp_path: Path) -> None:
    parts = chain("hull", "upper", "fore", "finger_wrist") + fixed_thrusters()
    questions = proposed(tmp_path, parts).questions
    assert any("finger_wrist_j: fingers" in line and "wrist" in line for line in questions)
    urdf = tmp_path / "robot.urdf"
    robot = propose(urdf, base="free_flyer", tool=("finger_wrist",)).robot
    assert robot.joint_names == joints_of("upper", "fore", "finger_wrist")


def test_each_role_is_told_with_its_reason(tmp_path: Path) -> None:
    parts = ARM + TCP + SLIDERS + spinning("cutter", "c") + fixed_thrusters()
    proposal = proposed(tmp_path, parts)
    assert "tool tcp: on the last link of an arm of joint a_j, b_j, c_j" in proposal.reasons
    assert any(line.startswith("4 thrusters along the x axis") for line in proposal.reasons)
    questions = " ".join(proposal.questions)
    assert "joint cutter_0_j: spins a tool" in questions
    assert "joint pack_0_j, pack_1_j, pack_2_j, pack_3_j: slides a mass" in questions


def test_what_turns_without_end_at_the_end_of_an_arm_is_asked(tmp_path: Path) -> None:
    bare = proposed(tmp_path, ARM + spinning("mill", "c", "0.2 0 0") + fixed_thrusters())
    assert any("mill_0_j: turns without end" in question for question in bare.questions)
    held = part("c", "d", "continuous", axis="1 0 0") + fixed("d", "gripper")
    assert not any(
        "turns without end" in question
        for question in proposed(tmp_path, ARM + held + fixed_thrusters()).questions
    )


def test_an_arm_whose_names_say_sensor_is_asked_beside_another_one(tmp_path: Path) -> None:
    other = part("hull", "camera_arm/a") + part("camera_arm/a", "camera_arm/b")
    other += part("camera_arm/b", "camera_arm/c")
    proposal = proposed(tmp_path, ARM + TCP + other + fixed_thrusters())
    assert any("camera_arm/a_j" in question for question in proposal.questions)
    head = part("hull", "camera_pan", axis="0 0 1") + part("camera_pan", "camera_tilt")
    proposal = proposed(tmp_path, ARM + TCP + head + fixed_thrusters())
    assert not any("camera_pan" in question for question in proposal.questions)


def test_a_mount_without_range_below_an_arm_is_held(tmp_path: Path) -> None:
    parts = part("hull", "mount") + chain("mount", "a", "b", "c") + fixed_thrusters()
    parts += chain("hull", "camera", mass=0.1)
    rangeless = "lower='0' upper='0' velocity='0' effort='0'"
    for name in ("mount", "camera"):
        before, after = parts.split(f"<joint name='{name}_j'")
        after = after.replace("lower='-0.5' upper='0.5' velocity='0.7' effort='9'", rangeless, 1)
        parts = f"{before}<joint name='{name}_j'{after}"
    proposal = proposed(tmp_path, parts)
    assert proposal.robot.joint_names == joints_of("a", "b", "c")
    assert proposal.robot.tools == ("c",)
    assert "joint camera_j, mount_j: has no range, held still" in proposal.reasons


def test_a_dvl_counts_once_with_its_beams(tmp_path: Path) -> None:
    beams = "".join(fixed("dvl", f"dvl_sonar_{k}") for k in range(4))
    robot = proposed(tmp_path, ARM + fixed_thrusters() + fixed("hull", "dvl") + beams).robot
    assert robot.description.dvl == "dvl"


def test_sensors_that_have_a_role_are_told_with_their_reason(tmp_path: Path) -> None:
    parts = ARM + TCP + fixed_thrusters() + fixed("hull", "altimeter_1") + fixed("hull", "dvl_a50")
    reasons = proposed(tmp_path, parts).reasons
    assert "altimeter is altimeter_1, the only link that looks down and is called one" in reasons
    assert "dvl is dvl_a50, the only link that is on the vehicle and is called one" in reasons
    urdf = tmp_path / "robot.urdf"
    said = propose(urdf, base="free_flyer", altimeter="altimeter_1", dvl="hull").reasons
    assert {"altimeter is altimeter_1, as you said", "dvl is hull, as you said"} <= set(said)


def test_what_the_user_calls_the_tool_moves(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(
        f"<robot name='r'>{HULL}{SLIDERS}{fixed_thrusters()}</robot>", encoding="utf-8"
    )
    robot = propose(tmp_path / "robot.urdf", base="free_flyer", tool=("pack_2",)).robot
    assert robot.tools == ("pack_2",)
    assert robot.joint_names == ("pack_2_j",)

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

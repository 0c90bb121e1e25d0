"""A vehicle whose file has z down is not flown upside down in silence: what speaks for it is said, and
how to turn it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from uvms_ocp.robot.proposal import propose
from uvms_ocp.scenario.preflight.robot_check import check_robot

UUV = (
    "<gazebo><plugin name='p' filename='libuuv_underwater_object_ros_plugin.so'><link name='{root}'>"
    "<volume>0.03</volume><center_of_buoyancy>0 0 {centre}</center_of_buoyancy><hydrodynamic_model>"
    "<type>fossen</type></hydrodynamic_model></link></plugin></gazebo>"
)


def robot_text(root: str, dvl: float, centre: float | None) -> str:
    text = (
        f"<robot name='r'><link name='{root}'><inertial><origin xyz='0 0 0.02'/><mass value='30'/>"
        "<inertia ixx='0.6' iyy='1.1' izz='1.3' ixy='0' ixz='0' iyz='0'/></inertial><collision>"
        "<geometry><box size='0.6 0.4 0.3'/></geometry></collision></link><link name='rov_dvl'/>"
        f"<joint name='d' type='fixed'><parent link='{root}'/><child link='rov_dvl'/>"
        f"<origin xyz='0.1 0 {dvl}'/></joint>"
    )
    if centre is not None:
        text += UUV.format(root=root, centre=centre)
    return f"{text}</robot>"


@pytest.mark.parametrize(
    ("root", "dvl", "centre", "signs"),
    [
        ("base_link", -0.15, None, []),
        ("base_link", -0.15, 0.06, []),
        ("base_link", 0.0, 0.02, []),  # buoyancy in the mass, a DVL in the middle
        ("base_link", 0.15, None, ["rov_dvl would be on top of the hull"]),
        ("base_link", -0.15, -0.04, ["stands 0.06 m below the mass"]),
        ("base_link_ned", -0.15, None, ["the root is called 'base_link_ned'"]),
        ("base_frd", 0.15, -0.04, ["the root is called", "0.06 m below", "on top"]),
    ],
)
def test_signs_of_z_down_are_asked_and_told(
    root: str, dvl: float, centre: float | None, signs: list[str], tmp_path: Path
) -> None:
    (tmp_path / "robot.urdf").write_text(robot_text(root, dvl, centre), encoding="utf-8")
    proposal = propose(tmp_path / "robot.urdf", base="free_flyer")
    asked = [question for question in proposal.questions if question.startswith("axes:")]
    told = [f.text for f in check_robot(proposal.robot).findings if f.subject == "axes"]
    assert len(asked) == len(told) == bool(signs)
    for sign in signs:
        assert sign in asked[0]
        assert sign in told[0]


def test_buoyancy_of_all_links_of_the_vehicle_counts(tmp_path: Path) -> None:
    text = robot_text("hull", -0.15, 0.06)
    bracket = (
        "<link name='<volume>0.0005</volume><center_of_buoyancy>0 0 -0.3</center_of_buoyancy>"
        "<hydrodynamic_model><type>fossen</type></hydrodynamic_model></link></plugin>"
    ).replace("<link name='", "<link name='rov_dvl'>")
    (tmp_path / "robot.urdf").write_text(text.replace("</plugin>", bracket), encoding="utf-8")
    questions = propose(tmp_path / "robot.urdf", base="free_flyer").questions
    assert not any(question.startswith("axes:") for question in questions)


def test_a_root_above_it_turns_the_vehicle(tmp_path: Path) -> None:
    text = robot_text("hull", 0.15, -0.04).replace(
        "<link name='hull'>",
        "<link name='base_link'/><joint name='up' type='fixed'><parent link='base_link'/><child"
        " link='hull'/><origin rpy=\"3.14159265 0 0\"/></joint><link name='hull'>",
    )
    (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
    proposal = propose(tmp_path / "robot.urdf", base="free_flyer")
    assert not [question for question in proposal.questions if question.startswith("axes:")]
    assert not [
        f for f in check_robot(proposal.robot).findings if f.subject in ("axes", "attitude")
    ]

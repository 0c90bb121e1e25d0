"""Rotors of motors: inertia that a joint feels, and bodies do not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot.assembly import mount, without_arm
from uvms_ocp.robot.description import RobotDescription, TrimBody, checked_copy
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import example_robot_data, load_robot
from uvms_ocp.robot.proposal import propose
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import with_trim, without_trim

ROTOR = 0.25  # [kg m2]


@pytest.fixture(scope="module")
def bare() -> Robot:
    return load_robot("bluerov2_alpha5")


@pytest.fixture(scope="module")
def geared(bare: Robot) -> Robot:
    joints = {name: {"rotor_inertia": ROTOR} for name in bare.joint_names[1:]}
    return load_robot(
        "bluerov2_alpha5", hydrodynamics=checked_copy(bare.description, joints=joints)
    )


def test_a_rotor_adds_to_the_inertia_of_its_joint_alone(bare: Robot, geared: Robot) -> None:
    q = bare.configuration(joints=np.full(bare.n_joints, 0.4))
    added = robot_dynamics(geared).mass_matrix(q) - robot_dynamics(bare).mass_matrix(q)
    np.testing.assert_allclose(
        added, np.diag([0.0] * 7 + [ROTOR] * (bare.n_joints - 1)), atol=1e-12
    )


def test_a_rotor_stays_where_bodies_come_and_go(geared: Robot) -> None:
    ballast = TrimBody(
        name="ballast", link="base_link", position=(0.1, 0.0, 0.0), mass=1.0, volume=0.0
    )
    for robot in (with_trim(geared, [ballast]), without_trim(geared)):
        np.testing.assert_array_equal(robot.model.armature, geared.model.armature)


def test_rotors_come_along_with_an_arm_that_is_mounted(bare: Robot) -> None:
    urdf = example_robot_data() / "robots/ur_description/urdf/ur5_robot.urdf"
    joints = {"elbow_joint": {"rotor_inertia": ROTOR}}
    arm = load_robot(
        urdf=urdf, hydrodynamics=checked_copy(RobotDescription(), base="fixed", joints=joints)
    )
    mounted = mount(without_arm(bare), arm, pin.SE3.Identity(), prefix="ur5_")
    assert (
        dict(
            zip(mounted.joint_names, mounted.model.armature[mounted.joint_v].tolist(), strict=True)
        )["ur5_elbow_joint"]
        == ROTOR
    )
    assert mounted.model.armature.sum() == ROTOR


def ur5_with_gear(folder: Path, gear: float) -> Robot:
    plain = example_robot_data() / "robots/ur_description/urdf/ur5_robot.urdf"
    text = plain.read_text(encoding="utf-8")
    effort = re.compile(r'effort="([^"]+)" (.*?)velocity="([^"]+)"')
    geared = effort.sub(
        lambda m: f'effort="{float(m[1]) * gear}" {m[2]}velocity="{float(m[3]) / gear}"', text
    )
    (folder / "ur5.urdf").write_text(geared, encoding="utf-8")
    return propose(folder / "ur5.urdf", loading={"meshes": "no"}).robot


@pytest.mark.parametrize("gear", [0.5, 1.0, 50.0])
def test_full_effort_brings_a_proposed_rotor_to_full_speed_in_a_time_that_no_gear_changes(
    gear: float, tmp_path: Path
) -> None:
    robot = ur5_with_gear(tmp_path, gear)
    M = pin.crba(robot.model, robot.model.createData(), pin.neutral(robot.model))
    moved = np.diag(M)[robot.joint_v] - robot.model.armature[robot.joint_v]
    by_motor = 0.03 * robot.limits.effort / robot.limits.velocity
    rotors = robot.model.armature[robot.joint_v]
    np.testing.assert_allclose(rotors, np.minimum(by_motor, np.maximum(moved, 0.01)), rtol=0.01)


def test_a_proposed_rotor_does_not_hide_the_arm_that_it_moves(tmp_path: Path) -> None:
    robot = ur5_with_gear(tmp_path, 50.0)
    M = pin.crba(robot.model, robot.model.createData(), pin.neutral(robot.model))
    rotors = robot.model.armature[robot.joint_v]
    assert (rotors <= np.maximum(0.5 * np.diag(M)[robot.joint_v], 0.01) * 1.01).all()

"""Arms on vehicles: any arm of example-robot-data on any vehicle of ours."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.robot.assembly import mount, without_arm
from uvms_ocp.robot.description import (
    Channel,
    LinkDescription,
    SensorDescription,
    Sphere,
    checked_copy,
)
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.link_boxes import cylinders_around_links
from uvms_ocp.robot.loading import example_robot_data, list_robots, load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import trimmed, without_trim
from uvms_ocp.robot.thrusters import thruster_matrix

ARMS = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
}
VEHICLES = ("girona_maris7", "bluerov2_alpha5")
X_BA = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.9, 0.05, -0.3]))
PAIRS = [(vehicle, arm) for vehicle in VEHICLES for arm in ARMS]


@cache
def bare(vehicle: str) -> Robot:
    return without_trim(without_arm(load_robot(vehicle)))


@cache
def arm_of(name: str) -> Robot:
    return load_robot(
        urdf=example_robot_data() / "robots" / ARMS[name][0], base="fixed", mimic="free"
    )


@cache
def mounted(vehicle: str, arm: str) -> Robot:
    return mount(bare(vehicle), arm_of(arm), X_BA, flange=ARMS[arm][1])


def pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id(frame)]


def total_mass(robot: Robot) -> float:
    return float(sum(inertia.mass for inertia in robot.model.inertias))


@pytest.mark.sampled
@pytest.mark.parametrize(("vehicle", "arm"), PAIRS)
def test_a_mounted_arm_moves_as_it_did_alone(vehicle: str, arm: str) -> None:
    robot = mounted(vehicle, arm)
    alone = arm_of(arm)
    joints = alone.configuration()
    q = np.concatenate(
        [robot.configuration(position=(1.0, 2.0, 3.0), rpy=(0.3, 0.2, 0.1))[:7], joints]
    )
    X_WE = pose(robot, q, "base_link") * X_BA * pose(alone, joints, ARMS[arm][1])
    assert pose(robot, q, "tool").isApprox(X_WE, 1e-10)


@pytest.mark.parametrize(("vehicle", "arm"), PAIRS)
def test_mounting_loses_no_mass_no_shape_and_no_limit(vehicle: str, arm: str) -> None:
    robot = mounted(vehicle, arm)
    alone = arm_of(arm)
    hull = bare(vehicle)
    assert total_mass(robot) == pytest.approx(total_mass(alone) + total_mass(hull))
    assert robot.visual_model.ngeoms == alone.visual_model.ngeoms + hull.visual_model.ngeoms
    assert (
        robot.collision_model.ngeoms == alone.collision_model.ngeoms + hull.collision_model.ngeoms
    )
    assert np.array_equal(robot.limits.position_upper, alone.limits.position_upper)
    assert np.array_equal(robot.limits.velocity, [*hull.limits.velocity, *alone.limits.velocity])
    assert robot.joint_names == tuple(f"{alone.name}_{name}" for name in alone.joint_names)


@pytest.mark.parametrize(("vehicle", "arm"), PAIRS)
def test_an_arm_without_water_data_gets_the_cylinder_rule_on_every_link(
    vehicle: str, arm: str
) -> None:
    robot = mounted(vehicle, arm)
    alone = arm_of(arm)
    hull = bare(vehicle)
    volume = sum(link.volume for link in robot.hydrodynamics) - sum(
        link.volume for link in hull.hydrodynamics
    )
    assert 0.2e-3 < volume / total_mass(alone) < 3e-3
    wet = {
        robot.model.frames[robot.frame_id(link.frame)].parentJoint for link in robot.hydrodynamics
    }
    assert len(wet) >= len(alone.joints)


@pytest.mark.parametrize(("vehicle", "arm"), PAIRS)
def test_the_mass_matrix_in_water_stays_positive_definite(vehicle: str, arm: str) -> None:
    robot = mounted(vehicle, arm)
    M = robot_dynamics(robot).mass_matrix(robot.configuration())
    assert np.linalg.eigvalsh(M).min() > 0.0


@pytest.mark.parametrize(("vehicle", "arm"), PAIRS)
def test_a_mounted_robot_can_be_trimmed(vehicle: str, arm: str) -> None:
    robot = trimmed(mounted(vehicle, arm), bow=0.6, stern=-0.6)
    at_rest = robot_dynamics(robot).bias_force(robot.configuration(), np.zeros(robot.n_v))
    assert np.abs(at_rest[:6]).max() < 1e-6


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_a_vehicle_without_its_arm_keeps_hull_thrusters_and_water(vehicle: str) -> None:
    robot = load_robot(vehicle)
    alone = without_arm(load_robot(vehicle))
    assert (alone.n_q, alone.n_v, alone.n_joints) == (7, 6, 0)
    assert alone.model.inertias[1].isApprox(robot.model.inertias[1])
    assert np.array_equal(thruster_matrix(alone), thruster_matrix(robot))
    assert alone.has_frame("altimeter")
    assert not alone.has_frame("tool")
    assert alone.hydrodynamics[0].volume == robot.hydrodynamics[0].volume


def test_two_arms_fit_on_one_vehicle() -> None:
    one_armed = mount(bare("girona_maris7"), arm_of("ur5"), X_BA, prefix="left_", flange="tool0")
    two_armed = mount(one_armed, arm_of("ur5"), X_BA * X_BA, prefix="right_")
    assert two_armed.n_joints == 12
    assert two_armed.has_frame("left_tool0")
    assert two_armed.has_frame("right_tool0")


def test_given_water_takes_the_place_of_the_cylinder_rule() -> None:
    links = {"wrist_3_link": LinkDescription(sphere=Sphere(radius=0.05))}
    robot = mount(bare("girona_maris7"), arm_of("ur5"), X_BA, links=links)
    assert [link.frame for link in robot.hydrodynamics] == ["base_link", "ur5_wrist_3_link"]


def test_a_cylinder_around_a_link_lies_along_its_longest_side() -> None:
    cylinder = cylinders_around_links(load_robot("girona_maris7"))["link5"].cylinder
    assert cylinder is not None
    assert cylinder.length == pytest.approx(0.325)
    assert 0.02 < cylinder.radius <= 0.05
    assert cylinder.pose.position == pytest.approx((0.0, 0.0, 0.1625))
    across = cylinders_around_links(load_robot("planar5"))["link1"].cylinder
    assert across is not None
    assert across.length == pytest.approx(0.4)
    assert pin.rpy.rpyToMatrix(np.array(across.pose.rpy))[:, 2] == pytest.approx(
        [1.0, 0.0, 0.0], abs=1e-12
    )


def test_parts_that_do_not_fit_are_refused() -> None:
    hull = bare("girona_maris7")
    arm = arm_of("ur5")
    with pytest.raises(InvalidInput, match="fixed base; load it with base='free_flyer'"):
        mount(arm, arm, X_BA)
    with pytest.raises(InvalidInput, match="free-flying base; load it with base='fixed'"):
        mount(hull, hull, X_BA)
    with pytest.raises(
        InvalidInput, match="vehicle and arm both have base_link; give another prefix"
    ):
        mount(hull, arm, X_BA, prefix="")
    with pytest.raises(FrameNotFound, match="unknown frame 'tool9'"):
        mount(hull, arm, X_BA, flange="tool9")
    with pytest.raises(InvalidInput, match="already has flange, tool"):
        mount(load_robot("girona_maris7"), arm, X_BA, flange="tool0")
    with pytest.raises(InvalidInput, match="only a free-flyer has a vehicle"):
        without_arm(arm)


def test_what_a_file_says_of_all_joints_is_mounted_with_them() -> None:
    sensors: dict[Channel, SensorDescription | None] = {
        "joint_positions": SensorDescription(rate=25.0, sigma=0.01),
        "joint_velocities": None,
        "depth": SensorDescription(rate=3.0),
    }
    arm = arm_of("kinova")
    description = checked_copy(arm.description, sensors=sensors, joint_efficiency=0.8)
    arm = load_robot(
        urdf=example_robot_data() / "robots" / ARMS["kinova"][0],
        hydrodynamics=description,
        base="fixed",
        mimic="free",
    )
    vehicle = bare("bluerov2_alpha5")
    mounted_description = mount(vehicle, arm, X_BA).description
    joint_sensors = dict(sensors)
    del joint_sensors["depth"]
    assert mounted_description.joint_efficiency == 0.8
    assert mounted_description.sensors == dict(vehicle.description.sensors) | joint_sensors


def test_the_original_parts_do_not_change() -> None:
    hull = bare("girona_maris7")
    arm = arm_of("ur5")
    before = (
        hull.n_v,
        hull.frame_names,
        arm.frame_names,
        arm.collision_model.geometryObjects[0].name,
    )
    mount(hull, arm, X_BA, flange="tool0")
    assert before == (
        hull.n_v,
        hull.frame_names,
        arm.frame_names,
        arm.collision_model.geometryObjects[0].name,
    )
    assert "girona_maris7" in list_robots()


@pytest.mark.parametrize(("vehicle", "arm"), PAIRS)
def test_no_link_of_an_arm_without_water_data_floats_by_itself(vehicle: str, arm: str) -> None:
    robot = mounted(vehicle, arm)
    lifted = np.zeros(robot.model.njoints)
    for link in robot.hydrodynamics:
        joint = robot.model.frames[robot.frame_id(link.frame)].parentJoint
        lifted[joint] += robot.description.water_density * link.volume
    masses = np.array([inertia.mass for inertia in robot.model.inertias])
    assert (lifted[2:] <= masses[2:] * (1.0 + 1e-3)).all()

"""Numeric kinematics of a robot."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.robot.kinematics import AltimeterBeam, Kinematics
from uvms_ocp.robot.loading import list_robots, load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_model import SymbolicModel

POSITION = (1.0, -2.0, -3.0)
RPY = (0.2, -0.4, 1.3)


def posed(name: str) -> Kinematics:
    robot = load_robot(name)
    q = (
        robot.configuration(position=POSITION, rpy=RPY)
        if robot.n_vehicle
        else robot.configuration()
    )
    return Kinematics(robot, q)


@pytest.fixture
def uvms() -> Kinematics:
    return posed("girona_maris7_full")


def moved(kinematics: Kinematics, step: np.ndarray, frame: str) -> pin.SE3:
    robot: Robot = kinematics.robot
    return Kinematics(robot, pin.integrate(robot.model, kinematics.q, step)).pose(frame)


@pytest.mark.parametrize("name", list_robots())
def test_poses_and_jacobians_agree_with_the_symbolic_ones_at_every_frame(name: str) -> None:
    kinematics = posed(name)
    q = ca.SX.sym("q", kinematics.robot.model.nq)
    symbolic = SymbolicModel(kinematics.robot.model).forward_kinematics(q)
    for frame in kinematics.robot.frame_names:
        R, p, J = ca.Function(
            "frame", [q], [*symbolic.pose(frame), ca.densify(symbolic.jacobian(frame))]
        )(kinematics.q)
        X_WF = kinematics.pose(frame)
        np.testing.assert_allclose(R, X_WF.rotation, atol=1e-12)
        np.testing.assert_allclose(np.asarray(p).ravel(), X_WF.translation, atol=1e-12)
        np.testing.assert_allclose(kinematics.jacobian(frame), J, atol=1e-12)


def test_a_jacobian_maps_velocities_to_the_motion_of_its_frame(uvms: Kinematics) -> None:
    h = 1e-6
    for column, step in zip(uvms.jacobian("tool").T, h * np.eye(uvms.robot.n_v), strict=True):
        ahead = moved(uvms, step, "tool")
        behind = moved(uvms, -step, "tool")
        linear = (ahead.translation - behind.translation) / (2 * h)
        angular = pin.log3(ahead.rotation @ behind.rotation.T) / (2 * h)
        np.testing.assert_allclose(column, np.concatenate([linear, angular]), atol=1e-8)


def test_a_jacobian_expressed_in_the_vehicle_is_a_unit_matrix_at_the_vehicle(
    uvms: Kinematics,
) -> None:
    np.testing.assert_allclose(
        uvms.jacobian("base_link", expressed_in="B"), np.eye(6, uvms.robot.n_v), atol=1e-14
    )


def test_a_jacobian_can_be_expressed_in_the_axes_of_any_frame(uvms: Kinematics) -> None:
    R_WT = uvms.pose("tool").rotation
    J_W = uvms.jacobian("flange")
    J_T = uvms.jacobian("flange", expressed_in="tool")
    np.testing.assert_allclose(R_WT @ J_T[:3], J_W[:3], atol=1e-14)
    np.testing.assert_allclose(R_WT @ J_T[3:], J_W[3:], atol=1e-14)


def test_a_fixed_base_has_the_axes_of_the_world() -> None:
    planar = posed("planar5")
    frame = planar.robot.frame_names[-1]
    np.testing.assert_allclose(
        planar.jacobian(frame, expressed_in="B"), planar.jacobian(frame), atol=1e-14
    )


def test_a_changed_pose_does_not_change_the_kinematics(uvms: Kinematics) -> None:
    uvms.pose("tool").translation = np.zeros(3)
    assert np.linalg.norm(uvms.pose("tool").translation) > 1.0


def test_an_invalid_configuration_is_refused(uvms: Kinematics) -> None:
    with pytest.raises(InvalidInput, match=r"(?i)nan"):
        Kinematics(uvms.robot, np.full(uvms.robot.n_q, np.nan))


def test_unknown_frames_are_refused(uvms: Kinematics) -> None:
    with pytest.raises(FrameNotFound, match="unknown frame 'hand'"):
        uvms.pose("hand")
    with pytest.raises(FrameNotFound, match="unknown frame 'hand'"):
        uvms.jacobian("tool", expressed_in="hand")


@pytest.mark.parametrize("name", ["girona_maris7_full", "bluerov2_alpha5"])
def test_the_beam_of_the_altimeter_looks_along_minus_z_of_its_frame(name: str) -> None:
    robot = load_robot(name)
    rng = np.random.default_rng(5)
    beam = AltimeterBeam(robot, "altimeter")
    for _ in range(20):
        q = robot.configuration(position=rng.uniform(-5, 5, 3), rpy=rng.uniform(-0.5, 0.5, 3))
        ray = beam.at(q)
        pose = Kinematics(robot, q).pose("altimeter")
        np.testing.assert_allclose(ray.origin, pose.translation, atol=1e-12)
        np.testing.assert_allclose(
            ray.direction, pose.act(np.array([0, 0, -1.0])) - pose.translation, atol=1e-12
        )
        assert ray.cosine == pytest.approx(-ray.direction[2])


def test_a_beam_stays_as_it_was_when_the_next_one_is_asked_for() -> None:
    robot = load_robot("girona_maris7_full")
    beam = AltimeterBeam(robot, "altimeter")
    first = beam.at(robot.configuration(position=(1, 2, -3)))
    copied = first.origin.copy(), first.direction.copy()
    beam.at(robot.configuration(position=(4, 5, -6), rpy=(0.3, 0.2, 0.1)))
    np.testing.assert_array_equal(first.origin, copied[0])
    np.testing.assert_array_equal(first.direction, copied[1])
    with pytest.raises(FrameNotFound):
        AltimeterBeam(robot, "sonar")

"""Laws that every robot shipped with the package keeps; a new folder in robots/ is tested by being there."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.model.description import LinkDescription
from uvms_ocp.model.library import robot_folder
from uvms_ocp.model.robot import Robot, list_robots, load_robot

ROBOTS = list_robots()
GIRONAS = ("girona_maris7", "girona_maris7_full")
GRAVITY = 9.81


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_names_its_sources(name: str) -> None:
    text = (robot_folder(name) / "SOURCE.md").read_text(encoding="utf-8")
    assert name in text
    assert "source" in text.lower()


def test_the_home_posture_is_a_valid_configuration(robot: Robot) -> None:
    q = robot.configuration()
    assert np.array_equal(q[robot.joint_q], robot.home)


def test_every_moving_link_has_a_physical_inertia(robot: Robot) -> None:
    massless = {"x0", "y0"}
    for joint in robot.joints:
        inertia = robot.model.inertias[robot.model.getJointId(joint.name)]
        assert joint.name in massless or inertia.mass > 0.0
        a, b, c = np.linalg.eigvalsh(inertia.inertia)
        assert a >= 0.0
        assert c <= (a + b) * (1.0 + 1e-4)


def test_the_mass_matrix_is_positive_definite(robot: Robot) -> None:
    data = robot.model.createData()
    M = pin.crba(robot.model, data, robot.configuration())
    assert np.linalg.eigvalsh(np.triu(M) + np.triu(M, 1).T).min() > 0.0


def test_gravity_points_down_in_a_world_with_z_up(robot: Robot) -> None:
    assert robot.model.gravity.linear == pytest.approx([0.0, 0.0, -GRAVITY])


def test_speed_acceleration_and_effort_are_limited(robot: Robot) -> None:
    limits = robot.limits
    assert limits.velocity.shape == limits.acceleration.shape == (robot.n_v,)
    for values in (limits.velocity, limits.acceleration, limits.effort):
        assert np.isfinite(values).all()
        assert (values > 0.0).all()


def test_every_moving_link_has_something_to_see_and_to_hit(robot: Robot) -> None:
    moving = {robot.model.getJointId(name) for name in robot.joint_names} - {
        robot.model.getJointId(name) for name in ("x0", "y0") if name in robot.joint_names
    }
    for shapes in (robot.visual_model, robot.collision_model):
        assert moving <= {shape.parentJoint for shape in shapes.geometryObjects}


@pytest.mark.parametrize("name", GIRONAS)
def test_the_flange_is_at_its_golden_position(name: str) -> None:
    robot = load_robot(name)
    q = robot.configuration(joints=(0.3, -0.5, 0.7, -1.1, 0.4, 0.2, -0.9))
    X_WA, X_WE = (frame_pose(robot, q, frame) for frame in ("arm_base", "flange"))
    golden = (-0.610847124493206, -0.601664780593950, 0.667235532389772)
    assert np.abs((X_WA.inverse() * X_WE).translation - golden).max() < 1e-12


@pytest.mark.parametrize("name", GIRONAS)
def test_the_frames_of_the_gironas_are_where_the_paper_puts_them(name: str) -> None:
    robot = load_robot(name)
    q = robot.configuration()
    assert frame_pose(robot, q, "altimeter").isApprox(pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.33])))
    arm = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.array([0.85, 0.0, -0.42]))
    assert frame_pose(robot, q, "arm_base").isApprox(arm)
    assert frame_pose(robot, q, "tool").isApprox(frame_pose(robot, q, "flange"))


@pytest.mark.parametrize("name", GIRONAS)
def test_the_hull_ends_half_a_metre_below_its_origin(name: str) -> None:
    robot = load_robot(name)
    boxes = [shape for shape in robot.collision_model.geometryObjects if shape.parentJoint == 1]
    lowest = min(box.placement.translation[2] - box.geometry.halfSide[2] for box in boxes)
    assert lowest == pytest.approx(-0.5, abs=1e-12)


@pytest.mark.parametrize("name", GIRONAS)
def test_the_stowed_arm_does_not_touch_the_hull(name: str) -> None:
    robot = load_robot(name)
    shapes = robot.collision_model.copy()
    for i, a in enumerate(shapes.geometryObjects):
        for j, b in enumerate(shapes.geometryObjects):
            if a.parentJoint == 1 and b.parentJoint > 1:
                shapes.addCollisionPair(pin.CollisionPair(i, j))
    data, shape_data = robot.model.createData(), shapes.createData()
    pin.computeDistances(robot.model, data, shapes, shape_data, robot.configuration())
    assert min(result.min_distance for result in shape_data.distanceResults) > 0.03


@pytest.mark.parametrize("name", [name for name in ROBOTS if load_robot(name).description.thrusters])
def test_a_trimmed_robot_floats_level_with_its_arm_stowed(name: str) -> None:
    robot = load_robot(name)
    force, moment = static_balance(robot, robot.configuration())
    assert np.abs(force) < 0.5
    assert np.linalg.norm(moment) < 0.5


def static_balance(robot: Robot, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Net upward force and moment about the vehicle's origin, from the description alone."""
    density = robot.description.water_density
    volumes = [(link, *displaced(entry)) for link, entry in robot.description.links.items()]
    volumes += [(body.link, body.volume, np.array(body.position)) for body in robot.description.trim]
    lifts = [(frame_pose(robot, q, link).act(centre), density * GRAVITY * V) for link, V, centre in volumes]
    data = robot.model.createData()
    mass = pin.computeTotalMass(robot.model)
    lifts.append((pin.centerOfMass(robot.model, data, q), -mass * GRAVITY))
    force = sum(lift for _, lift in lifts)
    moment = sum(np.cross(point, [0.0, 0.0, lift]) for point, lift in lifts)
    return float(force), np.asarray(moment)


def displaced(entry: LinkDescription) -> tuple[float, np.ndarray]:
    if entry.coefficients is not None:
        centre = entry.coefficients.centre_of_buoyancy or (0.0, 0.0, 0.0)
        return entry.coefficients.volume, np.array(centre)
    cylinder = entry.cylinder
    assert cylinder is not None
    return np.pi * cylinder.radius**2 * cylinder.length, np.array(cylinder.pose.position)


def frame_pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id(frame)]


@pytest.mark.parametrize(("name", "rank"), [("girona_maris7", 5), ("girona_maris7_full", 6)])
def test_the_thrusters_reach_as_many_axes_as_stated(name: str, rank: int) -> None:
    columns = []
    for thruster in load_robot(name).description.thrusters:
        force = np.array(thruster.direction) / np.linalg.norm(thruster.direction)
        columns.append(np.concatenate([force, np.cross(thruster.position, force)]))
    assert np.linalg.matrix_rank(np.array(columns).T) == rank


def test_the_arm_masses_follow_from_wet_weight_and_cylinder_volume() -> None:
    robot = load_robot("girona_maris7")
    wet_weights = (27.15, 28.61, 24.72, 22.98, 9.03, 19.91, 9.17)
    for i, wet_weight in enumerate(wet_weights, start=1):
        volume, _ = displaced(robot.description.links[f"link{i}"])
        expected = wet_weight / GRAVITY + 1000.0 * volume
        mass = robot.model.inertias[robot.model.getJointId(f"joint{i}")].mass
        assert mass == pytest.approx(expected, abs=1e-3)

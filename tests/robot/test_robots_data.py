"""Laws that every robot shipped with the package keeps; a new folder in robots/ is tested by being
there.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.robot.description import LinkDescription
from uvms_ocp.robot.loading import list_robots, list_variants, load_robot, robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thruster_matrix

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
    assert frame_pose(robot, q, "altimeter").isApprox(
        pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.33]))
    )
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
    data = robot.model.createData()
    shape_data = shapes.createData()
    pin.computeDistances(robot.model, data, shapes, shape_data, robot.configuration())
    assert min(result.min_distance for result in shape_data.distanceResults) > 0.03


@pytest.mark.parametrize(
    "name", [name for name in ROBOTS if load_robot(name).description.thrusters]
)
def test_a_trimmed_robot_floats_level_with_its_arm_stowed(name: str) -> None:
    robot = load_robot(name)
    force, moment = static_balance(robot, robot.configuration())
    assert np.abs(force) < 0.5
    assert np.linalg.norm(moment) < 0.5


def static_balance(robot: Robot, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Net upward force and moment about the vehicle's origin, from the description alone."""
    density = robot.description.water_density
    volumes = [(link, *displaced(entry)) for link, entry in robot.description.links.items()]
    volumes += [
        (body.link, body.volume, np.array(body.position)) for body in robot.description.trim
    ]
    lifts = [
        (frame_pose(robot, q, link).act(centre), density * GRAVITY * V)
        for link, V, centre in volumes
    ]
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


@pytest.mark.parametrize(
    ("name", "rank"), [("girona_maris7", 5), ("girona_maris7_full", 6), ("bluerov2_alpha5", 6)]
)
def test_the_thrusters_reach_as_many_axes_as_stated(name: str, rank: int) -> None:
    assert np.linalg.matrix_rank(thruster_matrix(load_robot(name))) == rank


def test_the_bluerov_thrusters_have_the_published_singular_values() -> None:
    singular = np.linalg.svd(thruster_matrix(load_robot("bluerov2_alpha5")), compute_uv=False)
    assert singular == pytest.approx([2.0, 1.41, 1.41, 0.43, 0.335, 0.236], abs=5e-3)


def test_a_thruster_pushes_at_its_position() -> None:
    matrix = thruster_matrix(load_robot("girona_maris7"))
    names = [thruster.name for thruster in load_robot("girona_maris7").description.thrusters]
    assert matrix[:, names.index("surge_port")] == pytest.approx(
        [1.0, 0.0, 0.0, 0.0, -0.021, -0.2587]
    )
    assert matrix[:, names.index("heave_bow")] == pytest.approx([0.0, 0.0, 1.0, 0.0, -0.5347, 0.0])


def test_five_published_sets_exist_for_the_bluerov_and_span_its_surge_drag() -> None:
    variants = list_variants("bluerov2_alpha5")
    assert variants == ("angler", "blue_sdf", "hippocampus", "wu")
    robots = [load_robot("bluerov2_alpha5", variant=variant) for variant in (None, *variants)]
    surge = [np.diag(robot.hydrodynamics[0].quadratic_drag)[0] for robot in robots]
    assert (min(surge), max(surge)) == (18.18, 141.0)
    balances = [static_balance(robot, robot.configuration())[0] for robot in robots]
    assert balances == pytest.approx([balances[0]] * 5)


@pytest.mark.parametrize("name", [name for name in ROBOTS if name.startswith("bluerov2")])
def test_the_hull_of_a_bluerov_is_dragged_by_the_flow_under_every_set_and_its_arm_by_axes(
    name: str,
) -> None:
    """Nobody published its drag between the axes."""
    for variant in (None, *list_variants(name)):
        hull, *arm = load_robot(name, variant=variant).hydrodynamics
        assert (hull.frame, hull.by_flow) == ("base_link", True)
        assert not any(link.by_flow for link in arm)


def test_an_unknown_variant_names_the_alternatives() -> None:
    with pytest.raises(
        NameNotFound, match=r"unknown variant of bluerov2_alpha5 'blue'; known: angler, blue_sdf"
    ):
        load_robot("bluerov2_alpha5", variant="blue")
    with pytest.raises(NameNotFound, match="known: none"):
        load_robot("planar5", variant="blue")


def test_the_bluerov_arm_has_the_published_lengths() -> None:
    robot = load_robot("bluerov2_alpha5")
    q = robot.configuration()
    p = [
        frame_pose(robot, q, frame).translation
        for frame in ("arm_base", "link2", "link3", "link4", "flange")
    ]
    lengths = [np.linalg.norm(b - a) for a, b in pairwise(p)]
    assert lengths == pytest.approx([np.hypot(0.02, 0.0462), 0.150705, 0.02, 0.18])
    assert p[0] == pytest.approx([0.203, 0.0, -0.1317])


def test_the_bluerov_arm_weighs_eight_newtons_in_water() -> None:
    robot = load_robot("bluerov2_alpha5")
    volume = sum(
        displaced(link)[0] for name, link in robot.description.links.items() if name != "base_link"
    )
    mass = (
        pin.computeTotalMass(robot.model) - 13.5 - sum(body.mass for body in robot.description.trim)
    )
    assert GRAVITY * (mass - 998.0 * volume) == pytest.approx(8.0, abs=0.5)


def test_another_water_density_changes_buoyancy_only_where_data_say_so() -> None:
    robot = load_robot("girona_maris7")
    sea = robot.with_water_density(1025.0)
    assert sea.description.water_density == 1025.0
    assert [link.volume for link in sea.hydrodynamics] == [
        link.volume for link in robot.hydrodynamics
    ]
    assert np.array_equal(sea.hydrodynamics[0].added_mass, robot.hydrodynamics[0].added_mass)
    ratio = sea.hydrodynamics[1].added_mass[0, 0] / robot.hydrodynamics[1].added_mass[0, 0]
    assert ratio == pytest.approx(1025.0 / 998.0)
    with pytest.raises(
        InvalidInput, match=r"water_density: given 1.0; .*greater than or equal to 900"
    ):
        robot.with_water_density(1)


def test_the_arm_of_the_bluerov_can_be_mounted_elsewhere() -> None:
    X_BA = pin.SE3(np.eye(3), np.array([0.25, -0.10965, 0.005]))
    robot = load_robot("bluerov2_alpha5")
    moved = robot.with_frame_pose("arm_base", X_BA)
    q = robot.configuration()
    before = frame_pose(robot, q, "arm_base").inverse() * frame_pose(robot, q, "tool")
    assert frame_pose(moved, q, "arm_base").isApprox(X_BA)
    assert (X_BA.inverse() * frame_pose(moved, q, "tool")).isApprox(before)


def test_the_arm_masses_follow_from_wet_weight_and_cylinder_volume() -> None:
    robot = load_robot("girona_maris7")
    wet_weights = (27.15, 28.61, 24.72, 22.98, 9.03, 19.91, 9.17)
    for i, wet_weight in enumerate(wet_weights, start=1):
        volume, _ = displaced(robot.description.links[f"link{i}"])
        expected = wet_weight / GRAVITY + 1000.0 * volume
        mass = robot.model.inertias[robot.model.getJointId(f"joint{i}")].mass
        assert mass == pytest.approx(expected, abs=1e-3)

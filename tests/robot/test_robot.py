"""Robot values and their loader."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import FrameNotFound, InvalidInput, NameNotFound, RobotDataError
from uvms_ocp.robot.loading import example_robot_data, list_robots, load_robot, robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points

EXAMPLE_ARMS = {
    "panda": ("panda_description/urdf/panda.urdf", 9, 9),
    "kinova": ("kinova_description/robots/kinova.urdf", 9, 6),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", 6, 6),
}
INERTIA = "<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/>"
BACK_TO_A = "<joint name='k' type='fixed'><parent link='b'/><child link='a'/></joint>"
MESH = "<visual><geometry><mesh filename='{}'/></geometry></visual>"
LIMIT = "<limit lower='-1' upper='1' velocity='1' effort='1'/>"


@pytest.fixture(scope="module")
def girona() -> Robot:
    return load_robot("girona_maris7_full")


def urdf(tmp_path: Path, body: str) -> Path:
    path = tmp_path / "mine.urdf"
    path.write_text(f"<robot name='mine'>{body}</robot>", encoding="utf-8")
    return path


def link(name: str, mass: object = 1.0) -> str:
    return with_shape(name, "", mass)


def with_shape(name: str, shape: str, mass: object = 1.0) -> str:
    return f"<link name='{name}'><inertial><mass value='{mass}'/>{INERTIA}</inertial>{shape}</link>"


def joint(
    kind: str = "revolute",
    limit: str = LIMIT,
    child: str = "b",
    axis: str = "0 0 1",
    name: str = "j",
) -> str:
    ends = f"<parent link='a'/><child link='{child}'/>"
    return f"<joint name='{name}' type='{kind}'>{ends}<axis xyz='{axis}'/>{limit}</joint>"


def test_the_robots_of_the_paper_are_listed() -> None:
    assert {"girona_maris7", "girona_maris7_full", "planar5"} <= set(list_robots())


def test_an_unknown_robot_names_the_alternatives() -> None:
    with pytest.raises(
        NameNotFound, match=r"unknown robot 'girona'; known: .*girona_maris7_full.*Did you mean"
    ):
        load_robot("girona")


def test_a_name_or_a_path_is_needed_but_not_both(tmp_path: Path) -> None:
    for arguments in ({}, {"name": "planar5", "urdf": tmp_path}):
        with pytest.raises(InvalidInput, match="either a name or urdf=PATH"):
            load_robot(**arguments)


def test_a_folder_or_a_urdf_stands_in_place_of_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = load_robot("bluerov2")
    shutil.copytree(robot_folder("bluerov2"), tmp_path / "mine")
    monkeypatch.chdir(tmp_path)
    for place in ("mine", "mine/robot.urdf", tmp_path / "mine", Path("mine") / "robot.urdf"):
        assert load_robot(place).description == named.description
    (tmp_path / "mine" / "hydrodynamics.yaml").unlink()
    assert not load_robot("mine").description.links
    for place in ("mine/other.urdf", "other.urdf", Path("other")):
        with pytest.raises(RobotDataError, match=r"other.*No such file"):
            load_robot(place)


def test_a_free_flyer_has_the_vehicle_before_the_joints(girona: Robot) -> None:
    assert (girona.n_q, girona.n_v, girona.n_vehicle, girona.n_joints) == (14, 13, 6, 7)
    assert girona.joint_names == tuple(f"joint{i}" for i in range(1, 8))
    assert (girona.vehicle_v, girona.joint_v, girona.joint_q) == (
        slice(0, 6),
        slice(6, 13),
        slice(7, 14),
    )
    assert [j.idx_v for j in girona.joints] == list(range(6, 13))


def test_a_fixed_base_has_joints_only() -> None:
    robot = load_robot("planar5")
    assert (robot.n_q, robot.n_v, robot.n_vehicle, robot.n_joints) == (5, 5, 0, 5)
    assert robot.joint_q == robot.joint_v == slice(0, 5)


def test_the_numbers_of_the_paper_reach_the_limits(girona: Robot) -> None:
    limits = girona.limits
    assert limits.velocity.tolist() == [1.0, 0.5, 0.5, 0.5, 0.5, 0.5] + [0.8] * 7
    assert limits.acceleration.tolist() == [1.0] * 6 + [2.0] * 7
    assert limits.position_lower.tolist() == [-2.9, -1.6, -2.9, -2.95, -2.9, -1.65, -2.8]
    assert limits.position_upper.tolist() == [2.9, 1.65, 2.9, 0.01, 2.9, 1.25, 2.8]
    assert limits.effort.tolist() == [120.0, 120.0, 80.0, 80.0, 40.0, 40.0, 20.0]


def test_a_robot_and_its_arrays_cannot_be_changed(girona: Robot) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        girona.name = "other"  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        girona.limits.velocity[0] = 9.0
    with pytest.raises(ValueError, match="read-only"):
        girona.home[0] = 9.0


def test_an_unknown_frame_names_the_alternatives(girona: Robot) -> None:
    assert girona.has_frame("tool")
    assert not girona.has_frame("tol")
    with pytest.raises(FrameNotFound, match=r"unknown frame 'tol'.*altimeter.*Did you mean 'tool'"):
        girona.frame_id("tol")


def test_an_unknown_joint_names_the_alternatives(girona: Robot) -> None:
    with pytest.raises(NameNotFound, match=r"unknown joint 'joint8'; known: joint1"):
        girona.joint("joint8")


def frame_pose(robot: Robot, frame: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.configuration())
    return data.oMf[robot.frame_id(frame)]


def test_a_sensor_moves_to_its_new_pose_and_the_original_stays(girona: Robot) -> None:
    X_BS = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.5, 0.0, -0.2]))
    moved = girona.with_frame_pose("altimeter", X_BS)
    assert frame_pose(moved, "altimeter").isApprox(X_BS)
    assert frame_pose(girona, "altimeter").translation == pytest.approx([0.0, 0.0, -0.33])
    assert frame_pose(moved, "tool").isApprox(frame_pose(girona, "tool"))


def test_the_shapes_and_frames_on_a_moved_frame_follow_it(girona: Robot) -> None:
    step = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    index = girona.frame_id("flange")
    moved = girona.with_frame_pose("flange", step * girona.model.frames[index].placement)
    assert frame_pose(moved, "tool").isApprox(frame_pose(moved, "flange"))
    assert not frame_pose(moved, "tool").isApprox(frame_pose(girona, "tool"))
    moved = girona.with_frame_pose("altimeter", pin.SE3.Identity())
    shape = next(s for s in moved.visual_model.geometryObjects if s.name.startswith("altimeter"))
    assert shape.placement.translation == pytest.approx([0.0, 0.0, 0.03])


@pytest.mark.parametrize("frame", ["base_link", "link3", "joint3", "root_joint"])
def test_a_moving_link_cannot_be_placed(girona: Robot, frame: str) -> None:
    with pytest.raises(InvalidInput, match=f"frame '{frame}' is a moving link"):
        girona.with_frame_pose(frame, pin.SE3.Identity())


def test_a_configuration_is_built_from_its_parts(girona: Robot) -> None:
    q = girona.configuration(
        position=(1.0, 2.0, 3.0), rpy=(0.0, 0.0, np.pi / 2), joints={"joint2": 0.5}
    )
    assert q[:3].tolist() == [1.0, 2.0, 3.0]
    assert q[3:7] == pytest.approx([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    expected = girona.home.copy()
    expected[1] = 0.5
    assert q[7:] == pytest.approx(expected)
    assert not q.flags.writeable
    same = girona.configuration(position=(1.0, 2.0, 3.0), quaternion=q[3:7], joints=q[7:])
    np.testing.assert_allclose(same, q, atol=1e-15)


WRONG_CONFIGURATIONS = {
    "NaN": (0, np.nan, r"q has NaN or infinite entries at \[0\]"),
    "infinity": (9, np.inf, r"q has NaN or infinite entries at \[9\]"),
    "unnormalised quaternion": (6, 2.0, "quaternion has norm 2; allowed: 1"),
    "zero quaternion": (6, 0.0, "quaternion has norm 0"),
    "joint outside its limits": (10, 0.5, "joint 'joint4': given 0.5; allowed: -2.95 to 0.01"),
}


@pytest.mark.parametrize("mistake", WRONG_CONFIGURATIONS)
def test_a_wrong_configuration_says_what_is_wrong(girona: Robot, mistake: str) -> None:
    index, value, message = WRONG_CONFIGURATIONS[mistake]
    q = girona.configuration().copy()
    q[index] = value
    with pytest.raises(InvalidInput, match=message):
        girona.check_configuration(q)


def test_a_configuration_of_wrong_shape_or_type_is_refused(girona: Robot) -> None:
    with pytest.raises(InvalidInput, match=r"q has shape \(13,\); allowed: \(14,\)"):
        girona.check_configuration(np.zeros(13))
    with pytest.raises(InvalidInput, match=r"q = 'home'; give an array of numbers"):
        girona.check_configuration("home")
    with pytest.raises(InvalidInput, match=r"joints has shape \(6,\)"):
        girona.configuration(joints=np.zeros(6))
    with pytest.raises(InvalidInput, match="either rpy or quaternion"):
        girona.configuration(rpy=np.zeros(3), quaternion=(0.0, 0.0, 0.0, 1.0))
    with pytest.raises(InvalidInput, match="fixed base"):
        load_robot("planar5").configuration(position=np.zeros(3))


@pytest.mark.sampled
@pytest.mark.parametrize("name", EXAMPLE_ARMS)
def test_an_arm_of_example_robot_data_loads_with_a_fixed_base(name: str) -> None:
    path, n_q, n_v = EXAMPLE_ARMS[name]
    robot = load_robot(urdf=example_robot_data() / "robots" / path, base="fixed", mimic="free")
    assert (robot.n_q, robot.n_v, robot.n_vehicle) == (n_q, n_v, 0)
    assert len(robot.collision_model.geometryObjects) > 0
    assert np.array_equal(robot.joint_values(robot.configuration()), robot.home)


def test_a_continuous_joint_has_no_position_limit_and_an_angle_as_its_value() -> None:
    robot = load_robot(
        urdf=example_robot_data() / "robots" / EXAMPLE_ARMS["kinova"][0], base="fixed"
    )
    assert robot.limits.position_lower[0] == -np.inf
    first = robot.joints[0]
    q = robot.configuration(joints={first.name: 20.0})
    assert q[first.q] == pytest.approx([np.cos(20.0), np.sin(20.0)])
    broken = q.copy()
    broken[first.q] = 0.0
    with pytest.raises(InvalidInput, match=f"joint '{first.name}' has norm 0"):
        robot.check_configuration(broken)


def test_without_example_robot_data_the_error_tells_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def absent(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "files", absent)
    with pytest.raises(InvalidInput, match=r'pip install "uvms-ocp\[robots\]"'):
        example_robot_data()


def test_a_users_robot_needs_no_hydrodynamics(tmp_path: Path) -> None:
    robot = load_robot(urdf=urdf(tmp_path, link("a") + link("b") + joint()))
    assert (robot.name, robot.n_vehicle, robot.joint_names) == ("mine", 6, ("j",))
    assert np.isinf(robot.limits.velocity[:6]).all()


def test_trim_bodies_add_their_mass(tmp_path: Path) -> None:
    water = tmp_path / "water.yaml"
    water.write_text(
        "trim: [{name: lead, link: b, position: [0, 0, 1], mass: 3, volume: 0}]", encoding="utf-8"
    )
    path = urdf(tmp_path, link("a") + link("b") + joint())
    dry = load_robot(urdf=path)
    trimmed = load_robot(urdf=path, hydrodynamics=water)
    assert pin.computeTotalMass(trimmed.model) - pin.computeTotalMass(dry.model) == pytest.approx(
        3.0
    )
    assert trimmed.model.inertias[2].lever[2] == pytest.approx(0.75)


BROKEN_URDFS = {
    "not XML": ("<link", "the XML is broken"),
    "no links": ("", "no <link>"),
    "no mass": ("<link name='a'/>", "no link has a mass"),
    "negative mass": (link("a", -1), "link 'a' mass: given -1.0 kg; allowed: >= 0 kg"),
    "mass is a word": (
        link("a", "heavy"),
        "link 'a' mass: given 'heavy'; allowed: a finite number in plain digits",
    ),
    "mass is NaN": (link("a", "nan"), "link 'a' mass: given 'nan'; allowed: a finite number"),
    "unnamed link": (link(""), "a <link> has no name"),
    "two links of one name": (link("a") + link("a"), "repeated: a"),
    "two roots": (link("a") + link("b"), "2 root links"),
    "child that does not exist": (
        link("a") + joint(child="ghost"),
        "child link 'ghost' does not exist",
    ),
    "unknown joint type": (
        link("a") + link("b") + joint("hinge"),
        "type 'hinge'; allowed: revolute",
    ),
    "no limits": (link("a") + link("b") + joint(limit=""), "joint 'j' limit is missing"),
    "limits swapped": (
        link("a")
        + link("b")
        + joint(limit="<limit lower='1' upper='-1' velocity='1' effort='1'/>"),
        "lower 1.0 > upper -1.0",
    ),
    "endless axis": (
        link("a") + link("b") + joint(axis="0 0 1e200"),
        "axis: given '0 0 1e200'; allowed: a length from",
    ),
    "zero axis": (link("a") + link("b") + joint(axis="0 0 0"), "joint 'j' axis: given '0 0 0'"),
    "two parents": (link("a") + link("b") + joint() + joint(name="k"), "link 'b' has two parents"),
    "loop": (link("a") + link("b") + joint() + BACK_TO_A, "root links"),
    "missing mesh": (
        with_shape("a", MESH.replace("visual", "collision").format("package://x/y.stl")),
        (
            "link 'a' collision: mesh 'package://x/y.stl' not found, and nothing would be told of"
            " what the link touches; --pack"
        ),
    ),
    "shape that does not exist": (
        with_shape("a", "<collision><geometry><cone/></geometry></collision>"),
        "link 'a' collision geometry: given <cone>; allowed: box, sphere, cylinder, mesh",
    ),
    "negative friction": (
        link("a") + link("b") + joint(limit=LIMIT + "<dynamics damping='-1'/>"),
        "joint 'j' dynamics damping: given -1.0; allowed: >= 0",
    ),
    "flat box": (
        with_shape("a", "<collision><geometry><box size='1 1 0'/></geometry></collision>"),
        "link 'a' collision box: given {'size': '1 1 0'}; allowed: sizes > 0 m",
    ),
}


@pytest.mark.parametrize("mistake", BROKEN_URDFS)
def test_a_broken_urdf_is_one_line_that_names_the_element(
    mistake: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    body, message = BROKEN_URDFS[mistake]
    with pytest.raises(RobotDataError) as caught:
        load_robot(urdf=urdf(tmp_path, body))
    assert message in str(caught.value)
    assert "mine.urdf" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_missing_empty_or_foreign_urdf_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotDataError, match=r"none\.urdf: cannot be read"):
        load_robot(urdf=tmp_path / "none.urdf")
    empty = tmp_path / "empty.urdf"
    empty.touch()
    with pytest.raises(RobotDataError, match="the XML is broken"):
        load_robot(urdf=empty)
    empty.write_text("<html/>", encoding="utf-8")
    with pytest.raises(RobotDataError, match="the root element is <html>"):
        load_robot(urdf=empty)
    empty.write_text("<sdf/>", encoding="utf-8")
    with pytest.raises(RobotDataError, match="no <model> in the <sdf>"):
        load_robot(urdf=empty)
    empty.write_text("<scenario/>", encoding="utf-8")
    with pytest.raises(RobotDataError, match="a scene of Stonefish"):
        load_robot(urdf=empty)


def test_meshes_are_found_in_package_dirs_and_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "packages" / "x").mkdir(parents=True)
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0"
    box = f"solid s\nfacet normal 0 0 1\nouter loop\n{corners}\nendloop\nendfacet\nendsolid s\n"
    for folder in (tmp_path, tmp_path / "packages" / "x"):
        (folder / "y.stl").write_text(box, encoding="utf-8")
    for filename in ("package://x/y.stl", "y.stl"):
        path = urdf(tmp_path, with_shape("a", MESH.format(filename)))
        robot = load_robot(urdf=path, package_dirs=[tmp_path / "packages"])
        assert robot.visual_model.geometryObjects[0].meshPath.endswith("y.stl")


WRONG_NAMES = {
    "links: {ghost: {sphere: {radius: 1}}}": "links: 'ghost' is not in the URDF",
    "altimeter: ghost": "altimeter: 'ghost' is not in the URDF",
    "joints: {ghost: {home: 0}}": "joints: 'ghost' is no joint of the URDF that moves",
    "trim: [{name: t, link: ghost, position: [0, 0, 0], mass: 1, volume: 0}]": (
        "trim 't' link: 'ghost'"
    ),
    "joints: {j: {home: 2}}": "home: joint 'j': given 2; allowed: -1 to 1",
}


@pytest.mark.parametrize("text", WRONG_NAMES)
def test_a_description_must_fit_its_urdf(text: str, tmp_path: Path) -> None:
    water = tmp_path / "water.yaml"
    water.write_text(text, encoding="utf-8")
    with pytest.raises(RobotDataError, match=WRONG_NAMES[text]):
        load_robot(urdf=urdf(tmp_path, link("a") + link("b") + joint()), hydrodynamics=water)


def test_a_named_robot_can_get_other_water(tmp_path: Path) -> None:
    water = tmp_path / "sea.yaml"
    text = (robot_folder("girona_maris7") / "hydrodynamics.yaml").read_text(encoding="utf-8")
    water.write_text(
        text.replace("water_density: 998.0", "water_density: 1025.0"), encoding="utf-8"
    )
    assert load_robot("girona_maris7", hydrodynamics=water).description.water_density == 1025.0


def test_a_thruster_must_sit_on_the_vehicle(tmp_path: Path) -> None:
    water = tmp_path / "water.yaml"
    ends = "position: [0, 0, 0], direction: [1, 0, 0], minimum: -1, maximum: 1, time_constant: 0"
    water.write_text(f"thrusters: [{{name: t, link: b, {ends}}}]", encoding="utf-8")
    with pytest.raises(
        RobotDataError, match="thruster 't' link: given 'b'; allowed: links fixed to the vehicle"
    ):
        load_robot(urdf=urdf(tmp_path, link("a") + link("b") + joint()), hydrodynamics=water)


def test_a_base_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"base: given 'wheels'; .*'free_flyer' or 'fixed'"):
        load_robot("planar5", base="wheels")  # type: ignore[arg-type]


def test_files_that_say_the_same_give_the_same_robot_also_after_its_use(tmp_path: Path) -> None:
    """What was compiled for a robot is found by which robot it is."""
    robot = load_robot("bluerov2_alpha5")
    skid_points(robot)
    assert load_robot("bluerov2_alpha5") is robot
    path = tmp_path / "hydrodynamics.yaml"
    text = (robot_folder("bluerov2_alpha5") / path.name).read_text(encoding="utf-8")
    path.write_text(text.replace("water_density:", "water_density: 1000.0 #"), encoding="utf-8")
    denser = load_robot("bluerov2_alpha5", hydrodynamics=path)
    assert (denser.description.water_density, robot.description.water_density) == (1000.0, 998.0)

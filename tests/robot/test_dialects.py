"""A robot is the same robot in whichever format it is written: URDF, SDF, MJCF or xacro. In the SDF a
link stands elsewhere than its joint and an axis is stated in another frame; in the MJCF bodies have
classes, frames, and joints beside their origin.
"""

from __future__ import annotations

import builtins
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.dialects.robot_xml import read_robot_xml
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.own_meshes import with_own_meshes
from uvms_ocp.robot.proposal import find_urdf, propose
from uvms_ocp.robot.robot import Robot

FOLDER = Path(__file__).parent / "dialects"
needs_xacro = pytest.mark.skipif(
    find_spec("xacrodoc") is None, reason='needs pip install "uvms-ocp[xacro]"'
)
OTHERS = ("arm.sdf", "arm.xml", pytest.param("arm.urdf.xacro", marks=needs_xacro))


@pytest.mark.parametrize("name", OTHERS)
def test_mechanism_and_shapes_are_those_of_the_urdf(name: str) -> None:
    expected = load_robot(FOLDER / "arm.urdf")
    robot = load_robot(FOLDER / name)
    assert robot.joint_names == expected.joint_names
    for key in ("position_lower", "position_upper", "effort"):
        np.testing.assert_allclose(getattr(robot.limits, key), getattr(expected.limits, key))
    np.testing.assert_allclose(robot.model.damping, expected.model.damping)
    rng = np.random.default_rng(2)
    data = [r.model.createData() for r in (robot, expected)]
    for _ in range(5):
        q = pin.integrate(
            expected.model, pin.neutral(expected.model), rng.normal(size=expected.model.nv)
        )
        M, expected_M = (
            pin.crba(r.model, d, q) for r, d in zip((robot, expected), data, strict=True)
        )
        np.testing.assert_allclose(M, expected_M, atol=1e-12)
        for r, d in zip((robot, expected), data, strict=True):
            pin.framesForwardKinematics(r.model, d, q)
        for frame in ("hull", "upper", "fore", "slide", "tcp"):
            pose, expected_pose = (
                d.oMf[r.model.getFrameId(frame)]
                for r, d in zip((robot, expected), data, strict=True)
            )
            np.testing.assert_allclose(
                pose.homogeneous, expected_pose.homogeneous, atol=1e-12, err_msg=frame
            )
    places = [_places(r) for r in (robot, expected)]
    np.testing.assert_allclose(places[0], places[1], atol=1e-12)


def _places(robot: Robot) -> np.ndarray:
    """Return joint, volume and corners of all collision shapes."""
    rows = list[np.ndarray]()
    for shape in robot.collision_model.geometryObjects:
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        size = np.array(box.max_) - np.array(box.min_)
        rows.append(np.array([shape.parentJoint, *size, *shape.placement.translation]))
    return np.array(sorted(rows, key=lambda row: row[0]))


@pytest.mark.parametrize("name", OTHERS)
def test_roles_are_those_of_the_urdf(name: str) -> None:
    expected = propose(FOLDER / "arm.urdf")
    proposal = propose(FOLDER / name)
    assert proposal.robot.tools == expected.robot.tools
    assert proposal.reasons == expected.reasons
    water = [np.diag(link.added_mass) for link in proposal.robot.hydrodynamics]
    expected_water = [np.diag(link.added_mass) for link in expected.robot.hydrodynamics]
    np.testing.assert_allclose(np.sum(water, axis=0), np.sum(expected_water, axis=0), rtol=1e-3)


LINK = "<link name='hull'><inertial><mass>3</mass></inertial></link><link name='b'/>"
JOINT = "<joint name='j' type='{}'><parent>hull</parent><child>b</child><axis><xyz>{}</xyz></axis></joint>"


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (LINK + JOINT.format("ball", "0 0 1"), "type 'ball'; allowed: revolute"),
        (LINK + JOINT.format("revolute", "0 0 0"), "<xyz>: given '0 0 0'"),
        ("<link name='a'><pose relative_to='b'/></link><link name='b'><pose relative_to='a'/></link>"
         + JOINT.format("revolute", "1 0 0").replace("hull", "a"), "relative to itself"),
        ("<link name='a'><pose>1 2 3</pose></link>", "<pose>: given '1 2 3'"),
        ("<include><uri>model://nowhere</uri></include>", "'model://nowhere': not found"),
        ("<link name='a'><inertial><mass>heavy</mass></inertial></link>", "<mass>: given 'heavy'"),
        ("<frame name='f' attached_to='x'/>" + LINK + JOINT.format("fixed", "1 0 0"), "'x' is not in"),
    ],
)  # fmt: skip
def test_what_sdf_alone_has_is_refused_by_name(model: str, said: str, tmp_path: Path) -> None:
    text = f"<sdf version='1.9'><model name='m'>{model}</model></sdf>"
    require_refused(tmp_path / "m.sdf", text, said)


def require_refused(path: Path, text: str, said: str) -> None:
    """A file with this text is refused, in words that hold what is said."""
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RobotDataError) as caught:
        load_robot(path)
    assert said in str(caught.value)


BODY = "<body name='b'>{}<geom size='1'/></body>"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (BODY.format("<joint type='ball'/>"), "type 'ball'; allowed: hinge, slide"),
        (BODY.format("") + BODY.format("").replace("'b'", "'c'"), "2 bodies of the world, b, c"),
        (BODY.format("<geom type='mesh' mesh='m'/>"), "'m' is not among the assets"),
        (BODY.format("<joint class='wet'/>"), "class 'wet' is not among"),
        (BODY.format("<geom type='box' size='1 2'/>"), "allowed of a box: 3"),
        (BODY.format("<joint axis='0 0 x'/>"), "axis: given '0 0 x'"),
        (BODY.format("<replicate/>"), "<replicate> is not read"),
    ],
)
def test_what_mjcf_alone_has_is_refused_by_name(content: str, said: str, tmp_path: Path) -> None:
    text = f"<mujoco model='m'><worldbody>{content}</worldbody></mujoco>"
    require_refused(tmp_path / "m.xml", text, said)


def test_what_has_no_place_in_a_urdf_is_named(tmp_path: Path) -> None:
    (tmp_path / "m.sdf").write_text(
        "<sdf version='1.9'><model name='m'><link name='a'><inertial><mass>2</mass></inertial>"
        "<gravity>0</gravity><collision name='c'><geometry><ellipsoid><radii>1 2 3</radii></ellipsoid>"
        "</geometry></collision><visual name='v'><geometry><heightmap/></geometry></visual></link>"
        "<link name='b'/><joint name='j' type='fixed'><parent>a</parent><child>b</child></joint>"
        "</model></sdf>",
        encoding="utf-8",
    )  # fmt: skip
    notes = "\n".join(read_robot_xml(tmp_path / "m.sdf").notes)
    assert "link 'b' has no <inertial>: of SDF it has 1 kg" in notes
    assert "<ellipsoid> is taken as the box around it" in notes
    assert "<heightmap> is left out" in notes
    assert "not read of SDF: <gravity>" in notes
    assert load_robot(tmp_path / "m.sdf").model.inertias[1].mass == 3.0


def test_models_in_models_are_one_robot(tmp_path: Path) -> None:
    whole = (FOLDER / "arm.sdf").read_text(encoding="utf-8")
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "model.sdf").write_text(whole, encoding="utf-8")
    (tmp_path / "outer.sdf").write_text(
        "<sdf version='1.9'><model name='outer'><link name='frame'><inertial><mass>5</mass>"
        "</inertial></link><include><uri>model://inner</uri><name>rov</name>"
        "<pose>0 0 1 0 0 0.5</pose></include><joint name='bolt' type='fixed'>"
        "<parent>frame</parent><child>rov::hull</child></joint></model></sdf>",
        encoding="utf-8",
    )
    robot = load_robot(tmp_path / "outer.sdf")
    alone = load_robot(FOLDER / "arm.sdf")
    assert robot.joint_names == tuple(f"rov::{name}" for name in alone.joint_names)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, pin.neutral(robot.model))
    X = data.oMf[robot.frame_id("rov::hull")]
    stated = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, 2.0, 3.0]))
    placed = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.5), np.array([0.0, 0.0, 1.0])) * stated
    np.testing.assert_allclose(X.homogeneous, placed.homogeneous, atol=1e-12)


def test_a_folder_without_urdf_has_its_only_robot_file(tmp_path: Path) -> None:
    text = (FOLDER / "arm.sdf").read_text(encoding="utf-8")
    (tmp_path / "model.sdf").write_text(text, encoding="utf-8")
    (tmp_path / "notes.xml").write_text("<notes/>", encoding="utf-8")
    assert find_urdf(tmp_path) == tmp_path / "model.sdf"
    assert load_robot(tmp_path).joint_names == ("shoulder", "elbow", "wrist")


def test_xacro_without_its_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    really_import = builtins.__import__

    def without_xacro(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.startswith("xacro"):
            raise ImportError(name)
        return really_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_xacro)
    with pytest.raises(RobotDataError, match=r"uvms-ocp\[xacro\]"):
        load_robot(FOLDER / "arm.urdf.xacro")


@needs_xacro
def test_packages_of_xacro_are_found_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "parts_description").mkdir()
    part = (FOLDER / "part.xacro").read_text(encoding="utf-8")
    (tmp_path / "parts_description" / "part.xacro").write_text(part, encoding="utf-8")
    (tmp_path / "rov_description").mkdir()
    file = tmp_path / "rov_description" / "rov.urdf.xacro"
    text = (FOLDER / "arm.urdf.xacro").read_text(encoding="utf-8")
    named = text.replace("part.xacro", "$(find parts_description)/part.xacro")
    file.write_text(named, encoding="utf-8")
    assert load_robot(file).model.inertias[1].mass == 30.0
    file.write_text(named.replace("parts_d", "lost_d"), encoding="utf-8")
    with pytest.raises(RobotDataError, match="package 'lost_description' is not found"):
        load_robot(file)


@needs_xacro
@pytest.mark.parametrize("group", ["parts", "stack/parts"])
def test_packages_in_groups_of_a_workspace_are_found(group: str, tmp_path: Path) -> None:
    package = tmp_path / group / "parts_description"
    package.mkdir(parents=True)
    (package / "package.xml").write_text(
        "<package><name>parts_description</name></package>", encoding="utf-8"
    )
    part = (FOLDER / "part.xacro").read_text(encoding="utf-8")
    (package / "part.xacro").write_text(part, encoding="utf-8")
    file = tmp_path / "rovs" / "rov_description" / "rov.urdf.xacro"
    file.parent.mkdir(parents=True)
    text = (FOLDER / "arm.urdf.xacro").read_text(encoding="utf-8")
    file.write_text(
        text.replace("part.xacro", "$(find parts_description)/part.xacro"), encoding="utf-8"
    )
    assert load_robot(file).model.inertias[1].mass == 30.0


def test_prefixes_that_are_declared_nowhere_are_taken(tmp_path: Path) -> None:
    text = (FOLDER / "arm.sdf").read_text(encoding="utf-8")
    sensor = (
        "<sensor name='s' type='custom' gz:type='dvl'><gz:dvl/><pose>0 0 -0.2 0 0 0</pose></sensor>"
    )
    (tmp_path / "arm.sdf").write_text(
        text.replace("</link>", sensor + "</link>", 1), encoding="utf-8"
    )
    proposal = propose(tmp_path / "arm.sdf")
    assert proposal.robot.description.dvl == "s_dvl"
    X = proposal.robot.model.frames[proposal.robot.frame_id("s_dvl")].placement
    np.testing.assert_allclose(X.translation, [0.0, 0.0, -0.2])


def test_of_several_bodies_the_driven_one_is_the_robot_and_has_its_total_mass(
    tmp_path: Path,
) -> None:
    text = (
        "<mujoco model='m'><compiler settotalmass='14' balanceinertia='true'/><worldbody>"
        "<body name='arm'><joint name='j'/><geom size='0.1' mass='3'/>"
        "<body name='hand'><joint name='k'/><geom size='0.1' mass='4'/></body></body>"
        "<body name='crate'><joint type='slide'/><geom size='0.1'/></body></worldbody>"
        "<actuator><motor joint='k'/></actuator></mujoco>"
    )
    (tmp_path / "m.xml").write_text(text, encoding="utf-8")
    robot = load_robot(tmp_path / "m.xml", base="fixed")
    assert robot.joint_names == ("j", "k")
    masses = [inertia.mass for inertia in robot.model.inertias]
    assert sum(masses) == pytest.approx(14.0)
    assert masses[-1] == pytest.approx(8.0)
    moments = robot.model.inertias[2].inertia
    np.testing.assert_allclose(moments, 0.4 * 8.0 * 0.1**2 * np.eye(3))
    notes = "\n".join(read_robot_xml(tmp_path / "m.xml").notes)
    assert "body of the world" in notes
    assert "compiler balanceinertia" in notes


@pytest.mark.parametrize("name", OTHERS)
def test_the_urdf_that_is_written_of_it_is_the_same_robot(name: str, tmp_path: Path) -> None:
    text, _ = with_own_meshes(FOLDER / name)
    (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
    written = load_robot(tmp_path / "robot.urdf")
    direct = load_robot(FOLDER / name)
    assert written.joint_names == direct.joint_names
    for of_written, of_direct in zip(written.model.inertias, direct.model.inertias, strict=True):
        assert of_written.isApprox(of_direct, 1e-12)
    for frame in ("hull", "fore", "tcp"):
        X, X_direct = (
            robot.model.frames[robot.frame_id(frame)].placement for robot in (written, direct)
        )
        assert X.isApprox(X_direct, 1e-12)

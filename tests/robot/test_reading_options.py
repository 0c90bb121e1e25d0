"""How a URDF is read is part of the robot: the same in its YAML and by option, and a joint that is
locked moves nowhere.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.robot.description import LinkCoefficients, forward_left_up, read_description
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot, robot_folder

URDF = robot_folder("bluerov2_alpha5") / "robot.urdf"


def as_said(folder: Path, loading: str) -> object:
    (folder / "water.yaml").write_text(f"loading: {{{loading}}}\n", encoding="utf-8")
    return load_robot(urdf=URDF, hydrodynamics=folder / "water.yaml")


@pytest.mark.parametrize(
    ("loading", "options"),
    [
        ("lock: {joint2: 0.4}", {"lock": {"joint2": 0.4}}),
        ("drop: [link3]", {"drop": ["link3"]}),
        ("meshes: no", {"meshes": False}),
    ],
)
def test_the_file_and_the_option_say_the_same(
    loading: str, options: dict[str, object], tmp_path: Path
) -> None:
    by_file = as_said(tmp_path, loading)
    by_option = load_robot(urdf=URDF, **options)
    assert by_file.joint_names == by_option.joint_names
    assert by_file.frame_names == by_option.frame_names
    for inertia, expected in zip(by_file.model.inertias, by_option.model.inertias, strict=True):
        assert_allclose(inertia.matrix(), expected.matrix(), rtol=1e-12)
    assert by_file.description.loading == by_option.description.loading


def test_a_locked_joint_leaves_the_robot_as_it_is_there() -> None:
    whole = load_robot(urdf=URDF)
    name = whole.joint_names[1]
    position = 0.4
    locked = load_robot(urdf=URDF, lock={name: position})
    assert locked.joint_names == tuple(joint for joint in whole.joint_names if joint != name)
    q = whole.configuration(joints={name: position})
    q_locked = locked.configuration()
    moving = np.setdiff1d(np.arange(whole.n_v), range(*whole.joint(name).v.indices(whole.n_v)))
    M = pin.crba(whole.model, whole.model.createData(), np.array(q))
    M_locked = pin.crba(locked.model, locked.model.createData(), np.array(q_locked))
    assert_allclose(np.triu(M_locked), np.triu(M)[np.ix_(moving, moving)], atol=1e-9)
    for frame in ("tool", "base_link"):
        pose, locked_pose = (
            Kinematics(r, np.array(c)).pose(frame) for r, c in ((whole, q), (locked, q_locked))
        )
        assert_allclose(pose.homogeneous, locked_pose.homogeneous, atol=1e-12)


FOLLOWING = """<robot name='r'><link name='hull'><inertial><mass value='9'/>
<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link><link name='a'/><link name='b'/>
<joint name='lead' type='prismatic'><parent link='hull'/><child link='a'/><axis xyz='2 0 0'/>
<limit lower='-1' upper='1' velocity='1' effort='1'/></joint>
<joint name='follow' type='prismatic'><parent link='hull'/><child link='b'/><axis xyz='1 0 0'/>
<limit lower='-9' upper='9' velocity='1' effort='1'/>
<mimic joint='lead' multiplier='-2' offset='0.5'/></joint></robot>"""


def test_a_joint_that_follows_stays_where_its_leader_puts_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.urdf"
    path.write_text(FOLLOWING, encoding="utf-8")
    free = load_robot(urdf=path, mimic="fixed")
    assert (free.joint_names, free.leading_joints) == (("lead",), ())
    still = load_robot(urdf=path, mimic="fixed", lock={"lead": 0.1})
    kinematics = Kinematics(still, still.configuration())
    assert_allclose(kinematics.pose("a").translation, [0.1, 0.0, 0.0], atol=1e-15)
    assert_allclose(kinematics.pose("b").translation, [0.3, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("leading", "home", "leader"),
    [("'-1' upper='1'", "", 0.0), ("'0.2' upper='1'", "", 0.6), ("'-1' upper='1'", "0.3", 0.3)],
)
def test_a_joint_that_follows_is_where_the_home_of_its_leader_puts_it(
    leading: str, home: str, leader: float, tmp_path: Path
) -> None:
    third = (
        "<link name='c'/><joint name='third' type='prismatic'><parent link='hull'/><child"
        " link='c'/><axis xyz='1 0 0'/><limit lower='-9' upper='9' velocity='1' effort='1'/><mimic"
        " joint='follow' multiplier='3'/></joint></robot>"
    )
    text = FOLLOWING.replace("'-1' upper='1'", leading).replace("</robot>", third)
    (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
    (tmp_path / "water.yaml").write_text(
        f"joints: {{lead: {{{f'home: {home}' if home else ''}}}}}\n", encoding="utf-8"
    )
    robot = load_robot(
        urdf=tmp_path / "robot.urdf", hydrodynamics=tmp_path / "water.yaml", mimic="fixed"
    )
    kinematics = Kinematics(robot, robot.configuration())
    for name, x in (("a", leader), ("b", -2 * leader + 0.5), ("c", -6 * leader + 1.5)):
        assert_allclose(kinematics.pose(name).translation, [x, 0.0, 0.0], atol=1e-14)


@pytest.mark.parametrize("leader", ["nobody", "follow"])
def test_a_joint_that_follows_none_is_at_its_offset(
    leader: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "mine.urdf"
    path.write_text(
        FOLLOWING.replace("mimic joint='lead'", f"mimic joint='{leader}'"), encoding="utf-8"
    )
    robot = load_robot(urdf=path, mimic="fixed")
    assert f"'follow' mimics '{leader}', which leads nowhere; that is taken as 0" in caplog.text
    assert_allclose(
        Kinematics(robot, robot.configuration()).pose("b").translation, [0.5, 0.0, 0.0], atol=1e-15
    )


def test_what_is_to_be_locked_or_dropped_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(
        RobotDataError, match=r"drop: link 'x' is not.*; and lock: joint 'y' does not move"
    ):
        load_robot(urdf=URDF, drop=["x"], lock={"y": 0.0})


MATRIX = np.diag([9.0, 13.0, 25.0, 5.0, 7.0, 2.5])


def coupled(i: int, j: int, first: float, second: float) -> list[list[float]]:
    matrix = MATRIX.copy()
    matrix[i, j] = first
    matrix[j, i] = second
    return matrix.tolist()


@pytest.mark.parametrize(("first", "second"), [(-0.55, -0.56), (1.2, 1.3), (0.55, 0.6), (1.0, 1.0)])
def test_a_last_digit_that_is_rounded_is_told_and_both_halves_are_meant(
    first: float, second: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = (
        coupled(0, 2, 100 * first, 100 * second) if first == -0.55 else coupled(0, 2, first, second)
    )
    rows[0][0] = 900.0
    path = tmp_path / "water.yaml"
    path.write_text(
        f"links: {{hull: {{coefficients: {{added_mass: {rows}}}}}}}\n", encoding="utf-8"
    )
    if abs(rows[0][2] - rows[2][0]) > 0.01 * abs(rows[0][2]):
        with pytest.raises(RobotDataError, match="but for a rounded last digit: entry 1, 3 is"):
            read_description(path)
        return
    coefficients = read_description(path).links["hull"].coefficients
    assert coefficients is not None
    assert_allclose(coefficients.added_mass, np.array(rows) / 2 + np.array(rows).T / 2)
    assert ("symmetric but for a last digit" in caplog.text) == (first != second)


def test_quadratic_drag_takes_a_matrix_that_takes_energy(tmp_path: Path) -> None:
    rows = coupled(1, 5, 1.5, 1.5)
    diagonal = LinkCoefficients(quadratic_drag=tuple(np.diag(MATRIX)))
    assert_allclose(np.diag(diagonal.quadratic_drag), MATRIX)
    path = tmp_path / "water.yaml"
    path.write_text(
        f"convention: NED\nlinks: {{base_link: {{coefficients: {{quadratic_drag: {rows}, volume:"
        " 0.01}}}\n",
        encoding="utf-8",
    )
    turned = forward_left_up(read_description(path)).links["base_link"].coefficients
    T = np.diag([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    assert_allclose(turned.quadratic_drag, T @ np.array(rows) @ T)
    (water,) = load_robot(urdf=URDF, hydrodynamics=path).hydrodynamics
    assert_allclose(water.quadratic_drag, turned.quadratic_drag)
    with pytest.raises(ValueError, match=r"feeds .* W at nu"):
        LinkCoefficients(quadratic_drag=coupled(1, 5, 90.0, 90.0))


def test_an_unknown_word_for_mimic_is_refused() -> None:
    with pytest.raises(InvalidInput, match="mimic"):
        load_robot(urdf=URDF, mimic="sometimes")

"""No word of a URDF is dropped in silence: a misspelt one is refused, what others add is told."""

from __future__ import annotations

import copy
from pathlib import Path
from xml.etree import ElementTree

import pytest

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.loading import example_robot_data, list_robots, robot_folder
from uvms_ocp.robot.urdf import read_urdf
from uvms_ocp.robot.urdf_words import unread_words

MINE = Path("mine.urdf")
SOUND = """<robot name='mine' version='1.0'><link name='a'><inertial><mass value='1'/>
<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>
<collision><geometry><sphere radius='1'/></geometry>{collision}</collision>{link}</link>
<link name='b'/><joint name='j' type='revolute'><parent link='a'/><child link='b'/>
<limit lower='-1' upper='1' velocity='1' effort='1' {limit}/>{joint}</joint>{robot}</robot>"""
PLACES = dict.fromkeys(("collision", "link", "limit", "joint", "robot"), "")


def misspelt(word: str) -> set[str]:
    """The word with two letters swapped, with one left out, and with another case."""
    swapped = word[:1] + word[2] + word[1] + word[3:]
    return {swapped, word[:2] + word[3:], word[:3] + word[2:], word.capitalize()} - {word}


def refusal(root: ElementTree.Element) -> str:
    with pytest.raises(RobotDataError) as caught:
        unread_words(MINE, root)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300
    return str(caught.value)


@pytest.mark.parametrize("name", list_robots())
def test_a_misspelt_element_is_refused_with_the_one_that_was_meant(name: str) -> None:
    whole = ElementTree.parse(robot_folder(name) / "robot.urdf").getroot()
    assert unread_words(MINE, whole) == ""
    for path in {(parent.tag, child.tag) for parent in whole.iter() for child in parent}:
        for wrong in misspelt(path[1]):
            root = copy.deepcopy(whole)
            next(
                child for parent in root.iter(path[0]) for child in parent if child.tag == path[1]
            ).tag = wrong
            assert f"unknown element <{wrong}>; did you mean '{path[1]}'? allowed: " in refusal(
                root
            )


@pytest.mark.sampled
@pytest.mark.parametrize("name", list_robots())
def test_a_misspelt_attribute_is_refused(name: str) -> None:
    whole = ElementTree.parse(robot_folder(name) / "robot.urdf").getroot()
    for tag, key in {(element.tag, key) for element in whole.iter() for key in element.attrib}:
        for wrong in misspelt(key):
            root = copy.deepcopy(whole)
            element = next(element for element in root.iter(tag) if key in element.attrib)
            element.set(wrong, element.attrib.pop(key))
            assert f"unknown attribute {wrong}; " in refusal(root)


@pytest.mark.parametrize(
    ("place", "text", "message"),
    [
        (
            "joint",
            "<dynamics dampning='1'/>",
            "joint 'j' dynamics: unknown attribute dampning; did you mean 'damping'?",
        ),
        (
            "joint",
            "<origin xyz='0 0 0' xzy='1 1 1'/>",
            "joint 'j' origin: unknown attribute xzy; did you mean",
        ),
        (
            "joint",
            "<origin quat_xyzw='0 0 0 1'/>",
            "joint 'j' origin: unknown attribute quat_xyzw; allowed: rpy, xyz",
        ),
        (
            "joint",
            "<axis rpy='0 1.57 0' xyz='0 0 1'/>",
            "joint 'j' axis: unknown attribute rpy; allowed: xyz",
        ),
        (
            "joint",
            "<dynamics friction_='1'/>",
            "unknown attribute friction_; did you mean 'friction'?",
        ),
        ("link", "<Inertial/>", "link 'a': unknown element <Inertial>; did you mean 'inertial'?"),
        ("robot", "<jiont/>", "mine.urdf: robot: unknown element <jiont>; did you mean 'joint'?"),
        (
            "robot",
            "<x:include xmlns:x='http://www.ros.org/wiki/xacro'/>",
            "<include> is of xacro; give the URDF that",
        ),
    ],
)
def test_what_can_only_be_a_mistake_is_refused(place: str, text: str, message: str) -> None:
    assert message in refusal(ElementTree.fromstring(SOUND.format(**PLACES | {place: text})))


@pytest.mark.parametrize(
    ("place", "text", "told"),
    [
        (
            "robot",
            "<gazebo><Mass>1</Mass><material/></gazebo><transmission/><ros2_control/><sensor/><plugin/>",
            "",
        ),
        ("link", "<verbose value='1'/><contact/><contact_coefficients/><sensor/>", ""),
        ("collision", "<verbose value='1'/><material/>", ""),
        ("joint", "<safety_controller k_velocity='1'/><calibration rising='0'/>", ""),
        ("robot", "<loop_joint/><loop_joint/>", "<loop_joint> in <robot> (2 times)"),
        ("robot", "<n:mass xmlns:n='http://a.b'/>", "<mass> in <robot>"),
        ("link", "<mass value='3'/>", "<mass> in <link>"),
        ("joint", "<inertial/>", "<inertial> in <joint>"),
        (
            "limit",
            "gear_velocity='2' current='1'",
            "attribute gear_velocity of <limit>, attribute current of <limit>",
        ),
        ("joint", "<axis rpy='0 0 0' xyz='0 0 1'/>", "attribute rpy of <axis>"),
        ("joint", "<dynamics damping='1'>friction='1'</dynamics>", "text in <dynamics>"),
        ("link", "mass 3", "text in <link>"),
        ("link", "".join(f"<q{i}/>" for i in range(30)), "<q7> in <link> and 22 more"),
    ],
)
def test_what_others_add_loads_and_is_told_once(
    place: str, text: str, told: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "mine.urdf"
    path.write_text(SOUND.format(**PLACES | {place: text}))
    read_urdf(path, free_flyer=True)
    assert [record.message.endswith(told) for record in caplog.records] == [True] * bool(told)


def test_of_two_shapes_none_gets_lost(tmp_path: Path) -> None:
    path = tmp_path / "mine.urdf"
    path.write_text(SOUND.format(**PLACES).replace("</geometry>", "<box size='1 1 1'/></geometry>"))
    with pytest.raises(
        RobotDataError, match="collision geometry: given <sphere>, <box>; allowed: one shape"
    ):
        read_urdf(path, free_flyer=True)


def test_no_robot_that_others_publish_is_called_misspelt() -> None:
    files = sorted(example_robot_data().rglob("*.urdf"))
    told = [unread_words(path, ElementTree.parse(path).getroot()) for path in files]
    assert len(files) > 50
    assert sum(map(bool, told)) < len(files) / 4

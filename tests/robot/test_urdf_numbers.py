"""Any URDF that loads has the numbers of its XML; what Pinocchio's parser would drop is refused."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.loading import list_robots, load_robot, robot_folder
from uvms_ocp.robot.urdf import UrdfModels, read_urdf
from uvms_ocp.robot.urdf_agreement import check_agreement
from uvms_ocp.robot.urdf_elements import to_float

READ = (
    "5",
    " 5",
    "\t5",
    "\n5",
    "+5",
    "-5",
    "5.",
    ".5",
    "5e1",
    "5E+1",
    "5e-1",
    "1e-400",
    "0005",
    "1e308",
)
NOT_READ = (
    *(
        "5 ",
        "5.9682 ",
        "10\n",
        "5\t",
        "1_0",
        "５",
        "٥",
        "nan",
        "-nan",
        "inf",
        "infinity",
        "1e400",
        "0x10",
        "0x1p3",
    ),
    *("1,5", "1'000", "", "  ", "--5", "5e", "5d1", "5f", "\u00a05", "five", "5 6", "1/2"),
)
BODY = """<robot name='mine'><link name='a'><inertial><origin xyz='{com}' rpy='{turn}'/><mass value='{mass}'/>
<inertia ixx='{moment}' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>
<collision><geometry><sphere radius='{radius}'/></geometry></collision>
<collision><geometry><box size='{box}'/></geometry></collision></link>
<link name='b'><inertial><mass value='1'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>
<collision><geometry><cylinder radius='1' length='{length}'/></geometry></collision></link>
<joint name='j' type='{kind}'><parent link='a'/><child link='b'/><origin xyz='{place}'/><axis xyz='{axis}'/>
<limit lower='-1' upper='{upper}' velocity='{velocity}' effort='{effort}'/><dynamics damping='{damping}'/>{more}</joint>
</robot>"""
SOUND = {
    **dict.fromkeys(
        ("mass", "moment", "radius", "length", "upper", "velocity", "effort", "damping"), "1"
    ),
    **dict.fromkeys(("com", "turn", "box", "place"), "1 1 1"),
    "axis": "0 0 1",
    "kind": "revolute",
    "more": "",
}
NUMBERS = [name for name, text in SOUND.items() if text.startswith("1")]


def written(folder: Path, **texts: str) -> Path:
    path = folder / "mine.urdf"
    safe = str.maketrans({"\n": "&#10;", "\t": "&#9;", "'": "&apos;"})
    escaped = {key: text if key == "more" else text.translate(safe) for key, text in texts.items()}
    path.write_text(BODY.format(**SOUND | escaped), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "parent", ["link", "link/inertial", "link/collision", "link/collision/geometry", "joint"]
)
def test_what_stands_twice_and_differs_where_parsers_take_the_first_is_refused(
    parent: str, tmp_path: Path
) -> None:
    whole = ElementTree.fromstring(BODY.format(**SOUND))
    for tag in {child.tag for child in whole.find(parent)} - {"collision", "visual", "origin"}:
        root = copy.deepcopy(whole)
        element = root.find(parent)
        element.append(copy.deepcopy(element.find(tag)))
        element[-1].set("other", "1")
        path = tmp_path / f"{tag}.urdf"
        path.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
        with pytest.raises(
            RobotDataError, match=rf"'[aj]'.*: given <{tag}> 2 times; allowed: once"
        ):
            load_robot(urdf=path)


@pytest.mark.parametrize("text", [*READ, *NOT_READ])
def test_a_number_is_read_where_urdfdom_reads_it_and_as_the_same(text: str) -> None:
    root = ElementTree.fromstring(BODY.format(**SOUND))
    root.find("link/inertial/mass").set("value", text)
    model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    read = to_float(text)
    built = model.inertias[0].mass
    assert math.isnan(read) == (text in NOT_READ)
    assert built == (0.0 if text in NOT_READ else read)


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_that_urdfdom_does_not_read_is_refused_by_name(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    place = (
        "joint 'j'"
        if name in ("place", "axis", "upper", "velocity", "effort", "damping")
        else "link '"
    )
    for bad in NOT_READ:
        vector = SOUND[name] == "1 1 1"
        if vector and bad in ("", "  ", "5 ", "5.9682 ", "5 6"):
            continue  # spaces are what stands between the numbers of a vector
        path = written(tmp_path, **{name: f"1 {bad} 1" if vector else bad})
        with pytest.raises(RobotDataError) as caught:
            load_robot(urdf=path)
        message = str(caught.value)
        assert message.startswith(f"{path}: {place}")
        assert repr(bad)[1:-1] in message
        assert "\n" not in message
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ({"com": "1 1"}, "link 'a' origin xyz: given '1 1'; allowed: three finite numbers"),
        ({"com": "1\t1 1"}, "link 'a' origin xyz: given '1\\t1 1'"),
        ({"mass": "1" * 5000}, "link 'a' mass: given '1111111111"),
        (
            {"kind": "planar", "axis": "0 1 0"},
            "joint 'j' axis: the file says '[0. 1. 0.]', the model that",
        ),
        (
            {"kind": "planar", "velocity": "1"},
            "joint 'j' limit velocity: the file says '[1. 1. 1.]'",
        ),
        ({"kind": "continuous", "effort": "1 "}, "joint 'j' limit effort: given '1 '"),
        ({"more": "<calibration rising='1 '/>"}, "joint 'j' calibration rising: given '1 '"),
        ({"more": "<safety_controller/>"}, "joint 'j' safety_controller k_velocity: given nothing"),
    ],
)
def test_what_the_model_would_not_hold_is_refused(
    texts: dict[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(RobotDataError) as caught:
        load_robot(urdf=written(tmp_path, **texts))
    assert message in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "scale",
    ["0 1 1", "1e-320 1 1", "1 1e-7 1", "1 -1e7 1", "nan 1 1", "1 1", "1 1 1e400", "1 1 1_0"],
)
def test_a_mesh_of_no_size_is_refused(scale: str, tmp_path: Path) -> None:
    mesh = (
        "<collision><geometry><mesh filename='y.stl'"
        f" scale='{scale}'/></geometry></collision></link>"
    )
    path = written(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("</link>", mesh, 1), encoding="utf-8")
    with pytest.raises(RobotDataError, match=f"link 'a' collision mesh scale: given '{scale}'"):
        load_robot(urdf=path)


def test_a_joint_that_mimics_becomes_one_of_its_own_where_that_is_asked_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path, more="<mimic joint='k' multiplier='2'/>")
    assert load_robot(urdf=path, mimic="free").joint_names == ("j",)
    assert "joint 'j' moves on its own" in caplog.text
    with pytest.raises(RobotDataError, match="joint 'j' mimic multiplier: given '2 '"):
        load_robot(urdf=written(tmp_path, more="<mimic joint='k' multiplier='2 '/>"), mimic="free")


def _poses(root: ElementTree.Element) -> dict[str, np.ndarray]:
    """(4, 4) by link, all joints at zero, from the XML alone."""
    joints = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    poses: dict[str, np.ndarray] = {}

    def pose(link: str) -> np.ndarray:
        if link not in poses:
            joint = joints.get(link)
            poses[link] = (
                np.eye(4)
                if joint is None
                else pose(joint.find("parent").get("link")) @ _origin(joint)
            )
        return poses[link]

    for link in root.findall("link"):
        pose(link.get("name"))
    return poses


def _origin(element: ElementTree.Element) -> np.ndarray:
    origin = element.find("origin")
    texts = (
        ("0 0 0", "0 0 0")
        if origin is None
        else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
    )
    xyz, (r, p, y) = (np.array([float(word) for word in text.split()]) for text in texts)
    turns = [pin.utils.rotate(axis, angle) for axis, angle in (("z", y), ("y", p), ("x", r))]
    X = np.eye(4)
    X[:3, :3] = turns[0] @ turns[1] @ turns[2]
    X[:3, 3] = xyz
    return X


def _stated_inertia(root: ElementTree.Element) -> np.ndarray:
    """Mass, mass x centre (3,) and second moments (3, 3) about the root, joints at zero, (13,)."""
    total = np.zeros(13)
    poses = _poses(root)
    for link in root.findall("link[inertial]"):
        inertial = link.find("inertial")
        X = poses[link.get("name")] @ _origin(inertial)
        m = float(inertial.find("mass").get("value"))
        values = {key: float(text) for key, text in inertial.find("inertia").attrib.items()}
        moments = np.array([[values["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
        R = X[:3, :3]
        c = X[:3, 3]
        about_root = R @ moments @ R.T + m * (c @ c * np.eye(3) - np.outer(c, c))
        total += np.concatenate([[m], m * c, about_root.ravel()])
    return total


def _built_inertia(model: pin.Model) -> np.ndarray:
    data = model.createData()
    total = np.zeros((6, 6))
    pin.forwardKinematics(model, data, pin.neutral(model))
    for X, inertia in zip(data.oMi, model.inertias, strict=True):
        total += X.dualAction @ inertia.matrix() @ X.actionInverse
    first = [total[1, 5], total[2, 3], total[0, 4]]  # of -m [c]x
    return np.concatenate([[total[0, 0]], first, total[3:, 3:].ravel()])


def _assert_same(root: ElementTree.Element, models: UrdfModels) -> None:
    stated = _stated_inertia(root)
    built = _built_inertia(models.model)
    for part in (np.s_[:1], np.s_[1:4], np.s_[4:]):
        assert np.abs(stated[part] - built[part]).max() <= 1e-9 * max(
            np.abs(stated[part]).max(), stated[0]
        )
    assert models.collision.ngeoms == len(root.findall("link/collision"))
    for joint in root.findall("joint[limit]"):
        at = models.model.joints[models.model.getJointId(joint.get("name"))].idx_v
        limit = joint.find("limit")
        assert models.model.upperVelocityLimit[at] == float(limit.get("velocity"))
        assert models.model.upperEffortLimit[at] == float(limit.get("effort"))


@pytest.mark.sampled
@pytest.mark.parametrize("name", list_robots())
def test_a_perturbed_number_loads_with_its_value_or_is_refused(name: str, tmp_path: Path) -> None:
    source = ElementTree.parse(robot_folder(name) / "robot.urdf").getroot()
    rng = np.random.default_rng(12)
    path = tmp_path / "robot.urdf"
    loaded = 0
    refused = 0
    for _ in range(40):
        root = copy.deepcopy(source)
        places = [
            (e, key) for e in root.iter() for key, text in e.attrib.items() if _is_number(text)
        ]
        element, key = places[rng.integers(len(places))]
        element.set(key, _perturbed(element.get(key, ""), rng))
        path.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
        try:
            models = read_urdf(path, free_flyer=bool(rng.integers(2)))
        except RobotDataError:
            refused += 1
        else:
            _assert_same(root, models)
            loaded += 1
    assert min(loaded, refused) >= 5


def _is_number(text: str) -> bool:
    return bool(text.split()) and not any(math.isnan(to_float(word)) for word in text.split())


def _perturbed(text: str, rng: np.random.Generator) -> str:
    words = text.split()
    i = rng.integers(len(words))
    value = float(words[i])
    ways = (
        f"{1.01 * value!r}",
        f"{value:+.6e}",
        f"{words[i]}e0",
        f" {words[i]}",
        *NOT_READ[:6],
        "0",
        "-1",
        "1e100",
        "1_0",
    )
    words[i] = ways[rng.integers(len(ways))]
    return " ".join(words)


def _scaled(name: str, index: int = -1) -> Callable[[UrdfModels], None]:
    def tamper(models: UrdfModels) -> None:
        values = getattr(models.model, name)
        values[index] = 1.0000001 * values[index] + 1e-6
        setattr(models.model, name, values)

    return tamper


def _heavier(models: UrdfModels) -> None:
    models.model.inertias[models.model.njoints - 1].mass *= 1.0 + 1e-9


def _shifted(models: UrdfModels) -> None:
    models.model.jointPlacements[models.model.njoints - 1].translation += 1e-9


def _larger(models: UrdfModels) -> None:
    shape = models.collision.geometryObjects[0].geometry
    if hasattr(shape, "radius"):
        shape.radius *= 1.0 + 1e-15
    else:
        shape.halfSide *= 1.0 + 1e-15


def _moved(models: UrdfModels) -> None:
    models.visual.geometryObjects[0].placement.translation += 1e-9


def _lost(models: UrdfModels) -> None:
    models.collision.removeGeometryObject(models.collision.geometryObjects[0].name)


TAMPERING: dict[str, Callable[[UrdfModels], None]] = {
    **{
        field: _scaled(field)
        for field in ("upperVelocityLimit", "upperEffortLimit", "damping", "upperDryFrictionLimit")
    },
    **{field: _scaled(field) for field in ("lowerPositionLimit", "upperPositionLimit")},
    **{f.__name__: f for f in (_heavier, _shifted, _larger, _moved, _lost)},
}


@pytest.mark.parametrize("name", [name for name in list_robots() if load_robot(name).n_joints])
@pytest.mark.parametrize("way", TAMPERING)
def test_a_model_that_differs_from_its_file_is_refused(way: str, name: str) -> None:
    path = robot_folder(name) / "robot.urdf"
    models = read_urdf(path, free_flyer=True)
    root = ElementTree.parse(path).getroot()
    check_agreement(path, root, models.model, (models.visual, models.collision))
    TAMPERING[way](models)
    with pytest.raises(RobotDataError, match="the file says"):
        check_agreement(path, root, models.model, (models.visual, models.collision))


@pytest.mark.parametrize("name", ["mass", "moment", "com", "place", "box", "radius"])
def test_a_number_that_cannot_be_squared_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    for huge in ("1e308", "-1e200"):
        path = written(tmp_path, **{name: SOUND[name].replace("1", huge)})
        with pytest.raises(RobotDataError, match=r"<= 1e\+30|allowed: > 0") as refused:
            read_urdf(path, free_flyer=False)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("start", ["", "package://", "package://robot/", "file:///"])
def test_a_mesh_whose_name_no_disk_takes_is_not_found(start: str, tmp_path: Path) -> None:
    mesh = f"<mesh filename='{start}{'a' * 5000}.stl'/>"
    path = written(tmp_path)
    path.write_text(path.read_text().replace("<sphere radius='1'/>", mesh))
    with pytest.raises(RobotDataError, match="not found") as refused:
        read_urdf(path, free_flyer=False)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (
            {"kind": "continuous"},
            "continuous <limit> lower and upper not kept of joint 'j'; make it revolute",
        ),
        (
            {
                "more": (
                    "<safety_controller soft_lower_limit='-1' soft_upper_limit='1' k_position='1'"
                    " k_velocity='1'/>"
                )
            },
            (
                "<safety_controller> soft_lower_limit and soft_upper_limit not kept of joint 'j';"
                " write those"
            ),
        ),
        ({"more": "<safety_controller soft_lower_limit='0' k_velocity='1'/>"}, ""),
        ({}, ""),
    ],
)
def test_limits_that_nothing_keeps_are_named(
    changes: dict[str, str], named: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_urdf(written(tmp_path, **changes), free_flyer=False)
    lines = [record.message for record in caplog.records if "not kept" in record.message]
    assert len(lines) == bool(named)
    assert named in "".join(lines)

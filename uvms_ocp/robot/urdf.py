"""Read URDF text into Pinocchio models, and check that they hold the numbers of the XML.

urdfdom and Pinocchio leave out what they cannot read, so everything that later results rest on is
read a second time, from the XML alone, and compared: the tree, inertias, axes, limits, friction and
shapes. Fixed joints disappear in the model: the links they join are compared as one body.

The XML is checked before Pinocchio sees it, because its parser writes to stderr and its messages do
not say which element is wrong; and the models are checked against the XML, because it leaves out
what it cannot read.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal, NoReturn
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.record.xml_file import read_xml, read_xml_text
from uvms_ocp.robot import urdf_checks
from uvms_ocp.robot.mimic import Groups, coupled, leader_of, position_of

# Does the model that Pinocchio built hold the numbers of the XML?

Element = ElementTree.Element

_ROUNDING = 1e-11  # relative: poses are multiplied in another order
_INERTIA = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")  # row by row

_log = logging.getLogger(__name__)

_DRAWN = ("visual", "collision")
"""Elements of a link that have a shape."""

_NOT_DRAWN = "not drawn"
_FIND = "--packages DIR, or `packages` in loading of hydrodynamics.yaml, says where packages are"
_DO_WITHOUT = "`meshes: no` there, or --no-meshes, does without"
_MOST_NOTES = 4  # of one kind that are told one by one

_LFS = b"version https://git-lfs"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Mount:
    """The joint of the model that carries a link, and the pose of the link there."""

    joint: int
    X: pin.SE3


def check_agreement(
    path: Path, root: Element, model: pin.Model, shapes: Sequence[pin.GeometryModel]
) -> None:
    """Raise ``RobotDataError`` with all numbers of the XML that the model does not have.

    shapes: the visual ones, then those for collision.
    """
    findings = urdf_checks.Findings(path)
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # what comes of it is no number, which agrees with nothing
        mounts = _mounts(path, root, model)
        findings.attempt(_check_inertias, path, root, model, mounts)
        for joint in _moving_joints(root):
            findings.attempt(_check_joint, path, joint, model)
        for kind, geometry in zip(_DRAWN, shapes, strict=True):
            findings.attempt(_check_shapes, path, root, kind, geometry, mounts)
    findings.refuse()


def _moving_joints(root: Element) -> list[Element]:
    return [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]


def _mounts(path: Path, root: Element, model: pin.Model) -> dict[str, _Mount]:
    """Place every link on its joint; raises where a joint of the XML is missing in the model or
    sits elsewhere.
    """
    below: dict[str, list[Element]] = {}
    for joint in root.findall("joint"):
        below.setdefault(_end(joint, "parent"), []).append(joint)
    children = {_end(joint, "child") for joint in root.findall("joint")}
    top = next(
        name for link in root.findall("link") if (name := link.get("name", "")) not in children
    )
    on_free_flyer = model.njoints - 1 - len(_moving_joints(root))
    if on_free_flyer not in (0, 1):
        _refuse(path, "the number of moving joints", len(_moving_joints(root)), model.njoints - 1)
    mounts = {top: _Mount(joint=on_free_flyer, X=pin.SE3.Identity())}
    waiting = [top]
    while waiting:
        parent = waiting.pop()
        for joint in below.get(parent, ()):
            waiting.append(_end(joint, "child"))
            mounts[waiting[-1]] = _mount_below(path, joint, mounts[parent], model)
    return mounts


def _end(joint: Element, end: str) -> str:
    element = joint.find(end)
    if element is None:
        return ""
    return element.get("link", "")


def _mount_below(path: Path, joint: Element, parent: _Mount, model: pin.Model) -> _Mount:
    X = parent.X * _origin(path, joint)
    name = joint.get("name", "")
    if joint.get("type") == "fixed":
        return _Mount(joint=parent.joint, X=X)
    if not model.existJointName(name):
        _refuse(path, f"joint {name!r}", "a moving joint", "none")
    index = model.getJointId(name)
    _check_equal(path, f"joint {name!r} parent", parent.joint, model.parents[index])
    _check_close(
        path, f"joint {name!r} origin", X.homogeneous, model.jointPlacements[index].homogeneous
    )
    return _Mount(joint=index, X=pin.SE3.Identity())


def _origin(path: Path, element: Element) -> pin.SE3:
    origin = element.find("origin")
    vectors = (
        urdf_checks.read_vector(path, origin, key, "origin")
        if origin is not None and key in origin.attrib
        else (0.0, 0.0, 0.0)
        for key in ("xyz", "rpy")
    )
    xyz, rpy = map(np.array, vectors)
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _check_inertias(path: Path, root: Element, model: pin.Model, mounts: dict[str, _Mount]) -> None:
    stated = np.zeros((model.njoints, 6, 6))
    sizes = np.zeros((model.njoints, 6, 6))
    bodies: list[list[str]] = [[] for _ in range(model.njoints)]
    for link in root.findall("link"):
        name = link.get("name", "")
        inertial = link.find("inertial")
        if inertial is not None:
            mount = mounts[name]
            bodies[mount.joint].append(name)
            X = mount.X * _origin(path, inertial)
            part = X.dualAction @ _inertia(path, inertial) @ X.actionInverse
            stated[mount.joint] += part
            sizes[mount.joint] += np.abs(part)
    for body, matrix, size, inertia in zip(bodies, stated, sizes, model.inertias, strict=True):
        where = f"link {' with '.join(map(repr, body))}"
        built = inertia.matrix()
        for quantity, block in (
            ("mass", np.s_[:1, :1]),
            ("mass x centre", np.s_[:3, 3:]),
            ("inertia", np.s_[3:, 3:]),
        ):
            _check_close(
                path, f"{where} {quantity}", matrix[block], built[block], float(size[block].max())
            )


def _inertia(path: Path, inertial: Element) -> np.ndarray:
    """(6, 6) [kg, kg m2] about the centre of mass, linear axes first."""
    mass = urdf_checks.read_number(path, inertial.find("mass"), "value", "mass")
    values = [urdf_checks.read_number(path, inertial.find("inertia"), key, key) for key in _INERTIA]
    matrix = np.diag([mass, mass, mass, 0.0, 0.0, 0.0])
    matrix[3:, 3:] = np.reshape(values, (3, 3))
    return matrix


def _check_joint(path: Path, joint: Element, model: pin.Model) -> None:
    where = f"joint {joint.get('name')!r}"
    index = model.getJointId(joint.get("name", ""))
    built = model.joints[index]
    _check_axis(path, joint, where, model)
    v = slice(built.idx_v, built.idx_v + built.nv)
    for quantity, value, values in _velocity_numbers(path, joint, model):
        _check_equal(path, f"{where} {quantity}", np.full(built.nv, value), values[v])
    if joint.get("type") in ("revolute", "prismatic"):
        for key, positions in (
            ("lower", model.lowerPositionLimit),
            ("upper", model.upperPositionLimit),
        ):
            limit = urdf_checks.read_number(path, joint.find("limit"), key, key, default=0.0)
            _check_equal(path, f"{where} limit {key}", limit, positions[built.idx_q])


def _velocity_numbers(
    path: Path, joint: Element, model: pin.Model
) -> Iterator[tuple[str, float, np.ndarray]]:
    """Limits of a joint per velocity: its name, the number of the XML, the numbers of the model."""
    limit = joint.find("limit")
    dynamics = joint.find("dynamics")
    for key, values in (("velocity", model.upperVelocityLimit), ("effort", model.upperEffortLimit)):
        yield f"limit {key}", urdf_checks.read_number(path, limit, key, key, default=np.inf), values
    for key, values in (("damping", model.damping), ("friction", model.upperDryFrictionLimit)):
        yield (
            f"dynamics {key}",
            urdf_checks.read_number(path, dynamics, key, key, default=0.0),
            values,
        )


def _check_axis(path: Path, joint: Element, where: str, model: pin.Model) -> None:
    kind = joint.get("type")
    axis = joint.find("axis")
    if kind == "floating":
        return
    vector = np.array(
        (1.0, 0.0, 0.0) if axis is None else urdf_checks.read_vector(path, axis, "xyz", where)
    )
    built = model.joints[model.getJointId(joint.get("name", ""))]
    last = np.array(built.createData().S).reshape(6, -1)[
        :, -1
    ]  # of a planar joint: its turn, about the normal of its plane
    direction = last[:3] if kind == "prismatic" else last[3:]
    _check_close(path, f"{where} axis", vector / np.linalg.norm(vector), direction)


def _check_shapes(
    path: Path, root: Element, kind: str, geometry: pin.GeometryModel, mounts: dict[str, _Mount]
) -> None:
    stated = [
        (f"{link.get('name')}_{i}", element, mounts[link.get("name", "")])
        for link in root.findall("link")
        for i, element in enumerate(link.findall(kind))
    ]
    _check_equal(path, f"the number of {kind} shapes", len(stated), geometry.ngeoms)
    for name, element, mount in stated:
        where = f"{kind} shape {name!r}"
        if not geometry.existGeometryName(name):
            _refuse(path, where, "a shape", "none")
        _check_shape(
            path, element, mount, geometry.geometryObjects[geometry.getGeometryId(name)], where
        )


def _check_shape(
    path: Path, element: Element, mount: _Mount, built: pin.GeometryObject, where: str
) -> None:
    shape = element.find("geometry/*")
    X = mount.X * _origin(path, element)
    _check_equal(path, f"{where} joint", mount.joint, built.parentJoint)
    _check_close(path, f"{where} origin", X.homogeneous, built.placement.homogeneous)
    if shape is None:
        _refuse(path, where, "nothing", "a shape")
    stated = urdf_checks.read_sizes(path, shape, where)
    sizes = _sizes(shape.tag, built)
    if sizes is None:
        _refuse(path, where, f"a {shape.tag}", type(built.geometry).__name__)
    _check_equal(path, f"{where} {'scale' if shape.tag == 'mesh' else 'size'}", stated, sizes)


def _sizes(tag: str, built: pin.GeometryObject) -> np.ndarray | None:
    """The sizes in the order of `read_sizes`, `None` for a shape of another kind."""
    shape = built.geometry
    if tag == "mesh":
        return np.asarray(built.meshScale)
    if tag == "box" and isinstance(shape, coal.Box):
        return 2.0 * np.asarray(shape.halfSide)
    if tag == "sphere" and isinstance(shape, coal.Sphere):
        return np.array([shape.radius])
    if tag == "cylinder" and isinstance(
        shape, (coal.Cylinder, coal.Capsule)
    ):  # <collision_checking> rounds the ends
        return np.array([shape.radius, 2.0 * shape.halfLength])
    return None


def _check_equal(path: Path, where: str, stated: ArrayLike, built: ArrayLike) -> None:
    if not np.array_equal(np.asarray(stated), np.asarray(built)):
        _refuse(path, where, stated, built)


def _check_close(
    path: Path, where: str, stated: np.ndarray, built: np.ndarray, size: float | None = None
) -> None:
    """size: that of the parts of a sum, which may cancel."""
    # Not "difference > tolerance", which would let NaN pass.
    if not np.abs(stated - built).max() <= _ROUNDING * (
        np.abs(stated).max() if size is None else size
    ):
        _refuse(path, where, stated, built)


def _refuse(path: Path, where: str, stated: object, built: object) -> NoReturn:
    file, model = (urdf_checks.quoted(" ".join(str(value).split())) for value in (stated, built))
    problem = (
        f"{where}: the file says {file}, the model that Pinocchio builds has {model}; write what"
        " both agree on"
    )
    raise RobotDataError(path, problem)


# URDF text to Pinocchio models.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UrdfModels:
    """Content of one URDF: the mechanism and its two sets of shapes."""

    name: str
    model: pin.Model
    visual: pin.GeometryModel
    collision: pin.GeometryModel
    no_links: frozenset[str] = frozenset()
    """Links of the file that are left out."""
    no_joints: frozenset[str] = frozenset()
    """Moving joints of the file that are left out, or have no motion of their own here."""


@dataclass(frozen=True, kw_only=True, slots=True)
class UrdfReading:
    """Options of which parts of a file become part of the robot."""

    mimic: Literal["coupled", "free", "fixed"] = "coupled"
    """Joints that mimic another one: one with it, of their own, or fixed where the leader's lock,
    or its home, puts them.
    """
    home: Mapping[str, float] = field(default_factory=dict)
    """Stowed positions [rad or m] of joints; of others 0, or mid-range where 0 is not allowed."""
    lock: Mapping[str, float] = field(default_factory=dict)
    """Joints that are fixed at a position [rad or m]."""
    drop: tuple[str, ...] = ()
    """Links that are left out, with all that hangs on them."""
    meshes: bool = True
    """Shapes that are meshes are read."""


PLAIN = UrdfReading()
"""Everything, as it stands."""


def prepare(
    path: Path, root: Element, reading: UrdfReading, *, free_flyer: bool
) -> tuple[list[str], Groups]:
    """Leave in the <robot> what is to be read; return notes for the user, and which joints move as
    one.

    Raises ``RobotDataError`` with all mistakes.
    """
    findings = urdf_checks.Findings(path)
    _drop(findings, root, reading.drop)
    if not reading.meshes:
        _drop_meshes(findings, root)
    if free_flyer:
        _drop_floating_root(findings, root)
    unread = findings.attempt(urdf_checks.unread_words, path, root)
    locked, groups = _locked(findings, root, reading)
    notes = findings.attempt(partial(urdf_checks.check_urdf, locked=locked), path, root) or []
    findings.refuse()
    for joint in root.findall("joint"):
        if joint.get("name") in locked:
            _lock(path, joint, locked[joint.get("name", "")])
    findings.notes += notes
    if unread:
        findings.notes.append(f"not read, since it is no part of URDF: {unread}")
    for joint in root.findall("joint[mimic]") if reading.mimic == "free" else ():
        findings.notes.append(
            f"joint {joint.get('name')!r} moves on its own, its <mimic> is not kept"
        )
    return findings.notes, groups


def _drop(findings: urdf_checks.Findings, root: Element, links: Iterable[str]) -> None:
    for name in links:
        if root.find(f"link[@name={name!r}]") is None:
            link_names = ", ".join(link.get("name", "") for link in root.findall("link"))
            findings.faults.append(f"drop: link {name!r} is not in the URDF; allowed: {link_names}")
    waiting = list(links)
    while waiting:
        name = waiting.pop()
        for link in [link for link in root.findall("link") if link.get("name") == name]:
            root.remove(link)
        for joint in root.findall("joint"):
            if name in (_end(joint, "parent"), _end(joint, "child")):
                root.remove(joint)
                waiting.append(_end(joint, "child"))


def _shapes_of(root: Element) -> Iterator[tuple[Element, Element]]:
    """Yield each link with each of its elements that have a shape, which may be removed from it."""
    for link in root.findall("link"):
        yield from ((link, shape) for kind in _DRAWN for shape in link.findall(kind))


def _drop_meshes(findings: urdf_checks.Findings, root: Element) -> None:
    dropped = dict.fromkeys(_DRAWN, 0)
    for link, shape in _shapes_of(root):
        if shape.find("geometry/mesh") is not None:
            link.remove(shape)
            dropped[shape.tag] += 1
    if any(dropped.values()):
        counts = " and ".join(f"{n} {kind}" for kind, n in dropped.items())
        findings.notes.append(f"without meshes: {counts} shapes are left out")


def _drop_floating_root(findings: urdf_checks.Findings, root: Element) -> None:
    """A world on which the robot floats is the world that every free-flyer has."""
    children = {_end(joint, "child") for joint in root.findall("joint")}
    tops = [link for link in root.findall("link") if link.get("name") not in children]
    if len(tops) != 1 or len(tops[0]):
        return
    below = [
        joint for joint in root.findall("joint") if _end(joint, "parent") == tops[0].get("name")
    ]
    if len(below) == 1 and below[0].get("type") == "floating":
        root.remove(tops[0])
        root.remove(below[0])
        world = tops[0].get("name")
        joint = below[0].get("name")
        findings.notes.append(
            f"joint {joint!r} floats on the empty link {world!r}: both are the free base of the"
            " vehicle"
        )


def _locked(
    findings: urdf_checks.Findings, root: Element, reading: UrdfReading
) -> tuple[dict[str, float], Groups]:
    """Positions of the joints that do not move, and joints that move as one."""
    names = [
        joint.get("name", "") for joint in root.findall("joint") if joint.get("type") != "fixed"
    ]
    for name in reading.lock:
        if name not in names:
            findings.faults.append(
                f"lock: joint {name!r} does not move in the URDF; allowed: {', '.join(names)}"
            )
    locked = dict(reading.lock)
    groups = Groups()
    held = {**reading.home, **reading.lock}
    for joint in root.findall("joint[mimic]") if reading.mimic != "free" else ():
        leader, scale, offset = leader_of(
            findings, root, joint, reading.lock if reading.mimic == "coupled" else held
        )
        name = joint.get("name", "")
        if leader is None:
            lead = ""
        else:
            lead = leader.get("name", "")
        if name in locked:
            continue
        kinds = {joint.get("type"), None if leader is None else leader.get("type")}
        moves = reading.mimic == "coupled" and scale != 0.0 and kinds <= {"revolute", "prismatic"}
        if moves and lead not in locked:
            groups.setdefault(lead, {lead: (1.0, 0.0)})[name] = (scale, offset)
        else:
            if leader is None:
                at = 0.0
            else:
                at = position_of(findings, leader, held)
            locked[name] = held.get(name, scale * at + offset)
    return locked, groups


def _lock(path: Path, joint: Element, position: float) -> None:
    """Make a joint a fixed one, at a position [rad or m]."""
    axis = joint.find("axis")
    vector = np.array(
        (1.0, 0.0, 0.0) if axis is None else urdf_checks.read_vector(path, axis, "xyz", "axis")
    )
    along = position * vector / np.linalg.norm(vector)
    slides = joint.get("type") == "prismatic"
    X = _origin(path, joint) * (
        pin.SE3(np.eye(3), along) if slides else pin.SE3(pin.exp3(along), np.zeros(3))
    )
    for tag in ("origin", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    rpy = pin.rpy.matrixToRpy(X.rotation)
    numbers = {
        key: " ".join(map(repr, np.asarray(values).tolist()))
        for key, values in (("xyz", X.translation), ("rpy", rpy))
    }
    joint.set("type", "fixed")
    ElementTree.SubElement(joint, "origin", numbers)


def read_urdf(
    path: Path, *, free_flyer: bool, reading: UrdfReading = PLAIN, package_dirs: Sequence[Path] = ()
) -> UrdfModels:
    """Read a URDF file; all mistakes in it are one ``RobotDataError``, and so are numbers that get
    lost.

    What is left out without harm, such as a picture that is missing, is a warning each, and what
    the file holds beside a URDF one more, see `uvms_ocp.robot.urdf_checks`.

    ``package://name/...`` is searched as ``<dir>/name/...`` in ``package_dirs`` and in the folders
    above the file; other mesh paths are relative to the file.
    """
    models, notes = models_and_notes(
        path, free_flyer=free_flyer, reading=reading, package_dirs=package_dirs
    )
    for note in notes:
        _log.warning("%s: %s", path, note)
    return models


def models_and_notes(
    path: Path, *, free_flyer: bool, reading: UrdfReading, package_dirs: Sequence[Path]
) -> tuple[UrdfModels, list[str]]:
    """Read a URDF as `read_urdf` does, and return its warnings as well. Raises `RobotDataError`, as
    it does.
    """
    root = read_urdf_xml(path)
    links = {link.get("name", "") for link in root.findall("link")}
    joints = {joint.get("name", "") for joint in _moving_joints(root)}
    notes, groups = prepare(path, root, reading, free_flyer=free_flyer)
    findings = urdf_checks.Findings(path)
    _resolve_meshes(
        findings, root, (*(folder.resolve() for folder in package_dirs), *path.resolve().parents)
    )
    models = _build(findings, root, free_flyer)
    model = coupled(models.model, groups)
    moving = {name for name, joint in zip(model.names, model.joints, strict=True) if joint.nv}
    gone = links - {link.get("name", "") for link in root.findall("link")}
    models = replace(
        models, model=model, no_links=frozenset(gone), no_joints=frozenset(joints - moving)
    )
    return models, _shown([*notes, *findings.notes])


def read_urdf_xml(path: Path) -> Element:
    """Return the <robot> of a file. Raises ``RobotDataError`` for what is none."""
    try:
        root = read_xml(path)
    except OSError as error:
        raise RobotDataError(path, f"cannot be read ({error.strerror or error})") from None
    except InvalidInput as error:
        raise RobotDataError(path, f"not a URDF, {error}") from None
    if root.tag != "robot":
        raise RobotDataError(
            path, f"not a URDF, the root element is <{root.tag}>; allowed: <robot>"
        )
    return root


def _resolve_meshes(findings: urdf_checks.Findings, root: Element, folders: Sequence[Path]) -> None:
    for link, shape in _shapes_of(root):
        for mesh in shape.iter("mesh"):
            written = mesh.get("filename", "")
            mesh_file = find_mesh(findings.path, written, folders)
            if mesh_file is None:
                _give_up(findings, link, shape, f"mesh {urdf_checks.quoted(written)} not found")
            else:
                mesh.set("filename", str(mesh_file))
    findings.refuse()


def _give_up(findings: urdf_checks.Findings, link: Element, shape: Element, problem: str) -> None:
    """Leave a shape out that cannot be read and is only drawn; report a fault of the file
    otherwise.
    """
    where = f"link {link.get('name')!r} {shape.tag}: {problem}"
    if shape.tag == "visual":
        link.remove(shape)
        findings.notes.append(f"{where}; {_NOT_DRAWN}")
    else:
        findings.faults.append(
            f"{where}, and nothing would be told of what the link touches; {_FIND}, or"
            f" {_DO_WITHOUT}"
        )


def _shown(notes: Sequence[str]) -> list[str]:
    """Notes as they are told: of many that are not drawn the first, and how many more."""
    undrawn = [note for note in notes if note.endswith(_NOT_DRAWN)]
    shown = undrawn[:_MOST_NOTES]
    more = len(undrawn) - _MOST_NOTES
    if undrawn:
        shown[-1] += f", and so are {more} more" if more > 0 else ""
        shown[-1] += f"; {_FIND}" if any(" mesh" in note for note in undrawn) else ""
    return [note for note in notes if note not in undrawn] + shown


def with_own_meshes(path: Path, package_dirs: Sequence[Path] = ()) -> tuple[str, dict[str, Path]]:
    """The text of a URDF, for UTF-8, whose meshes stand in ``meshes`` beside it, and which files
    these are copies of.

    What is not found is named as it was.
    """
    text = re.sub(
        r"""(<\?xml[^>]*\sencoding\s*=\s*)["'][^"'>]*["']""",
        r'\1"utf-8"',
        read_xml_text(path),
        count=1,
    )
    folders = (*(folder.resolve() for folder in package_dirs), *path.resolve().parents)
    copies: dict[str, Path] = {}
    for written in dict.fromkeys(
        mesh.get("filename", "") for mesh in read_urdf_xml(path).iter("mesh")
    ):
        mesh_file = find_mesh(path, written, folders)
        if mesh_file is not None:
            name = f"meshes/{mesh_file.name}"
            while copies.get(name, mesh_file) != mesh_file:
                name = name.replace("meshes/", "meshes/_", 1)
            copies[name] = mesh_file
            text = text.replace(f'"{written}"', f'"{name}"').replace(f"'{written}'", f"'{name}'")
    return text, copies


def find_mesh(path: Path, filename: str, folders: Sequence[Path]) -> Path | None:
    """Find the file of a mesh of a URDF at `path`; `None` where there is none."""
    mesh_file = next(
        filter(os.path.isfile, _mesh_candidates(path, filename, folders)), None
    )  # False for a name that no disk takes
    if mesh_file is not None:
        note_file_read(mesh_file)
    return mesh_file


def _mesh_candidates(path: Path, filename: str, folders: Sequence[Path]) -> list[Path]:
    scheme, mark, relative = filename.partition("://")
    if mark and scheme in ("package", "model"):
        package, _, inside = relative.partition("/")
        return [
            place
            for folder in folders
            for place in (folder / relative, *_in_package(folder, package, inside))
        ]
    plain = Path(filename.removeprefix("file://"))
    return [path.resolve().parent / plain, *(folder / plain for folder in folders)]


def _in_package(folder: Path, package: str, inside: str) -> list[Path]:
    """The file where the folder is that package under another name, as a checkout may be."""
    manifest = folder / "package.xml"
    with suppress(OSError, InvalidInput):
        if os.path.isfile(manifest) and read_xml(manifest).findtext("name", "").strip() == package:
            return [folder / inside]
    return []


def _build(findings: urdf_checks.Findings, root: Element, free_flyer: bool) -> UrdfModels:
    path = findings.path
    try:
        model = pin.buildModelFromXML(
            _text(root), *([pin.JointModelFreeFlyer()] if free_flyer else [])
        )
        shapes = _shapes(model, root)
    except (ValueError, RuntimeError) as error:
        _drop_unreadable_meshes(findings, root)
        if not findings.notes:
            raise RobotDataError(
                path, f"Pinocchio refuses it ({' '.join(str(error).split())})"
            ) from None
        shapes = _shapes(model, root)
    check_agreement(path, root, model, shapes)
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name = f"joint {frame.name}"  # a name of a frame means one
    name = root.get("name", path.stem)
    model.name = name
    return UrdfModels(name=name, model=model, visual=shapes[0], collision=shapes[1])


def _text(root: Element) -> str:
    return ElementTree.tostring(root, encoding="unicode")


def _shapes(model: pin.Model, root: Element) -> list[pin.GeometryModel]:
    kinds = (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION)
    return [pin.buildGeomFromUrdfString(model, _text(root), kind) for kind in kinds]


def _drop_unreadable_meshes(findings: urdf_checks.Findings, root: Element) -> None:
    """Leave out meshes that coal cannot read, where they are only drawn. Raises ``RobotDataError``
    for the others.
    """
    loader = coal.MeshLoader()
    for link, shape in _shapes_of(root):
        for mesh in shape.iter("mesh"):
            problem = _unreadable(Path(mesh.get("filename", "")), loader)
            if problem:
                _give_up(findings, link, shape, problem)
    findings.refuse()


def _unreadable(file: Path, loader: coal.MeshLoader) -> str:
    with suppress(OSError), file.open("rb") as stream:
        if stream.read(len(_LFS)) == _LFS:
            return (
                f"mesh {file.name!r} is a pointer of Git LFS, without content: `git lfs pull`"
                " fetches it"
            )
    try:
        loader.load(str(file), np.ones(3))
    except (ValueError, RuntimeError):
        return f"mesh {file.name!r} cannot be read; allowed: STL, DAE or OBJ with triangles"
    return ""

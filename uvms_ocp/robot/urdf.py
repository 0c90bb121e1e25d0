"""Read URDF text into Pinocchio models, and check that they hold the numbers of the XML.

urdfdom and Pinocchio leave out what they cannot read, so everything that later results rest on is read a second time,
from the XML alone, and compared: the tree, inertias, axes, limits, friction and shapes. Fixed joints disappear in the
model: the links they join are compared as one body.

The XML is checked before Pinocchio sees it, because its parser writes to stderr and its messages do not say
which element is wrong; and the models are checked against the XML, because it leaves out what it cannot read.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.record.untrusted import note_file_read, read_xml
from uvms_ocp.robot.urdf_checks import check_urdf, quoted, read_number, read_sizes, read_vector, unread_words

# Does the model that Pinocchio built hold the numbers of the XML?
#
# urdfdom and Pinocchio leave out what they cannot read, so everything that later results rest on is read a second time,
# from the XML alone, and compared: the tree, inertias, axes, limits, friction and shapes. Fixed joints disappear in the
# model: the links they join are compared as one body.

Element = ElementTree.Element

_ROUNDING = 1e-11  # relative: poses are multiplied in another order
_INERTIA = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")  # row by row


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Mount:
    """Where a link sits: on which joint of the model, and its pose there."""

    joint: int
    X: pin.SE3


def check_agreement(path: Path, root: Element, model: pin.Model, shapes: Sequence[pin.GeometryModel]) -> None:
    """Raise ``RobotDataError`` for the first number of the XML that the model does not have.

    shapes: the visual ones, then those for collision.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is no number, which agrees with nothing
        mounts = _mounts(path, root, model)
        _check_inertias(path, root, model, mounts)
        for joint in _moving_joints(root):
            _check_joint(path, joint, model)
        for kind, geometry in zip(("visual", "collision"), shapes, strict=True):
            _check_shapes(path, root, kind, geometry, mounts)


def _moving_joints(root: Element) -> list[Element]:
    return [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]


def _mounts(path: Path, root: Element, model: pin.Model) -> dict[str, _Mount]:
    """Place every link on its joint; raises where a joint of the XML is missing in the model or sits elsewhere."""
    below: dict[str, list[Element]] = {}
    for joint in root.findall("joint"):
        below.setdefault(_end(joint, "parent"), []).append(joint)
    children = {_end(joint, "child") for joint in root.findall("joint")}
    top = next(name for link in root.findall("link") if (name := link.get("name", "")) not in children)
    on_free_flyer = model.njoints - 1 - len(_moving_joints(root))
    if on_free_flyer not in (0, 1):
        _refuse(path, "the number of moving joints", len(_moving_joints(root)), model.njoints - 1)
    mounts, waiting = {top: _Mount(joint=on_free_flyer, X=pin.SE3.Identity())}, [top]
    while waiting:
        parent = waiting.pop()
        for joint in below.get(parent, ()):
            waiting.append(_end(joint, "child"))
            mounts[waiting[-1]] = _mount_below(path, joint, mounts[parent], model)
    return mounts


def _end(joint: Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _mount_below(path: Path, joint: Element, parent: _Mount, model: pin.Model) -> _Mount:
    X, name = parent.X * _origin(path, joint), joint.get("name", "")
    if joint.get("type") == "fixed":
        return _Mount(joint=parent.joint, X=X)
    if not model.existJointName(name):
        _refuse(path, f"joint {name!r}", "a moving joint", "none")
    index = model.getJointId(name)
    _check_equal(path, f"joint {name!r} parent", parent.joint, model.parents[index])
    _check_close(path, f"joint {name!r} origin", X.homogeneous, model.jointPlacements[index].homogeneous)
    return _Mount(joint=index, X=pin.SE3.Identity())


def _origin(path: Path, element: Element) -> pin.SE3:
    origin = element.find("origin")
    vectors = (
        read_vector(path, origin, key, "origin") if origin is not None and key in origin.attrib else (0.0, 0.0, 0.0)
        for key in ("xyz", "rpy")
    )
    xyz, rpy = map(np.array, vectors)
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _check_inertias(path: Path, root: Element, model: pin.Model, mounts: dict[str, _Mount]) -> None:
    stated = np.zeros((model.njoints, 6, 6))
    bodies: list[list[str]] = [[] for _ in range(model.njoints)]
    for link in root.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if inertial is not None:
            mount = mounts[name]
            bodies[mount.joint].append(name)
            X = mount.X * _origin(path, inertial)
            stated[mount.joint] += X.dualAction @ _inertia(path, inertial) @ X.actionInverse
    for body, matrix, inertia in zip(bodies, stated, model.inertias, strict=True):
        where, built = f"link {' with '.join(map(repr, body))}", inertia.matrix()
        for what, block in (("mass", np.s_[:1, :1]), ("mass x centre", np.s_[:3, 3:]), ("inertia", np.s_[3:, 3:])):
            _check_close(path, f"{where} {what}", matrix[block], built[block])


def _inertia(path: Path, inertial: Element) -> np.ndarray:
    """(6, 6) [kg, kg m2] about the centre of mass, linear axes first."""
    mass = read_number(path, inertial.find("mass"), "value", "mass")
    values = [read_number(path, inertial.find("inertia"), key, key) for key in _INERTIA]
    matrix = np.diag([mass, mass, mass, 0.0, 0.0, 0.0])
    matrix[3:, 3:] = np.reshape(values, (3, 3))
    return matrix


def _check_joint(path: Path, joint: Element, model: pin.Model) -> None:
    where, index = f"joint {joint.get('name')!r}", model.getJointId(joint.get("name", ""))
    built = model.joints[index]
    _check_axis(path, joint, where, model)
    v = slice(built.idx_v, built.idx_v + built.nv)
    for what, value, values in _velocity_numbers(path, joint, model):
        _check_equal(path, f"{where} {what}", np.full(built.nv, value), values[v])
    if joint.get("type") in ("revolute", "prismatic"):
        for key, positions in (("lower", model.lowerPositionLimit), ("upper", model.upperPositionLimit)):
            limit = read_number(path, joint.find("limit"), key, key, default=0.0)
            _check_equal(path, f"{where} limit {key}", limit, positions[built.idx_q])


def _velocity_numbers(path: Path, joint: Element, model: pin.Model) -> Iterator[tuple[str, float, np.ndarray]]:
    """Limits of a joint per velocity: its name, the number of the XML, the numbers of the model."""
    limit, dynamics = joint.find("limit"), joint.find("dynamics")
    for key, values in (("velocity", model.upperVelocityLimit), ("effort", model.upperEffortLimit)):
        yield f"limit {key}", read_number(path, limit, key, key, default=np.inf), values
    for key, values in (("damping", model.damping), ("friction", model.upperDryFrictionLimit)):
        yield f"dynamics {key}", read_number(path, dynamics, key, key, default=0.0), values


def _check_axis(path: Path, joint: Element, where: str, model: pin.Model) -> None:
    kind, axis = joint.get("type"), joint.find("axis")
    if kind == "floating":
        return
    vector = np.array((1.0, 0.0, 0.0) if axis is None else read_vector(path, axis, "xyz", where))
    built = model.joints[model.getJointId(joint.get("name", ""))]
    data = built.createData()
    built.calc(data, pin.neutral(model))
    last = np.array(data.S).reshape(6, -1)[:, -1]  # of a planar joint: its turn, about the normal of its plane
    direction = last[:3] if kind == "prismatic" else last[3:]
    _check_close(path, f"{where} axis", vector / np.linalg.norm(vector), direction)


def _check_shapes(path: Path, root: Element, kind: str, geometry: pin.GeometryModel, mounts: dict[str, _Mount]) -> None:
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
        _check_shape(path, element, mount, geometry.geometryObjects[geometry.getGeometryId(name)], where)


def _check_shape(path: Path, element: Element, mount: _Mount, built: pin.GeometryObject, where: str) -> None:
    shape, X = element.find("geometry/*"), mount.X * _origin(path, element)
    _check_equal(path, f"{where} joint", mount.joint, built.parentJoint)
    _check_close(path, f"{where} origin", X.homogeneous, built.placement.homogeneous)
    if shape is None:
        _refuse(path, where, "nothing", "a shape")
    stated, sizes = read_sizes(path, shape, where), _sizes(shape.tag, built)
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
    if tag == "cylinder" and isinstance(shape, (coal.Cylinder, coal.Capsule)):  # <collision_checking> rounds the ends
        return np.array([shape.radius, 2.0 * shape.halfLength])
    return None


def _check_equal(path: Path, where: str, stated: ArrayLike, built: ArrayLike) -> None:
    if not np.array_equal(np.asarray(stated), np.asarray(built)):
        _refuse(path, where, stated, built)


def _check_close(path: Path, where: str, stated: np.ndarray, built: np.ndarray) -> None:
    # Not "difference > tolerance", which would let NaN pass.
    if not np.abs(stated - built).max() <= _ROUNDING * np.abs(stated).max():
        _refuse(path, where, stated, built)


def _refuse(path: Path, where: str, stated: object, built: object) -> NoReturn:
    file, model = (quoted(" ".join(str(value).split())) for value in (stated, built))
    problem = f"{where}: the file says {file}, the model that Pinocchio builds has {model}; write what both agree on"
    raise RobotDataError(path, problem)


# URDF text to Pinocchio models.
#
# The XML is checked before Pinocchio sees it, because its parser writes to stderr and its messages do not say
# which element is wrong; and the models are checked against the XML, because it leaves out what it cannot read.

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UrdfModels:
    """Content of one URDF: the mechanism and its two sets of shapes."""

    name: str
    model: pin.Model
    visual: pin.GeometryModel
    collision: pin.GeometryModel


def read_urdf(
    path: Path, *, free_flyer: bool, package_dirs: Sequence[Path] = (), let_mimic: bool = False
) -> UrdfModels:
    """Read a URDF file; every mistake in it is a one-line ``RobotDataError``, and so is a number that gets lost.

    What the file holds beside a URDF is one warning, see `uvms_ocp.robot.urdf_checks`.

    ``package://name/...`` is searched as ``<dir>/name/...`` in ``package_dirs`` and in the folders above the
    file; other mesh paths are relative to the file. Joints that
    mimic another one are refused, unless ``let_mimic`` makes them joints of their own.
    """
    root = _parse(path)
    unread = unread_words(path, root)
    check_urdf(path, root, let_mimic=let_mimic)
    if unread:
        _log.warning("%s: not read, since it is no part of URDF: %s", path, unread)
    for joint in root.findall("joint[mimic]"):
        _log.warning("%s: joint %r moves on its own, its <mimic> is not kept", path, joint.get("name"))
    _resolve_meshes(path, root, (*(folder.resolve() for folder in package_dirs), *path.resolve().parents))
    return _build(path, root, free_flyer)


def _parse(path: Path) -> Element:
    try:
        root = read_xml(path)
    except OSError as error:
        raise RobotDataError(path, f"cannot be read ({error.strerror or error})") from None
    except InvalidInput as error:
        raise RobotDataError(path, f"not a URDF, {error}") from None
    if root.tag != "robot":
        raise RobotDataError(path, f"not a URDF, the root element is <{root.tag}>; allowed: <robot>")
    return root


def _resolve_meshes(path: Path, root: Element, search: Iterable[Path]) -> None:
    folders = tuple(search)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(_resolve_mesh(path, mesh.get("filename", ""), folders)))


def _resolve_mesh(path: Path, filename: str, folders: Sequence[Path]) -> Path:
    for candidate in _mesh_candidates(path, filename, folders):
        if candidate.is_file():
            note_file_read(candidate)
            return candidate
    advice = (
        "give package_dirs=[folder that contains the package], `check-robot --packages DIR`; or put that above the URDF"
    )
    raise RobotDataError(path, f"mesh {filename!r} not found; {advice}")


def _mesh_candidates(path: Path, filename: str, folders: Sequence[Path]) -> list[Path]:
    if filename.startswith("package://"):
        relative = filename.removeprefix("package://")
        return [folder / relative for folder in folders]
    plain = Path(filename.removeprefix("file://"))
    return [path.resolve().parent / plain, *(folder / plain for folder in folders)]


def _build(path: Path, root: Element, free_flyer: bool) -> UrdfModels:
    text = ElementTree.tostring(root, encoding="unicode")
    try:
        model = pin.buildModelFromXML(text, *([pin.JointModelFreeFlyer()] if free_flyer else []))
        shapes = [
            pin.buildGeomFromUrdfString(model, text, kind)
            for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION)
        ]
    except (ValueError, RuntimeError) as error:
        raise RobotDataError(path, f"Pinocchio refuses it ({' '.join(str(error).split())})") from None
    check_agreement(path, root, model, shapes)
    name = root.get("name", path.stem)
    model.name = name
    return UrdfModels(name=name, model=model, visual=shapes[0], collision=shapes[1])

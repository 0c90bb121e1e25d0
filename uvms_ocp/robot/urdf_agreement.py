"""Check that the model that Pinocchio built holds the numbers of the XML of a URDF.

urdfdom and Pinocchio leave out what they cannot read, so everything that later results rest on is
read a second time, from the XML alone, and compared: the tree, inertias, axes, limits, friction and
shapes. Fixed joints disappear in the model: the links they join are compared as one body.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.urdf_elements import (
    DRAWN,
    Element,
    linked_name,
    moving_joints,
    quoted,
    read_axis,
    read_number,
    read_origin,
    read_sizes,
)
from uvms_ocp.robot.urdf_findings import Findings

_ROUNDING = 1e-11  # relative: poses are multiplied in another order
_INERTIA = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")  # row by row


def check_agreement(
    path: Path, root: Element, model: pin.Model, shapes: Sequence[pin.GeometryModel]
) -> None:
    """Raise ``RobotDataError`` with all numbers of the XML that the model does not have.

    shapes: the visual ones, then those for collision.
    """
    findings = Findings(path)
    # What comes of an overflow is no number, which agrees with nothing.
    with np.errstate(over="ignore", invalid="ignore"):
        mounts = _mounts(path, root, model)
        findings.attempt(_check_inertias, path, root, model, mounts)
        for joint in moving_joints(root):
            findings.attempt(_check_joint, path, joint, model)
        for kind, geometry in zip(DRAWN, shapes, strict=True):
            findings.attempt(_check_shapes, path, root, kind, geometry, mounts)
    findings.refuse()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Mount:
    """The joint of the model that carries a link, and the pose of the link there."""

    joint: int
    X: pin.SE3


def _mounts(path: Path, root: Element, model: pin.Model) -> dict[str, _Mount]:
    """Place every link on its joint; raises where a joint of the XML is missing in the model or
    sits elsewhere.
    """
    joints_below: dict[str, list[Element]] = {}
    children = set[str]()
    for joint in root.findall("joint"):
        joints_below.setdefault(linked_name(joint, "parent"), []).append(joint)
        children.add(linked_name(joint, "child"))
    link_names = [link.get("name", "") for link in root.findall("link")]
    top = next(name for name in link_names if name not in children)
    n_moving = len(moving_joints(root))
    root_joint = model.njoints - 1 - n_moving  # 1 on a free-flyer, 0 in the world
    if root_joint not in (0, 1):
        _refuse(path, "the number of moving joints", n_moving, model.njoints - 1)
    mounts = {top: _Mount(joint=root_joint, X=pin.SE3.Identity())}
    waiting = [top]
    while waiting:
        parent = waiting.pop()
        for joint in joints_below.get(parent, ()):
            child = linked_name(joint, "child")
            mounts[child] = _mount_below(path, joint, mounts[parent], model)
            waiting.append(child)
    return mounts


def _mount_below(path: Path, joint: Element, parent: _Mount, model: pin.Model) -> _Mount:
    X = parent.X * read_origin(path, joint)
    name = joint.get("name", "")
    if joint.get("type") == "fixed":
        return _Mount(joint=parent.joint, X=X)
    if not model.existJointName(name):
        _refuse(path, f"joint {name!r}", "a moving joint", "none")
    index = model.getJointId(name)
    placement = model.jointPlacements[index]
    _check_equal(path, f"joint {name!r} parent", parent.joint, model.parents[index])
    _check_close(path, f"joint {name!r} origin", X.homogeneous, placement.homogeneous)
    return _Mount(joint=index, X=pin.SE3.Identity())


def _check_inertias(path: Path, root: Element, model: pin.Model, mounts: dict[str, _Mount]) -> None:
    stated = np.zeros((model.njoints, 6, 6))
    sizes = np.zeros((model.njoints, 6, 6))
    links: list[list[str]] = [[] for _ in range(model.njoints)]
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        name = link.get("name", "")
        mount = mounts[name]
        links[mount.joint].append(name)
        X = mount.X * read_origin(path, inertial)
        link_inertia = X.dualAction @ _inertia(path, inertial) @ X.actionInverse
        stated[mount.joint] += link_inertia
        sizes[mount.joint] += np.abs(link_inertia)
    for names, matrix, size, inertia in zip(links, stated, sizes, model.inertias, strict=True):
        where = f"link {' with '.join(map(repr, names))}"
        built = inertia.matrix()
        for quantity, block in (
            ("mass", np.s_[:1, :1]),
            ("mass x centre", np.s_[:3, 3:]),
            ("inertia", np.s_[3:, 3:]),
        ):
            largest = float(size[block].max())
            _check_close(path, f"{where} {quantity}", matrix[block], built[block], largest)


def _inertia(path: Path, inertial: Element) -> np.ndarray:
    """Return the inertia (6, 6) [kg, kg m2] about the centre of mass, linear axes first."""
    mass = read_number(path, inertial.find("mass"), "value", "mass")
    values = [read_number(path, inertial.find("inertia"), key, key) for key in _INERTIA]
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
        limit = joint.find("limit")
        lower = read_number(path, limit, "lower", "lower", default=0.0)
        _check_equal(path, f"{where} limit lower", lower, model.lowerPositionLimit[built.idx_q])
        upper = read_number(path, limit, "upper", "upper", default=0.0)
        _check_equal(path, f"{where} limit upper", upper, model.upperPositionLimit[built.idx_q])


def _velocity_numbers(
    path: Path, joint: Element, model: pin.Model
) -> Iterator[tuple[str, float, np.ndarray]]:
    """Yield limits of a joint per velocity: its name, the number of the XML, the numbers of the
    model.
    """
    limit = joint.find("limit")
    dynamics = joint.find("dynamics")
    for key, values in (("velocity", model.upperVelocityLimit), ("effort", model.upperEffortLimit)):
        stated = read_number(path, limit, key, key, default=np.inf)
        yield f"limit {key}", stated, values
    for key, values in (("damping", model.damping), ("friction", model.upperDryFrictionLimit)):
        stated = read_number(path, dynamics, key, key, default=0.0)
        yield f"dynamics {key}", stated, values


def _check_axis(path: Path, joint: Element, where: str, model: pin.Model) -> None:
    kind = joint.get("type")
    if kind == "floating":
        return
    axis = read_axis(path, joint, where)
    built = model.joints[model.getJointId(joint.get("name", ""))]
    S = np.array(built.createData().S).reshape(6, -1)
    last_motion = S[:, -1]  # of a planar joint: its turn, about the normal of its plane
    if kind == "prismatic":
        direction = last_motion[:3]
    else:
        direction = last_motion[3:]
    _check_close(path, f"{where} axis", axis / np.linalg.norm(axis), direction)


def _check_shapes(
    path: Path, root: Element, kind: str, geometry: pin.GeometryModel, mounts: dict[str, _Mount]
) -> None:
    n_stated = len(root.findall(f"link/{kind}"))
    _check_equal(path, f"the number of {kind} shapes", n_stated, geometry.ngeoms)
    for link in root.findall("link"):
        for i, element in enumerate(link.findall(kind)):
            mount = mounts[link.get("name", "")]
            name = f"{link.get('name')}_{i}"
            where = f"{kind} shape {name!r}"
            if not geometry.existGeometryName(name):
                _refuse(path, where, "a shape", "none")
            built = geometry.geometryObjects[geometry.getGeometryId(name)]
            _check_shape(path, element, mount, built, where)


def _check_shape(
    path: Path, element: Element, mount: _Mount, built: pin.GeometryObject, where: str
) -> None:
    shape = element.find("geometry/*")
    X = mount.X * read_origin(path, element)
    _check_equal(path, f"{where} joint", mount.joint, built.parentJoint)
    _check_close(path, f"{where} origin", X.homogeneous, built.placement.homogeneous)
    if shape is None:
        _refuse(path, where, "nothing", "a shape")
    stated = read_sizes(path, shape, where)
    sizes = _sizes(shape.tag, built)
    if sizes is None:
        _refuse(path, where, f"a {shape.tag}", type(built.geometry).__name__)
    quantity = "scale" if shape.tag == "mesh" else "size"
    _check_equal(path, f"{where} {quantity}", stated, sizes)


def _sizes(tag: str, built: pin.GeometryObject) -> np.ndarray | None:
    """Return the sizes in the order of `read_sizes`, `None` for a shape of another kind."""
    shape = built.geometry
    if tag == "mesh":
        return np.asarray(built.meshScale)
    if tag == "box" and isinstance(shape, coal.Box):
        return 2.0 * np.asarray(shape.halfSide)
    if tag == "sphere" and isinstance(shape, coal.Sphere):
        return np.array([shape.radius])
    # <collision_checking> rounds the ends of cylinders.
    if tag == "cylinder" and isinstance(shape, (coal.Cylinder, coal.Capsule)):
        return np.array([shape.radius, 2.0 * shape.halfLength])
    return None


def _check_equal(path: Path, where: str, stated: ArrayLike, built: ArrayLike) -> None:
    if not np.array_equal(np.asarray(stated), np.asarray(built)):
        _refuse(path, where, stated, built)


def _check_close(
    path: Path, where: str, stated: np.ndarray, built: np.ndarray, size: float | None = None
) -> None:
    """Refuse numbers that differ by more than rounding; size: of the parts of a sum, which may
    cancel.
    """
    if size is None:
        size = np.abs(stated).max()
    # Not "difference > tolerance", which would let NaN pass.
    if not np.abs(stated - built).max() <= _ROUNDING * size:
        _refuse(path, where, stated, built)


def _refuse(path: Path, where: str, stated: object, built: object) -> NoReturn:
    in_file = quoted(" ".join(str(stated).split()))
    in_model = quoted(" ".join(str(built).split()))
    problem = (
        f"{where}: the file says {in_file}, the model that Pinocchio builds has {in_model}; write"
        " what both agree on"
    )
    raise RobotDataError(path, problem)

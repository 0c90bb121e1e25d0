"""Read URDF text into Pinocchio models.

The XML is checked before Pinocchio sees it, because its parser writes to stderr and its messages do
not say which element is wrong; and the models are checked against the XML, because it leaves out
what it cannot read.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.dialects.robot_xml import read_robot_xml
from uvms_ocp.robot.mimic import Groups, coupled, leader_of, position_of
from uvms_ocp.robot.urdf_agreement import check_agreement
from uvms_ocp.robot.urdf_checks import check_urdf
from uvms_ocp.robot.urdf_elements import (
    DRAWN,
    Element,
    linked_name,
    moving_joints,
    quoted,
    read_axis,
    read_origin,
    read_sizes,
)
from uvms_ocp.robot.urdf_findings import Findings
from uvms_ocp.robot.urdf_meshes import collada_asset, find_mesh, mesh_problem
from uvms_ocp.robot.urdf_words import unread_words

_log = logging.getLogger(__name__)

_NOT_DRAWN = "not drawn"
_FIND = "--packages DIR, or `packages` in loading of hydrodynamics.yaml, says where packages are"
_DO_WITHOUT = "`meshes: no` there, or --no-meshes, does without"
_MAX_NOTES = 4  # of one kind that are told one by one


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
    joint_groups: Groups = field(default_factory=dict)
    """Joints that move as one."""


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


def _prepare(
    path: Path, root: Element, reading: UrdfReading, *, free_flyer: bool
) -> tuple[list[str], Groups]:
    """Leave in the <robot> what is to be read; return notes for the user, and which joints move as
    one.

    Raises ``RobotDataError`` with all mistakes.
    """
    findings = Findings(path)
    _drop(findings, root, reading.drop)
    if not reading.meshes:
        _drop_meshes(findings, root)
    if free_flyer:
        _drop_floating_root(findings, root)
    _settle_capsules(findings, root)
    unread = findings.attempt(unread_words, path, root)
    locked, groups = _locked(findings, root, reading)
    notes = findings.attempt(partial(check_urdf, locked=locked), path, root) or []
    findings.refuse()
    for joint in root.findall("joint"):
        if joint.get("name") in locked:
            _lock(path, joint, locked[joint.get("name", "")])
    findings.notes += notes
    if unread:
        findings.notes.append(f"not read, since it is no part of URDF: {unread}")
    if reading.mimic == "free":
        for joint in root.findall("joint[mimic]"):
            findings.notes.append(
                f"joint {joint.get('name')!r} moves on its own, its <mimic> is not kept"
            )
    return findings.notes, groups


def _drop(findings: Findings, root: Element, links: Iterable[str]) -> None:
    """Leave out links with all that hangs on them."""
    for name in links:
        if root.find(f"link[@name={name!r}]") is None:
            link_names = ", ".join(link.get("name", "") for link in root.findall("link"))
            findings.faults.append(f"drop: link {name!r} is not in the URDF; allowed: {link_names}")
    waiting = list(links)
    while waiting:
        name = waiting.pop()
        for link in root.findall("link"):
            if link.get("name") == name:
                root.remove(link)
        for joint in root.findall("joint"):
            if name in (linked_name(joint, "parent"), linked_name(joint, "child")):
                root.remove(joint)
                waiting.append(linked_name(joint, "child"))


def _shapes_of(root: Element) -> Iterator[tuple[Element, Element]]:
    """Yield each link with each of its elements that have a shape, which may be removed from it."""
    for link in root.findall("link"):
        for kind in DRAWN:
            for shape in link.findall(kind):
                yield link, shape


def _drop_meshes(findings: Findings, root: Element) -> None:
    dropped = dict.fromkeys(DRAWN, 0)
    for link, shape in _shapes_of(root):
        if shape.find("geometry/mesh") is not None:
            link.remove(shape)
            dropped[shape.tag] += 1
    if any(dropped.values()):
        counts = " and ".join(f"{n} {kind}" for kind, n in dropped.items())
        findings.notes.append(f"without meshes: {counts} shapes are left out")


def _settle_capsules(findings: Findings, root: Element) -> None:
    """Write ``<capsule>``, a word of some simulators, as a cylinder, whose ends Pinocchio rounds
    where it may touch something. The length is that of the straight part.
    """
    names = list[str]()
    for link, shape in _shapes_of(root):
        capsule = shape.find("geometry/capsule")
        if capsule is None:
            continue
        capsule.tag = "cylinder"
        names.append(quoted(link.get("name", "")))
        if shape.tag == "collision":
            name = f"capsule_{len(names)}"
            shape.set("name", name)
            checking = link.find("collision_checking")
            if checking is None:
                checking = ElementTree.SubElement(link, "collision_checking")
            ElementTree.SubElement(checking, "capsule", {"name": name})
    if names:
        findings.notes.append(
            f"<capsule> of link {_first_of([*dict.fromkeys(names)])} is read with the length of its"
            " straight part, and drawn without its ends"
        )


def _drop_floating_root(findings: Findings, root: Element) -> None:
    """Leave out a world on which the robot floats: it is the world that every free-flyer has."""
    children = {linked_name(joint, "child") for joint in root.findall("joint")}
    tops = [link for link in root.findall("link") if link.get("name") not in children]
    if len(tops) != 1 or len(tops[0]):
        return
    world = tops[0]
    world_name = world.get("name")
    joints = [j for j in root.findall("joint") if linked_name(j, "parent") == world_name]
    if len(joints) == 1 and joints[0].get("type") == "floating":
        root.remove(world)
        root.remove(joints[0])
        findings.notes.append(
            f"joint {joints[0].get('name')!r} floats on the empty link {world_name!r}: both are the"
            " free base of the vehicle"
        )


def _locked(
    findings: Findings, root: Element, reading: UrdfReading
) -> tuple[dict[str, float], Groups]:
    """Return positions [rad or m] of the joints that do not move, and joints that move as one."""
    names = [joint.get("name", "") for joint in moving_joints(root)]
    for name in reading.lock:
        if name not in names:
            findings.faults.append(
                f"lock: joint {name!r} does not move in the URDF; allowed: {', '.join(names)}"
            )
    locked = dict(reading.lock)
    groups = Groups()
    if reading.mimic == "free":
        return locked, groups
    held = {**reading.home, **reading.lock}
    known = reading.lock if reading.mimic == "coupled" else held
    for joint in root.findall("joint[mimic]"):
        leader, scale, offset = leader_of(findings, root, joint, known)
        name = joint.get("name", "")
        if name in locked:
            continue
        if leader is None:
            locked[name] = held.get(name, scale * 0.0 + offset)
            continue
        leader_name = leader.get("name", "")
        have_limits = {joint.get("type"), leader.get("type")} <= {"revolute", "prismatic"}
        moves = reading.mimic == "coupled" and scale != 0.0 and have_limits
        if moves and leader_name not in locked:
            group = groups.setdefault(leader_name, {leader_name: (1.0, 0.0)})
            group[name] = (scale, offset)
        else:
            leader_position = position_of(findings, leader, held)
            locked[name] = held.get(name, scale * leader_position + offset)
    return locked, groups


def _lock(path: Path, joint: Element, position: float) -> None:
    """Make a joint a fixed one, at a position [rad or m]."""
    axis = read_axis(path, joint, "axis")
    along = position * axis / np.linalg.norm(axis)
    if joint.get("type") == "prismatic":
        motion = pin.SE3(np.eye(3), along)
    else:
        motion = pin.SE3(pin.exp3(along), np.zeros(3))
    X = read_origin(path, joint) * motion
    for tag in ("origin", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    joint.set("type", "fixed")
    origin = {"xyz": _words(X.translation), "rpy": _words(pin.rpy.matrixToRpy(X.rotation))}
    ElementTree.SubElement(joint, "origin", origin)


def _words(values: np.ndarray) -> str:
    """Write numbers in full, with spaces between."""
    return " ".join(map(repr, np.asarray(values).tolist()))


def read_urdf(
    path: Path, *, free_flyer: bool, reading: UrdfReading = PLAIN, package_dirs: Sequence[Path] = ()
) -> UrdfModels:
    """Read a URDF file, or one of another format as the URDF that says the same.

    All mistakes in it are one ``RobotDataError``, and so are numbers that get lost.

    What is left out without harm, such as a picture that is missing, is a warning each, and what
    the file holds beside a URDF one more, see `uvms_ocp.robot.urdf_words`.

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
    robot_xml = read_robot_xml(path, package_dirs)
    root = robot_xml.root
    links = {link.get("name", "") for link in root.findall("link")}
    joints = {joint.get("name", "") for joint in moving_joints(root)}
    notes, groups = _prepare(path, root, reading, free_flyer=free_flyer)
    findings = Findings(path)
    folders = (*(folder.resolve() for folder in package_dirs), *path.resolve().parents)
    _resolve_meshes(findings, root, folders)
    _scale_to_metres(findings, root)
    models = _build(findings, root, free_flyer)
    model = coupled(models.model, groups)
    moving = {name for name, joint in zip(model.names, model.joints, strict=True) if joint.nv}
    remaining_links = {link.get("name", "") for link in root.findall("link")}
    models = replace(
        models,
        model=model,
        no_links=frozenset(links - remaining_links),
        no_joints=frozenset(joints - moving),
        joint_groups=groups,
    )
    return models, _shortened([*robot_xml.notes, *notes, *findings.notes])


def _resolve_meshes(findings: Findings, root: Element, folders: Sequence[Path]) -> None:
    for link, shape in _shapes_of(root):
        for mesh in shape.iter("mesh"):
            written = mesh.get("filename", "")
            mesh_file = find_mesh(findings.path, written, folders)
            if mesh_file is None:
                _give_up(findings, link, shape, f"mesh {quoted(written)} not found")
            else:
                mesh.set("filename", str(mesh_file))
    findings.refuse()


def _scale_to_metres(findings: Findings, root: Element) -> None:
    """Multiply the scale of Collada meshes by the unit that they state, which the loader does not
    do. Their axes stay, as in RViz: most files that state y up have z up.
    """
    units = dict[str, float]()
    turned = dict[str, str]()
    for link, shape in _shapes_of(root):
        for mesh in shape.iter("mesh"):
            file = Path(mesh.get("filename", ""))
            asset = collada_asset(file)
            if asset.up_axis != "Z_UP":
                turned[file.name] = asset.up_axis
            if asset.metres == 1.0:
                continue
            units[file.name] = asset.metres
            where = f"link {link.get('name')!r} {shape.tag}"
            scale = np.array(read_sizes(findings.path, mesh, where))
            mesh.set("scale", _words(scale * asset.metres))
    if units:
        stated = [f"{name!r} ({metres:g} m)" for name, metres in units.items()]
        findings.notes.append(f"meshes that state a unit are read in it: {_first_of(stated)}")
    if turned:
        stated = [f"{name!r} ({axis})" for name, axis in turned.items()]
        findings.notes.append(
            f"meshes that state other axes than z up are not turned, as in RViz: {_first_of(stated)};"
            " look at the picture of `uvms-ocp show`"
        )


def _first_of(words: Sequence[str]) -> str:
    """Return the first words in a row, and how many more there are."""
    text = ", ".join(words[:_MAX_NOTES])
    n_more = len(words) - _MAX_NOTES
    if n_more > 0:
        text += f" and {n_more} more"
    return text


def _give_up(findings: Findings, link: Element, shape: Element, problem: str) -> None:
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


def _shortened(notes: Sequence[str]) -> list[str]:
    """Return the notes; of many shapes that are not drawn the first, and how many more."""
    undrawn = [note for note in notes if note.endswith(_NOT_DRAWN)]
    if not undrawn:
        return [*notes]
    first_undrawn = undrawn[:_MAX_NOTES]
    n_more = len(undrawn) - _MAX_NOTES
    if n_more > 0:
        first_undrawn[-1] += f", and so are {n_more} more"
    if any(" mesh" in note for note in undrawn):
        first_undrawn[-1] += f"; {_FIND}"
    return [note for note in notes if note not in undrawn] + first_undrawn


def _build(findings: Findings, root: Element, free_flyer: bool) -> UrdfModels:
    path = findings.path
    try:
        if free_flyer:
            model = pin.buildModelFromXML(_text(root), pin.JointModelFreeFlyer())
        else:
            model = pin.buildModelFromXML(_text(root))
        shapes = _shapes(model, root)
    except (ValueError, RuntimeError) as error:
        _drop_unreadable_meshes(findings, root)
        if not findings.notes:
            reason = " ".join(str(error).split())
            raise RobotDataError(path, f"Pinocchio refuses it ({reason})") from None
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


def _drop_unreadable_meshes(findings: Findings, root: Element) -> None:
    """Leave out meshes that coal cannot read, where they are only drawn. Raises ``RobotDataError``
    for the others.
    """
    loader = coal.MeshLoader()
    for link, shape in _shapes_of(root):
        for mesh in shape.iter("mesh"):
            problem = mesh_problem(Path(mesh.get("filename", "")), loader)
            if problem:
                _give_up(findings, link, shape, problem)
    findings.refuse()

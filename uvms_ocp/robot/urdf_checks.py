"""Check the XML of a URDF: links, joints and the tree they form, one line per mistake that names the
element.

Pinocchio's parser writes to stderr, ignores what it does not understand and does not say which
element is wrong.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.urdf_elements import (
    SHAPES,
    Element,
    quoted,
    read_number,
    read_sizes,
    read_vector,
    to_float,
    to_floats,
)
from uvms_ocp.robot.urdf_findings import Findings
from uvms_ocp.robot.urdf_words import PLACES

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_WATER_DENSITY = 1000.0  # [kg/m3]
_ROUNDING = 1e-9  # share of a principal moment, or of that of a cube of water as heavy
_SHOWN_NAMES = 10  # names in a message
# a humanoid with hands has 150; Pinocchio's recursion ends the process at some thousands in a row
_MAX_LINKS = 1000
_SCALES = (1e-6, 1e6)  # of meshes, from micrometres to metres and back; beyond them digits are lost
_LOCK = "--lock JOINT, or `lock: {JOINT: 0}` in loading of hydrodynamics.yaml"
_UNUSED = {
    "mimic": ("multiplier", "offset"),
    "calibration": ("rising", "falling"),
    "safety_controller": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
}
"""Attributes of elements of a joint that are numbers, though nothing here uses them."""

_NOT_KEPT = (
    ("continuous", "limit", ("lower", "upper"), "make it revolute to keep them"),
    (
        "",
        "safety_controller",
        ("soft_lower_limit", "soft_upper_limit"),
        "write those that hold into <limit>",
    ),
)
"""Type of the joints (empty for all), tag and attributes of limits that nothing here keeps, and
what to do.
"""


def check_urdf(path: Path, root: Element, *, locked: Collection[str] = ()) -> list[str]:
    """Raise ``RobotDataError`` with all mistakes in links, joints and the tree they form; return
    notes, one line for each element that is left out.

    Taken out of `root` are visuals that cannot be drawn, elements that stand twice, shapes without
    extent and limits below 0 of joints that turn without end. Limits that nothing here keeps are
    noted. locked: names of joints that need no limits.
    """
    findings = Findings(path)
    if not root.get("name"):
        findings.faults.append("the <robot> has no name")
    _settle_visuals(findings, root)
    _settle_materials(findings, root)
    _check_repeats(findings, root)
    _check_links(findings, root)
    _check_joints(findings, root, locked)
    _name_limits_not_kept(findings, root)
    findings.attempt(_check_tree, path, root)
    findings.refuse()
    return findings.notes


def _settle_visuals(findings: Findings, root: Element) -> None:
    """Take out visuals that cannot be drawn."""
    for link in root.findall("link"):
        where = f"link {link.get('name')!r} visual"
        for visual in link.findall("visual"):
            try:
                for element in visual.iter():
                    _drop_twins(findings, element, where)
                _check_origin(findings.path, visual, where)
                _check_shape(findings.path, visual.findall("geometry/*"), where)
            except RobotDataError as error:
                link.remove(visual)
                findings.notes.append(f"{'; '.join(error.problems)}; not drawn")


def _settle_materials(findings: Findings, root: Element) -> None:
    """Take out materials without a colour: visuals of them are drawn grey."""
    # A <material> elsewhere in the file is that of a simulator.
    shared_materials = root.findall("material")
    used_materials = root.findall("link/visual/material")
    colours = dict[str, Element]()
    for material in reversed([*shared_materials, *used_materials]):
        if _is_drawn(material):
            colours[material.get("name", "")] = material
    colours.pop("", None)
    for parent in (root, *root.findall("link/visual")):
        for material in parent.findall("material"):
            name = material.get("name", "")
            is_another_of_root = parent is root and material is not colours.get(name)
            if name in colours and not is_another_of_root:
                material[:] = list(colours[name])  # urdfdom knows what stands in the <robot> alone
                continue
            parent.remove(material)
            if _is_drawn(material) and not name:
                material.set("name", f"unnamed{sum(1 for _ in root.iter('material'))}")
                parent.append(material)
            else:
                findings.notes.append(
                    f"material {name!r}: no colour of that name in the file; drawn grey"
                )


def _is_drawn(material: Element) -> bool:
    """Check whether a material has a colour, or a texture in place of it."""
    colour = material.find("color")
    if colour is None:
        return material.find("texture") is not None
    values = to_floats(colour.get("rgba", ""))
    return len(values) == 4 and all(0.0 <= value <= 1.0 for value in values)


def _check_repeats(findings: Findings, root: Element) -> None:
    """Check links and joints for elements that stand twice."""
    for part in (*root.findall("link"), *root.findall("joint")):
        for element in part.iter():
            where = f"{part.tag} {part.get('name')!r}"
            if element is not part:
                where = f"{where} {element.tag}"
            findings.attempt(_drop_twins, findings, element, where)


def _drop_twins(findings: Findings, element: Element, where: str) -> None:
    """Take out elements that repeat an equal one, and a second ``<origin>``. Raises
    ``RobotDataError`` for other elements that stand twice and differ: parsers take the first of two.
    """
    first: dict[str, Element] = {}
    once = PLACES[element.tag].once if element.tag in PLACES else ()
    for child in [child for child in element if child.tag in once]:
        twin = first.setdefault(child.tag, child)
        if twin is child:
            continue
        are_equal = _canonical_text(twin) == _canonical_text(child)
        if not are_equal and child.tag != "origin":
            times = len(element.findall(child.tag))
            raise RobotDataError(
                findings.path, f"{where}: given <{child.tag}> {times} times; allowed: once"
            )
        element.remove(child)
        if are_equal:
            note = f"{where}: <{child.tag}> stands there twice, and is the same"
        else:
            note = f"{where}: <origin> stands there twice; the first counts, as for other readers"
        findings.notes.append(note)


def _canonical_text(element: Element) -> str:
    return ElementTree.canonicalize(ElementTree.tostring(element), strip_text=True)


def _check_links(findings: Findings, root: Element) -> None:
    """Check names, shapes and inertias of links."""
    path = findings.path
    names = findings.attempt(_names, path, root, "link")
    if names == []:
        findings.faults.append("no <link>; a robot needs at least one")
    if names and len(names) > _MAX_LINKS:
        findings.faults.append(f"{len(names)} links; at most {_MAX_LINKS} are read")
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            findings.attempt(_check_collision, findings, link, collision)
    total_mass = 0.0  # [kg]
    are_all_read = True
    for link in root.findall("link"):
        mass = findings.attempt(_check_inertial, path, link)
        if mass is None:
            are_all_read = False
        else:
            total_mass += mass
    if names and are_all_read and total_mass <= 0.0:
        findings.faults.append(
            "no link has a mass; give an <inertial> with mass > 0 kg to the moving links"
        )


def _check_collision(findings: Findings, link: Element, collision: Element) -> None:
    """Check the shape of a ``<collision>``; take it out where it has no extent."""
    where = f"link {link.get('name')!r} collision"
    shapes = collision.findall("geometry/*")
    _check_origin(findings.path, collision, where)
    if not shapes or _is_flat(findings.path, shapes[0], where):
        link.remove(collision)
        findings.notes.append(f"{where}: a shape of no size, which nothing can touch; left out")
        return
    _check_shape(findings.path, shapes, where)


def _is_flat(path: Path, shape: Element, where: str) -> bool:
    """Check for a placeholder, a shape whose sizes are all 0."""
    if shape.tag not in SHAPES or shape.tag == "mesh":
        return False
    return not any(read_sizes(path, shape, f"{where} {shape.tag}"))


def _check_shape(path: Path, shapes: Sequence[Element], where: str) -> None:
    """Check that a ``<geometry>`` holds one shape of sizes that can be used."""
    tags = [f"<{element.tag}>" for element in shapes if element.tag in SHAPES]
    if len(tags) > 1:
        raise RobotDataError(
            path,
            f"{where} geometry: given {', '.join(tags)}; allowed: one shape, for the others get"
            " lost",
        )
    shape = shapes[0] if shapes else None
    if shape is None or shape.tag not in SHAPES:
        written = "nothing" if shape is None else f"<{shape.tag}>"
        raise RobotDataError(
            path, f"{where} geometry: given {written}; allowed: {', '.join(SHAPES)}"
        )
    sizes = read_sizes(path, shape, f"{where} {shape.tag}")
    if shape.tag == "mesh" and not all(_SCALES[0] <= abs(size) <= _SCALES[1] for size in sizes):
        allowed = f"sizes from {_SCALES[0]:g} to {_SCALES[1]:g}, negative to mirror"
        raise RobotDataError(
            path, f"{where} mesh scale: given {quoted(shape.get('scale', ''))}; allowed: {allowed}"
        )
    if shape.tag != "mesh" and min(sizes) <= 0.0:
        raise RobotDataError(
            path, f"{where} {shape.tag}: given {dict(shape.attrib)}; allowed: sizes > 0 m"
        )


def _check_inertial(path: Path, link: Element) -> float:
    """Check the ``<inertial>`` of a link; return its mass [kg]."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0
    where = f"link {link.get('name')!r}"
    _check_origin(path, inertial, where)
    mass = read_number(path, inertial.find("mass"), "value", f"{where} mass")
    if mass < 0.0:
        advice = (
            "give the real mass; what lifts is a volume, in links or trim of hydrodynamics.yaml"
        )
        raise RobotDataError(path, f"{where} mass: given {mass} kg; allowed: >= 0 kg; {advice}")
    _check_inertia(path, inertial.find("inertia"), f"{where} inertia", mass)
    return mass


def _check_inertia(path: Path, element: Element | None, where: str, mass: float) -> None:
    """Check that principal moments of inertia are not negative; mass [kg]: of the link."""
    xx, xy, xz, yy, yz, zz = (read_number(path, element, key, f"{where} {key}") for key in _INERTIA)
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # Some files have moments of nearly 0, whose signs are those of rounding.
    of_cube = mass * np.cbrt(mass / _WATER_DENSITY) ** 2
    if mass > 0.0 and moments[0] < -_ROUNDING * max(moments[2], of_cube):
        raise RobotDataError(
            path, f"{where}: principal moment {moments[0]:.4g} kg m2; allowed: >= 0; mend <inertia>"
        )


def _check_joints(findings: Findings, root: Element, locked: Collection[str]) -> None:
    """Check names, types, axes and limits of joints."""
    path = findings.path
    findings.attempt(_names, path, root, "joint")
    for joint in root.findall("joint"):
        where = f"joint {joint.get('name')!r}"
        kind = joint.get("type")
        if kind not in _JOINT_TYPES:
            findings.faults.append(f"{where}: type {kind!r}; allowed: {', '.join(_JOINT_TYPES)}")
        _settle_limit(findings, joint, where)
        findings.attempt(_check_origin, path, joint, where)
        findings.attempt(_check_axis, path, joint, where)
        findings.attempt(_check_dynamics, path, joint, where)
        if joint.get("name") not in locked:
            findings.attempt(_check_limit, path, joint, f"{where} limit")
        findings.attempt(_check_unused, path, joint, where)


def _settle_limit(findings: Findings, joint: Element, where: str) -> None:
    """Drop a limit below 0 of a joint that turns without end, such as a propeller's."""
    limit = joint.find("limit")
    if limit is None or joint.get("type") in ("revolute", "prismatic"):
        return
    for key in ("velocity", "effort"):
        if to_float(limit.get(key)) < 0.0:
            findings.notes.append(f"{where} limit {key}: given {limit.get(key)}; taken as no limit")
            limit.set(key, "0")


def _name_limits_not_kept(findings: Findings, root: Element) -> None:
    """Note the limits in a file that nothing here keeps."""
    for kind, tag, words, advice in _NOT_KEPT:
        stated = list[str]()
        for joint in root.findall("joint"):
            if kind not in ("", joint.get("type")):
                continue
            for element in joint.findall(tag):
                if any(to_float(element.get(word, "0")) for word in words):
                    stated.append(quoted(joint.get("name", "")))
        if stated:
            names = ", ".join(stated[:_SHOWN_NAMES])
            if len(stated) > _SHOWN_NAMES:
                names += ", ..."
            findings.notes.append(
                f"{kind} <{tag}> {' and '.join(words)} not kept of joint {names}; {advice}".lstrip()
            )


def _check_unused(path: Path, joint: Element, where: str) -> None:
    """Check numbers that nothing here uses, but for which urdfdom gives up the whole file."""
    for tag, keys in _UNUSED.items():
        element = joint.find(tag)
        for key in keys:
            is_required = key == "k_velocity" and element is not None
            default = None if is_required else 0.0
            read_number(path, element, key, f"{where} {tag} {key}", default=default)


def _check_dynamics(path: Path, joint: Element, where: str) -> None:
    """Check that damping and friction of a joint are not negative."""
    dynamics = joint.find("dynamics")
    _check_not_negative(path, dynamics, ("damping", "friction"), f"{where} dynamics", 0.0)


def _check_not_negative(
    path: Path, element: Element | None, keys: Sequence[str], where: str, default: float | None
) -> None:
    """Check that attributes of an element are numbers from 0 on."""
    for key in keys:
        value = read_number(path, element, key, f"{where} {key}", default)
        if value < 0.0:
            raise RobotDataError(path, f"{where} {key}: given {value}; allowed: >= 0")


def _check_axis(path: Path, joint: Element, where: str) -> None:
    """Check that the axis of a joint has a direction."""
    axis = joint.find("axis")
    if axis is None or joint.get("type") in ("fixed", "floating"):
        return
    vector = read_vector(path, axis, "xyz", f"{where} axis", math.inf)
    if not 1e-9 <= math.hypot(*vector) <= 1e9:
        raise RobotDataError(
            path, f"{where} axis: given {axis.get('xyz')!r}; allowed: a length from 1e-9 to 1e9"
        )


def _check_limit(path: Path, joint: Element, where: str) -> None:
    """Check the limits of a joint, which revolute and prismatic ones must have."""
    element = joint.find("limit")
    is_bounded = joint.get("type") in ("revolute", "prismatic")
    if element is None:
        if is_bounded:
            raise RobotDataError(
                path,
                f"{where} is missing; give lower, upper, velocity and effort, or fix the joint:"
                f" {_LOCK}",
            )
        return
    lower = read_number(path, element, "lower", f"{where} lower", default=0.0)
    upper = read_number(path, element, "upper", f"{where} upper", default=0.0)
    if is_bounded and lower > upper:
        raise RobotDataError(
            path, f"{where}: lower {lower} > upper {upper}; allowed: lower <= upper"
        )
    _check_not_negative(path, element, ("velocity", "effort"), where, None)


def _check_tree(path: Path, root: Element) -> None:
    """Check that the joints connect all links to one tree."""
    links = dict.fromkeys(link.get("name") for link in root.findall("link"))
    parent_of: dict[str | None, str | None] = {}
    for joint in root.findall("joint"):
        parent = _linked(path, joint, "parent", links)
        child = _linked(path, joint, "child", links)
        if child in parent_of:
            raise RobotDataError(path, f"link {child!r} has two parents; allowed: one (a tree)")
        parent_of[child] = parent
    roots = [link for link in links if link not in parent_of]
    if len(roots) != 1:
        problem = f"{len(roots)} root links, {roots[:_SHOWN_NAMES]}"
        raise RobotDataError(path, f"{problem}; allowed: exactly one, joints must form a tree")
    _check_acyclic(path, parent_of)


def _check_acyclic(path: Path, parent_of: dict[str | None, str | None]) -> None:
    """Check that no joints form a loop; parent_of: parent of each link that has one."""
    rooted: set[str | None] = set()  # links whose ancestors are known to end at a root
    for start in parent_of:
        passed = set[str | None]()
        link = start
        while link in parent_of and link not in rooted:
            if link in passed:
                raise RobotDataError(
                    path, f"the joints form a loop through link {link!r}; allowed: a tree"
                )
            passed.add(link)
            link = parent_of[link]
        rooted |= passed


def _linked(path: Path, joint: Element, end: str, links: Collection[str | None]) -> str:
    """Return the name of the ``parent`` or ``child`` link of a joint. Raises ``RobotDataError``
    where there is no such link.
    """
    element = joint.find(end)
    name = None if element is None else element.get("link")
    if name is None or name not in links:
        raise RobotDataError(
            path, f"joint {joint.get('name')!r}: {end} link {name!r} does not exist"
        )
    return name


def _names(path: Path, root: Element, tag: str) -> list[str]:
    """Return the names of all links, or of all joints. Raises ``RobotDataError`` unless they are
    unique.
    """
    names = [element.get("name", "") for element in root.findall(tag)]
    if "" in names:
        raise RobotDataError(path, f"a <{tag}> has no name")
    repeated = sorted(name for name, n in Counter(names).items() if n > 1)
    if repeated:
        raise RobotDataError(
            path, f"<{tag}> names must be unique; repeated: {', '.join(repeated[:_SHOWN_NAMES])}"
        )
    return names


def _check_origin(path: Path, element: Element, where: str) -> None:
    """Check that position and angles of the ``<origin>`` of an element are three numbers each."""
    origin = element.find("origin")
    for key in ("xyz", "rpy"):
        if origin is not None and key in origin.attrib:
            read_vector(path, origin, key, f"{where} origin")

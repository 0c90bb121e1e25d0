"""Check the XML of a URDF: numbers as strictly as urdfdom reads them, one line per mistake, words
that nobody reads.

urdfdom hands the whole text to a C++ stream in the classic locale: blanks may come before a number,
nothing after it. Where that fails Pinocchio leaves the inertia or the shape out without a word, so
what urdfdom does not read is refused here. Python's `float` takes more: blanks behind, ``1_0``,
digits of other scripts, ``nan`` and ``inf``.

Pinocchio's parser writes to stderr, ignores what it does not understand and does not say which
element is wrong.

A word that can only be a mistake is refused: one that is nearly a known word, or any unknown one
where nothing but numbers of the robot stands, unless it is one of another element whose numbers are
all 0. Others, such as what a simulator adds to links, are named in one warning. The known words are
those of urdfdom's parsers and of Pinocchio's ``<collision_checking>``.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import numpy as np

from uvms_ocp.errors import RobotDataError, plain_line
from uvms_ocp.record.meta_values import LARGEST

# Numbers of a URDF, read as strictly as urdfdom reads them.

Element = ElementTree.Element
_T = TypeVar("_T")

_DECIMAL = re.compile(r"[ \t\n\v\f\r]*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
SHAPES = {"box": (), "sphere": ("radius",), "cylinder": ("radius", "length"), "mesh": ()}
"""The scalar attributes of the shapes of a URDF."""

_LONGEST_NUMBER = 60  # characters of a mistake that a message repeats

_LIMITS = ("lower", "upper", "velocity", "effort")  # where a huge number says that there is none

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_SHOWN_NAMES = 10  # names in a message
# a humanoid with hands has 150; Pinocchio's recursion ends the process at some thousands in a row
_MOST_LINKS = 1000
_SCALES = (1e-6, 1e6)  # of meshes, from micrometres to metres and back; beyond it numbers get lost
_LOCK = "--lock JOINT, or `lock: {JOINT: 0}` in loading of hydrodynamics.yaml"
_SOFT_LIMIT = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")

_NOT_KEPT = (
    ("continuous", "limit", ("lower", "upper"), "make it revolute to keep them"),
    (
        "",
        "safety_controller",
        ("soft_lower_limit", "soft_upper_limit"),
        "write those that hold into <limit>",
    ),
)
"""Type of the joints, tag and words of limits that nothing here keeps, and what to do; no type:
all.
"""

_LIKENESS = 0.66  # of difflib: "dampning" to "damping" is 0.93, "xzy" to "xyz" 0.67
_SHOWN_WORDS = 8  # words in a warning
_LONGEST_WORD = 40  # characters of a word
_XACRO = re.compile(r"\{[^}]*xacro[^}]*\}")


def to_float(text: str | None) -> float:
    """Return the number of one text, NaN for what urdfdom would not read or a float cannot hold."""
    if text is None or _DECIMAL.fullmatch(text) is None:
        return math.nan
    value = float(text)
    if math.isfinite(value):
        return value
    return math.nan


def to_floats(text: str) -> tuple[float, ...]:
    """Return the numbers between the spaces of a text, NaN in the places of `to_float`; a tab
    separates nothing.
    """
    return tuple(to_float(word) for word in text.split(" ") if word)


def read_number(
    path: Path, element: Element | None, key: str, where: str, default: float | None = None
) -> float:
    """Return the number of an attribute, or ``default`` [in its unit] where it is left out.

    Raises ``RobotDataError`` where it is no number, or left out without a default.
    """
    if element is None:
        text = None
    else:
        text = element.get(key)
    if text is None and default is not None:
        return default
    value = to_float(text)
    if math.isnan(value) or (abs(value) > LARGEST and key not in _LIMITS):
        if text is None:
            written = "nothing"
        else:
            written = quoted(text)
        problem = (
            f"{where}: given {written}; allowed: a finite number in plain digits, nothing after it,"
            f" <= {LARGEST:g}"
        )
        raise RobotDataError(path, problem)
    return value


def read_vector(
    path: Path, element: Element, key: str, where: str, largest: float = LARGEST
) -> tuple[float, ...]:
    """Return the three numbers of an attribute. Raises ``RobotDataError`` where they are not."""
    text = element.get(key, "")
    values = to_floats(text)
    if len(values) != 3 or not all(abs(value) <= largest for value in values):
        problem = (
            f"{where} {key}: given {quoted(text)}; allowed: three finite numbers with spaces"
            f" between them, <= {largest:g}"
        )
        raise RobotDataError(path, problem)
    return values


def read_sizes(path: Path, shape: Element, where: str) -> tuple[float, ...]:
    """Return the sizes [m] of a shape, or the scale of a mesh. Raises ``RobotDataError``."""
    if shape.tag == "box":
        return read_vector(path, shape, "size", where)
    if shape.tag == "mesh":
        if "scale" in shape.attrib:
            return read_vector(path, shape, "scale", where)
        return (1.0, 1.0, 1.0)
    return tuple(read_number(path, shape, key, f"{where} {key}") for key in SHAPES[shape.tag])


def quoted(text: str) -> str:
    """Return a text in quotes on one line, shortened."""
    return repr(text if len(text) <= _LONGEST_NUMBER else text[:_LONGEST_NUMBER] + "...")


# Checks of a URDF's XML, each mistake one line that names the element.


class Findings:
    """All faults of one file, and the parts of it that are left out without harm."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.faults: list[str] = []
        self.notes: list[str] = []

    def attempt(self, check: Callable[..., _T], *args: Any) -> _T | None:
        """The result of a check, `None` where it raises: what it raises becomes a fault of the
        file.
        """
        try:
            return check(*args)
        except RobotDataError as error:
            self.faults += error.problems
            return None

    def refuse(self) -> None:
        """Raise ``RobotDataError`` with all faults, if there are any."""
        if self.faults:
            raise RobotDataError(self.path, *dict.fromkeys(self.faults))


def check_urdf(path: Path, root: Element, *, locked: Collection[str] = ()) -> list[str]:
    """Raise ``RobotDataError`` with all mistakes in links, joints and the tree they form; return
    what is left out.

    What only draws is taken out of `root` where it cannot be drawn, and so are twins, shapes
    without extent and limits below 0 of joints that turn without end: one line each. Limits that
    nothing keeps are named; those that are ``locked`` need none.
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
    """Take out what cannot be drawn."""
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
    """Take out the paint that has no colour: what it is on is drawn grey."""
    # elsewhere it is a simulator's
    shared_materials = root.findall("material")
    used_materials = root.findall("link/visual/material")
    colours = {
        m.get("name", ""): m for m in reversed([*shared_materials, *used_materials]) if _is_drawn(m)
    }
    colours.pop("", None)
    for parent in (root, *root.findall("link/visual")):
        for material in parent.findall("material"):
            name = material.get("name", "")
            if name in colours and not (parent is root and material is not colours[name]):
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
    colour = material.find("color")
    if colour is None:
        return material.find("texture") is not None
    values = to_floats(colour.get("rgba", ""))
    return len(values) == 4 and all(0.0 <= value <= 1.0 for value in values)


def _check_repeats(findings: Findings, root: Element) -> None:
    for part in (*root.findall("link"), *root.findall("joint")):
        for element in part.iter():
            where = f"{part.tag} {part.get('name')!r}" + (
                "" if element is part else f" {element.tag}"
            )
            findings.attempt(_drop_twins, findings, element, where)


def _drop_twins(findings: Findings, element: Element, where: str) -> None:
    """Take out what stands twice and is equal. Raises ``RobotDataError`` where it is not: of two,
    parsers take the first.
    """
    first: dict[str, Element] = {}
    once = _PLACES[element.tag].once if element.tag in _PLACES else ()
    for child in [child for child in element if child.tag in once]:
        twin = first.setdefault(child.tag, child)
        if twin is child:
            continue
        texts = {
            ElementTree.canonicalize(ElementTree.tostring(element_of_tag), strip_text=True)
            for element_of_tag in (twin, child)
        }
        if len(texts) > 1:
            times = len(element.findall(child.tag))
            raise RobotDataError(
                findings.path, f"{where}: given <{child.tag}> {times} times; allowed: once"
            )
        element.remove(child)
        findings.notes.append(f"{where}: <{child.tag}> stands there twice, and is the same")


def _check_links(findings: Findings, root: Element) -> None:
    path = findings.path
    names = findings.attempt(_names, path, root, "link")
    if names == []:
        findings.faults.append("no <link>; a robot needs at least one")
    if names and len(names) > _MOST_LINKS:
        findings.faults.append(f"{len(names)} links; at most {_MOST_LINKS} are read")
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            findings.attempt(_check_collision, findings, link, collision)
    masses = [findings.attempt(_check_inertial, path, link) for link in root.findall("link")]
    if names and None not in masses and sum(filter(None, masses)) <= 0.0:
        findings.faults.append(
            "no link has a mass; give an <inertial> with mass > 0 kg to the moving links"
        )


def _check_collision(findings: Findings, link: Element, collision: Element) -> None:
    where = f"link {link.get('name')!r} collision"
    shapes = collision.findall("geometry/*")
    _check_origin(findings.path, collision, where)
    if not shapes or _is_flat(findings.path, shapes[0], where):
        link.remove(collision)
        findings.notes.append(f"{where}: a shape of no size, which nothing can touch; left out")
        return
    _check_shape(findings.path, shapes, where)


def _is_flat(path: Path, shape: Element, where: str) -> bool:
    """Check for a placeholder: no size below 0, and all of them 0."""
    return (
        shape.tag in SHAPES
        and shape.tag != "mesh"
        and not any(read_sizes(path, shape, f"{where} {shape.tag}"))
    )


def _check_shape(path: Path, shapes: Sequence[Element], where: str) -> None:
    tags = [f"<{element.tag}>" for element in shapes if element.tag in SHAPES]
    if len(tags) > 1:
        raise RobotDataError(
            path,
            f"{where} geometry: given {', '.join(tags)}; allowed: one shape, for the others get"
            " lost",
        )
    shape = shapes[0] if shapes else None
    if shape is None or shape.tag not in SHAPES:
        if shape is None:
            written = "nothing"
        else:
            written = f"<{shape.tag}>"
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
    xx, xy, xz, yy, yz, zz = (read_number(path, element, key, f"{where} {key}") for key in _INERTIA)
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass > 0.0 and moments[0] < -1e-9 * max(1.0, moments[2]):
        raise RobotDataError(
            path, f"{where}: principal moment {moments[0]:.4g} kg m2; allowed: >= 0; mend <inertia>"
        )


def _check_joints(findings: Findings, root: Element, locked: Collection[str]) -> None:
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
        findings.attempt(
            _check_not_negative,
            path,
            joint.find("dynamics"),
            ("damping", "friction"),
            f"{where} dynamics",
            0.0,
        )
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
    for kind, tag, words, advice in _NOT_KEPT:
        stated = [
            quoted(joint.get("name", ""))
            for joint in root.findall("joint")
            for element in joint.findall(tag)
            if kind in ("", joint.get("type"))
            and any(to_float(element.get(word, "0")) for word in words)
        ]
        if stated:
            names = ", ".join(stated[:_SHOWN_NAMES]) + (
                ", ..." if len(stated) > _SHOWN_NAMES else ""
            )
            findings.notes.append(
                f"{kind} <{tag}> {' and '.join(words)} not kept of joint {names}; {advice}".lstrip()
            )


def _check_unused(path: Path, joint: Element, where: str) -> None:
    """Numbers that nothing here uses, but for which urdfdom gives up the whole file."""
    read = {
        "mimic": ("multiplier", "offset"),
        "calibration": ("rising", "falling"),
        "safety_controller": _SOFT_LIMIT,
    }
    for tag, keys in read.items():
        for key in keys:
            needed = key == "k_velocity" and joint.find(tag) is not None
            read_number(
                path, joint.find(tag), key, f"{where} {tag} {key}", default=None if needed else 0.0
            )


def _check_not_negative(
    path: Path, element: Element | None, keys: Sequence[str], where: str, default: float | None
) -> None:
    for key in keys:
        value = read_number(path, element, key, f"{where} {key}", default)
        if value < 0.0:
            raise RobotDataError(path, f"{where} {key}: given {value}; allowed: >= 0")


def _check_axis(path: Path, joint: Element, where: str) -> None:
    axis = joint.find("axis")
    if axis is None or joint.get("type") in ("fixed", "floating"):
        return
    if not 1e-9 <= math.hypot(*read_vector(path, axis, "xyz", f"{where} axis", math.inf)) <= 1e9:
        raise RobotDataError(
            path, f"{where} axis: given {axis.get('xyz')!r}; allowed: a length from 1e-9 to 1e9"
        )


def _check_limit(path: Path, joint: Element, where: str) -> None:
    element = joint.find("limit")
    bounded = joint.get("type") in ("revolute", "prismatic")
    if element is None:
        if bounded:
            raise RobotDataError(
                path,
                f"{where} is missing; give lower, upper, velocity and effort, or fix the joint:"
                f" {_LOCK}",
            )
        return
    lower, upper = (
        read_number(path, element, key, f"{where} {key}", default=0.0) for key in ("lower", "upper")
    )
    if bounded and lower > upper:
        raise RobotDataError(
            path, f"{where}: lower {lower} > upper {upper}; allowed: lower <= upper"
        )
    _check_not_negative(path, element, ("velocity", "effort"), where, None)


def _check_tree(path: Path, root: Element) -> None:
    links = dict.fromkeys(link.get("name") for link in root.findall("link"))
    parent_of: dict[str | None, str | None] = {}
    for joint in root.findall("joint"):
        parent, child = (_linked(path, joint, end, links) for end in ("parent", "child"))
        if child in parent_of:
            raise RobotDataError(path, f"link {child!r} has two parents; allowed: one (a tree)")
        parent_of[child] = parent
    roots = [link for link in links if link not in parent_of]
    if len(roots) != 1:
        problem = f"{len(roots)} root links, {roots[:_SHOWN_NAMES]}"
        raise RobotDataError(path, f"{problem}; allowed: exactly one, joints must form a tree")
    _check_acyclic(path, parent_of)


def _check_acyclic(path: Path, parent_of: dict[str | None, str | None]) -> None:
    rooted: set[str | None] = set()  # links from which the way up is known to end
    for start in parent_of:
        way = set[str | None]()
        link = start
        while link in parent_of and link not in rooted:
            if link in way:
                raise RobotDataError(
                    path, f"the joints form a loop through link {link!r}; allowed: a tree"
                )
            way.add(link)
            link = parent_of[link]
        rooted |= way


def _linked(path: Path, joint: Element, end: str, links: Collection[str | None]) -> str:
    element = joint.find(end)
    if element is None:
        name = None
    else:
        name = element.get("link")
    if name is None or name not in links:
        raise RobotDataError(
            path, f"joint {joint.get('name')!r}: {end} link {name!r} does not exist"
        )
    return name


def _names(path: Path, root: Element, tag: str) -> list[str]:
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
    origin = element.find("origin")
    for key in ("xyz", "rpy"):
        if origin is not None and key in origin.attrib:
            read_vector(path, origin, key, f"{where} origin")


# Elements and attributes of a URDF that nobody reads: urdfdom and Pinocchio skip a word that they
# do not know.


@dataclass(frozen=True, kw_only=True, slots=True)
class _Place:
    """Attributes and elements that one element may hold."""

    children: frozenset[str] = frozenset()
    attributes: frozenset[str] = frozenset()
    others: frozenset[str] = frozenset()
    """Elements for other programs, which change nothing here."""
    once: frozenset[str] = frozenset()
    """Children that may stand once. Of two, parsers take the first without a word."""
    closed: bool = True
    """True where nobody adds attributes of their own."""


def _places() -> dict[str, _Place]:
    """Read the table ``urdf_words.csv``: attributes and children that each element may have, and
    how often, by its name.
    """
    rows = csv.DictReader(
        (files("uvms_ocp.robot") / "urdf_words.csv").read_text(encoding="utf-8").splitlines()
    )
    words = ("children", "attributes", "others", "once")
    return {
        row["element"]: _Place(
            **{key: frozenset(row[key].split()) for key in words}, closed=row["closed"] == "yes"
        )
        for row in rows
    }


_PLACES = _places()
_WORDS = frozenset().union(*(place.attributes for place in _PLACES.values()))


def unread_words(path: Path, root: Element) -> str:
    """Describe the content of the file that is not read, for a warning; "" for none.

    Raises ``RobotDataError`` for all words that are misspelt.
    """
    findings = Findings(path)
    unread = Counter(_unread(findings, root, "robot"))
    for part in root:
        if part.tag in _PLACES["robot"].children:
            unread.update(
                _unread_below(findings, part, f"{part.tag} {quoted(part.get('name', ''))}")
            )
    findings.refuse()
    words = [
        word if n == 1 else f"{word} ({n} times)" for word, n in unread.most_common(_SHOWN_WORDS)
    ]
    return ", ".join(words) + (
        f" and {len(unread) - _SHOWN_WORDS} more" if len(unread) > _SHOWN_WORDS else ""
    )


def _unread_below(findings: Findings, element: Element, where: str) -> Iterator[str]:
    yield from _unread(findings, element, where)
    for child in element:
        if child.tag in _PLACES[element.tag].children:
            yield from _unread_below(findings, child, f"{where} {child.tag}")


def _unread(findings: Findings, element: Element, where: str) -> Iterator[str]:
    """The words of one element, without those below, that nothing reads."""
    place = _PLACES[element.tag]
    for word, value in element.attrib.items():
        if word not in place.attributes:
            if word not in _WORDS or set(to_floats(value)) != {
                0.0
            }:  # a rpy of an axis, as of Gazebo, turns it by nothing
                findings.attempt(
                    _check_attribute, findings.path, word, place, element.attrib, where
                )
            yield f"attribute {_shown(word)} of <{element.tag}>"
    for child in element:
        if child.tag not in place.children | place.others:
            if not _is_limit_of_none(element, child):
                findings.attempt(_check_element, findings.path, child.tag, place, where)
            yield f"<{_shown(child.tag)}> in <{element.tag}>"
    if any(
        text and not text.isspace() for text in (element.text, *(child.tail for child in element))
    ):
        yield f"text in <{element.tag}>"


def _is_limit_of_none(element: Element, child: Element) -> bool:
    """Check for <limits> of a joint that turns without end, such as a propeller: it would limit
    nothing that is used.
    """
    return (
        child.tag == "limits"
        and element.tag == "joint"
        and element.get("type") in ("continuous", "fixed")
    )


def _check_attribute(
    path: Path, word: str, place: _Place, present: Collection[str], where: str
) -> None:
    parts = re.split("[_-]", word.lower())
    replaced = [part for part in parts if part in place.attributes and part not in present]
    meant = replaced or _meant(word, place.attributes)
    if meant or (place.closed and not _is_foreign(word)):
        raise RobotDataError(
            path, _unknown(f"{where}: unknown attribute {_shown(word)}", meant, place.attributes)
        )


def _check_element(path: Path, word: str, place: _Place, where: str) -> None:
    if _XACRO.match(word):
        raise RobotDataError(
            path,
            f"{where}: <{_shown(word)}> is of xacro; give the URDF that xacro makes of the file",
        )
    meant = _meant(word, place.children)
    if meant:
        raise RobotDataError(
            path, _unknown(f"{where}: unknown element <{_shown(word)}>", meant, place.children)
        )


def _meant(word: str, allowed: Collection[str]) -> list[str]:
    parts = re.split("[_-]", word.lower())
    # A longer word that contains a known one is somebody's own: gear_velocity, loop_joint.
    candidates = sorted(set(allowed).difference(parts[1:] and parts))
    if _is_foreign(word):
        return []
    return get_close_matches(word.lower(), candidates, n=1, cutoff=_LIKENESS)


def _is_foreign(word: str) -> bool:
    """Check for a word of another namespace, written by someone who knows that URDF does not have
    it.
    """
    return word.startswith("{")


def _unknown(problem: str, meant: list[str], attributes: Collection[str]) -> str:
    allowed = f"allowed: {', '.join(sorted(attributes)) or 'none'}"
    if meant:
        return f"{problem}; did you mean {meant[0]!r}? {allowed}"
    return f"{problem}; {allowed}"


def _shown(word: str) -> str:
    """A word of anybody's, without the address of its namespace."""
    return plain_line(word.rpartition("}")[2], _LONGEST_WORD)

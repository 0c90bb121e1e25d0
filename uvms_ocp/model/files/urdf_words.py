"""Elements and attributes of a URDF that nobody reads: urdfdom and Pinocchio skip a word that they do not know.

A word that can only be a mistake is refused: one that is nearly a known word, or any unknown one where nothing but numbers
of the robot stands. Others, such as what a simulator adds to links, are told in one warning. The known words are those of
urdfdom's parsers and of Pinocchio's ``<collision_checking>``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from xml.etree import ElementTree

from uvms_ocp.exceptions import RobotDataError, plain_line
from uvms_ocp.model.files.urdf_numbers import quoted

Element = ElementTree.Element

_LIKENESS = 0.66  # of difflib: "dampning" to "damping" is 0.93, "xzy" to "xyz" 0.67
_SHOWN = 8  # words in a warning
_LONGEST = 40  # characters of a word
_XACRO = re.compile(r"\{[^}]*xacro[^}]*\}")


@dataclass(frozen=True, kw_only=True, slots=True)
class _Place:
    """What one element may hold."""

    children: frozenset[str] = frozenset()
    attributes: frozenset[str] = frozenset()
    others: frozenset[str] = frozenset()
    """Elements for other programs, which change nothing here."""
    closed: bool = True
    """Whether nobody adds attributes of their own."""


def _place(children: str = "", attributes: str = "", others: str = "", closed: bool = True) -> _Place:
    words = [frozenset(text.split()) for text in (children, attributes, others)]
    return _Place(children=words[0], attributes=words[1], others=words[2], closed=closed)


_SHAPES = "box sphere cylinder mesh"
_PLACES = {
    "robot": _place(
        "link joint material", "name version", "gazebo transmission ros2_control sensor plugin verbose", closed=False
    ),
    "link": _place(
        "inertial visual collision collision_checking",
        "name",
        "verbose contact contact_coefficients self_collision_checking sensor material",
        closed=False,
    ),
    "collision_checking": _place("capsule convex"),
    "capsule": _place("", "name"),
    "convex": _place("", "name"),
    "inertial": _place("origin mass inertia"),
    "mass": _place("", "value"),
    "inertia": _place("", "ixx ixy ixz iyy iyz izz"),
    "visual": _place("origin geometry material", "name", closed=False),
    "collision": _place("origin geometry", "name", "material verbose contact_coefficients", closed=False),
    "geometry": _place(_SHAPES, "name", closed=False),
    "box": _place("", "size"),
    "sphere": _place("", "radius"),
    "cylinder": _place("", "radius length"),
    "mesh": _place("", "filename scale"),
    "material": _place("color texture", "name"),
    "color": _place("", "rgba"),
    "texture": _place("", "filename"),
    "joint": _place(
        "origin parent child axis limit dynamics mimic safety_controller calibration", "name type", closed=False
    ),
    "origin": _place("", "xyz rpy"),
    "parent": _place("", "link"),
    "child": _place("", "link"),
    "axis": _place("", "xyz"),
    "limit": _place("", "lower upper velocity effort", closed=False),
    "dynamics": _place("", "damping friction", closed=False),
    "mimic": _place("", "joint multiplier offset"),
    "safety_controller": _place("", "soft_lower_limit soft_upper_limit k_position k_velocity"),
    "calibration": _place("", "rising falling reference_position"),
}


def unread_words(path: Path, root: Element) -> str:
    """What the file holds that is not read, in words for a warning, "" for nothing.

    Raises ``RobotDataError`` for the first word that is misspelt.
    """
    unread = Counter(_unread(path, root, "robot"))
    for part in root:
        if part.tag in _PLACES["robot"].children:
            unread.update(_unread_below(path, part, f"{part.tag} {quoted(part.get('name', ''))}"))
    words = [word if n == 1 else f"{word} ({n} times)" for word, n in unread.most_common(_SHOWN)]
    return ", ".join(words) + (f" and {len(unread) - _SHOWN} more" if len(unread) > _SHOWN else "")


def _unread_below(path: Path, element: Element, where: str) -> Iterator[str]:
    yield from _unread(path, element, where)
    for child in element:
        if child.tag in _PLACES[element.tag].children:
            yield from _unread_below(path, child, f"{where} {child.tag}")


def _unread(path: Path, element: Element, where: str) -> Iterator[str]:
    """The words of one element, without those below, that nothing reads."""
    place = _PLACES[element.tag]
    for word in element.attrib:
        if word not in place.attributes:
            _check_attribute(path, word, place, element.attrib, where)
            yield f"attribute {_shown(word)} of <{element.tag}>"
    for child in element:
        if child.tag not in place.children | place.others:
            _check_element(path, child.tag, place, where)
            yield f"<{_shown(child.tag)}> in <{element.tag}>"
    if any(text and not text.isspace() for text in (element.text, *(child.tail for child in element))):
        yield f"text in <{element.tag}>"


def _check_attribute(path: Path, word: str, place: _Place, present: Collection[str], where: str) -> None:
    parts = re.split("[_-]", word.lower())
    replaced = [known for known in parts if known in place.attributes and known not in present]
    meant = replaced or _meant(word, place.attributes)
    if meant or (place.closed and not _is_foreign(word)):
        raise RobotDataError(path, _unknown(f"{where}: unknown attribute {_shown(word)}", meant, place.attributes))


def _check_element(path: Path, word: str, place: _Place, where: str) -> None:
    if _XACRO.match(word):
        raise RobotDataError(path, f"{where}: <{_shown(word)}> is of xacro; give the URDF that xacro makes of the file")
    meant = _meant(word, place.children)
    if meant:
        raise RobotDataError(path, _unknown(f"{where}: unknown element <{_shown(word)}>", meant, place.children))


def _meant(word: str, known: Collection[str]) -> list[str]:
    parts = re.split("[_-]", word.lower())
    # A longer word that contains a known one is somebody's own: gear_velocity, loop_joint.
    candidates = sorted(set(known).difference(parts[1:] and parts))
    return [] if _is_foreign(word) else get_close_matches(word.lower(), candidates, n=1, cutoff=_LIKENESS)


def _is_foreign(word: str) -> bool:
    """Whether the word is of another namespace, written by someone who knows that URDF does not have it."""
    return word.startswith("{")


def _unknown(problem: str, meant: list[str], known: Collection[str]) -> str:
    allowed = f"allowed: {', '.join(sorted(known)) or 'none'}"
    return f"{problem}; did you mean {meant[0]!r}? {allowed}" if meant else f"{problem}; {allowed}"


def _shown(word: str) -> str:
    """A word of anybody's, without the address of its namespace."""
    return plain_line(word.rpartition("}")[2], _LONGEST)

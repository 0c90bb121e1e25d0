"""Find elements and attributes of a URDF that nobody reads: urdfdom and Pinocchio skip words that
they do not know.

A word that can only be a mistake is refused: one that is nearly a known word, or an unknown one in
an element that holds nothing but numbers of the robot, unless another element has such a word and
its numbers are all 0. Others, such as what a simulator adds to links, are named in one warning. The
known words are those of urdfdom's parsers and of Pinocchio's ``<collision_checking>``.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path

from uvms_ocp.errors import RobotDataError, plain_line
from uvms_ocp.robot.urdf_elements import Element, quoted, to_floats
from uvms_ocp.robot.urdf_findings import Findings

_LIKENESS = 0.66  # least ratio of difflib: "dampning" to "damping" is 0.93, "xzy" to "xyz" 0.67
_SHOWN_WORDS = 8  # largest number of words in a warning
_LONGEST_WORD = 40  # characters of a word that are shown
_XACRO = re.compile(r"\{[^}]*xacro[^}]*\}")


@dataclass(frozen=True, kw_only=True, slots=True)
class _Place:
    """Attributes and elements that one element may hold."""

    children: frozenset[str] = frozenset()
    """Elements in it that are read."""
    attributes: frozenset[str] = frozenset()
    """Attributes that are read."""
    others: frozenset[str] = frozenset()
    """Elements for other programs, which change nothing here."""
    once: frozenset[str] = frozenset()
    """Children that may stand once: of two, parsers take the first without a warning."""
    closed: bool = True
    """True where other programs add no attributes."""


def _places() -> dict[str, _Place]:
    """Read the table ``urdf_words.csv``: attributes and children that each element may have, and
    how often, by its name.
    """
    text = (files("uvms_ocp.robot") / "urdf_words.csv").read_text(encoding="utf-8")
    places = dict[str, _Place]()
    for row in csv.DictReader(text.splitlines()):
        places[row["element"]] = _Place(
            children=frozenset(row["children"].split()),
            attributes=frozenset(row["attributes"].split()),
            others=frozenset(row["others"].split()),
            once=frozenset(row["once"].split()),
            closed=row["closed"] == "yes",
        )
    return places


PLACES = _places()
_WORDS = frozenset().union(*(place.attributes for place in PLACES.values()))


def unread_words(path: Path, root: Element) -> str:
    """Describe the content of the file that is not read, for a warning; "" for none.

    Raises ``RobotDataError`` for all words that are misspelt.
    """
    findings = Findings(path)
    unread = Counter(_unread(findings, root, "robot"))
    for part in root:
        if part.tag in PLACES["robot"].children:
            where = f"{part.tag} {quoted(part.get('name', ''))}"
            unread.update(_unread_below(findings, part, where))
    findings.refuse()
    words = list[str]()
    for word, n in unread.most_common(_SHOWN_WORDS):
        words.append(word if n == 1 else f"{word} ({n} times)")
    text = ", ".join(words)
    n_more = len(unread) - _SHOWN_WORDS
    if n_more > 0:
        text += f" and {n_more} more"
    return text


def _unread_below(findings: Findings, element: Element, where: str) -> Iterator[str]:
    """Yield the words of an element and of all below it that nothing reads."""
    yield from _unread(findings, element, where)
    for child in element:
        if child.tag in PLACES[element.tag].children:
            yield from _unread_below(findings, child, f"{where} {child.tag}")


def _unread(findings: Findings, element: Element, where: str) -> Iterator[str]:
    """Yield the words of one element, without those below it, that nothing reads."""
    place = PLACES[element.tag]
    for word, value in element.attrib.items():
        if word in place.attributes:
            continue
        # An rpy of an axis, as of Gazebo, turns it by nothing.
        changes_nothing = word in _WORDS and set(to_floats(value)) == {0.0}
        if not changes_nothing:
            findings.attempt(_check_attribute, findings.path, word, place, element.attrib, where)
        yield f"attribute {_shown(word)} of <{element.tag}>"
    for child in element:
        if child.tag not in place.children | place.others:
            if not _is_limit_of_none(element, child):
                findings.attempt(_check_element, findings.path, child.tag, place, where)
            yield f"<{_shown(child.tag)}> in <{element.tag}>"
    texts = [element.text, *(child.tail for child in element)]
    if any(text and not text.isspace() for text in texts):
        yield f"text in <{element.tag}>"


def _is_limit_of_none(element: Element, child: Element) -> bool:
    """Check for <limits>, a misspelt <limit>, in a joint that has no limits, such as a propeller."""
    return (
        child.tag == "limits"
        and element.tag == "joint"
        and element.get("type") in ("continuous", "fixed")
    )


def _check_attribute(
    path: Path, word: str, place: _Place, present: Collection[str], where: str
) -> None:
    """Check an unknown attribute beside those that are present. Raises `RobotDataError` for one that
    can only be a mistake.
    """
    parts = re.split("[_-]", word.lower())
    missing_parts = [part for part in parts if part in place.attributes and part not in present]
    meant = missing_parts or _meant(word, place.attributes)
    if meant or (place.closed and not _is_foreign(word)):
        problem = f"{where}: unknown attribute {_shown(word)}"
        raise RobotDataError(path, _unknown(problem, meant, place.attributes))


def _check_element(path: Path, word: str, place: _Place, where: str) -> None:
    """Check an unknown element. Raises `RobotDataError` for one that can only be a mistake."""
    if _XACRO.match(word):
        raise RobotDataError(
            path,
            f"{where}: <{_shown(word)}> is of xacro; give the URDF that xacro makes of the file",
        )
    meant = _meant(word, place.children)
    if meant:
        problem = f"{where}: unknown element <{_shown(word)}>"
        raise RobotDataError(path, _unknown(problem, meant, place.children))


def _meant(word: str, allowed: Collection[str]) -> list[str]:
    """Return the allowed word that an unknown one is nearly, in a list; empty for none."""
    if _is_foreign(word):
        return []
    candidates = {*allowed}
    parts = re.split("[_-]", word.lower())
    if len(parts) > 1:
        # A longer word that contains a known one is somebody's own: gear_velocity, loop_joint.
        candidates.difference_update(parts)
    return get_close_matches(word.lower(), sorted(candidates), n=1, cutoff=_LIKENESS)


def _is_foreign(word: str) -> bool:
    """Check for a word of another XML namespace: its writer knows that URDF does not have it."""
    return word.startswith("{")


def _unknown(problem: str, meant: list[str], words: Collection[str]) -> str:
    """Write the problem with the word that was perhaps meant, and all that are allowed."""
    allowed = f"allowed: {', '.join(sorted(words)) or 'none'}"
    if meant:
        return f"{problem}; did you mean {meant[0]!r}? {allowed}"
    return f"{problem}; {allowed}"


def _shown(word: str) -> str:
    """Return a word for a message: on one line, shortened, without the address of its namespace."""
    return plain_line(word.rpartition("}")[2], _LONGEST_WORD)

"""Numbers of a URDF, read as strictly as urdfdom reads them.

urdfdom hands the whole text to a C++ stream in the classic locale: blanks may come before a number, nothing after it.
Where that fails Pinocchio leaves the inertia or the shape out without a word, so what urdfdom does not read is refused
here. Python's `float` takes more: blanks behind, ``1_0``, digits of other scripts, ``nan`` and ``inf``.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

from uvms_ocp.exceptions import RobotDataError

Element = ElementTree.Element

_DECIMAL = re.compile(r"[ \t\n\v\f\r]*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
SHAPES = {"box": (), "sphere": ("radius",), "cylinder": ("radius", "length"), "mesh": ()}
"""The scalar attributes of the shapes of a URDF."""

_LONGEST = 60  # characters of a mistake that a message repeats


def to_float(text: str | None) -> float:
    """Return the number of one text, NaN for what urdfdom would not read or a float cannot hold."""
    if text is None or _DECIMAL.fullmatch(text) is None:
        return math.nan
    value = float(text)
    return value if math.isfinite(value) else math.nan


def to_floats(text: str) -> tuple[float, ...]:
    """Return the numbers between the spaces of a text, NaN in the places of `to_float`; a tab separates nothing."""
    return tuple(to_float(word) for word in text.split(" ") if word)


def read_number(path: Path, element: Element | None, key: str, where: str, default: float | None = None) -> float:
    """Return the number of an attribute, or ``default`` [in its unit] where it is left out.

    Raises ``RobotDataError`` where it is no number, or left out without a default.
    """
    text = None if element is None else element.get(key)
    if text is None and default is not None:
        return default
    value = to_float(text)
    if math.isnan(value):
        given = "nothing" if text is None else quoted(text)
        problem = f"{where}: given {given}; allowed: a finite number in plain digits, nothing after it"
        raise RobotDataError(path, problem)
    return value


def read_vector(path: Path, element: Element, key: str, where: str) -> tuple[float, ...]:
    """Return the three numbers of an attribute. Raises ``RobotDataError`` where they are not."""
    text = element.get(key, "")
    values = to_floats(text)
    if len(values) != 3 or any(map(math.isnan, values)):
        problem = f"{where} {key}: given {quoted(text)}; allowed: three finite numbers with spaces between them"
        raise RobotDataError(path, problem)
    return values


def read_sizes(path: Path, shape: Element, where: str) -> tuple[float, ...]:
    """Return the sizes [m] of a shape, or the scale [-] of a mesh. Raises ``RobotDataError``."""
    if shape.tag == "box":
        return read_vector(path, shape, "size", where)
    if shape.tag == "mesh":
        return read_vector(path, shape, "scale", where) if "scale" in shape.attrib else (1.0, 1.0, 1.0)
    return tuple(read_number(path, shape, key, f"{where} {key}") for key in SHAPES[shape.tag])


def quoted(text: str) -> str:
    """Return a text in quotes on one line, shortened."""
    return repr(text if len(text) <= _LONGEST else text[:_LONGEST] + "...")

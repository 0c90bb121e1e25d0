"""Elements of a URDF and their numbers, read as strictly as urdfdom reads them.

urdfdom hands the whole text to a C++ stream in the classic locale: blanks may come before a number,
nothing after it. Where that fails Pinocchio leaves the inertia or the shape out without a word, so
what urdfdom does not read is refused here. Python's `float` takes more: blanks behind, ``1_0``,
digits of other scripts, ``nan`` and ``inf``.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import RobotDataError
from uvms_ocp.record.meta_values import LARGEST

Element = ElementTree.Element

SHAPES = {"box": (), "sphere": ("radius",), "cylinder": ("radius", "length"), "mesh": ()}
"""The scalar attributes of the shapes of a URDF."""
DRAWN = ("visual", "collision")
"""Elements of a link that have a shape."""

_DECIMAL = re.compile(r"[ \t\n\v\f\r]*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_LIMITS = ("lower", "upper", "velocity", "effort")  # where a huge number says that there is none
_MAX_QUOTED = 60  # characters of a mistake that a message repeats


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
    text = None if element is None else element.get(key)
    if text is None and default is not None:
        return default
    value = to_float(text)
    is_too_large = abs(value) > LARGEST and key not in _LIMITS
    if math.isnan(value) or is_too_large:
        written = "nothing" if text is None else quoted(text)
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
    if len(text) > _MAX_QUOTED:
        text = text[:_MAX_QUOTED] + "..."
    return repr(text)


def read_origin(path: Path, element: Element) -> pin.SE3:
    """Return the pose of an element, the identity where it is left out. Raises
    ``RobotDataError``.
    """
    xyz: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    origin = element.find("origin")
    if origin is not None and "xyz" in origin.attrib:
        xyz = read_vector(path, origin, "xyz", "origin")
    if origin is not None and "rpy" in origin.attrib:
        rpy = read_vector(path, origin, "rpy", "origin")
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz))


def read_axis(path: Path, joint: Element, where: str) -> np.ndarray:
    """Return the axis (3,) of a joint, of any length, x where it is left out."""
    axis = joint.find("axis")
    if axis is None:
        return np.array((1.0, 0.0, 0.0))
    return np.array(read_vector(path, axis, "xyz", where))


def linked_name(joint: Element, end: str) -> str:
    """Return the name of the ``parent`` or ``child`` link of a joint, "" where it is left out."""
    element = joint.find(end)
    if element is None:
        return ""
    return element.get("link", "")


def moving_joints(root: Element) -> list[Element]:
    """Return the joints of a <robot> that are not fixed."""
    return [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]

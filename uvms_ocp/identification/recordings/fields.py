"""Numbers in a message by paths such as ``pose.pose.position.x``, whatever library has decoded it.

``actuators[3]`` and ``position.2`` are elements; ``position[elbow]`` and ``transforms[base_link].translation.x`` are those of a
name, which a ``name`` or ``child_frame_id`` says. A path to a whole array has all its elements.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound

_STEP = re.compile(r"\[([^\[\]]+)\]|([^.\[\]]+)")
_PATH = re.compile(r"[^.\[\]]+(\.[^.\[\]]+|\[[^\[\]]+\])*$")
_NAMED = ("name", "child_frame_id")
_STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Fields of a time in ROS 2, in Foxglove's JSON, in ROS 1 and in protobuf."""


def steps_of(path: str) -> tuple[str, ...]:
    """Of a path, one after the other. Raises InvalidInput for what is none."""
    if not _PATH.match(path):
        raise InvalidInput(
            f"field {path!r} given; allowed: names with dots between them, such as pose.position.x or a[3]"
        )
    return tuple(element or name for element, name in _STEP.findall(path))


def numbers_at(message: Any, steps: Sequence[str]) -> list[float]:
    """What is there [as it is]: one number, or all of an array. Raises NameNotFound, and InvalidInput for what is no number."""
    value = _value_at(message, steps)
    return [_number(x, steps) for x in value] if _is_array(value) else [_number(value, steps)]


def seconds_at(message: Any, steps: Sequence[str], unit: float) -> float:
    """A time [s]; unit: that of a plain number [s], which a stamp of seconds and nanoseconds does not need.

    Raises NameNotFound, and InvalidInput for what is neither.
    """
    value = _value_at(message, steps)
    names = () if isinstance(value, (int, float)) else _names_in(value)
    for whole, part in _STAMPS:
        if whole in names and part in names:
            return _number(_field(value, whole), steps) + 1e-9 * _number(_field(value, part), steps)
    return unit * _number(value, steps)


def _value_at(message: Any, steps: Sequence[str]) -> Any:
    parent, value = None, message
    for step in steps:
        parent, value = value, _element(parent, value, step) if _is_array(value) else _field(value, step)
    return value


def _field(value: Any, name: str) -> Any:
    names = _names_in(value)
    if name not in names:
        raise NameNotFound("field", name, names)
    return value[name] if isinstance(value, Mapping) else getattr(value, name)


def _names_in(value: Any) -> tuple[str, ...]:
    """Of the fields of a message; none of a number."""
    if isinstance(value, Mapping):
        return tuple(map(str, value))
    if is_dataclass(value):
        return tuple(field.name for field in fields(value))
    return tuple(field.name for field in getattr(getattr(value, "DESCRIPTOR", None), "fields", ()))


def _element(parent: Any, value: Any, step: str) -> Any:
    if step.isdecimal():
        if int(step) >= len(value):
            raise NameNotFound("element", step, [f"0 to {len(value) - 1}"])
        return value[int(step)]
    names = list(_names_of_elements(parent, value))
    if step not in names:
        raise NameNotFound("element", step, names)
    return value[names.index(step)]


def _names_of_elements(parent: Any, value: Any) -> Iterator[str]:
    """By a field of each, or by the names that stand beside them."""
    beside = _names_in(parent)
    if _NAMED[0] in beside and len(_field(parent, _NAMED[0])) == len(value):
        yield from map(str, _field(parent, _NAMED[0]))
        return
    for one in value:
        yield from (str(_field(one, name)) for name in _NAMED if name in _names_in(one))


def _is_array(value: Any) -> bool:
    return isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (str, bytes))


def _number(value: Any, steps: Sequence[str]) -> float:
    if isinstance(value, (int, float, np.number, np.bool_)):
        return float(value)
    known = ", ".join(_names_in(value))
    raise InvalidInput(f"{'.'.join(steps)} is no number{f', it has {known}' if known else ''}; give a path to one")

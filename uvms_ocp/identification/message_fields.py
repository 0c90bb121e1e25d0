"""Read numbers of a message by paths of fields such as ``pose.pose.position.x``, whatever library
has decoded it.

``actuators[3]`` and ``position.2`` are elements; ``position[elbow]`` and
``transforms[base_link].translation.x`` are those of a name, which a ``name`` or ``child_frame_id``
says. A path to a whole array has all its elements. Where elements have names, they are read by
these, see `paths_by_name`: another message may have them in another order.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, NameNotFound, require_known

_STEP = re.compile(r"\[([^\[\]]+)\]|([^.\[\]]+)")
_PATH = re.compile(r"[^.\[\]]+(\.[^.\[\]]+|\[[^\[\]]+\])*$")
_NAMED = ("name", "child_frame_id")
_STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Fields of a time in ROS 2, in Foxglove's JSON, in ROS 1 and in protobuf."""


def steps_of(path: str) -> tuple[str, ...]:
    """Split a path into its steps. Raises InvalidInput for a malformed one."""
    if not _PATH.match(path):
        raise InvalidInput(
            f"field {path!r} given; allowed: names with dots between them, such as pose.position.x"
            " or a[3]"
        )
    return tuple(element or name for element, name in _STEP.findall(path))


def numbers_at(message: Any, steps: Sequence[str]) -> list[float]:
    """Return the number at a path, or all numbers of an array. Raises NameNotFound, and
    InvalidInput for a value that is no number.
    """
    value = value_at(message, steps)
    if _is_array(value):
        return [_number(x, steps) for x in value]
    return [_number(value, steps)]


def seconds_at(message: Any, steps: Sequence[str], unit: float) -> float:
    """Return a time [s]; unit: that of a plain number [s], which a stamp of seconds and nanoseconds
    does not need.

    Raises NameNotFound, and InvalidInput for what is neither.
    """
    value = value_at(message, steps)
    names = () if isinstance(value, (int, float)) else _names_in(value)
    for stamp_seconds, part in _STAMPS:
        if stamp_seconds in names and part in names:
            seconds = _number(_field(value, stamp_seconds), steps)
            nanoseconds = _number(_field(value, part), steps)
            return seconds + 1e-9 * nanoseconds
    return unit * _number(value, steps)


def value_at(message: Any, steps: Sequence[str]) -> Any:
    """Return the value at a path of fields. Raises NameNotFound."""
    parent = None
    value = message
    for step in steps:
        if _is_array(value):
            child = _element(parent, value, step)
        else:
            child = _field(value, step)
        parent = value
        value = child
    return value


def paths_by_name(message: Any, steps: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Return the paths that a path means in a message, by the names of elements where they have
    such: of one element in place of its number, of a whole array one for each name.

    The path itself where elements have no names. Raises NameNotFound.
    """
    parent = None
    value = message
    path = list[str]()
    for step in steps:
        if _is_array(value):
            names = _unique_names(parent, value)
            is_place = step.isdecimal() and step not in names and int(step) < len(names)
            name = names[int(step)] if is_place else step
            child = _element(parent, value, step)
        else:
            name = step
            child = _field(value, step)
        path.append(name)
        parent = value
        value = child
    if _is_array(value):
        names = _unique_names(parent, value)
        if names:
            return tuple((*path, name) for name in names)
    return (tuple(path),)


def _unique_names(parent: Any, value: Any) -> tuple[str, ...]:
    """Return the names of all elements; none where some have none, or two have the same."""
    names = tuple(_names_of_elements(parent, value))
    if len(names) == len(value) == len(set(names)):
        return names
    return ()


def has_value(message: Any, steps: Sequence[str]) -> bool:
    """Check whether there is anything at a path of fields."""
    try:
        value_at(message, steps)
    except NameNotFound:
        return False
    return True


def _field(value: Any, name: str) -> Any:
    require_known("field", name, _names_in(value))
    if isinstance(value, Mapping):
        return value[name]
    return getattr(value, name)


def _names_in(value: Any) -> tuple[str, ...]:
    """List the names of the fields of a message; none for a number."""
    if isinstance(value, Mapping):
        return tuple(map(str, value))
    if is_dataclass(value):
        return tuple(field.name for field in fields(value))
    descriptor = getattr(value, "DESCRIPTOR", None)  # of protobuf
    return tuple(field.name for field in getattr(descriptor, "fields", ()))


def _element(parent: Any, value: Any, step: str) -> Any:
    """Return the element of an array at a place, or with a name."""
    names = list(_names_beside(parent, value))
    if step.isdecimal() and step not in names:
        if int(step) >= len(value):
            raise NameNotFound("element", step, [f"0 to {len(value) - 1}"])
        return value[int(step)]
    names = list(_names_of_elements(parent, value))
    require_known("element", step, names)
    return value[names.index(step)]


def _names_of_elements(parent: Any, value: Any) -> Iterator[str]:
    """Yield names of elements, by a field of each or by the names beside them."""
    names = _names_beside(parent, value)
    if names:
        yield from names
        return
    for element in value:
        for name in _NAMED:
            if name in _names_in(element):
                yield str(_field(element, name))


def _names_beside(parent: Any, value: Any) -> tuple[str, ...]:
    """Return the names that stand beside an array in its message, one for each element."""
    if "name" in _names_in(parent):
        names = _field(parent, "name")
        if _is_array(names) and len(names) == len(value):
            return tuple(map(str, names))
    return ()


def _is_array(value: Any) -> bool:
    return isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (str, bytes))


def _number(value: Any, steps: Sequence[str]) -> float:
    """Return a value as a number. Raises InvalidInput for one that is none."""
    if isinstance(value, (int, float, np.number, np.bool_)):
        return float(value)
    field_names = ", ".join(_names_in(value))
    contents = f", it has {field_names}" if field_names else ""
    raise InvalidInput(f"{'.'.join(steps)} is no number{contents}; give a path to one")

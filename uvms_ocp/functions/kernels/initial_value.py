"""A memory as C text: what initialises another one like it."""

from __future__ import annotations

import ctypes
from typing import Any

from uvms_ocp.functions.kernels.expressions import c_name
from uvms_ocp.functions.kernels.smooth import SmoothStructure


def initial_value(memory: ctypes.Structure) -> str:
    """A constant expression of C99, with its functions under their own names; what is zero is left out."""
    return _text(memory) or "{0}"


def _text(value: Any) -> str:
    """Nothing for what is zero."""
    if isinstance(value, SmoothStructure):
        return f"{{.call = {value.function.name()}}}"
    if isinstance(value, ctypes.Structure):
        return _structure(value)
    if isinstance(value, ctypes.Array):
        return _array(value)
    return _number(value)


def _structure(value: ctypes.Structure) -> str:
    fields = {name: _text(getattr(value, name)) for name, *_ in value._fields_}
    lines = [f".{c_name(name)} = {text}" for name, text in fields.items() if text]
    return f"{{{', '.join(lines)}}}" if lines else ""


def _array(value: ctypes.Array[Any]) -> str:
    items = [_text(item) for item in value]
    while items and not items[-1]:
        items.pop()
    empty = "{0}" if isinstance(value[0], (ctypes.Array, ctypes.Structure)) else "0"
    return f"{{{', '.join(item or empty for item in items)}}}" if items else ""


def _number(value: float) -> str:
    """Whatever reads it gets the same bits."""
    if isinstance(value, int):
        return str(value) if value else ""
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0 else "-INFINITY"
    return value.hex() if value or str(value) == "-0.0" else ""

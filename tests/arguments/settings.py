"""What users rely on: defaults, and which numbers settings take: ``python tests/arguments/settings.py --reason WHY``."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import json
import math
import re
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from public_surface import Call, surface
from valid_calls import EXPENSIVE, right_arguments

from uvms_ocp.errors import UvmsError

RECORDED = Path(__file__).with_name("settings.json")
FLOATS = (
    *(-math.inf, -1e9, -2.0, -1.0, -0.5, -1e-9, 0.0, 1e-9, 0.5, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 1.5, 2.0, 3.0, 10.0),
    *(1e3, 1e6, 1e9, 1e30, math.inf),
)
WHOLE = (-1, 0, 1, 2, 3, 4, 10, 1000, 10**6, 10**12)
"""Numbers that are tried on settings."""


def defaults() -> dict[str, str]:
    """``callable(parameter)`` to its default as text."""
    found = {}
    for call in surface():
        for name, parameter in call.parameters.items():
            value = _default(call, parameter)
            if value is not inspect.Parameter.empty:
                found[f"{call.title}({name})"] = _text(value)
    return found


def ranges() -> dict[str, str]:
    """``dataclass(field)`` to those of the numbers above that it takes, all other fields being right."""
    found = {}
    for call in surface():
        if dataclasses.is_dataclass(call.function) and call.title not in EXPENSIVE:
            right = right_arguments(call)
            for name, parameter in call.parameters.items():
                numbers = _numbers(right.get(name, parameter.default))
                if numbers:
                    taken = (f"{value:.10g}" for value in numbers if _takes(call, right, name, value))
                    found[f"{call.title}({name})"] = " ".join(taken)
    return found


def _numbers(value: Any) -> tuple[float, ...]:
    if isinstance(value, (bool, Enum)) or not isinstance(value, (int, float)):
        return ()
    return WHOLE if isinstance(value, int) else FLOATS


def _takes(call: Call, right: Mapping[str, Any], name: str, value: float) -> bool:
    try:
        call.function(**{**right, name: value})
    except UvmsError:
        return False
    return True


def _default(call: Call, parameter: inspect.Parameter) -> Any:
    if dataclasses.is_dataclass(call.function):
        fields = {field.name: field for field in dataclasses.fields(call.function)}
        field = fields.get(parameter.name)
        if field is not None and field.default_factory is not dataclasses.MISSING:
            return field.default_factory()
    return parameter.default


def _text(value: Any) -> str:
    if isinstance(value, Enum):
        return f"{type(value).__name__}.{value.name}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        shown = (
            f"{field.name}={_text(getattr(value, field.name))}" for field in dataclasses.fields(value) if field.repr
        )
        return f"{type(value).__name__}({', '.join(shown)})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, pin.SE3):
        return repr(value.homogeneous.round(12).tolist())
    if isinstance(value, np.ndarray):
        return repr(value.tolist())
    return getattr(value, "__qualname__", None) or re.sub(r" at 0x\w+", "", repr(value))


def main() -> None:
    """Record all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reason", required=True, help="why they move; it belongs into CHANGELOG too")
    given = parser.parse_args()
    found = {"reason": given.reason, "defaults": defaults(), "ranges": ranges()}
    RECORDED.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

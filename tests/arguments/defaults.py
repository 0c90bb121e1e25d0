"""The defaults of everything public, on which users rely. New ones: ``python tests/arguments/defaults.py --reason WHY``."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import json
import re
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from public_surface import Call, surface

RECORDED = Path(__file__).with_name("defaults.json")


def defaults() -> dict[str, str]:
    """``callable(parameter)`` to its default as text."""
    found = {}
    for call in surface():
        for name, parameter in call.parameters.items():
            value = _default(call, parameter)
            if value is not inspect.Parameter.empty:
                found[f"{call.title}({name})"] = _text(value)
    return found


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
    RECORDED.write_text(json.dumps({"reason": given.reason, "defaults": defaults()}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

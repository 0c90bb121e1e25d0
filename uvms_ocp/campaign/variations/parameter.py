"""One number of a scenario that can be set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from uvms_ocp.scenario import Scenario


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """By name; what it means, and how a scenario gets another value of it."""

    name: str
    unit: str
    meaning: str
    apply: Callable[[Scenario, float], Scenario]
    """The scenario with a value [unit]."""


def real_numbers(value: Any) -> list[str]:
    """Fields of a dataclass that it is made of and that are real numbers."""
    return [item.name for item in fields(value) if item.init and type(getattr(value, item.name)) is float]

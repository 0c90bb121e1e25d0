"""One number of a scenario that can be set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from uvms_ocp.scenario import Scenario


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """By name; what it means, and how a scenario gets another value of it."""

    name: str
    unit: str
    meaning: str
    apply: Callable[[Scenario, float], Scenario]
    """The scenario with a value [unit]."""

"""Parameters of parts that are not the toolkit's: the numbers of the dataclass that makes one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import is_dataclass, replace
from functools import partial
from typing import Any

from uvms_ocp.campaign.variations.parameter import Parameter, real_numbers
from uvms_ocp.parts.fresh import maker_of
from uvms_ocp.scenario import Scenario


def own_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Such as ``parts.plant.rate``, of every own part that is made by a dataclass with real numbers."""
    for part, name in scenario.own_parts.items():
        maker = _maker(scenario, part)
        for item in _numbers(maker):
            apply, meaning = partial(_with, part, item), f"{item} of {name}, as its class has it"
            yield Parameter(name=f"parts.{part}.{item}", unit="as there", meaning=meaning, apply=apply)


def _maker(scenario: Scenario, part: str) -> Any:
    return maker_of(part, getattr(scenario, part))


def _numbers(maker: Any) -> list[str]:
    return real_numbers(maker) if is_dataclass(maker) and not isinstance(maker, type) else []


def _with(part: str, name: str, scenario: Scenario, value: float) -> Scenario:
    return replace(scenario, **{part: replace(_maker(scenario, part), **{name: value})})

"""Parameters of parts that are not the toolkit's: the numbers of the dataclass that makes one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

from uvms_ocp.campaign.variations.parameter import Parameter
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
    if not is_dataclass(maker) or isinstance(maker, type):
        return []
    return [item.name for item in fields(maker) if item.init and type(getattr(maker, item.name)) is float]


def _with(part: str, name: str, scenario: Scenario, value: float) -> Scenario:
    return replace(scenario, **{part: replace(_maker(scenario, part), **{name: value})})

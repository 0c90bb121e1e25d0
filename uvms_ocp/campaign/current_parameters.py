"""Parameters of the current: uniform parts, heading and gusts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from uvms_ocp.campaign.distributions import Parameter
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import (
    Current,
    GustyCurrent,
    OnsetCurrent,
    StillWater,
    UniformCurrent,
)

_UNIFORM = (StillWater, UniformCurrent, OnsetCurrent)


def flow_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters of a uniform current, with gusts or without; of other currents gusts
    alone.
    """
    if scenario.plant == "kinematic":
        return
    if isinstance(_base(scenario), _UNIFORM):
        for axis, name in enumerate("xyz"):
            meaning = f"added to the velocity of the water along {name} of W"
            yield Parameter(f"current.{name}", "m/s", meaning, partial(_added, axis))
        yield Parameter(
            "current.speed", "m/s", "horizontal speed of the water", partial(_with_flow, "speed")
        )
        meaning = "heading of the horizontal flow, from x of W towards y"
        yield Parameter("current.heading", "rad", meaning, partial(_with_flow, "heading"))
    yield Parameter(
        "current.gusts", "m/s", "standard deviation of gusts along each axis of W", _with_gusts
    )


def _added(axis: int, scenario: Scenario, value: float) -> Scenario:
    return _flowing(scenario, _velocity(scenario) + value * np.eye(3)[axis])


def _with_flow(name: str, scenario: Scenario, value: float) -> Scenario:
    x, y, z = _velocity(scenario)
    flow = {"speed": math.hypot(x, y), "heading": math.atan2(y, x), name: value}
    way = np.array([math.cos(flow["heading"]), math.sin(flow["heading"]), 0.0])
    return _flowing(scenario, flow["speed"] * way + [0.0, 0.0, z])


def _with_gusts(scenario: Scenario, value: float) -> Scenario:
    current = scenario.environment.current
    if isinstance(current, GustyCurrent):
        return with_environment(scenario, current=replace(current, sigma=value))
    return with_environment(
        scenario, current=GustyCurrent(base=current, sigma=value, seed=scenario.seed)
    )


def _velocity(scenario: Scenario) -> np.ndarray:
    """Return the velocity (3,) [m/s] of the uniform part of the current."""
    base = _base(scenario)
    if isinstance(base, UniformCurrent | OnsetCurrent):
        return base.value
    return np.zeros(3)


def _base(scenario: Scenario) -> Current:
    """Return the current without its gusts."""
    current = scenario.environment.current
    if isinstance(current, GustyCurrent):
        return current.base
    return current


def _flowing(scenario: Scenario, velocity: np.ndarray) -> Scenario:
    """Return the scenario with another velocity (3,) [m/s] of its steady current, below any gusts."""
    base = _base(scenario)
    current = scenario.environment.current
    if isinstance(base, OnsetCurrent):
        base = OnsetCurrent(velocity, start=base.start, rise=base.rise)
    else:
        base = UniformCurrent(velocity)
    if isinstance(current, GustyCurrent):
        return with_environment(scenario, current=replace(current, base=base))
    return with_environment(scenario, current=base)


def with_environment(scenario: Scenario, **changes: Any) -> Scenario:
    """Return the scenario with changes of its environment."""
    return replace(scenario, environment=replace(scenario.environment, **changes))

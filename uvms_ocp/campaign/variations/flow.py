"""Parameters of the current: uniform parts, heading and gusts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from uvms_ocp.campaign.variations.parameter import Parameter
from uvms_ocp.scenario import Scenario
from uvms_ocp.sim.currents import Current, GustyCurrent, OnsetCurrent, StillWater, UniformCurrent

_UNIFORM = (StillWater, UniformCurrent, OnsetCurrent)


def flow_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Of water that flows the same everywhere, with gusts or without; of others gusts alone."""
    if scenario.plant == "kinematic":
        return
    if isinstance(_base(scenario), _UNIFORM):
        for axis, name in enumerate("xyz"):
            meaning = f"added to the velocity of the water along {name} of W"
            yield Parameter(name=f"current.{name}", unit="m/s", meaning=meaning, apply=partial(_added, axis))
        yield Parameter(name="current.speed", unit="m/s", meaning="horizontal speed of the water", apply=_with_speed)
        meaning = "heading of the horizontal flow, from x of W towards y"
        yield Parameter(name="current.heading", unit="rad", meaning=meaning, apply=_with_heading)
    meaning = "standard deviation of gusts along each axis of W"
    yield Parameter(name="current.gusts", unit="m/s", meaning=meaning, apply=_with_gusts)


def _added(axis: int, scenario: Scenario, value: float) -> Scenario:
    return _flowing(scenario, _velocity(scenario) + value * np.eye(3)[axis])


def _with_speed(scenario: Scenario, value: float) -> Scenario:
    x, y, z = _velocity(scenario)
    heading = math.atan2(y, x)
    return _flowing(scenario, np.array([value * math.cos(heading), value * math.sin(heading), z]))


def _with_heading(scenario: Scenario, value: float) -> Scenario:
    x, y, z = _velocity(scenario)
    speed = math.hypot(x, y)
    return _flowing(scenario, np.array([speed * math.cos(value), speed * math.sin(value), z]))


def _with_gusts(scenario: Scenario, value: float) -> Scenario:
    current = scenario.environment.current
    if isinstance(current, GustyCurrent):
        return _in(scenario, replace(current, sigma=value))
    return _in(scenario, GustyCurrent(base=current, sigma=value, seed=scenario.seed))


def _velocity(scenario: Scenario) -> np.ndarray:
    """(3,) [m/s] of the uniform part."""
    base = _base(scenario)
    return base.value if isinstance(base, UniformCurrent | OnsetCurrent) else np.zeros(3)


def _base(scenario: Scenario) -> Current:
    """The current without its gusts."""
    current = scenario.environment.current
    return current.base if isinstance(current, GustyCurrent) else current


def _flowing(scenario: Scenario, velocity: np.ndarray) -> Scenario:
    current = scenario.environment.current
    if isinstance(current, GustyCurrent):
        return _in(scenario, replace(current, base=_uniform(current.base, velocity)))
    return _in(scenario, _uniform(current, velocity))


def _uniform(current: Current, velocity: np.ndarray) -> Current:
    if isinstance(current, OnsetCurrent):
        return OnsetCurrent(velocity, start=current.start, rise=current.rise)
    return UniformCurrent(velocity)


def _in(scenario: Scenario, current: Current) -> Scenario:
    return replace(scenario, environment=replace(scenario.environment, current=current))

"""Parameters of the sensors, as they truly are: the estimator goes on with what the robot's file says of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from uvms_ocp.campaign.variations.parameter import Parameter
from uvms_ocp.model.sensing import CHANNELS, SensorSpec, SensorSpecs
from uvms_ocp.scenario import Scenario

_FIELDS = {
    "sigma": ("standard deviation of the noise", ""),
    "bias": ("constant error of all components", ""),
    "delay": ("time from taking a reading to delivering it", "s"),
    "dropout": ("probability that a reading is lost", "-"),
    "rate": ("readings per second", "Hz"),
}
_UNITS = {
    "position": "m",
    "depth": "m",
    "attitude": "rad",
    "angular_velocity": "rad/s",
    "linear_velocity": "m/s",
    "joint_positions": "rad",
    "joint_velocities": "rad/s",
    "altimeter_range": "m",
    "specific_force": "m/s2",
}


def sensor_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Of all channels together, and of each that the robot has."""
    yield Parameter(name="sensors.noise", unit="-", meaning="factor of the noise of all channels", apply=_noisier)
    yield Parameter(name="sensors.delay", unit="s", meaning="added to the delay of all channels", apply=_later)
    for channel in CHANNELS:
        if getattr(scenario.specs, channel) is not None:
            for name, (meaning, unit) in _FIELDS.items():
                yield Parameter(
                    name=f"sensors.{channel}.{name}",
                    unit=unit or _UNITS[channel],
                    meaning=meaning,
                    apply=partial(_with, channel, name),
                )


def _noisier(scenario: Scenario, factor: float) -> Scenario:
    return _each(scenario, lambda spec: {"sigma": factor * spec.sigma})


def _later(scenario: Scenario, value: float) -> Scenario:
    return _each(scenario, lambda spec: {"delay": spec.delay + value})


def _each(scenario: Scenario, change: Callable[[SensorSpec], dict[str, float]]) -> Scenario:
    specs = _true(scenario)
    found = {name: getattr(specs, name) for name in CHANNELS}
    changed = {name: replace(spec, **change(spec)) for name, spec in found.items() if spec is not None}
    return replace(scenario, real_sensors=replace(specs, **changed))


def _with(channel: str, name: str, scenario: Scenario, value: float) -> Scenario:
    specs = _true(scenario)
    spec: SensorSpec = getattr(specs, channel)
    return replace(scenario, real_sensors=replace(specs, **{channel: replace(spec, **{name: value})}))


def _true(scenario: Scenario) -> SensorSpecs:
    return scenario.real_sensors or scenario.specs

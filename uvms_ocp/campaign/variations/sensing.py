"""Parameters of the sensors, as they truly are: the estimator goes on with what the robot's file says of them.

Of delays alone it is told, as somebody who fits the sensors measures them; those that nobody knows of have names of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from uvms_ocp.campaign.variations.parameter import Parameter
from uvms_ocp.model.sensing import CHANNELS, UNITS, SensorSpec, SensorSpecs
from uvms_ocp.scenario import Scenario

_FIELDS = {
    "sigma": ("standard deviation of the noise", ""),
    "bias": ("constant error of all components", ""),
    "untold_delay": ("added to its delay, and known to nobody", "s"),
    "dropout": ("probability that a reading is lost", "-"),
    "rate": ("readings per second", "Hz"),
}


def sensor_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Of all channels together, and of each that the robot has."""
    yield Parameter(name="sensors.noise", unit="-", meaning="factor of the noise of all channels", apply=_noisier)
    if isinstance(scenario.sensors, SensorSpecs):
        yield from _told_delays(scenario.specs)
    text = "added to the delay of all channels, and known to nobody"
    yield Parameter(name="sensors.untold_delay", unit="s", meaning=text, apply=_later)
    for channel in CHANNELS:
        if getattr(scenario.specs, channel) is not None:
            for name, (meaning, unit) in _FIELDS.items():
                yield Parameter(
                    name=f"sensors.{channel}.{name}",
                    unit=unit or UNITS[channel],
                    meaning=meaning,
                    apply=partial(_with, channel, name),
                )


def _told_delays(specs: SensorSpecs) -> Iterator[Parameter]:
    """Known to estimator and controller, where the sensors are those of the toolkit."""
    text = "added to the delay of all channels, as their file would say it"
    yield Parameter(name="sensors.delay", unit="s", meaning=text, apply=_told_later)
    for channel in CHANNELS:
        if getattr(specs, channel) is not None:
            text = "time from taking a reading to delivering it, as its file would say it"
            apply = partial(_told_delay, channel)
            yield Parameter(name=f"sensors.{channel}.delay", unit="s", meaning=text, apply=apply)


def _told_later(scenario: Scenario, value: float) -> Scenario:
    for channel in CHANNELS:
        spec: SensorSpec | None = getattr(scenario.specs, channel)
        if spec is not None:
            scenario = _told_delay(channel, scenario, spec.delay + value)
    return scenario


def _told_delay(channel: str, scenario: Scenario, value: float) -> Scenario:
    """What nobody knows of the delay stays."""
    specs, true = scenario.specs, _true(scenario)
    known, spec = getattr(specs, channel), getattr(true, channel)
    told = replace(specs, **{channel: replace(known, delay=value)})
    real = replace(true, **{channel: replace(spec, delay=value + spec.delay - known.delay)})
    return replace(scenario, sensors=told, real_sensors=scenario.real_sensors and real)


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
    if name == "untold_delay":
        name, value = "delay", spec.delay + value
    return replace(scenario, real_sensors=replace(specs, **{channel: replace(spec, **{name: value})}))


def _true(scenario: Scenario) -> SensorSpecs:
    return scenario.real_sensors or scenario.specs

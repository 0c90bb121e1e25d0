"""Parameters of the sensors, as they truly are: the estimator goes on with what the robot's file
says of them.

It is given delays, as somebody who fits the sensors measures them; those that it is not given
are `unmodelled_delay`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from uvms_ocp.campaign.distributions import Parameter
from uvms_ocp.record.tables import of_joints
from uvms_ocp.robot.signals import CHANNELS, UNITS, SensorSpec, SensorSpecs
from uvms_ocp.scenario.scenario import Scenario

_FIELDS = {
    "sigma": ("standard deviation of the noise", ""),
    "bias": ("constant error of all components", ""),
    "unmodelled_delay": ("added to its delay, unknown to the controller", "s"),
    "dropout": ("probability that a reading is lost", "-"),
    "rate": ("readings per second", "Hz"),
}


def sensor_parameters(scenario: Scenario) -> Iterator[Parameter]:
    """Yield parameters of all sensors together, and of each that the robot has."""
    channels = [channel for channel in CHANNELS if getattr(scenario.specs, channel) is not None]
    noise = partial(_each, lambda spec, factor: {"sigma": factor * spec.sigma})
    unmodelled_delay = partial(_each, lambda spec, value: {"delay": spec.delay + value})
    yield Parameter("sensors.noise", "-", "factor of the noise of all channels", noise)
    if isinstance(scenario.sensors, SensorSpecs):  # estimator and controller are given the delays
        text = "added to the delay of all channels, as their file would say it"
        yield Parameter("sensors.delay", "s", text, _delayed)
        text = "time from taking a reading to delivering it, as its file would say it"
        for channel in channels:
            yield Parameter(f"sensors.{channel}.delay", "s", text, partial(_with_delay, channel))
    yield Parameter(
        "sensors.unmodelled_delay",
        "s",
        "added to the delay of all channels, unknown to the controller",
        unmodelled_delay,
    )
    slides = [joint.slides for joint in scenario.robot.joints]
    for channel in channels:
        for name, (meaning, unit) in _FIELDS.items():
            apply = partial(_with_field, channel, name)
            yield Parameter(
                f"sensors.{channel}.{name}",
                unit or of_joints(UNITS[channel], slides),
                meaning,
                apply,
            )


def _delayed(scenario: Scenario, value: float) -> Scenario:
    for channel in CHANNELS:
        spec: SensorSpec | None = getattr(scenario.specs, channel)
        if spec is not None:
            scenario = _with_delay(channel, scenario, spec.delay + value)
    return scenario


def _with_delay(channel: str, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with another nominal delay; the unmodelled part of the delay stays."""
    specs = scenario.specs
    true_specs = _true(scenario)
    nominal = getattr(specs, channel)
    spec = getattr(true_specs, channel)
    specified = replace(specs, **{channel: replace(nominal, delay=value)})
    real_specs = replace(
        true_specs, **{channel: replace(spec, delay=value + spec.delay - nominal.delay)}
    )
    return replace(scenario, sensors=specified, real_sensors=scenario.real_sensors and real_specs)


def _each(
    change: Callable[[SensorSpec, float], dict[str, float]], scenario: Scenario, value: float
) -> Scenario:
    specs = _true(scenario)
    changed = {}
    for name in CHANNELS:
        spec = getattr(specs, name)
        if spec is not None:
            changed[name] = replace(spec, **change(spec, value))
    return replace(scenario, real_sensors=replace(specs, **changed))


def _with_field(channel: str, name: str, scenario: Scenario, value: float) -> Scenario:
    specs = _true(scenario)
    spec: SensorSpec = getattr(specs, channel)
    if name == "unmodelled_delay":
        name = "delay"
        value = spec.delay + value
    return replace(
        scenario, real_sensors=replace(specs, **{channel: replace(spec, **{name: value})})
    )


def _true(scenario: Scenario) -> SensorSpecs:
    return scenario.real_sensors or scenario.specs

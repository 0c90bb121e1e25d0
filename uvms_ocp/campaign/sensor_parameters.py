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
from uvms_ocp.robot.channels import SensorSpec, rows_by_name
from uvms_ocp.robot.signals import SensorSpecs, with_sensors
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
    channels = scenario.specs.present
    rows = rows_by_name(scenario.specs.own)
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
                unit or of_joints(rows[channel].unit, slides),
                meaning,
                apply,
            )


def _delayed(scenario: Scenario, value: float) -> Scenario:
    for channel, spec in scenario.specs.present.items():
        scenario = _with_delay(channel, scenario, spec.delay + value)
    return scenario


def _with_delay(channel: str, scenario: Scenario, value: float) -> Scenario:
    """Return the scenario with another nominal delay; the unmodelled part of the delay stays."""
    specs = scenario.specs
    true_specs = _true(scenario)
    nominal = specs.present[channel]
    spec = true_specs.present[channel]
    specified = with_sensors(specs, {channel: replace(nominal, delay=value)})
    real_delay = value + spec.delay - nominal.delay
    real_specs = with_sensors(true_specs, {channel: replace(spec, delay=real_delay)})
    return replace(scenario, sensors=specified, real_sensors=scenario.real_sensors and real_specs)


def _each(
    change: Callable[[SensorSpec, float], dict[str, float]], scenario: Scenario, value: float
) -> Scenario:
    specs = _true(scenario)
    changed = {}
    for name, spec in specs.present.items():
        changed[name] = replace(spec, **change(spec, value))
    return replace(scenario, real_sensors=with_sensors(specs, changed))


def _with_field(channel: str, name: str, scenario: Scenario, value: float) -> Scenario:
    specs = _true(scenario)
    spec = specs.present[channel]
    if name == "unmodelled_delay":
        name = "delay"
        value = spec.delay + value
    changed = replace(spec, **{name: value})
    return replace(scenario, real_sensors=with_sensors(specs, {channel: changed}))


def _true(scenario: Scenario) -> SensorSpecs:
    return scenario.real_sensors or scenario.specs

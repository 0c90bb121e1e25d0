"""What the sensors of a robot are like: rates, noise, delays. The simulated sensors and the estimator read the same."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.files.description import RobotDescription, SensorDescription


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class SensorSpec:
    """One channel. Raises `InvalidInput` for a value outside its range."""

    rate: float = math.inf
    """[Hz]; inf is once per tick."""
    sigma: float = 0.0
    """[unit of the channel] standard deviation of the noise of every component."""
    bias: float | tuple[float, ...] = 0.0
    """[unit of the channel] constant error, of all components or of each."""
    delay: float = 0.0
    """[s] between taking a reading and delivering it."""
    dropout: float = 0.0
    """[-] probability that a reading is lost."""

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise InvalidInput(f"sensor rate = {self.rate} Hz; give a number > 0, or inf for once per tick")
        for name in ("sigma", "delay"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InvalidInput(f"sensor {name} = {value}; give a finite number >= 0")
        if not 0 <= self.dropout <= 1:
            raise InvalidInput(f"sensor dropout = {self.dropout}; give a probability from 0 to 1")
        if not all(math.isfinite(value) for value in self.biases):
            raise InvalidInput(f"sensor bias = {self.bias}; give finite numbers")

    @property
    def biases(self) -> tuple[float, ...]:
        """`bias` as one value for all components, or one per component."""
        return self.bias if isinstance(self.bias, tuple) else (self.bias,)

    @property
    def exact(self) -> bool:
        """Whether readings equal the truth."""
        return self.sigma == 0.0 and not any(self.biases)


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class SensorSpecs:
    """All channels of `Readings`; `None` where the robot has no such sensor. The noise of the defaults is assumed."""

    position: SensorSpec | None = SensorSpec(rate=5.0, sigma=0.02)
    """[m]"""
    depth: SensorSpec | None = SensorSpec(rate=10.0, sigma=0.01)
    """[m]"""
    attitude: SensorSpec | None = SensorSpec(rate=100.0, sigma=0.001)
    """[rad], a rotation vector in B."""
    angular_velocity: SensorSpec | None = SensorSpec(rate=100.0, sigma=0.002)
    """[rad/s]"""
    linear_velocity: SensorSpec | None = SensorSpec(rate=5.0, sigma=0.002)
    """[m/s]"""
    joint_positions: SensorSpec | None = SensorSpec(rate=200.0, sigma=1e-4)
    """[rad or m]"""
    joint_velocities: SensorSpec | None = None
    """[rad/s or m/s]"""
    altimeter_range: SensorSpec | None = SensorSpec(rate=10.0, sigma=0.01)
    """[m]"""
    specific_force: SensorSpec | None = None
    """[m/s2] of an accelerometer at the origin of B; `ACCELEROMETER` is a usual one."""


CHANNELS = tuple(field.name for field in fields(SensorSpecs))
"""Names of the channels, the fields of `SensorSpecs` and of `Readings`."""

UNITS: Mapping[str, str] = {
    "position": "m",
    "depth": "m",
    "attitude": "rad",
    "angular_velocity": "rad/s",
    "linear_velocity": "m/s",
    "joint_positions": "rad or m",
    "joint_velocities": "rad/s or m/s",
    "altimeter_range": "m",
    "specific_force": "m/s2",
}
"""Of the values of each channel."""

ACCELEROMETER = SensorSpec(rate=100.0, sigma=0.02)
"""A usual one for `SensorSpecs.specific_force`, assumed: 2 mm/s2/sqrt(Hz)."""

IDEAL_SENSORS = SensorSpecs(**dict.fromkeys(CHANNELS, SensorSpec()) | {"specific_force": None})
"""Every channel of the state itself, once per tick, without error or delay; no accelerometer, which nothing needs then."""


def sensors_of(description: RobotDescription) -> SensorSpecs:
    """The channels of a robot: the defaults of `SensorSpecs`, with what its file says of them."""
    channels = {name: _channel(getattr(SensorSpecs(), name), given) for name, given in description.sensors.items()}
    return replace(SensorSpecs(), **channels)


def _channel(default: SensorSpec | None, given: SensorDescription | None) -> SensorSpec | None:
    if given is None:
        return None
    return replace(default or SensorSpec(), **given.model_dump(exclude_none=True))

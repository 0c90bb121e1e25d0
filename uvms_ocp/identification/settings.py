"""Settings of an identification as a YAML file: the robot, what is to be learnt of it, the sensors.

robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
commands: thrust
lag: 0.1
delay: 0.05
learn:
  mass: {prior: 0.01}
  added_mass: {free: [surge, sway, heave, yaw]}
  quadratic_drag: {}
  centre_of_buoyancy: {prior: 0.2}
noise: {velocity: 0.01, rate: 0.01, vertical: 0.005}
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import estimates, fit, parameters
from uvms_ocp.identification.parameters import ParameterStatus
from uvms_ocp.identification.vehicle_declaration import LONGEST_DELAY
from uvms_ocp.model_errors import FileModel, one_line_errors
from uvms_ocp.record.yaml_file import read_yaml_as

_Positive = Annotated[float, Field(gt=0.0)]
_NonNegative = Annotated[float, Field(ge=0.0)]
_Delay = Annotated[float, Field(ge=0.0, lt=LONGEST_DELAY)]
_Corner = tuple[float, float, float]
_Axis = Literal["surge", "sway", "heave", "roll", "pitch", "yaw"]
_NOISE = estimates.Noise()
"""Defaults of the section on noise."""
_SEARCH = fit.Search()
"""Defaults of step and stretch."""


class _SettingsSection(FileModel, allow_inf_nan=False, use_attribute_docstrings=True):
    """Base of the sections of a settings file."""


class QuantitySettings(_SettingsSection):
    """Prior knowledge of a quantity; an empty section frees all of it."""

    free: tuple[str, ...] | None = None
    """only these of its coordinates may be learnt"""
    prior: _Positive | None = None
    """deviation: relative for what is positive, or [unit]"""
    bounds: tuple[float, float] | None = None
    """lowest and highest value [unit]"""

    def status(self) -> ParameterStatus:
        """Return it as declarations take it. Raises InvalidInput for a prior with bounds."""
        if self.prior is not None and self.bounds is not None:
            raise InvalidInput("prior and bounds given; allowed: one of them")
        if self.bounds is not None:
            return parameters.Bounded(lower=self.bounds[0], upper=self.bounds[1], only=self.free)
        if self.prior is None:
            return parameters.Free(only=self.free)
        return parameters.Prior(sigma=self.prior, only=self.free)


class NoiseSettings(_SettingsSection):
    """Standard deviations of sensors."""

    velocity: _Positive = _NOISE.velocity
    """[m/s]"""
    rate: _Positive = _NOISE.rate
    """[rad/s]"""
    vertical: _Positive = _NOISE.vertical
    """[-] of W's vertical in B"""
    process: _Positive = _NOISE.process
    """[m/s, rad/s, rad] between segments"""


@one_line_errors
class CalibrationSettings(_SettingsSection):
    """Settings of a calibration, as the YAML file has them."""

    robot: str
    """name, see `uvms-ocp list`, or a URDF or its folder beside this file"""
    hydrodynamics: str | None = None
    """YAML beside this file; default: the robot's own"""
    arm: Literal["as it is", "taken off"] = "as it is"
    """taken off: of a vehicle driven without it"""
    hull: tuple[_Corner, _Corner]
    """box that holds the hull, lowest and highest corner [m], in its link"""
    commands: Literal["thrust", "wrench", "propeller_commands"] = "thrust"
    """channel of what was commanded; propeller_commands by the robot's thrust curves"""
    lag: _NonNegative | None = None
    """of actuators, where the search begins [s]; default: of thrusters their mean, or 0.1"""
    delay: _Delay | None = None
    """of commands [s]; default: 0 in runs of this toolkit, else learnt, from 0.05 on"""
    velocity_delay: _Delay | None = None
    """of measured velocity [s]; default: 0 in runs of this toolkit, else learnt, from 0.01 on"""
    dead_zone: _NonNegative | None = None
    """of actuators [N, N m]; default: of thrusters their mean, or 0.001"""
    axes: tuple[_Axis, ...] = Field(default=get_args(_Axis), min_length=1)
    """along which it moves, others at rest"""
    learn: dict[str, QuantitySettings] = Field(min_length=1)
    """by the names of quantities"""
    noise: NoiseSettings = NoiseSettings()
    """of sensors"""
    step: _Positive = _SEARCH.step
    """of the simulation [s]"""
    stretch: _Positive = _SEARCH.segment_length
    """length of segments [s]"""


@checked
def read_settings(path: Path | str) -> CalibrationSettings:
    """Read settings from a YAML file. Raises InvalidInput in one line for a malformed one."""
    return read_yaml_as(Path(path), CalibrationSettings)

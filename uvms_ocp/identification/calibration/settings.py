"""What of a robot is to be learnt, as a YAML file.

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
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.methods.output_error import Noise
from uvms_ocp.identification.methods.search import Search
from uvms_ocp.identification.parameters.status import Bounded, Free, Prior, Status
from uvms_ocp.identification.parameters.vehicle_quantities import Actuators
from uvms_ocp.untrusted.yaml_file import read_yaml_as
from uvms_ocp.validation import one_line_errors

_Positive = Annotated[float, Field(gt=0.0)]
_NonNegative = Annotated[float, Field(ge=0.0)]
_Corner = tuple[float, float, float]
_NOISE, _SEARCH, _ACTUATORS = Noise(), Search(), Actuators()  # whose defaults are those of the file


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Learnt(_Section):
    """What is known of a quantity; with nothing in it all of it is free."""

    free: tuple[str, ...] | None = Field(default=None, description="only these of its coordinates may be learnt")
    prior: _Positive | None = Field(default=None, description="deviation: relative for what is positive, or [unit]")
    bounds: tuple[float, float] | None = Field(default=None, description="lowest and highest value [unit]")

    def status(self) -> Status:
        """As declarations take it. Raises InvalidInput for a prior with bounds."""
        if self.prior is not None and self.bounds is not None:
            raise InvalidInput("prior and bounds given; allowed: one of them")
        if self.bounds is not None:
            return Bounded(lower=self.bounds[0], upper=self.bounds[1], only=self.free)
        return Free(only=self.free) if self.prior is None else Prior(sigma=self.prior, only=self.free)


class NoiseSettings(_Section):
    """Standard deviations of sensors."""

    velocity: _Positive = Field(default=_NOISE.velocity, description="[m/s]")
    rate: _Positive = Field(default=_NOISE.rate, description="[rad/s]")
    vertical: _Positive = Field(default=_NOISE.vertical, description="[-] of W's vertical in B")
    process: _Positive = Field(default=_NOISE.process, description="[m/s, rad/s, rad] between stretches")


@one_line_errors
class Settings(_Section):
    """All of it."""

    robot: str = Field(description="name, see `uvms-ocp list`, or a URDF or its folder beside this file")
    hydrodynamics: str | None = Field(default=None, description="YAML beside this file; default: the robot's own")
    arm: Literal["as it is", "taken off"] = Field(
        default="as it is", description="taken off: of a vehicle driven without it"
    )
    hull: tuple[_Corner, _Corner] = Field(
        description="box that holds the hull, lowest and highest corner [m], in its link"
    )
    commands: Literal["thrust", "wrench"] = Field(default="thrust", description="channel of what was commanded")
    lag: _NonNegative | None = Field(
        default=None, description="of actuators, where the search begins [s]; default: of thrusters their mean, or 0.1"
    )
    delay: Annotated[float, Field(ge=0.0, lt=_ACTUATORS.longest_delay)] = Field(
        default=0.05, description="of commands, where the search begins [s]; of runs of this toolkit 0"
    )
    dead_zone: _NonNegative | None = Field(
        default=None, description="of actuators [N, N m]; default: of thrusters their mean, or 0.001"
    )
    learn: dict[str, Learnt] = Field(min_length=1, description="by the names of quantities")
    noise: NoiseSettings = Field(default=NoiseSettings(), description="of sensors")
    step: _Positive = Field(default=_SEARCH.step, description="of the simulation [s]")
    stretch: _Positive = Field(default=_SEARCH.stretch, description="length of stretches [s]")


def read_settings(path: Path) -> Settings:
    """From a YAML file. Raises InvalidInput in one line for what is none."""
    return read_yaml_as(path, Settings)

"""Settings of an identification as a YAML file, and the robot that it is about.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import pinocchio as pin
from pydantic import Field

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import fit, output_error, parameters
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.parameters import (
    ActuatorModel,
    Declaration,
    NominalParameters,
    ParameterStatus,
    Unknowns,
)
from uvms_ocp.model_errors import FileModel, one_line_errors
from uvms_ocp.record.yaml_file import read_yaml_as
from uvms_ocp.robot import assembly, loading, symbolic_dynamics
from uvms_ocp.robot.coefficients import coefficients_of, links_in_water
from uvms_ocp.robot.description import LinkCoefficients, RobotDescription
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thruster_matrix

# What of a robot is to be learnt, as a YAML file.

_Positive = Annotated[float, Field(gt=0.0)]
_NonNegative = Annotated[float, Field(ge=0.0)]
_Delay = Annotated[float, Field(ge=0.0, lt=parameters.LONGEST_DELAY)]
_Corner = tuple[float, float, float]
_Axis = Literal["surge", "sway", "heave", "roll", "pitch", "yaw"]
# whose defaults are those of the file
_NOISE = output_error.Noise()
_SEARCH = fit.Search()
_ACTUATORS = ActuatorModel()

_VEHICLE = 1  # joint of Pinocchio's, after the universe
_DELAY = 0.05  # [s] of commands, where a search of it begins
_DELAY_SPREAD = 2.0  # of the logarithm of a delay
_LEAST = 1e-3  # [s], [N] of what is given as 0: logarithms are searched
SHAPE_SPREADS = {"added_mass": 0.7, "quadratic_drag": 0.7, "volume": 0.7, "linear_drag": 2.0}
"""Relative deviations of coefficients that a shape gives, priors where settings give none: rules
are right to a factor of two.
"""


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
    """[m/s, rad/s, rad] between stretches"""


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
    stretch: _Positive = _SEARCH.stretch
    """length of stretches [s]"""


def read_settings(path: Path | str) -> CalibrationSettings:
    """Read settings from a YAML file. Raises InvalidInput in one line for a malformed one."""
    return read_yaml_as(Path(path), CalibrationSettings)


# The robot that is calibrated, as settings have it: with its file's numbers, and as a vehicle with
# unknowns.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CalibratedRobot:
    """Robot of the settings, and its vehicle with what is to be learnt as unknowns."""

    robot: Robot
    vehicle: Vehicle
    start: NominalParameters
    file: Path
    """Hydrodynamics of the robot."""

    @property
    def frame(self) -> str:
        """Link whose coefficients are learnt."""
        return self.vehicle.dynamics.links[self.vehicle.link].frame

    def hull_in_body(self, hull: Sequence[Sequence[float]]) -> np.ndarray:
        """Compute the (2, 3) [m] box in B that holds one in the link's frame; hull: its lowest and
        highest corner [m].
        """
        model = self.vehicle.dynamics.model
        return _box_around(model.frames[model.getFrameId(self.frame)].placement, hull)

    def coefficients(self) -> LinkCoefficients:
        """Coefficients of the link in the robot's file, or of its shape there, which identified
        ones replace.

        Raises InvalidInput for a link that has neither, or has them along axes that are not its
        own.
        """
        description = self.robot.description
        link = self.robot.description.links.get(self.frame)
        if link is None:
            nominal = None
        else:
            nominal = link.coefficients or _of_shape(description, self.frame)
        if (
            nominal is None
            or description.convention != "FLU"
            or np.round(nominal.pose.rpy, 9).any()
        ):
            raise InvalidInput(
                f"{self.frame}: give it coefficients along the axes of its link, in FLU, to have it"
                " calibrated"
            )
        return nominal


def _box_around(X: pin.SE3, box: Sequence[Sequence[float]]) -> np.ndarray:
    """Compute the (2, 3) [m] lowest and highest corner of a box around one of another frame, which
    X places.
    """
    middle = X.act(np.mean(box, axis=0))
    reach = np.abs(X.rotation) @ (np.diff(box, axis=0)[0] / 2)
    return np.array([middle - reach, middle + reach])


def calibrated_robot(settings: CalibrationSettings, folder: Path | str) -> CalibratedRobot:
    """Load the robot of the settings and declare its unknowns; files are looked for in the
    settings' folder.

    Raises InvalidInput, NameNotFound and RobotDataError.
    """
    urdf, file = _files(settings, Path(folder))
    robot = loading.load_robot(urdf=urdf, hydrodynamics=file)
    if settings.arm == "taken off":
        robot = assembly.without_arm(robot)
    if not robot.n_vehicle:
        raise InvalidInput(
            f"robot {robot.name!r} has a fixed base; a vehicle is identified, which must float"
        )
    dynamics = robot_dynamics(robot).symbolic
    actuators = _actuators(settings, robot)
    if file is None or not dynamics.links:
        raise InvalidInput(
            f"robot {robot.name!r} has no hydrodynamics of a link in water; give it a file that has"
        )
    link = _own_link(robot, dynamics)
    start = NominalParameters.of(dynamics, link)
    learnt = {name: learnt_status.status() for name, learnt_status in settings.learn.items()}
    has_shape = bool(shape_of(robot, dynamics.links[link].frame))
    for name in learnt.keys() & SHAPE_SPREADS.keys():
        if has_shape and isinstance(learnt[name], parameters.Free):
            learnt[name] = parameters.Prior(sigma=SHAPE_SPREADS[name], only=learnt[name].only)
    hull = _box_around(dynamics.links[link].X_FL.inverse(), settings.hull)
    declaration = parameters.vehicle_declaration(
        start, hull, actuators, velocity_delay=settings.velocity_delay or 0.0
    )
    declaration = declaration.with_status(
        **{
            name: _along(settings.axes, declaration, name, learnt_status)
            for name, learnt_status in learnt.items()
        }
    )
    shared = Unknowns(declaration)
    own_unknowns = Unknowns(declaration, own=True)
    if not (shared.names or own_unknowns.names):
        raise InvalidInput(
            f"learn: {', '.join(learnt)} given, and nothing in it is free; free some of their"
            " coordinates"
        )
    axes = tuple(k for k, name in enumerate(parameters.AXES) if name in settings.axes)
    vehicle = Vehicle(
        dynamics=dynamics,
        shared=shared,
        own=own_unknowns,
        actuators=actuators,
        link=link,
        axes=axes,
    )
    return CalibratedRobot(robot=robot, vehicle=vehicle, start=start, file=file)


def _along(
    axes: Sequence[str], declaration: Declaration, name: str, status: ParameterStatus
) -> ParameterStatus:
    """Leave out the coordinates of axes along which the vehicle is held: a recording shows nothing
    of them.
    """
    names = declaration.quantities[name].coordinates.names if name in declaration.quantities else ()
    held_axes = set(parameters.AXES) - set(axes)
    held_coordinates = [
        coordinate
        for coordinate in names
        if held_axes.intersection(coordinate.replace(" from ", "-").split("-"))
    ]
    if held_coordinates:
        return replace(
            status,
            only=tuple(
                coordinate
                for coordinate in status.only or names
                if coordinate not in held_coordinates
            ),
        )
    return status


def with_delays(
    subject: CalibratedRobot, settings: CalibrationSettings, *, at_once: bool
) -> CalibratedRobot:
    """Add the delays that settings say nothing of to a robot: none where commands act at once, else
    unknown and learnt.
    """
    open_ones = [
        n for n in parameters.DELAYS if getattr(settings, n) is None and n not in settings.learn
    ]
    declaration = subject.vehicle.shared.declaration
    if at_once:
        declaration = declaration.with_start(
            **dict.fromkeys(open_ones, np.array([parameters.AT_ONCE]))
        )
    else:
        declaration = declaration.with_status(
            **dict.fromkeys(open_ones, parameters.Prior(sigma=_DELAY_SPREAD))
        )
    return replace(
        subject,
        vehicle=replace(
            subject.vehicle, shared=Unknowns(declaration), own=Unknowns(declaration, own=True)
        ),
    )


def _own_link(robot: Robot, dynamics: symbolic_dynamics.SymbolicDynamics) -> int:
    """Find the place in ``dynamics.links`` of the largest that the vehicle itself carries: a file
    has them in any order.
    """
    carried = [link for link in range(len(dynamics.links)) if dynamics.joint_of(link) == _VEHICLE]
    if not carried:
        wet = ", ".join(link.frame for link in dynamics.links)
        raise InvalidInput(
            f"robot {robot.name!r} has hydrodynamics of {wet} alone; give it some of the vehicle's"
            " own link"
        )
    return max(carried, key=lambda link: dynamics.links[link].volume)


def _files(settings: CalibrationSettings, folder: Path) -> tuple[Path, Path | None]:
    """Return the paths of URDF and hydrodynamics; `None` where there is no such file."""
    urdf = folder / settings.robot
    if urdf.suffix != ".urdf":
        urdf = (urdf if urdf.is_dir() else loading.robot_folder(settings.robot)) / "robot.urdf"
    if settings.hydrodynamics is None:
        file = urdf.parent / "hydrodynamics.yaml"
    else:
        file = folder / settings.hydrodynamics
    return urdf, file if settings.hydrodynamics is not None or file.is_file() else None


def _actuators(settings: CalibrationSettings, robot: Robot) -> ActuatorModel:
    optional_values = {name: getattr(settings, name) for name in ("lag", "dead_zone")}
    set_values: dict[str, Any] = {
        name: value or _LEAST for name, value in optional_values.items() if value is not None
    }
    channel = "wrench" if settings.commands == "wrench" else "thrust"
    model = ActuatorModel(
        delay=_DELAY if settings.delay is None else settings.delay, commands=channel
    )
    if settings.commands == "wrench":
        return replace(model, **set_values)
    names = robot.thruster_names
    thrusters = robot.description.thrusters
    if not names:
        raise InvalidInput(f"robot {robot.name!r} has no thrusters; give commands: wrench")
    described: dict[str, Any] = {
        "lag": max(float(np.mean([thruster.time_constant for thruster in thrusters])), _LEAST),
        "dead_zone": max(float(np.mean([thruster.dead_zone for thruster in thrusters])), _LEAST),
        "whole_beyond": True,
        "allocation": np.eye(len(names)),
    }
    return replace(model, names=names, wrench=thruster_matrix(robot), **(described | set_values))


# Coefficients of the calibrated link as a robot file has them: those that it has, or those that its
# shape amounts to.


def shape_of(robot: Robot, frame: str) -> str:
    """Key of the shape by which the robot's file describes a link, such as ``box``; empty for one
    with coefficients or none.
    """
    link = robot.description.links.get(frame)
    return next(
        (name for name in ("box", "cylinder", "sphere") if getattr(link, name, None) is not None),
        "",
    )


def _of_shape(description: RobotDescription, frame: str) -> LinkCoefficients:
    """Compute the coefficients of a link's shape alone, without floats and ballast."""
    (wet,) = links_in_water(
        description.model_copy(update={"links": {frame: description.links[frame]}, "trim": ()})
    )
    return coefficients_of(wet)

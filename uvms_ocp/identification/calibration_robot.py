"""Load the robot that is to be calibrated, with the numbers of its files, and declare the unknowns of its
vehicle by the settings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import parameters
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.parameters import (
    Declaration,
    ParameterStatus,
    Unknowns,
)
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    NominalParameters,
    vehicle_declaration,
)
from uvms_ocp.robot import assembly, loading, symbolic_dynamics
from uvms_ocp.robot.coefficients import coefficients_of, links_in_water
from uvms_ocp.robot.description import LinkCoefficients, RobotDescription
from uvms_ocp.robot.dialects.robot_xml import ROBOT_SUFFIXES, robot_file_in
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thruster_matrix

SHAPE_SPREADS = {"added_mass": 0.7, "quadratic_drag": 0.7, "volume": 0.7, "linear_drag": 2.0}
"""Relative standard deviations of coefficients that follow from a shape, priors where settings give
none: rules for shapes are right to a factor of two.
"""
_VEHICLE_JOINT = 1  # of Pinocchio, after the universe
_SHAPES = ("box", "cylinder", "sphere")
"""Keys of the shapes by which a robot's file may describe a link."""
_DELAY = 0.05  # [s] of commands, where a search for it begins
_DELAY_SPREAD = 2.0  # of the logarithm of a delay
_NOT_ZERO = 1e-3  # [s], [N] in place of 0: logarithms are searched


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CalibratedRobot:
    """Robot of the settings, and its vehicle with unknowns for all that is to be learnt."""

    robot: Robot
    """The robot with the numbers of its file, without its arm where that is taken off."""
    vehicle: Vehicle
    """The robot's vehicle with its unknowns."""
    start: NominalParameters
    """Numbers of the file, where the search begins."""
    file: Path
    """Path of the robot's hydrodynamics."""

    @property
    def frame(self) -> str:
        """Link whose coefficients are learnt."""
        return self.vehicle.dynamics.links[self.vehicle.link].frame

    def hull_in_body(self, hull: Sequence[Sequence[float]]) -> np.ndarray:
        """Compute the (2, 3) [m] box in B around a hull in the frame of the link, each by its lowest and
        highest corner [m].
        """
        model = self.vehicle.dynamics.model
        frame = model.frames[model.getFrameId(self.frame)]
        return _box_around(frame.placement, hull)

    def coefficients(self) -> LinkCoefficients:
        """Return the coefficients of the link, of the robot's file or of the shape in it, which
        identified ones replace.

        Raises InvalidInput for a link without either, or with coefficients along axes of another
        frame.
        """
        description = self.robot.description
        link = description.links.get(self.frame)
        nominal = None
        if link is not None:
            nominal = link.coefficients or _of_shape(description, self.frame)
        is_along_link = nominal is not None and not np.round(nominal.pose.rpy, 9).any()
        if nominal is None or not is_along_link or description.convention != "FLU":
            raise InvalidInput(
                f"{self.frame}: give it coefficients along the axes of its link, in FLU, to have it"
                " calibrated"
            )
        return nominal


@checked
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
    link = _vehicle_link(robot, dynamics)
    start = NominalParameters.of(dynamics, link)
    hull = _box_around(dynamics.links[link].X_FL.inverse(), settings.hull)
    declaration = vehicle_declaration(
        start, hull, actuators, velocity_delay=settings.velocity_delay or 0.0
    )
    has_shape = bool(shape_of(robot, dynamics.links[link].frame))
    declaration = _with_learnt(declaration, settings, has_shape=has_shape)
    shared = Unknowns(declaration)
    per_recording = Unknowns(declaration, per_recording=True)
    if not (shared.names or per_recording.names):
        raise InvalidInput(
            f"learn: {', '.join(settings.learn)} given, and nothing in it is free; free some of"
            " their coordinates"
        )
    vehicle = Vehicle(
        dynamics=dynamics,
        shared=shared,
        per_recording=per_recording,
        actuators=actuators,
        link=link,
        axes=tuple(k for k, name in enumerate(parameters.AXES) if name in settings.axes),
    )
    return CalibratedRobot(robot=robot, vehicle=vehicle, start=start, file=file)


def with_delays(
    subject: CalibratedRobot, settings: CalibrationSettings, *, at_once: bool
) -> CalibratedRobot:
    """Set the delays that the settings leave open: to none where commands act at once, else they are
    learnt.
    """
    unstated = []
    for name in parameters.DELAYS:
        if getattr(settings, name) is None and name not in settings.learn:
            unstated.append(name)
    declaration = subject.vehicle.shared.declaration
    if at_once:
        no_delay = np.array([parameters.AT_ONCE])
        declaration = declaration.with_start(**dict.fromkeys(unstated, no_delay))
    else:
        learnt = parameters.Prior(sigma=_DELAY_SPREAD)
        declaration = declaration.with_status(**dict.fromkeys(unstated, learnt))
    vehicle = replace(
        subject.vehicle,
        shared=Unknowns(declaration),
        per_recording=Unknowns(declaration, per_recording=True),
    )
    return replace(subject, vehicle=vehicle)


def _files(settings: CalibrationSettings, folder: Path) -> tuple[Path, Path | None]:
    """Return the paths of URDF and hydrodynamics; `None` where the robot's folder has none of
    these.
    """
    urdf = folder / settings.robot
    if not urdf.is_file() and urdf.suffix not in ROBOT_SUFFIXES:
        robot_folder = urdf
        if not urdf.is_dir():
            robot_folder = loading.robot_folder(settings.robot)
        urdf = robot_file_in(robot_folder)
    if settings.hydrodynamics is not None:
        return urdf, folder / settings.hydrodynamics
    file = urdf.parent / "hydrodynamics.yaml"
    if file.is_file():
        return urdf, file
    return urdf, None


def _actuators(settings: CalibrationSettings, robot: Robot) -> ActuatorModel:
    """Return the actuators: the wrench as commanded, or the robot's thrusters, with the lag, delay and
    dead zone of the settings.
    """
    stated: dict[str, Any] = {}
    for name in ("lag", "dead_zone"):
        value = getattr(settings, name)
        if value is not None:
            stated[name] = value or _NOT_ZERO
    delay = _DELAY if settings.delay is None else settings.delay
    if settings.commands == "wrench":
        return ActuatorModel(delay=delay, commands="wrench", **stated)
    names = robot.thruster_names
    if not names:
        raise InvalidInput(f"robot {robot.name!r} has no thrusters; give commands: wrench")
    thrusters = robot.description.thrusters
    mean_lag = float(np.mean([thruster.time_constant for thruster in thrusters]))
    mean_dead_zone = float(np.mean([thruster.dead_zone for thruster in thrusters]))
    described = {"lag": max(mean_lag, _NOT_ZERO), "dead_zone": max(mean_dead_zone, _NOT_ZERO)}
    return ActuatorModel(
        names=names,
        wrench=thruster_matrix(robot),
        allocation=np.eye(len(names)),
        whole_beyond=True,
        delay=delay,
        commands="thrust",
        **(described | stated),
    )


def _vehicle_link(robot: Robot, dynamics: symbolic_dynamics.SymbolicDynamics) -> int:
    """Find the index in ``dynamics.links`` of the largest link that the vehicle itself carries."""
    carried = [
        link for link in range(len(dynamics.links)) if dynamics.joint_of(link) == _VEHICLE_JOINT
    ]
    if not carried:
        wet = ", ".join(link.frame for link in dynamics.links)
        raise InvalidInput(
            f"robot {robot.name!r} has hydrodynamics of {wet} alone; give it some of the vehicle's"
            " own link"
        )
    return max(carried, key=lambda link: dynamics.links[link].volume)


def _box_around(X: pin.SE3, box: Sequence[Sequence[float]]) -> np.ndarray:
    """Compute the (2, 3) [m] lowest and highest corner of a box around a box whose frame has the pose
    X.
    """
    middle = X.act(np.mean(box, axis=0))
    reach = np.abs(X.rotation) @ (np.diff(box, axis=0)[0] / 2)
    return np.array([middle - reach, middle + reach])


def _with_learnt(
    declaration: Declaration, settings: CalibrationSettings, *, has_shape: bool
) -> Declaration:
    """Give the quantities that the settings want to learn their statuses; has_shape: True where
    coefficients follow from a shape, for which free ones get priors.
    """
    statuses = {}
    for name, section in settings.learn.items():
        status = section.status()
        if has_shape and name in SHAPE_SPREADS and isinstance(status, parameters.Free):
            status = parameters.Prior(sigma=SHAPE_SPREADS[name], only=status.only)
        statuses[name] = _along(settings.axes, declaration, name, status)
    return declaration.with_status(**statuses)


def _along(
    axes: Sequence[str], declaration: Declaration, name: str, status: ParameterStatus
) -> ParameterStatus:
    """Leave out the coordinates of axes along which the vehicle is held: a recording shows nothing
    of them.
    """
    if name not in declaration.quantities:
        return status
    names = declaration.quantities[name].coordinates.names
    held_axes = set(parameters.AXES) - set(axes)
    held = set()
    for coordinate in names:
        axes_of_coordinate = coordinate.replace(" from ", "-").split("-")
        if held_axes.intersection(axes_of_coordinate):
            held.add(coordinate)
    if not held:
        return status
    remaining = tuple(coordinate for coordinate in status.only or names if coordinate not in held)
    return replace(status, only=remaining)


def shape_of(robot: Robot, frame: str) -> str:
    """Return the key of the shape by which the robot's file describes a link, such as ``box``; empty
    for one with coefficients or none.
    """
    link = robot.description.links.get(frame)
    for name in _SHAPES:
        if getattr(link, name, None) is not None:
            return name
    return ""


def _of_shape(description: RobotDescription, frame: str) -> LinkCoefficients:
    """Compute the coefficients of a link's shape alone, without floats and ballast."""
    link_alone = {"links": {frame: description.links[frame]}, "trim": ()}
    (wet,) = links_in_water(description.model_copy(update=link_alone))
    return coefficients_of(wet)

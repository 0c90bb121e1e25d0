"""The robot that is calibrated, as settings have it: with its file's numbers, and as a vehicle with unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.calibration.settings import Settings
from uvms_ocp.identification.models.stage import Vehicle
from uvms_ocp.identification.parameters.unknowns import Unknowns
from uvms_ocp.identification.parameters.vehicle_quantities import Actuators, Start, vehicle_declaration
from uvms_ocp.model.assembly.mounting import without_arm
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.files.library import robot_folder
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thruster_matrix


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Subject:
    """One."""

    robot: Robot
    vehicle: Vehicle
    start: Start
    file: Path
    """Hydrodynamics of the robot."""

    @property
    def frame(self) -> str:
        """Link whose coefficients are learnt."""
        return self.vehicle.dynamics.links[self.vehicle.link].frame


def subject_of(settings: Settings, folder: Path) -> Subject:
    """Load it; files are looked for in the settings' folder. Raises InvalidInput, NameNotFound and RobotDataError."""
    urdf, file = _files(settings, folder)
    robot = load_robot(urdf=urdf, hydrodynamics=file)
    robot = without_arm(robot) if settings.arm == "taken off" else robot
    if not robot.n_vehicle:
        raise InvalidInput(f"robot {robot.name!r} has a fixed base; a vehicle is identified, which must float")
    dynamics, actuators = robot_dynamics(robot).symbolic, _actuators(settings, robot)
    if file is None or not dynamics.links:
        raise InvalidInput(f"robot {robot.name!r} has no hydrodynamics of a link in water; give it a file that has")
    start = Start.of(dynamics)
    learnt = {name: one.status() for name, one in settings.learn.items()}
    known = vehicle_declaration(start, np.array(settings.hull), actuators).learning(**learnt)
    vehicle = Vehicle(dynamics=dynamics, shared=Unknowns(known), own=Unknowns(known, own=True), actuators=actuators)
    return Subject(robot=robot, vehicle=vehicle, start=start, file=file)


def _files(settings: Settings, folder: Path) -> tuple[Path, Path | None]:
    """URDF and hydrodynamics."""
    named = folder / settings.robot
    urdf = named if named.suffix == ".urdf" else robot_folder(settings.robot) / "robot.urdf"
    file = urdf.parent / "hydrodynamics.yaml" if settings.hydrodynamics is None else folder / settings.hydrodynamics
    return urdf, file if settings.hydrodynamics is not None or file.is_file() else None


def _actuators(settings: Settings, robot: Robot) -> Actuators:
    wrench = Actuators(lag=settings.lag, delay=settings.delay, dead_zone=settings.dead_zone, commands=settings.commands)
    if settings.commands == "wrench":
        return wrench
    names = tuple(thruster.name for thruster in robot.description.thrusters)
    if not names:
        raise InvalidInput(f"robot {robot.name!r} has no thrusters; give commands: wrench")
    return replace(wrench, names=names, wrench=thruster_matrix(robot), allocation=np.eye(len(names)))

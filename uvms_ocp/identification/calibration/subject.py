"""The robot that is calibrated, as settings have it: with its file's numbers, and as a vehicle with unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics
from uvms_ocp.model.thrusters import thruster_matrix

_VEHICLE = 1  # joint of Pinocchio's, after the universe
_LEAST = 1e-3  # [s], [N] of what is given as 0: logarithms are searched


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

    def hull_in_body(self, hull: Sequence[Sequence[float]]) -> np.ndarray:
        """(2, 3) [m] box in B that holds one in the link's frame; hull: its lowest and highest corner [m]."""
        model = self.vehicle.dynamics.model
        X, low_high = model.frames[model.getFrameId(self.frame)].placement, np.array(hull)
        middle, reach = X.act(low_high.mean(axis=0)), np.abs(X.rotation) @ (np.diff(low_high, axis=0)[0] / 2)
        return np.array([middle - reach, middle + reach])


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
    link = _own_link(robot, dynamics)
    start = Start.of(dynamics, link)
    shared, own = _unknowns(settings, start, actuators)
    vehicle = Vehicle(dynamics=dynamics, shared=shared, own=own, actuators=actuators, link=link)
    return Subject(robot=robot, vehicle=vehicle, start=start, file=file)


def _unknowns(settings: Settings, start: Start, actuators: Actuators) -> tuple[Unknowns, Unknowns]:
    """Of all recordings, and of each."""
    learnt = {name: one.status() for name, one in settings.learn.items()}
    known = vehicle_declaration(start, np.array(settings.hull), actuators).learning(**learnt)
    shared, own = Unknowns(known), Unknowns(known, own=True)
    if not (shared.names or own.names):
        given = f"learn: {', '.join(learnt)} given, and nothing in it is free"
        raise InvalidInput(f"{given}; free some of their coordinates")
    return shared, own


def _own_link(robot: Robot, dynamics: SymbolicDynamics) -> int:
    """Place in ``dynamics.links`` of the largest that the vehicle itself carries: a file has them in any order."""
    own = [link for link in range(len(dynamics.links)) if dynamics.joint_of(link) == _VEHICLE]
    if not own:
        wet = ", ".join(link.frame for link in dynamics.links)
        raise InvalidInput(
            f"robot {robot.name!r} has hydrodynamics of {wet} alone; give it some of the vehicle's own link"
        )
    return max(own, key=lambda link: dynamics.links[link].volume)


def _files(settings: Settings, folder: Path) -> tuple[Path, Path | None]:
    """URDF and hydrodynamics."""
    named = folder / settings.robot
    urdf = (
        named if named.suffix == ".urdf" else (named if named.is_dir() else robot_folder(settings.robot)) / "robot.urdf"
    )
    file = urdf.parent / "hydrodynamics.yaml" if settings.hydrodynamics is None else folder / settings.hydrodynamics
    return urdf, file if settings.hydrodynamics is not None or file.is_file() else None


def _actuators(settings: Settings, robot: Robot) -> Actuators:
    asked = {name: getattr(settings, name) for name in ("lag", "dead_zone")}
    given: dict[str, Any] = {name: value or _LEAST for name, value in asked.items() if value is not None}
    known = Actuators(delay=settings.delay or _LEAST, commands=settings.commands)
    if settings.commands == "wrench":
        return replace(known, **given)
    names, thrusters = robot.thruster_names, robot.description.thrusters
    if not names:
        raise InvalidInput(f"robot {robot.name!r} has no thrusters; give commands: wrench")
    described: dict[str, Any] = {
        "lag": max(float(np.mean([one.time_constant for one in thrusters])), _LEAST),
        "dead_zone": max(float(np.mean([one.dead_zone for one in thrusters])), _LEAST),
        "whole_beyond": True,
        "allocation": np.eye(len(names)),
    }
    return replace(known, names=names, wrench=thruster_matrix(robot), **(described | given))

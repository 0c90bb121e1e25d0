"""From robot files to a `Robot`: URDF and description are read, checked against each other and joined."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput, RobotDataError
from uvms_ocp.model.files.conventions import forward_left_up
from uvms_ocp.model.files.description import RobotDescription, TrimBody, checked_copy
from uvms_ocp.model.files.description_file import read_description
from uvms_ocp.model.files.library import robot_folder, variant_file
from uvms_ocp.model.files.unknowns import unknowns
from uvms_ocp.model.files.urdf import UrdfModels, read_urdf
from uvms_ocp.model.limits import home_of, joints_of, limits_of
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.water.coefficients import links_in_water

_log = logging.getLogger(__name__)


@checked
def load_robot(
    name: str | None = None,
    *,
    urdf: Path | str | None = None,
    hydrodynamics: Path | str | None = None,
    variant: str | None = None,
    base: str | None = None,
    package_dirs: Sequence[Path | str] = (),
    mimic: Literal["free"] | None = None,
) -> Robot:
    """Load a robot by name, or from a URDF file and, if there is one, its hydrodynamics file.

    ``variant`` is another published data set of a named robot, see ``list_variants``. ``base`` overrides the file
    (default: free_flyer). ``package_dirs`` are searched for ``package://`` meshes. Joints that ``<mimic>`` another one
    are refused; ``mimic="free"`` makes them joints of their own, with the limits the URDF gives them. Raises
    ``InvalidInput`` for neither or both of name and URDF, another ``mimic``, or a variant without a name,
    ``NameNotFound`` for an unknown robot or variant, and ``RobotDataError`` for a file that is missing, broken, does not
    fit the other, or holds numbers that the model built from it has not.

    What the files leave open, such as links without water and thrusters without power data, is a warning of this module's
    logger.
    """
    urdf_path, yaml_path = _paths(name, urdf, hydrodynamics)
    description = _description(name, yaml_path, variant)
    if base is not None:
        description = checked_copy(description, base=base)
    free_flyer = description.base == "free_flyer"
    folders = [Path(folder) for folder in package_dirs]
    models = read_urdf(urdf_path, free_flyer=free_flyer, package_dirs=folders, let_mimic=mimic is not None)
    robot = assemble(models, description, yaml_path or urdf_path, name)
    for _, text in unknowns(models.model, description):
        _log.warning("%s: %s", yaml_path or urdf_path, text)
    return robot


def _paths(name: str | None, urdf: Path | str | None, hydrodynamics: Path | str | None) -> tuple[Path, Path | None]:
    if (name is None) == (urdf is None):
        raise InvalidInput("load_robot needs either a name or urdf=PATH; list_robots() gives the names")
    given = None if hydrodynamics is None else Path(hydrodynamics)
    if name is None:
        return Path(str(urdf)), given
    folder = robot_folder(name)
    return folder / "robot.urdf", given or folder / "hydrodynamics.yaml"


def _description(name: str | None, path: Path | None, variant: str | None) -> RobotDescription:
    if path is None:
        return RobotDescription()
    if variant is None:
        return read_description(path)
    if name is None:
        raise InvalidInput(f"variant {variant!r} without a robot's name; variants belong to named robots")
    return read_description(path, variant_file(name, variant))


def assemble(models: UrdfModels, description: RobotDescription, path: Path, name: str | None = None) -> Robot:
    """Join the mechanism and its description.

    Raises ``RobotDataError``, which blames the file ``path``, for names, thrusters and a home that do not fit.
    """
    description = forward_left_up(description)
    _check_names(models.model, description, path)
    trimmed = replace(models, model=_with_trim(models.model, description.trim))
    robot = robot_of(trimmed, description, name or models.name)
    _check_home(robot, path)
    return robot


def robot_of(models: UrdfModels, description: RobotDescription, name: str) -> Robot:
    """Return the robot of a mechanism that already carries its trim bodies."""
    joints = joints_of(models.model, free_flyer=description.base == "free_flyer")
    limits = limits_of(models.model, description, joints)
    return Robot(
        name=name,
        model=models.model,
        visual_model=models.visual,
        collision_model=models.collision,
        description=description,
        joints=joints,
        limits=limits,
        home=home_of(models.model, description, joints, limits),
        hydrodynamics=links_in_water(description),
    )


def _check_home(robot: Robot, path: Path) -> None:
    try:
        robot.configuration()
    except InvalidInput as error:
        raise RobotDataError(path, f"home: {error}") from None


def _check_names(model: pin.Model, description: RobotDescription, path: Path) -> None:
    known_frames = tuple(frame.name for frame in model.frames[1:])
    altimeter = [("altimeter", description.altimeter)] if description.altimeter else []
    wanted = [
        *(("links", link) for link in description.links),
        *((f"trim {body.name!r} link", body.link) for body in description.trim),
        *((f"thruster {thruster.name!r} link", thruster.link) for thruster in description.thrusters),
        *altimeter,
    ]
    _check_known(path, wanted, known_frames)
    _check_known(path, [("joints", joint) for joint in description.joints], tuple(model.names)[1:])
    _check_thrusters(model, description, path)


def _check_thrusters(model: pin.Model, description: RobotDescription, path: Path) -> None:
    carrier = 1 if description.base == "free_flyer" else 0
    for thruster in description.thrusters:
        if model.frames[model.getFrameId(thruster.link)].parentJoint != carrier:
            problem = f"thruster {thruster.name!r} link: given {thruster.link!r}; allowed: links fixed to the vehicle"
            raise RobotDataError(path, problem)


def _check_known(path: Path, wanted: Sequence[tuple[str, str]], known: Sequence[str]) -> None:
    for key, name in wanted:
        if name not in known:
            raise RobotDataError(path, f"{key}: {name!r} is not in the URDF; allowed: {', '.join(known)}")


def _with_trim(model: pin.Model, trim: Sequence[TrimBody]) -> pin.Model:
    model = model.copy()
    for body in trim:
        joint, inertia = trim_inertia(model, body)
        model.inertias[joint] += inertia
    return model


def trim_inertia(model: pin.Model, body: TrimBody) -> tuple[int, pin.Inertia]:
    """Return the joint that carries a float or ballast, and its point mass in the frame of that joint."""
    frame = model.frames[model.getFrameId(body.link)]
    point_mass = pin.Inertia(body.mass, np.array(body.position), np.zeros((3, 3)))
    return frame.parentJoint, frame.placement.act(point_mass)

"""Join the mechanism of a URDF and its description to a `Robot`, checked against each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.robot import coefficients, description as descriptions
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.limits import home_of, joints_of, limits_of
from uvms_ocp.robot.mimic import coupled_entries
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.roles import ALTIMETER, BASE, DVL, TOOL, tools_of, with_roles
from uvms_ocp.robot.static_balance import with_bodies
from uvms_ocp.robot.urdf import UrdfModels


def assemble(
    models: UrdfModels, description: RobotDescription, path: Path, name: str | None = None
) -> Robot:
    """Join the mechanism and its description.

    Raises ``RobotDataError``, which blames the file ``path``, for names, thrusters and a home that
    do not fit.
    """
    description = _of_what_is_there(descriptions.forward_left_up(description), models)
    model, description = with_roles(models.model, description, path)
    _check_names(model, description, path)
    trimmed_models = replace(models, model=with_bodies(model, description.trim))
    robot = robot_of(trimmed_models, description, name or models.name)
    try:
        robot.configuration()
    except InvalidInput as error:
        raise RobotDataError(path, f"home: {error}") from None
    return robot


def _of_what_is_there(description: RobotDescription, models: UrdfModels) -> RobotDescription:
    """Return the description without what it says of links and joints of the file that are left
    out, and with one entry for joints that move as one.
    """
    no_links = models.no_links
    no_joints = models.no_joints
    joints = coupled_entries(description.joints, models.model, models.joint_groups)
    entries: dict[str, Any] = {
        "trim": tuple(body for body in description.trim if body.link not in no_links),
        "thrusters": tuple(t for t in description.thrusters if t.link not in no_links),
        "links": {name: link for name, link in description.links.items() if name not in no_links},
        "joints": {name: joint for name, joint in joints.items() if name not in no_joints},
    }
    for key in (BASE, ALTIMETER, DVL):
        if getattr(description, key) in no_links:
            entries[key] = None
    tools = tools_of(description)
    if no_links & set(tools):
        entries[TOOL] = tuple(tool for tool in tools if tool not in no_links) or None
    changes = dict[str, Any]()
    for key, value in entries.items():
        if value != getattr(description, key):
            changes[key] = value
    return description.model_copy(update=changes)


def robot_of(models: UrdfModels, description: RobotDescription, name: str) -> Robot:
    """Return the robot of a mechanism that already carries its trim bodies."""
    joints = joints_of(models.model, free_flyer=description.base == "free_flyer")
    limits = limits_of(models.model, description, joints)
    model = models.model.copy()
    rotors = np.zeros(models.model.nv)
    for joint in joints:
        if joint.name in description.joints:
            rotors[joint.v] = description.joints[joint.name].rotor_inertia
        else:
            rotors[joint.v] = descriptions.JointDescription().rotor_inertia
    model.armature = rotors
    return Robot(
        name=name,
        model=model,
        visual_model=models.visual,
        collision_model=models.collision,
        description=description,
        joints=joints,
        limits=limits,
        home=home_of(models.model, description, joints, limits),
        hydrodynamics=coefficients.links_in_water(description),
    )


def _check_names(model: pin.Model, description: RobotDescription, path: Path) -> None:
    """Raise ``RobotDataError`` for links and joints that are not in the URDF, and for thrusters and
    a DVL that are not fixed to the vehicle.
    """
    faults = [*_unknown_frames(model, description)]
    joints = joints_of(model, free_flyer=description.base == "free_flyer")
    moving = [joint.name for joint in joints]
    for name in description.joints:
        if name not in moving:
            faults.append(
                f"joints: {name!r} is no joint of the URDF that moves; allowed:"
                f" {', '.join(moving) or 'none'}"
            )
    faults += _moving_parts(model, description)
    if faults:
        raise RobotDataError(path, *faults)


def _unknown_frames(model: pin.Model, description: RobotDescription) -> Iterator[str]:
    frames = [("links", link) for link in description.links]
    frames += [(f"trim {body.name!r} link", body.link) for body in description.trim]
    frames += [(f"thruster {t.name!r} link", t.link) for t in description.thrusters]
    if description.altimeter:
        frames.append((ALTIMETER, description.altimeter))
    if description.dvl:
        frames.append((DVL, description.dvl))
    known_frames = [frame.name for frame in model.frames[1:]]
    for key, name in frames:
        if name not in known_frames:
            yield f"{key}: {name!r} is not in the URDF; allowed: {', '.join(known_frames)}"


def _moving_parts(model: pin.Model, description: RobotDescription) -> Iterator[str]:
    """Yield what is wrong with a DVL and with thrusters on links that move."""
    carrier = 1 if description.base == "free_flyer" else 0
    dvl = description.dvl
    if dvl is not None and _is_carried_by_another(model, dvl, carrier):
        yield f"{DVL}: given {dvl!r}; allowed: links fixed to the vehicle"
    for thruster in description.thrusters:
        if _is_carried_by_another(model, thruster.link, carrier):
            yield (
                f"thruster {thruster.name!r} link: given {thruster.link!r}; allowed: links fixed to"
                " the vehicle, as gimballed thrusters are not modelled"
            )


def _is_carried_by_another(model: pin.Model, link: str, joint: int) -> bool:
    """Check whether a link is there and is moved by another joint than that of this index."""
    if not model.existFrame(link):
        return False
    return bool(model.frames[model.getFrameId(link)].parentJoint != joint)

"""Join the mechanism of a URDF and its description to a `Robot`, checked against each other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.robot import coefficients, description as descriptions
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.limits import home_of, joints_of, limits_of
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
    robot = robot_of(
        replace(models, model=with_bodies(model, description.trim)),
        description,
        name or models.name,
    )
    try:
        robot.configuration()
    except InvalidInput as error:
        raise RobotDataError(path, f"home: {error}") from None
    return robot


def _of_what_is_there(description: RobotDescription, models: UrdfModels) -> RobotDescription:
    """Without what is said of links and joints of the file that are left out."""
    gone = models.no_links
    tools = tools_of(description)
    entries: dict[str, Any] = {
        key: tuple(p for p in getattr(description, key) if p.link not in gone)
        for key in ("trim", "thrusters")
    }
    entries |= {key: None for key in (BASE, ALTIMETER, DVL) if getattr(description, key) in gone}
    entries |= (
        {TOOL: tuple(tool for tool in tools if tool not in gone) or None}
        if gone & set(tools)
        else {}
    )
    for key, out in (("links", gone), ("joints", models.no_joints)):
        entries[key] = {
            name: entry for name, entry in getattr(description, key).items() if name not in out
        }
    return description.model_copy(
        update={key: value for key, value in entries.items() if value != getattr(description, key)}
    )


def robot_of(models: UrdfModels, description: RobotDescription, name: str) -> Robot:
    """Return the robot of a mechanism that already carries its trim bodies."""
    joints = joints_of(models.model, free_flyer=description.base == "free_flyer")
    limits = limits_of(models.model, description, joints)
    model = models.model.copy()
    rotors = np.zeros(models.model.nv)
    for joint in joints:
        rotors[joint.v] = description.joints.get(
            joint.name, descriptions.JointDescription()
        ).rotor_inertia
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
    known_frames = tuple(frame.name for frame in model.frames[1:])
    named = [
        *(("links", link) for link in description.links),
        *((f"trim {body.name!r} link", body.link) for body in description.trim),
        *(
            (f"thruster {thruster.name!r} link", thruster.link)
            for thruster in description.thrusters
        ),
        *((key, name) for key in (ALTIMETER, DVL) if (name := getattr(description, key))),
    ]
    moving = [joint.name for joint in joints_of(model, free_flyer=description.base == "free_flyer")]
    rule = f"is not in the URDF; allowed: {', '.join(known_frames)}"
    faults = [f"{key}: {name!r} {rule}" for key, name in named if name not in known_frames]
    allowed = f"is no joint of the URDF that moves; allowed: {', '.join(moving) or 'none'}"
    faults += [f"joints: {name!r} {allowed}" for name in description.joints if name not in moving]
    faults += _moving_thrusters(model, description)
    if faults:
        raise RobotDataError(path, *faults)


def _moving_thrusters(model: pin.Model, description: RobotDescription) -> list[str]:
    carrier = 1 if description.base == "free_flyer" else 0
    allowed = "allowed: links fixed to the vehicle, as gimballed thrusters are not modelled"
    dvl = description.dvl
    moves = (
        dvl is not None
        and model.existFrame(dvl)
        and model.frames[model.getFrameId(dvl)].parentJoint != carrier
    )
    return [f"{DVL}: given {dvl!r}; allowed: links fixed to the vehicle"] * moves + [
        f"thruster {thruster.name!r} link: given {thruster.link!r}; {allowed}"
        for thruster in description.thrusters
        if model.existFrame(thruster.link)
        and model.frames[model.getFrameId(thruster.link)].parentJoint != carrier
    ]

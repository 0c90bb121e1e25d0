"""Make robots from robots: mount an arm on a vehicle, take it off."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import joining, roles
from uvms_ocp.robot.description import LinkDescription, RobotDescription, checked_copy
from uvms_ocp.robot.link_boxes import cylinders_around_links
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.urdf import UrdfModels


@checked
def mount(
    vehicle: Robot,
    arm: Robot,
    X_BA: pin.SE3,
    *,
    prefix: str | None = None,
    flange: str | None = None,
    links: Mapping[str, LinkDescription] | None = None,
) -> Robot:
    """Return the vehicle with the arm's base at ``X_BA`` in B.

    Frames and joints of the arm get ``prefix`` (default: the arm's name and an underscore), so that
    a second arm can be mounted too. ``flange`` is an arm frame, named without prefix, at which the
    frames ``flange`` and ``tool`` are added. The water on the arm is ``links`` by the arm's frame
    names, or that of its description, or else the cylinder rule on the boxes around its shapes. The
    trim stays as it is, see ``trimmed``.

    Raises ``InvalidInput`` for parts that do not fit and ``FrameNotFound``.
    """
    if not vehicle.n_vehicle:
        raise InvalidInput(
            f"vehicle {vehicle.name!r} has a fixed base; load it with base='free_flyer'"
        )
    if arm.n_vehicle:
        raise InvalidInput(f"arm {arm.name!r} has a free-flying base; load it with base='fixed'")
    if prefix is None:
        prefix = f"{arm.name}_"
    joined = _joined(vehicle, _prefixed(arm, prefix), X_BA)
    if flange is not None:
        flange_name = arm.model.frames[arm.frame_id(flange)].name
        _add_tool(vehicle, joined.model, prefix + flange_name)
    description = _joined_description(vehicle, arm, links, prefix)
    return joining.robot_of(joined, description, f"{vehicle.name}+{arm.name}")


@checked
def without_arm(robot: Robot) -> Robot:
    """Return the vehicle alone: everything fixed to the base of a free-flyer, its trim included.

    Raises ``InvalidInput`` for a fixed base.
    """
    if not robot.n_vehicle:
        raise InvalidInput(
            f"robot {robot.name!r} has a fixed base; only a free-flyer has a vehicle"
        )
    vehicle_links = {frame.name for frame in robot.model.frames if frame.parentJoint <= 1}
    description = robot.description
    vehicle_description = checked_copy(
        description,
        joints={},
        links={name: link for name, link in description.links.items() if name in vehicle_links},
        trim=tuple(body for body in description.trim if body.link in vehicle_links),
        tool=None,
        altimeter=description.altimeter if description.altimeter in vehicle_links else None,
        dvl=description.dvl if description.dvl in vehicle_links else None,
    )
    return joining.robot_of(_base_only(robot), vehicle_description, robot.name)


def _prefixed(arm: Robot, prefix: str) -> UrdfModels:
    """Return the models of an arm with a prefix before all names of frames, joints and shapes."""
    model = arm.model.copy()
    visual = arm.visual_model.copy()
    collision = arm.collision_model.copy()
    for i in range(1, model.nframes):
        model.frames[i].name = prefix + model.frames[i].name
    for i in range(1, model.njoints):
        model.names[i] = prefix + model.names[i]
    for shape in (*visual.geometryObjects, *collision.geometryObjects):
        shape.name = prefix + shape.name
    return UrdfModels(name=arm.name, model=model, visual=visual, collision=collision)


def _joined(vehicle: Robot, arm: UrdfModels, X_BA: pin.SE3) -> UrdfModels:
    """Return the models of the vehicle with those of an arm at a pose X_BA in B."""
    _check_names(vehicle, arm.model)
    base = vehicle.frame_id("base_link")
    model, visual = pin.appendModel(
        vehicle.model, arm.model, vehicle.visual_model, arm.visual, base, X_BA
    )
    _, collision = pin.appendModel(
        vehicle.model, arm.model, vehicle.collision_model, arm.collision, base, X_BA
    )
    return UrdfModels(name=vehicle.name, model=model, visual=visual, collision=collision)


def _check_names(vehicle: Robot, arm: pin.Model) -> None:
    """Raise ``InvalidInput`` for frames of one name."""
    clashes = sorted(set(vehicle.frame_names) & {frame.name for frame in arm.frames[1:]})
    if clashes:
        raise InvalidInput(
            f"vehicle and arm both have {', '.join(clashes[:5])}; give another prefix"
        )


def _add_tool(vehicle: Robot, model: pin.Model, at: str) -> None:
    """Add the frames ``flange`` and ``tool`` at a frame of the joined model."""
    existing = [name for name in ("flange", "tool") if vehicle.has_frame(name)]
    if existing:
        raise InvalidInput(
            f"vehicle {vehicle.name!r} already has {', '.join(existing)}; use the arm's frames by name"
        )
    if model.existFrame("tool"):  # of the arm alone
        model.frames[model.getFrameId("tool")].name = "tool_of_arm"
    for name in ("flange", "tool"):
        roles.add_frame(model, name, at, pin.FrameType.BODY)


def _joined_description(
    robot: Robot, arm: Robot, links: Mapping[str, LinkDescription] | None, prefix: str
) -> RobotDescription:
    """Return the vehicle's description with that of the arm, whose names get a prefix."""
    vehicle = robot.description
    joints = dict(vehicle.joints)
    for name, joint in arm.description.joints.items():
        joints[prefix + name] = joint
    arm_links = links or arm.description.links or cylinders_around_links(arm)
    all_links = dict(vehicle.links)
    for name, link in arm_links.items():
        all_links[prefix + name] = link
    trim = [*vehicle.trim]
    for body in arm.description.trim:
        names = {"name": prefix + body.name, "link": prefix + body.link}
        trim.append(body.model_copy(update=names))
    arm_tools = [prefix + tool for tool in roles.tools_of(arm.description)]
    tools = (*roles.tools_of(vehicle), *arm_tools)
    return checked_copy(
        vehicle,
        joints=joints,
        links=all_links,
        trim=tuple(trim),
        tool=tools or None,
        **_numbers_of_all_joints(robot, arm.description),
    )


def _numbers_of_all_joints(vehicle: Robot, arm: RobotDescription) -> dict[str, Any]:
    """Return what a description says of all joints at once, by key: what the arm states, where the
    vehicle states none, and has no joints of its own.
    """
    if vehicle.n_joints:
        return {}
    stated = vehicle.description.sensors
    sensors = dict(stated)
    for channel in ("joint_positions", "joint_velocities"):
        if channel in arm.sensors and channel not in stated:
            sensors[channel] = arm.sensors[channel]
    numbers: dict[str, Any] = {"sensors": sensors}
    if vehicle.description.joint_efficiency == RobotDescription().joint_efficiency:
        numbers["joint_efficiency"] = arm.joint_efficiency
    return numbers


def _base_only(robot: Robot) -> UrdfModels:
    """Return the models of the base of a free-flyer, with all that is fixed to it."""
    model = pin.Model()
    model.name = robot.model.name
    model.addJoint(
        0, pin.JointModelFreeFlyer(), robot.model.jointPlacements[1], robot.model.names[1]
    )
    model.appendBodyToJoint(1, robot.model.inertias[1], pin.SE3.Identity())
    old_to_new = {0: 0}
    for i, frame in enumerate(robot.model.frames):
        if i > 0 and frame.parentJoint <= 1:
            copy = pin.Frame(
                frame.name,
                frame.parentJoint,
                old_to_new[frame.parentFrame],
                frame.placement,
                frame.type,
            )
            old_to_new[i] = model.addFrame(copy, False)
    return UrdfModels(
        name=robot.name,
        model=model,
        visual=_shapes_on(robot.visual_model, old_to_new),
        collision=_shapes_on(robot.collision_model, old_to_new),
    )


def _shapes_on(shapes: pin.GeometryModel, old_to_new: Mapping[int, int]) -> pin.GeometryModel:
    """Return the shapes on frames that remain; old_to_new: new number of each of these."""
    remaining = pin.GeometryModel()
    for shape in shapes.geometryObjects:
        if shape.parentFrame in old_to_new:
            copy = shape.copy()
            copy.parentFrame = old_to_new[shape.parentFrame]
            remaining.addGeometryObject(copy)
    return remaining

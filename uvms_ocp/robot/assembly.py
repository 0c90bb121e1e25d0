"""Make robots from robots: mount an arm on a vehicle, take it off, trim with floats and ballast.

Trim is the static balance of weight and buoyancy; `rotation_at_rest` the attitude that a vehicle
comes to by itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import product
from typing import Annotated

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import coefficients, loading, roles, thrusters
from uvms_ocp.robot.description import (
    Cylinder,
    LinkDescription,
    Pose,
    RobotDescription,
    TrimBody,
    Vector3,
    checked_copy,
)
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.urdf import UrdfModels
from uvms_ocp.types import Range

# Cylinders around the links of an arm of which nothing but its shapes is known.

_SMALLEST = 1e-4  # [m]; flatter links displace no water worth counting

# Turns the cylinder's z axis to x, y, z.
_ALONG: tuple[Vector3, Vector3, Vector3] = (
    (0.0, np.pi / 2, 0.0),
    (-np.pi / 2, 0.0, 0.0),
    (0.0, 0.0, 0.0),
)

_FOAM = 200.0  # [kg/m3] syntactic foam
_LEAD = 11340.0  # [kg/m3]
_HEIGHT = 0.1  # [m] floats above, ballast below the origin, for stability

_Station = Annotated[float, Range(-50.0, 50.0)]  # [m], as positions in robot files

_SWEEPS = 200  # about one axis after the other; a tilt of 60 deg about two is exact by then
_FAINT = 0.1  # [N m] of righting moment, below which weight and buoyancy leave every attitude


def cylinders_around_links(robot: Robot) -> dict[str, LinkDescription]:
    """Return one cylinder per frame that carries collision shapes (visual ones where there are
    none).

    The cylinder lies along the longest side of the box around the link's shapes; its diameter is
    the mean of the other two sides. It overestimates the volume of hollow or bent links: give
    measured data where there are any.
    """
    shapes = robot.collision_model if robot.collision_model.ngeoms else robot.visual_model
    names = [
        robot.model.frames[i].name
        for i in dict.fromkeys(shape.parentFrame for shape in shapes.geometryObjects)
    ]
    cylinders = {name: cylinder_in(box_around(robot.model, shapes, name)) for name in names}
    return {
        name: LinkDescription(cylinder=cylinder) for name, cylinder in cylinders.items() if cylinder
    }


def box_around(
    model: pin.Model, shapes: pin.GeometryModel, frame: str, *, joint: int | None = None
) -> np.ndarray:
    """Corners (2, 3) [m] of the box around the shapes of a link, in its frame; nan without shapes.

    joint: take the shapes of all links that this joint carries.
    """
    index = model.getFrameId(frame)
    X_JF = model.frames[index].placement
    frame_shapes = [
        s
        for s in shapes.geometryObjects
        if (s.parentFrame == index if joint is None else s.parentJoint == joint)
    ]
    corners = [
        X_JF.actInv(s.placement.act(corner))
        for s in frame_shapes
        for corner in box_corners(s.geometry)
    ]
    if corners:
        return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])
    return np.full((2, 3), np.nan)


def box_corners(geometry: coal.CollisionGeometry) -> np.ndarray:
    """Corners (8, 3) [m] of the box around a shape, in its own frame."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return np.array(list(product(*zip(box.min_, box.max_, strict=True))))


def cylinder_in(corners: np.ndarray) -> Cylinder | None:
    """The cylinder along the longest side of a box with corners (n, 3) [m]; `None` for a flat
    one.
    """
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    sides = high - low
    axis = int(np.argmax(sides))
    radius = float(np.delete(sides, axis).mean()) / 2.0
    if not radius >= _SMALLEST:
        return None
    x, y, z = (0.5 * (low + high)).tolist()
    return Cylinder(
        radius=radius, length=float(sides[axis]), pose=Pose(position=(x, y, z), rpy=_ALONG[axis])
    )


# Vehicles and arms as parts: join an arm to a vehicle, or take it off.


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
        _add_tool(vehicle, joined.model, prefix + arm.model.frames[arm.frame_id(flange)].name)
    return loading.robot_of(
        joined,
        _joined_description(vehicle.description, arm, links, prefix),
        f"{vehicle.name}+{arm.name}",
    )


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
    before = robot.description
    links = {name: link for name, link in before.links.items() if name in vehicle_links}
    trim = tuple(body for body in before.trim if body.link in vehicle_links)
    sensors: dict[str, str | None] = {"altimeter": before.altimeter, "dvl": before.dvl}
    for key, link in sensors.items():
        if link not in vehicle_links:
            sensors[key] = None
    alone = checked_copy(before, joints={}, links=links, trim=trim, tool=None, **sensors)
    return loading.robot_of(_base_only(robot), alone, robot.name)


def _prefixed(arm: Robot, prefix: str) -> UrdfModels:
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
    clashes = sorted(set(vehicle.frame_names) & {frame.name for frame in arm.frames[1:]})
    if clashes:
        raise InvalidInput(
            f"vehicle and arm both have {', '.join(clashes[:5])}; give another prefix"
        )


def _add_tool(vehicle: Robot, model: pin.Model, at: str) -> None:
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
    vehicle: RobotDescription, arm: Robot, links: Mapping[str, LinkDescription] | None, prefix: str
) -> RobotDescription:
    before = arm.description
    water = links or before.links or cylinders_around_links(arm)
    trim = (
        body.model_copy(update={"name": prefix + body.name, "link": prefix + body.link})
        for body in before.trim
    )
    return checked_copy(
        vehicle,
        joints={
            **vehicle.joints,
            **{prefix + name: joint for name, joint in before.joints.items()},
        },
        links={**vehicle.links, **{prefix + name: link for name, link in water.items()}},
        trim=(*vehicle.trim, *trim),
        tool=(*roles.tools_of(vehicle), *(prefix + tool for tool in roles.tools_of(before)))
        or None,
    )


def _base_only(robot: Robot) -> UrdfModels:
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
    visual, collision = (
        _shapes_on(shapes, old_to_new) for shapes in (robot.visual_model, robot.collision_model)
    )
    return UrdfModels(name=robot.name, model=model, visual=visual, collision=collision)


def _shapes_on(shapes: pin.GeometryModel, old_to_new: Mapping[int, int]) -> pin.GeometryModel:
    remaining = pin.GeometryModel()
    for shape in shapes.geometryObjects:
        if shape.parentFrame in old_to_new:
            copy = shape.copy()
            copy.parentFrame = old_to_new[shape.parentFrame]
            remaining.addGeometryObject(copy)
    return remaining


# Trim: the static balance of weight and buoyancy, and the floats and ballast that make it zero.


def static_residual(robot: Robot, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the net upward force [N] and the moment (3,) [N m] about the origin of B, in W, at
    rest at q (n_q,) [m, rad].
    """
    arms, lift = lifts(robot, q)
    return float(lift.sum()), np.array([arms[:, 1] @ lift, -arms[:, 0] @ lift, 0.0])


def lifts(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where buoyancy and weight act, arms (n, 3) [m] from the origin of B, in W, and how
    much each lifts (n,) [N].

    At q (n_q,) [m, rad]; weight lifts less than nothing.
    """
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    density = robot.description.water_density
    inertias = robot.model.inertias
    loads = [
        *(
            (
                data.oMf[robot.frame_id(link.frame)].act(link.centre_of_buoyancy),
                density * link.volume,
            )
            for link in robot.hydrodynamics
        ),
        *(
            (data.oMi[i].act(inertias[i].lever), -inertias[i].mass)
            for i in range(1, robot.model.njoints)
        ),
    ]
    arms = np.array([point for point, _ in loads]) - q[:3]
    return arms, float(np.linalg.norm(robot.model.gravity.linear)) * np.array(
        [mass for _, mass in loads]
    )


def without_trim(robot: Robot) -> Robot:
    """Return a copy without floats and ballast, to be trimmed anew."""
    model = robot.model.copy()
    for body in robot.description.trim:
        joint, inertia = loading.trim_inertia(model, body)
        model.inertias[joint] = model.inertias[joint] - inertia
    return _retrimmed(robot, model, ())


def with_trim(robot: Robot, bodies: Iterable[TrimBody]) -> Robot:
    """Return a copy that carries these floats and weights too. Raises ``FrameNotFound`` and
    ``InvalidInput``.
    """
    added = tuple(bodies)
    for body in added:
        robot.frame_id(body.link)
    return _retrimmed(
        robot, loading.with_bodies(robot.model, added), (*robot.description.trim, *added)
    )


@checked
def trimmed(robot: Robot, *, bow: _Station, stern: _Station) -> Robot:
    """Return a copy that floats level and neutral with its arm stowed, by one body at ``bow`` and
    one at ``stern``.

    bow, stern: x in ``base_link`` [m]. Lift comes from foam of 200 kg/m3, weight from lead. Raises
    ``InvalidInput`` for a fixed base and for stations that are less than 1 cm apart.
    """
    if not robot.n_vehicle:
        raise InvalidInput(
            f"robot {robot.name!r} has a fixed base; only a free-flyer can be trimmed"
        )
    if bow - stern < 0.01:
        raise InvalidInput(
            f"bow {bow} m, stern {stern} m; allowed: bow at least 0.01 m ahead of stern"
        )
    return with_trim(robot, _trim_bodies(robot, bow, stern))


def _trim_bodies(robot: Robot, bow: float, stern: float) -> list[TrimBody]:
    force, moment = static_residual(robot, np.array(robot.configuration()))
    lifts = np.linalg.solve([[1.0, 1.0], [-bow, -stern]], [-force, -moment[1]])
    # The body with the larger lift takes the roll moment by a sideways shift.
    strongest = int(np.argmax(np.abs(lifts)))
    y = np.zeros(2)
    if abs(lifts[strongest]) > 0.0:
        y[strongest] = -moment[0] / lifts[strongest]
    stations = zip(("trim_bow", "trim_stern"), (bow, stern), y, lifts, strict=True)
    return [trim_body(*station, robot) for station in stations if abs(station[-1]) > 0.0]


def trim_body(name: str, x: float, y: float, lift: float, robot: Robot) -> TrimBody:
    """Return a float of foam, or ballast of lead, at x [m], y [m] in ``base_link`` with a lift [N]
    in the robot's water.
    """
    material = _FOAM if lift > 0.0 else _LEAD
    gravity = float(np.linalg.norm(robot.model.gravity.linear))
    volume = lift / (gravity * (robot.description.water_density - material))
    return TrimBody(
        name=name,
        position=(x, y, float(np.copysign(_HEIGHT, lift))),
        mass=material * volume,
        volume=volume,
    )


def _retrimmed(robot: Robot, model: pin.Model, trim: tuple[TrimBody, ...]) -> Robot:
    description: RobotDescription = checked_copy(robot.description, trim=trim)
    return replace(
        robot,
        model=model,
        description=description,
        hydrodynamics=coefficients.links_in_water(description),
    )


# The attitude that a vehicle comes to by itself about the axes that no thruster drives.


def up_at_rest(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return the direction (3,) that is up, in B, once a vehicle that was level has come to rest.

    q (n_q,) [m, rad] gives the posture of the arm. Thrusters keep the axes that they drive; about
    the others weight and buoyancy turn the vehicle to where they do no more work. ``(0, 0, 1)``,
    level, where every such axis is driven.
    """
    arms, lift = lifts(robot, robot.configuration(joints=robot.joint_values(q)))
    righting = arms.T @ lift  # [N m] with the vehicle level, when W and B have the same axes
    up = np.array([0.0, 0.0, 1.0])
    axes = [axis - 3 for axis in thrusters.unactuated_axes(robot) if axis >= 3]
    for _ in range(_SWEEPS if len(axes) > 1 else 1):
        for axis in axes:
            up = _turned(up, axis, righting)
    return up


def rotation_at_rest(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return R_WB (3, 3) without yaw of the attitude of `up_at_rest`, for q (n_q,) [m, rad]."""
    up = up_at_rest(robot, q)
    R: np.ndarray = pin.rpy.rpyToMatrix(
        float(np.arctan2(up[1], up[2])), float(-np.arcsin(up[0])), 0.0
    )
    return R


def _turned(up: np.ndarray, axis: int, righting: np.ndarray) -> np.ndarray:
    """After a turn about one axis of B, until buoyancy is straight above weight as seen along that
    axis.
    """
    across = np.arange(3) != axis
    pull = float(np.linalg.norm(righting[across]))
    if pull < _FAINT:
        return up
    turned = up.copy()
    turned[across] = np.linalg.norm(up[across]) * righting[across] / pull
    return turned

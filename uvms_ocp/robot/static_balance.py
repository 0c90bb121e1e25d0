"""Static balance of weight and buoyancy: floats and ballast that trim a vehicle, and the attitude that
it comes to by itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import coefficients, thrusters
from uvms_ocp.robot.description import RobotDescription, TrimBody, checked_copy
from uvms_ocp.robot.robot import Robot, require_normalized
from uvms_ocp.robot.size import size, weight
from uvms_ocp.types import Range

_FOAM = 200.0  # [kg/m3] syntactic foam
_LEAD = 11340.0  # [kg/m3]
TRIM_TOLERANCE = 2e-3
"""Largest difference of lift and weight of a trimmed vehicle, share of its weight."""
_STATIONS = 0.04  # [size of the robot] between floats at bow and stern, at least
# [size of the robot] by which floats are above, ballast below the origin, for stability
_HEIGHT = 0.4

_Station = Annotated[float, Range(-50.0, 50.0)]  # [m], as positions in robot files

_SWEEPS = 200  # about one axis after the other; a tilt of 60 deg about two is exact by then
_NEGLIGIBLE_LEVER = 3e-3
"""Lever of weight and buoyancy, share of the robot's size, below which they turn no vehicle."""


def static_residual(robot: Robot, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the net upward force [N] and the moment (3,) [N m] about the origin of B, in W, at
    rest at q (n_q,) [m, rad].
    """
    arms, lift = lifts(robot, q)
    return float(lift.sum()), np.array([arms[:, 1] @ lift, -arms[:, 0] @ lift, 0.0])


def lifts(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points at which buoyancy and weight act, arms (n, 3) [m] from the origin of B, in
    W, and the lift of each (n,) [N], which is negative for weight, at q (n_q,) [m, rad].
    """
    require_normalized(robot.model, q)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    density = robot.description.water_density
    points = list[np.ndarray]()  # (3,) [m] in W
    lifted_masses = list[float]()  # [kg]
    for link in robot.hydrodynamics:
        X_WF = data.oMf[robot.frame_id(link.frame)]
        points.append(X_WF.act(link.centre_of_buoyancy))
        lifted_masses.append(density * link.volume)
    for i in range(1, robot.model.njoints):
        inertia = robot.model.inertias[i]
        points.append(data.oMi[i].act(inertia.lever))
        lifted_masses.append(-inertia.mass)
    gravity = float(np.linalg.norm(robot.model.gravity.linear))
    return np.array(points) - q[:3], gravity * np.array(lifted_masses)


def without_trim(robot: Robot) -> Robot:
    """Return a copy without floats and ballast, to be trimmed anew."""
    model = robot.model.copy()
    for body in robot.description.trim:
        joint, inertia = trim_inertia(model, body)
        model.inertias[joint] = model.inertias[joint] - inertia
    return _retrimmed(robot, model, ())


def with_trim(robot: Robot, bodies: Iterable[TrimBody]) -> Robot:
    """Return a copy that carries these floats and weights too. Raises ``FrameNotFound`` and
    ``InvalidInput``.
    """
    added = tuple(bodies)
    for body in added:
        robot.frame_id(body.link)
    model = with_bodies(robot.model, added)
    return _retrimmed(robot, model, (*robot.description.trim, *added))


@checked
def trimmed(robot: Robot, *, bow: _Station, stern: _Station) -> Robot:
    """Return a copy that floats level and neutral with its arm stowed, by one body at ``bow`` and
    one at ``stern``.

    bow, stern: x in ``base_link`` [m]. Lift comes from foam of 200 kg/m3, weight from lead. Raises
    ``InvalidInput`` for a fixed base and for stations that are less than 0.04 of its size apart.
    """
    if not robot.n_vehicle:
        raise InvalidInput(
            f"robot {robot.name!r} has a fixed base; only a free-flyer can be trimmed"
        )
    nearest = _STATIONS * size(robot.model)
    if bow - stern < nearest:
        raise InvalidInput(
            f"bow {bow} m, stern {stern} m; allowed: bow at least {nearest:.1g} m ahead of stern"
        )
    return with_trim(robot, _trim_bodies(robot, bow, stern))


def _trim_bodies(robot: Robot, bow: float, stern: float) -> list[TrimBody]:
    force, moment = static_residual(robot, np.array(robot.configuration()))
    lift_at = np.linalg.solve([[1.0, 1.0], [-bow, -stern]], [-force, -moment[1]])  # [N]
    # The body with the larger lift takes the roll moment by a sideways shift.
    strongest = int(np.argmax(np.abs(lift_at)))
    y = np.zeros(2)
    if abs(lift_at[strongest]) > 0.0:
        y[strongest] = -moment[0] / lift_at[strongest]
    bodies = list[TrimBody]()
    for k, (name, x) in enumerate((("trim_bow", bow), ("trim_stern", stern))):
        if abs(lift_at[k]) > 0.0:
            bodies.append(trim_body(name, x, y[k], lift_at[k], robot))
    return bodies


def trim_body(name: str, x: float, y: float, lift: float, robot: Robot) -> TrimBody:
    """Return a float of foam, or ballast of lead, at x [m], y [m] in ``base_link`` with a lift [N]
    in the robot's water.
    """
    material = _FOAM if lift > 0.0 else _LEAD
    gravity = float(np.linalg.norm(robot.model.gravity.linear))
    volume = lift / (gravity * (robot.description.water_density - material))
    return TrimBody(
        name=name,
        position=(x, y, float(np.copysign(_HEIGHT * size(robot.model), lift))),
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


def with_bodies(model: pin.Model, bodies: Sequence[TrimBody]) -> pin.Model:
    """Return a copy of the model that carries these floats and weights too."""
    model = model.copy()
    for body in bodies:
        joint, inertia = trim_inertia(model, body)
        model.inertias[joint] += inertia
    return model


def trim_inertia(model: pin.Model, body: TrimBody) -> tuple[int, pin.Inertia]:
    """Return the joint that carries a float or ballast, and its point mass in the frame of that
    joint.
    """
    frame = model.frames[model.getFrameId(body.link)]
    point_mass = pin.Inertia(body.mass, np.array(body.position), np.zeros((3, 3)))
    return frame.parentJoint, frame.placement.act(point_mass)


def up_at_rest(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return the direction (3,) that is up, in B, once a vehicle that was level has come to rest.

    q (n_q,) [m, rad] gives the posture of the arm. Thrusters keep the axes that they drive; about
    the others weight and buoyancy turn the vehicle to where they do no more work. ``(0, 0, 1)``,
    level, where every such axis is driven.
    """
    arms, lift = lifts(robot, robot.configuration(joints=robot.joint_values(q)))
    righting = arms.T @ lift  # [N m] with the vehicle level, when W and B have the same axes
    negligible = _negligible_moment(robot)
    up = np.array([0.0, 0.0, 1.0])
    axes = [axis - 3 for axis in thrusters.unactuated_axes(robot) if axis >= 3]
    n_sweeps = _SWEEPS if len(axes) > 1 else 1
    for _ in range(n_sweeps):
        for axis in axes:
            up = _turned(up, axis, righting, negligible)
    return up


def rotation_at_rest(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return R_WB (3, 3) without yaw of the attitude of `up_at_rest`, for q (n_q,) [m, rad]."""
    up = up_at_rest(robot, q)
    roll = float(np.arctan2(up[1], up[2]))
    pitch = float(-np.arcsin(up[0]))
    R: np.ndarray = pin.rpy.rpyToMatrix(roll, pitch, 0.0)
    return R


@dataclass(frozen=True, kw_only=True, slots=True)
class DrivenTilt:
    """Tilt of a vehicle that thrust pushes beside its mass, about an axis that no thruster drives."""

    push: int
    """Number of the axis of B along which it is pushed."""
    turn: int
    """Number of the axis of B, 3 or 4, about which it tilts."""
    moment: float
    """[N m] moment of the thrust about the mass."""
    righting: float
    """[N m] moment of weight and buoyancy at a tilt of a right angle."""
    negligible: float
    """[N m] righting moment below which there is none."""

    @property
    def angle(self) -> float:
        """Tilt [rad], a right angle where the vehicle tips over."""
        return float(np.arcsin(min(1.0, self.moment / max(self.righting, self.negligible))))


def tilt_when_driven(robot: Robot) -> DrivenTilt | None:
    """Return the largest tilt at which thrust and weight balance while the vehicle is pushed to its
    limits of speed and acceleration along one of its axes; `None` where thrusters drive roll and
    pitch, or there are no limits.

    Thrust acts where the thrusters are, drag and inertia at the mass: the moment is that of both.
    """
    undriven = [axis for axis in thrusters.unactuated_axes(robot) if axis in (3, 4)]
    matrix = thrusters.thruster_matrix(robot)
    if not undriven or not matrix.shape[1]:
        return None
    driven = [axis for axis in range(6) if axis not in undriven]
    arms, lift = lifts(robot, robot.configuration())
    righting = float((arms.T @ lift)[2])
    data = robot.model.createData()
    centre = pin.centerOfMass(robot.model, data, np.array(robot.configuration()))
    to_mass = centre - np.array(robot.configuration())[:3]
    largest: DrivenTilt | None = None
    for push in range(2):
        force = _largest_push(robot, push)
        if not np.isfinite(force):
            continue
        required = np.zeros(6)
        required[push] = force
        required[3:] = np.cross(to_mass, required[:3])
        thrust = np.linalg.lstsq(matrix[driven], required[driven], rcond=None)[0]
        wrench = matrix @ thrust
        for turn in undriven:
            tilt = DrivenTilt(
                push=push,
                turn=turn,
                moment=abs(float(wrench[turn] - required[turn])),
                righting=righting,
                negligible=_negligible_moment(robot),
            )
            if largest is None or tilt.moment > largest.moment:
                largest = tilt
    return largest


def _largest_push(robot: Robot, axis: int) -> float:
    """Return the force [N] that speeds the vehicle up along an axis of B at its largest speed."""
    speed = float(robot.limits.velocity[axis])
    acceleration = float(robot.limits.acceleration[axis])
    force = acceleration * sum(float(inertia.mass) for inertia in robot.model.inertias)
    for link in robot.hydrodynamics:
        frame = robot.model.frames[robot.frame_id(link.frame)]
        if frame.parentJoint != 1:
            continue
        direction = (frame.placement.rotation @ link.X_FL.rotation)[axis]
        added = float(direction @ link.added_mass[:3, :3] @ direction)
        linear = float(direction @ link.linear_drag[:3, :3] @ direction)
        quadratic = float(direction @ link.quadratic_drag[:3, :3] @ direction)
        force += float(acceleration * added + linear * speed + quadratic * speed**2)
    return force


def _negligible_moment(robot: Robot) -> float:
    """Return the righting moment [N m] below which weight and buoyancy turn no vehicle."""
    return _NEGLIGIBLE_LEVER * weight(robot.model) * size(robot.model)


def _turned(up: np.ndarray, axis: int, righting: np.ndarray, negligible: float) -> np.ndarray:
    """Return the direction (3,) that is up in B after a turn about one axis of B, until buoyancy is
    straight above weight as seen along that axis; righting (3,) and negligible [N m].
    """
    across = np.arange(3) != axis
    pull = float(np.linalg.norm(righting[across]))
    if pull < negligible:
        return up
    turned = up.copy()
    turned[across] = np.linalg.norm(up[across]) * righting[across] / pull
    return turned

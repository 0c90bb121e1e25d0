"""Trim: the static balance of weight and buoyancy, and the floats and ballast that make it zero."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.files.description import RobotDescription, TrimBody, checked_copy
from uvms_ocp.model.loading import trim_inertia
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.water.coefficients import links_in_water

_FOAM = 200.0  # [kg/m3] syntactic foam
_LEAD = 11340.0  # [kg/m3]
_HEIGHT = 0.1  # [m] floats above, ballast below the origin, for stability


def static_residual(robot: Robot, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the net upward force [N] and the moment (3,) [N m] about the origin of B, in W, at rest at q (n_q,) [m, rad]."""
    arms, lift = lifts(robot, q)
    return float(lift.sum()), np.array([arms[:, 1] @ lift, -arms[:, 0] @ lift, 0.0])


def lifts(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where buoyancy and weight act, arms (n, 3) [m] from the origin of B, in W, and how much each lifts (n,) [N].

    At q (n_q,) [m, rad]; weight lifts less than nothing.
    """
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    density, inertias = robot.description.water_density, robot.model.inertias
    loads = [
        *((data.oMf[robot.frame_id(link.frame)].act(link.centre_of_buoyancy), density * link.volume)
          for link in robot.hydrodynamics),
        *((data.oMi[i].act(inertias[i].lever), -inertias[i].mass) for i in range(1, robot.model.njoints)),
    ]  # fmt: skip
    arms = np.array([point for point, _ in loads]) - q[:3]
    return arms, float(np.linalg.norm(robot.model.gravity.linear)) * np.array([mass for _, mass in loads])


def without_trim(robot: Robot) -> Robot:
    """Return a copy without floats and ballast, to be trimmed anew."""
    return _retrimmed(robot, removed=robot.description.trim, added=(), trim=())


def with_trim(robot: Robot, bodies: Iterable[TrimBody]) -> Robot:
    """Return a copy that carries these floats and weights too. Raises ``FrameNotFound`` and ``InvalidInput``."""
    added = tuple(bodies)
    for body in added:
        robot.frame_id(body.link)
    return _retrimmed(robot, removed=(), added=added, trim=(*robot.description.trim, *added))


def trimmed(robot: Robot, *, bow: float, stern: float) -> Robot:
    """Return a copy that floats level and neutral with its arm stowed, by one body at ``bow`` and one at ``stern``.

    bow, stern: x in ``base_link`` [m]. Lift comes from foam of 200 kg/m3, weight from lead. Raises ``InvalidInput``
    for a fixed base and for stations that are less than 1 cm apart.
    """
    if not robot.n_vehicle:
        raise InvalidInput(f"robot {robot.name!r} has a fixed base; only a free-flyer can be trimmed")
    if bow - stern < 0.01:
        raise InvalidInput(f"bow {bow} m, stern {stern} m; allowed: bow at least 0.01 m ahead of stern")
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
    return [body_of_lift(*station, robot) for station in stations if abs(station[-1]) > 0.0]


def body_of_lift(name: str, x: float, y: float, lift: float, robot: Robot) -> TrimBody:
    """Return a float of foam, or ballast of lead, at x [m], y [m] in ``base_link`` with a lift [N] in the robot's water."""
    material = _FOAM if lift > 0.0 else _LEAD
    gravity = float(np.linalg.norm(robot.model.gravity.linear))
    volume = lift / (gravity * (robot.description.water_density - material))
    position = (x, y, float(np.copysign(_HEIGHT, lift)))
    return TrimBody(name=name, position=position, mass=material * volume, volume=volume)


def _retrimmed(
    robot: Robot, *, removed: Iterable[TrimBody], added: Iterable[TrimBody], trim: tuple[TrimBody, ...]
) -> Robot:
    model = robot.model.copy()
    for body in removed:
        joint, inertia = trim_inertia(model, body)
        model.inertias[joint] = model.inertias[joint] - inertia
    for body in added:
        joint, inertia = trim_inertia(model, body)
        model.inertias[joint] = model.inertias[joint] + inertia
    description: RobotDescription = checked_copy(robot.description, trim=trim)
    return replace(robot, model=model, description=description, hydrodynamics=links_in_water(description))

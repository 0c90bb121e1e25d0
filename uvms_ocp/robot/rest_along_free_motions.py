"""Where a vehicle comes to rest along the motions that no thruster works on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.size import size, weight
from uvms_ocp.robot.static_balance import TRIM_TOLERANCE
from uvms_ocp.robot.thrusters import free_motions, undriven_axes

_STEP = 1e-4  # of the difference quotients, share of a unit of a motion
# stiffness along a motion that is none: of weight and buoyancy, share of the weight over the robot's size
_SOFT = 3e-3
_TILTS = (3, 4)  # axes of v about which weight rights a vehicle
_UNMATCHED = 1e-3  # share of drag that may be left when a tilt makes up for it


def motion_to_rest(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return the displacement (6,) [m, rad] of a vehicle from q (n_q,) [m, rad] to where weight and
    buoyancy do no more work along its `free_motions`, to first order.

    A motion that takes a turn along is held by what rights that: a vehicle that rises only as it pitches
    stops where it has pitched enough. Infinite where nothing holds it and something drives it.
    """
    length = size(robot.model)
    axes = undriven_axes(robot)
    # of the same unit, 1 m or the turn that goes that far at the end of the robot
    motions = free_motions(robot)[0] / np.where(np.array(axes) < 3, 1.0, length)
    force = motions.T @ _holding(robot, q)
    stiffness = np.zeros((len(axes), len(axes)))
    for k, motion in enumerate(motions.T):
        step = _STEP * length * motion
        ahead = _holding(robot, pin.integrate(robot.model, q, step))
        behind = _holding(robot, pin.integrate(robot.model, q, -step))
        stiffness[:, k] = motions.T @ (ahead - behind) / (2.0 * _STEP * length)
    stiffnesses, directions = np.linalg.eigh((stiffness + stiffness.T) / 2.0)
    displacement = np.zeros(6)
    for along, direction in zip(stiffnesses, directions.T, strict=True):
        pull = float(direction @ force)  # [N]
        motion = motions[:6] @ direction
        if along > _SOFT * weight(robot.model) / length:
            displacement -= motion * pull / along
        elif abs(pull) > TRIM_TOLERANCE * weight(robot.model):
            displacement[np.abs(motion) > _STEP] = np.inf
    return displacement


def tilt_for_drag(robot: Robot, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the turn (2,) [rad] in roll and pitch from q (n_q,) [m, rad] at which weight and buoyancy make
    up along `free_motions` for drag at a steady velocity v (n_v,) [m/s, rad/s], to first order;
    infinite where no tilt does.

    Of a vehicle whose lift comes with a pitch thrusters give the lift, and weight bears the pitch.
    """
    motions = free_motions(robot)[0]
    still = np.zeros(robot.n_v)
    drag = cached_dynamics(robot).inverse_dynamics(q, v, still) - _holding(robot, q)
    resistance = motions.T @ drag
    righting = np.zeros((len(resistance), 2))
    for k, axis in enumerate(_TILTS):
        step = np.zeros(robot.n_v)
        step[axis] = _STEP
        ahead = _holding(robot, pin.integrate(robot.model, q, step))
        behind = _holding(robot, pin.integrate(robot.model, q, -step))
        righting[:, k] = motions.T @ (ahead - behind) / (2.0 * _STEP)
    tilt = np.linalg.lstsq(righting, -resistance, rcond=None)[0]
    lack = np.linalg.norm(righting @ tilt + resistance)
    if lack > _UNMATCHED * np.linalg.norm(resistance):
        return np.full(2, np.inf)
    return np.asarray(tilt)


def _holding(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return the generalized force (n_v,) [N, N m] that holds the robot still at q (n_q,) [m, rad]."""
    still = np.zeros(robot.n_v)
    return cached_dynamics(robot).inverse_dynamics(q, still, still)

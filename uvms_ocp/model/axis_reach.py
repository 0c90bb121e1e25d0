"""How far an axis of a robot can move the points of its shapes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot


def shape_reach(robot: Robot, shape: pin.GeometryObject) -> np.ndarray:
    """(n_v,) upper bound on the speed of any point of a shape per unit of each axis, within the joint limits [m, or 1].

    Infinite for what turns a joint that travels without limit.
    """
    if shape.parentJoint == 0:
        return np.zeros(robot.n_v)  # a floor has no end
    shape.geometry.computeLocalAABB()
    centre = shape.placement.act(np.array(shape.geometry.aabb_center))
    return _reach_of_ball(robot, shape.parentJoint, float(np.linalg.norm(centre)) + shape.geometry.aabb_radius)


def point_reach(robot: Robot, frame: str) -> np.ndarray:
    """(n_v,) as `shape_reach`, for the origin of a frame. Raises FrameNotFound."""
    found = robot.model.frames[robot.frame_id(frame)]
    return _reach_of_ball(robot, found.parentJoint, float(np.linalg.norm(found.placement.translation)))


def largest_change(reach: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Upper bound (..., m) [m] of what moves by at most `reach` (m, n) [m, or 1] per unit of each axis; (...) for one (n,).

    `motion` (..., n) [rad, or m] is how far each axis moves, not negative. An axis that stands still costs nothing, however
    far it reaches.
    """
    endless = ~np.isfinite(reach)
    if not endless.any():
        return np.asarray(motion @ reach.T)
    bound = motion @ np.where(endless, 0.0, reach).T
    return np.where((motion > 0.0) @ endless.T, np.inf, bound)


def _reach_of_ball(robot: Robot, carrier: int, length: float) -> np.ndarray:
    """`length` [m] is the radius of a ball around the joint `carrier` that holds all points; it grows to the base."""
    reach, neutral = np.zeros(robot.n_v), pin.neutral(robot.model)
    while carrier:
        joint = robot.model.joints[carrier]
        linear, angular = _speeds(joint, neutral)
        turns = angular > 0.0
        own = linear.copy()
        own[turns] += angular[turns] * length
        reach[joint.idx_v : joint.idx_v + joint.nv] = own
        length += _travel(robot, joint.idx_v + np.flatnonzero(linear))
        length += float(np.linalg.norm(robot.model.jointPlacements[carrier].translation))
        carrier = robot.model.parents[carrier]
    return reach


def _speeds(joint: pin.JointModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Linear and angular speed (nv,) per unit of each axis; the same at any configuration for the joints of a URDF."""
    data = joint.createData()
    joint.calc(data, q)
    subspace = np.array(data.S).reshape(6, joint.nv)
    return np.linalg.norm(subspace[:3], axis=0), np.linalg.norm(subspace[3:], axis=0)


def _travel(robot: Robot, axes: np.ndarray) -> float:
    """[m] from zero to the farthest corner of the limits of the axes."""
    own = axes - robot.n_vehicle
    if (own < 0).any():
        return np.inf
    limits = robot.limits
    return float(np.linalg.norm(np.maximum(np.abs(limits.position_lower[own]), np.abs(limits.position_upper[own]))))

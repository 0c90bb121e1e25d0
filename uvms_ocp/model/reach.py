"""How far an axis of a robot can move the points of its shapes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot


def shape_reach(robot: Robot, shape: pin.GeometryObject) -> np.ndarray:
    """(n_v,) upper bound on the speed of any point of a shape per unit of each axis, at any configuration [m, or 1]."""
    reach = np.zeros(robot.n_v)
    shape.geometry.computeLocalAABB()
    centre = shape.placement.act(np.array(shape.geometry.aabb_center))
    return _reach_of_ball(robot, shape.parentJoint, float(np.linalg.norm(centre)) + shape.geometry.aabb_radius, reach)


def point_reach(robot: Robot, frame: str) -> np.ndarray:
    """(n_v,) as `shape_reach`, for the origin of a frame. Raises FrameNotFound."""
    found = robot.model.frames[robot.frame_id(frame)]
    length = float(np.linalg.norm(found.placement.translation))
    return _reach_of_ball(robot, found.parentJoint, length, np.zeros(robot.n_v))


def _reach_of_ball(robot: Robot, carrier: int, length: float, reach: np.ndarray) -> np.ndarray:
    """`length` [m] is the radius of a ball around the joint `carrier` that holds all points; it grows to the base."""
    while carrier:
        joint = robot.model.joints[carrier]
        if joint.nv == 6:
            reach[:3], reach[3:6] = 1.0, length
        else:
            prismatic = joint.shortname().startswith("JointModelP")
            reach[joint.idx_v] = 1.0 if prismatic else length
            length += _travel(robot, joint.idx_v) if prismatic else 0.0
        length += float(np.linalg.norm(robot.model.jointPlacements[carrier].translation))
        carrier = robot.model.parents[carrier]
    return reach


def _travel(robot: Robot, idx_v: int) -> float:
    axis = idx_v - robot.n_vehicle
    return float(max(abs(robot.limits.position_lower[axis]), abs(robot.limits.position_upper[axis])))

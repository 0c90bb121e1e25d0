"""Hull of a vehicle: the box around its collision shapes, and the height of the lowest point of a
robot.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.robot import link_boxes, symbolic_model
from uvms_ocp.robot.robot import Robot


def skid_points(robot: Robot) -> np.ndarray:
    """Return the lower corners (4, 3) [m] of the box around the vehicle's collision shapes, in the
    frame of the vehicle.

    (0, 3) for a robot with a fixed base or without collision shapes on its vehicle.
    """
    hull = _hull(robot)
    if not hull:
        return np.zeros((0, 3))
    corners = np.concatenate([_box_corners(shape) for shape in hull])
    x0, y0, z0 = corners.min(axis=0)
    x1, y1, _ = corners.max(axis=0)
    return np.array([[x0, y0, z0], [x0, y1, z0], [x1, y0, z0], [x1, y1, z0]])


def lowest_link(robot: Robot) -> str:
    """Return the name of the link of the vehicle whose collision shape reaches lowest in the frame of
    the vehicle, which has to have a shape.
    """
    shape = min(_hull(robot), key=lambda shape: float(_box_corners(shape)[:, 2].min()))
    return str(robot.model.frames[shape.parentFrame].name)


def _hull(robot: Robot) -> list[pin.GeometryObject]:
    """Return the collision shapes fixed to the vehicle."""
    if not robot.n_vehicle:
        return []
    shapes = robot.collision_model.geometryObjects
    return [shape for shape in shapes if shape.parentJoint == 1]


def _box_corners(shape: pin.GeometryObject) -> np.ndarray:
    """Return corners (8, 3) [m] of a shape's own bounding box, in the frame of the vehicle."""
    placement = shape.placement
    return np.asarray(
        link_boxes.box_corners(shape.geometry) @ placement.rotation.T + placement.translation
    )


@lru_cache(maxsize=8)
def lowest_point(robot: Robot, slope: float = 0.0, altimeter: str | None = None) -> ca.Function:
    """Build the function of q (n_q,) [m, rad] that gives z [m] in W of the lowest of the hull's
    corners, the joints of the arm and the tools.

    slope: of a floor that falls in all directions from the point below the frame `altimeter`: each
    point counts as higher by the slope times its horizontal distance from that frame.
    """
    q = ca.SX.sym("q", robot.n_q)
    kinematics = symbolic_model.SymbolicModel(robot.model).forward_kinematics(q)
    first_joint = 2 if robot.n_vehicle else 1
    points = [pose.p for pose in kinematics.joint_poses[first_joint:]]
    for frame in robot.tools:
        _, position = kinematics.pose(frame)
        points.append(position)
    if robot.n_vehicle:
        vehicle = kinematics.joint_poses[1]
        for point in skid_points(robot):
            points.append(vehicle.p + vehicle.R @ ca.DM(point))
    if altimeter is not None and robot.has_frame(altimeter):
        _, centre = kinematics.pose(altimeter)
        heights = []
        for point in points:
            heights.append(point[2] + slope * ca.norm_2(point[:2] - centre[:2]))
    else:
        heights = [point[2] for point in points]
    lowest = ca.densify(ca.mmin(ca.vertcat(ca.inf, *heights)))
    return ca.Function("lowest_point", [q], [lowest], {"cse": True})

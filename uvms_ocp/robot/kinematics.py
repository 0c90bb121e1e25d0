"""Compute where the frames of a robot are, how they move, where its altimeter looks, and how far
axes can move points.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.record.display import FieldTable
from uvms_ocp.robot.robot import Robot

STEEP = 0.1
"""Cosine of a beam's tilt below which its range says nothing about the height."""


@checked_dataclass(check=checked_on_failure, kw_only=False, eq=False, repr=False)
class Kinematics(FieldTable):
    """A robot at a configuration; its existence proves that q is valid.

    Raises InvalidInput for a q that is no configuration of the robot.
    """

    robot: Robot
    """The robot whose frames have poses here."""
    q: np.ndarray
    """Configuration (n_q,) [m, rad]."""
    _data: pin.Data = field(init=False, repr=False)
    """With poses of all frames and Jacobians of all joints."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", self.robot.check_configuration(self.q))
        data = self.robot.model.createData()
        pin.computeJointJacobians(self.robot.model, data, self.q)
        pin.updateFramePlacements(self.robot.model, data)
        object.__setattr__(self, "_data", data)

    def pose(self, frame: str) -> pin.SE3:
        """Return the pose X_WF of a frame [m]. Raises FrameNotFound."""
        return self._data.oMf[self.robot.frame_id(frame)].copy()

    def jacobian(self, frame: str, expressed_in: str = "W") -> np.ndarray:
        """Return the Jacobian (6, n_v) [-, m] of a frame's velocity in W at the frame's origin,
        linear rows first.

        expressed_in: "W" for world axes, "B" for those of the vehicle (the world's, if the base is
        fixed), or the name of a frame for its axes. Raises FrameNotFound.
        """
        J = pin.getFrameJacobian(
            self.robot.model, self._data, self.robot.frame_id(frame), pin.LOCAL_WORLD_ALIGNED
        )
        J = np.reshape(J, (6, self.robot.n_v))  # Pinocchio returns a vector for a single joint
        if expressed_in == "W":
            return J
        R = self._axes(expressed_in)
        return np.vstack([R.T @ J[:3], R.T @ J[3:]])

    def _axes(self, name: str) -> np.ndarray:
        """Return the rotation R_WF of the axes that `jacobian` is expressed in."""
        if name != "B":
            return np.asarray(self._data.oMf[self.robot.frame_id(name)].rotation)
        if self.robot.n_vehicle:
            return np.asarray(self._data.oMi[1].rotation)
        return np.eye(3)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Beam:
    """Ray of a range sensor S: along -z of its frame."""

    origin: np.ndarray
    """Position p_WS (3,) [m]."""
    direction: np.ndarray
    """Unit vector (3,) in W."""
    cosine: float
    """Cosine of the angle between the beam and straight down."""


class AltimeterBeam:
    """The beam of a robot's range sensor at one configuration after another. Holds working memory:
    not for two threads.
    """

    __slots__ = ("_data", "_frame", "_model")

    def __init__(self, robot: Robot, frame: str) -> None:
        """frame: that of the sensor. Raises FrameNotFound."""
        self._model = robot.model
        self._data = robot.model.createData()
        self._frame = robot.frame_id(frame)

    def at(self, q: np.ndarray) -> Beam:
        """Return the beam at q (n_q,) [m, rad]."""
        pin.forwardKinematics(self._model, self._data, q)
        X_WS = pin.updateFramePlacement(self._model, self._data, self._frame)
        R_WS = X_WS.rotation
        return Beam(origin=X_WS.translation.copy(), direction=-R_WS[:, 2], cosine=float(R_WS[2, 2]))


def shape_reach(robot: Robot, shape: pin.GeometryObject) -> np.ndarray:
    """Return an upper bound (n_v,) on the speed of any point of a shape per unit of each axis,
    within the joint limits [m, or 1].

    Infinite for what turns a joint that travels without limit.
    """
    if shape.parentJoint == 0:
        return np.zeros(robot.n_v)  # a floor has no end
    return _reach_of_ball(robot, shape.parentJoint, radius_around_joint(shape))


def radius_around_joint(shape: pin.GeometryObject) -> float:
    """Return the radius [m] of a ball around the joint of a shape in which all of the shape is."""
    shape.geometry.computeLocalAABB()
    centre = shape.placement.act(np.array(shape.geometry.aabb_center))
    return float(np.linalg.norm(centre)) + float(shape.geometry.aabb_radius)


def point_reach(robot: Robot, frame: str) -> np.ndarray:
    """Return an upper bound (n_v,) on the speed of the origin of a frame per unit of each axis,
    within the joint limits [m, or 1]. Raises FrameNotFound.
    """
    point_frame = robot.model.frames[robot.frame_id(frame)]
    radius = float(np.linalg.norm(point_frame.placement.translation))
    return _reach_of_ball(robot, point_frame.parentJoint, radius)


def largest_change(reach: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return an upper bound (..., m) [m] of what moves by at most `reach` (m, n) [m, or 1] per unit of each
    axis; (...) for one (n,).

    `motion` (..., n) [rad, or m] is how far each axis moves, not negative. An axis that stands
    still costs nothing, however far it reaches.
    """
    endless = ~np.isfinite(reach)
    if not endless.any():
        return np.asarray(motion @ reach.T)
    moves_endlessly = (motion > 0.0) @ endless.T
    return np.where(moves_endlessly, np.inf, motion @ np.where(endless, 0.0, reach).T)


def _reach_of_ball(robot: Robot, carrier: int, length: float) -> np.ndarray:
    """Return the reach (n_v,) [m, or 1] of points in a ball around the joint `carrier`; its radius
    `length` [m] grows to the base.
    """
    reach = np.zeros(robot.n_v)
    while carrier:
        joint = robot.model.joints[carrier]
        linear, angular = _speeds(joint)
        turns = angular > 0.0
        speed = linear.copy()
        speed[turns] += angular[turns] * length
        # of what mimics, with that of its leader
        reach[joint.idx_v : joint.idx_v + joint.nvExtended] += speed
        length += _travel(robot, joint, linear)
        length += float(np.linalg.norm(robot.model.jointPlacements[carrier].translation))
        carrier = robot.model.parents[carrier]
    return reach


def _speeds(joint: pin.JointModel) -> tuple[np.ndarray, np.ndarray]:
    """Return linear and angular speed (nv,) per unit of each axis; the same at any configuration for the
    joints of a URDF.
    """
    subspace = np.array(joint.createData().S).reshape(6, joint.nvExtended)
    return np.linalg.norm(subspace[:3], axis=0), np.linalg.norm(subspace[3:], axis=0)


def _travel(robot: Robot, joint: pin.JointModel, linear: np.ndarray) -> float:
    """Return the distance [m] from zero to the farthest corner of the limits of the axes that are
    `linear`, at that speed per unit.
    """
    moved = np.flatnonzero(linear)
    axes = joint.idx_v - robot.n_vehicle + moved
    if (axes < 0).any():
        return np.inf
    lower = robot.limits.position_lower[axes]
    upper = robot.limits.position_upper[axes]
    farthest = np.maximum(np.abs(lower), np.abs(upper))
    travel = float(np.linalg.norm(linear[moved] * farthest))
    mimics = joint.nv == 0
    if mimics and len(moved):
        travel += abs(joint.extract().offset)
    return travel

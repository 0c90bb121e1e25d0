"""Where the frames of a robot are, and how they move, at one configuration; and where its altimeter looks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import late
from uvms_ocp.model.robot import Robot
from uvms_ocp.shown.fielded import Fielded

STEEP = 0.1
"""[-] cosine of a beam's tilt below which its range says nothing about the height."""


@late
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Kinematics(Fielded):
    """A robot at a configuration; its existence proves that q is valid.

    Raises InvalidInput, as `Robot.check_configuration`.
    """

    robot: Robot
    """Whose frames they are."""
    q: np.ndarray
    """(n_q,) [m, rad]"""
    _data: pin.Data = field(init=False, repr=False)
    """With poses of all frames and Jacobians of all joints."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", self.robot.check_configuration(self.q))
        data = self.robot.model.createData()
        pin.computeJointJacobians(self.robot.model, data, self.q)
        pin.updateFramePlacements(self.robot.model, data)
        object.__setattr__(self, "_data", data)

    def pose(self, frame: str) -> pin.SE3:
        """Pose X_WF of a frame [m]. Raises FrameNotFound."""
        return self._data.oMf[self.robot.frame_id(frame)].copy()

    def jacobian(self, frame: str, expressed_in: str = "W") -> np.ndarray:
        """Jacobian (6, n_v) [-, m] of a frame's velocity in W at the frame's origin, linear rows first.

        expressed_in: "W" for world axes, "B" for those of the vehicle (the world's, if the base is fixed), or
        the name of a frame for its axes. Raises FrameNotFound.
        """
        index = self.robot.frame_id(frame)
        J = pin.getFrameJacobian(self.robot.model, self._data, index, pin.LOCAL_WORLD_ALIGNED)
        J = np.reshape(J, (6, self.robot.n_v))  # Pinocchio returns a vector for a single joint
        if expressed_in == "W":
            return J
        R = self._axes(expressed_in)
        return np.vstack([R.T @ J[:3], R.T @ J[3:]])

    def _axes(self, name: str) -> np.ndarray:
        """Rotation R_WF of the axes that `jacobian` is expressed in."""
        if name != "B":
            return np.asarray(self._data.oMf[self.robot.frame_id(name)].rotation)
        return self._data.oMi[1].rotation if self.robot.n_vehicle else np.eye(3)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Beam:
    """Where a range sensor S looks: along -z of its frame."""

    origin: np.ndarray
    """p_WS (3,) [m]."""
    direction: np.ndarray
    """(3,) unit vector in W [-]."""
    cosine: float
    """[-] of the angle between the beam and straight down."""


class AltimeterBeam:
    """The beam of a robot's range sensor at one configuration after another. Holds working memory: not for two threads."""

    __slots__ = ("_data", "_frame", "_model")

    def __init__(self, robot: Robot, frame: str) -> None:
        """frame: that of the sensor. Raises FrameNotFound."""
        self._model, self._data, self._frame = robot.model, robot.model.createData(), robot.frame_id(frame)

    def at(self, q: np.ndarray) -> Beam:
        """The beam at q (n_q,) [m, rad]."""
        pin.forwardKinematics(self._model, self._data, q)
        return self._beam()

    def moving(self, q: np.ndarray, v: np.ndarray) -> tuple[Beam, np.ndarray]:
        """The beam at q (n_q,) [m, rad], and the velocity (3,) [m/s] of the sensor in W.

        The robot moves with v (n_v,) [m/s, rad/s].
        """
        pin.forwardKinematics(self._model, self._data, q, v)
        beam = self._beam()
        return beam, pin.getFrameVelocity(self._model, self._data, self._frame, pin.LOCAL_WORLD_ALIGNED).linear

    def _beam(self) -> Beam:
        X_WS = pin.updateFramePlacement(self._model, self._data, self._frame)
        R_WS = X_WS.rotation
        return Beam(origin=X_WS.translation.copy(), direction=-R_WS[:, 2], cosine=float(R_WS[2, 2]))

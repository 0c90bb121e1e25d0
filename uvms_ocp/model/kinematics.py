"""Where the frames of a robot are, and how they move, at one configuration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """A robot at a configuration q (n_q,); its existence proves that q is valid.

    Raises InvalidInput, as `Robot.check_configuration`.
    """

    robot: Robot
    q: np.ndarray
    _data: pin.Data = field(init=False, repr=False)

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
        """Jacobian (6, n_v) of a frame's velocity in W at the frame's origin, linear rows first.

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

"""Where the altimeter looks from, for the filter and for who watches the floor."""

from __future__ import annotations

from typing import Any

import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.model.robot import Robot


class BeamMount:
    """The altimeter in B: fixed to the vehicle, or carried by the arm, which a tick then has to look at."""

    __slots__ = ("_data", "_frame", "_memory", "_robot", "moves")

    def __init__(self, robot: Robot, frame: str, memory: Any) -> None:
        """frame: that of the altimeter. Raises `FrameNotFound`.

        memory: who is told, with `beam_at` (3,) [m] the altimeter in B, and `beam_up` (3,) [-] its z axis there.
        """
        self._robot, self._frame, self._memory = robot, robot.frame_id(frame), memory
        self._data = robot.model.createData()
        self.moves = robot.model.frames[self._frame].parentJoint > 1
        self._look(pin.neutral(robot.model)[robot.joint_q])

    def place(self, joints: Array) -> None:
        """Tell it, if the altimeter may have moved; `joints` (n_joint_q,) is that part of q [rad or m]."""
        if self.moves:
            self._look(joints)

    def _look(self, joints: Array) -> None:
        model, memory, q = self._robot.model, self._memory, pin.neutral(self._robot.model)
        q[self._robot.joint_q] = joints
        pin.forwardKinematics(model, self._data, q)
        X_BS = pin.updateFramePlacement(model, self._data, self._frame)
        memory.beam_at[:], memory.beam_up[:] = X_BS.translation, X_BS.rotation[:, 2]

"""Channels that a state estimate needs, their age, and where the altimeter is mounted."""

from __future__ import annotations

import math
from typing import Any

import pinocchio as pin

from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import CHANNELS, Readings, SensorSpecs
from uvms_ocp.types import Array

# Which channels an estimate needs, and how old they are.

JOINT_CHANNELS = ("joint_positions",)
_VEHICLE_CHANNELS = ("position", "attitude", "linear_velocity", "angular_velocity")
_OPTIONAL_CHANNELS = ("depth", "joint_velocities", "specific_force")  # improve an estimate that does not need them


def age_of(readings: Readings, channels: tuple[str, ...], t: float) -> float:
    """Age [s] at time t [s] of the oldest of the channels' readings; inf where one is missing."""
    return oldest_of(readings, channels, t)[0]


def oldest_of(readings: Readings, channels: tuple[str, ...], t: float) -> tuple[float, str]:
    """Age [s] at time t [s] of the oldest of the channels' readings, inf where one is missing, and which channel that is."""
    taken, oldest = t, ""
    for name in channels:
        reading = getattr(readings, name)
        if reading is None:
            return math.inf, name
        if reading.t < taken:
            taken, oldest = reading.t, name
    return t - taken, oldest


def needed_channels(robot: Robot, specs: SensorSpecs, altimeter_frame: str | None) -> tuple[str, ...]:
    """Channels that the robot has and that no other replaces."""
    skipped = (
        *_OPTIONAL_CHANNELS,
        *(() if robot.n_vehicle else _VEHICLE_CHANNELS),
        *(() if altimeter_frame and robot.n_vehicle else ("altimeter_range",)),
    )
    return tuple(name for name in CHANNELS if getattr(specs, name) is not None and name not in skipped)


# Where the altimeter looks from, for the filter and for who watches the floor.


class AltimeterMount:
    """The altimeter in B: fixed to the vehicle, or carried by the arm, which a tick then has to look at."""

    __slots__ = ("_data", "_frame", "_memory", "_robot", "moves")

    def __init__(self, robot: Robot, frame: str, memory: Any) -> None:
        """frame: that of the altimeter. Raises `FrameNotFound`.

        memory: who is told, with `beam_at` (3,) [m] the altimeter in B, and `beam_up` (3,) its z axis there.
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

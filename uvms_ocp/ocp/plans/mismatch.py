"""How far a plant departed from a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True, slots=True)
class Mismatch:
    """How a plant departed from a plan."""

    position: float
    """[m] largest distance of the frame from its planned position."""
    end_position: float
    """[m] at the end."""
    end_orientation: float
    """[rad] at the end."""


def mismatch(trajectory: Trajectory, t: np.ndarray, q: np.ndarray, *, robot: Robot, frame: str) -> Mismatch:
    """The pose of a frame at the recorded q (n, n_q) [m, rad] against the planned one at the times t (n,) [s].

    Raises `FrameNotFound` for an unknown frame.
    """
    planned = np.array([trajectory.state_at(robot.model, float(moment))[0] for moment in t])
    pairs = zip(frame_poses(robot, frame, planned), frame_poses(robot, frame, q), strict=True)
    errors = [wanted.inverse() * found for wanted, found in pairs]
    distances = [float(np.linalg.norm(error.translation)) for error in errors]
    return Mismatch(
        position=max(distances),
        end_position=distances[-1],
        end_orientation=float(np.linalg.norm(pin.log3(errors[-1].rotation))),
    )


def frame_poses(robot: Robot, frame: str, q: np.ndarray) -> list[pin.SE3]:
    """X_WF at configurations q (n, n_q) [m, rad]. Raises `FrameNotFound` for an unknown frame."""
    data, index = robot.model.createData(), robot.frame_id(frame)
    poses = []
    for configuration in q:
        pin.framesForwardKinematics(robot.model, data, configuration)
        poses.append(data.oMf[index].copy())
    return poses

"""How far a plant departed from a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.motion_record import frame_poses
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.robot import Robot


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingError:
    """Departure of a plant from a plan."""

    position: float
    """[m] largest distance of the frame from its planned position."""
    end_position: float
    """[m] distance at the end."""
    end_orientation: float
    """[rad] angle at the end."""


def tracking_error(
    trajectory: Trajectory, t: np.ndarray, q: np.ndarray, *, robot: Robot, frame: str
) -> TrackingError:
    """Compare the pose of a frame at the recorded q (n, n_q) [m, rad] with the planned one at the
    times t (n,) [s].

    Raises `FrameNotFound` for an unknown frame.
    """
    planned_q = trajectory.states_at(robot.model, t)[0]
    planned_poses = frame_poses(robot, frame, planned_q)
    poses = frame_poses(robot, frame, q)
    errors = [
        planned.inverse() * actual for planned, actual in zip(planned_poses, poses, strict=True)
    ]
    distances = [float(np.linalg.norm(error.translation)) for error in errors]
    angle = float(np.linalg.norm(pin.log3(errors[-1].rotation)))
    return TrackingError(position=max(distances), end_position=distances[-1], end_orientation=angle)

"""Geometry of the thrusters: the wrench on the vehicle per newton of each thruster."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.model.description import Thruster
from uvms_ocp.model.robot import Robot


def thruster_matrix(robot: Robot) -> np.ndarray:
    """Return (6, n_thrusters) [N/N, N m/N]: wrench on the vehicle about the origin of B, in B, linear rows first."""
    columns = [_column(robot.model, thruster) for thruster in robot.description.thrusters]
    return np.column_stack(columns) if columns else np.zeros((6, 0))


def _column(model: pin.Model, thruster: Thruster) -> np.ndarray:
    direction = np.array(thruster.direction) / np.linalg.norm(thruster.direction)
    X_BF = model.frames[model.getFrameId(thruster.link)].placement
    force = X_BF.rotation @ direction
    return np.concatenate([force, np.cross(X_BF.act(np.array(thruster.position)), force)])

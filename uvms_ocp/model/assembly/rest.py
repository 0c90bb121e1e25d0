"""The attitude that a vehicle comes to by itself about the axes that no thruster drives."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.model.assembly.trim import lifts
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import unactuated_axes

_SWEEPS = 200  # about one axis after the other; a tilt of 60 deg about two is exact by then
_FAINT = 0.1  # [N m] of righting moment, below which weight and buoyancy leave every attitude


@checked
def up_at_rest(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return the direction (3,) [-] that is up, in B, once a vehicle that was level has come to rest.

    q (n_q,) [m, rad] gives the posture of the arm. Thrusters keep the axes that they drive; about the others weight and
    buoyancy turn the vehicle to where they do no more work. ``(0, 0, 1)``, level, where every such axis is driven.
    """
    level = robot.configuration(joints=q[robot.n_q - robot.n_joints :])
    arms, lift = lifts(robot, np.asarray(level))
    righting = arms.T @ lift  # [N m] with the vehicle level, when W and B have the same axes
    up = np.array([0.0, 0.0, 1.0])
    axes = [axis - 3 for axis in unactuated_axes(robot) if axis >= 3]
    for _ in range(_SWEEPS if len(axes) > 1 else 1):
        for axis in axes:
            up = _turned(up, axis, righting)
    return up


def _turned(up: np.ndarray, axis: int, righting: np.ndarray) -> np.ndarray:
    """After a turn about one axis of B, until buoyancy is straight above weight as seen along that axis."""
    across = np.arange(3) != axis
    pull = float(np.linalg.norm(righting[across]))
    if pull < _FAINT:
        return up
    turned = up.copy()
    turned[across] = np.linalg.norm(up[across]) * righting[across] / pull
    return turned

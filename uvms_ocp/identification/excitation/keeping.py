"""Any commands, made to stay in the pool: where they lead out of it, a spring at the actuators pulls back."""

from __future__ import annotations

import numpy as np

from uvms_ocp.identification.excitation.assignment import Assignment
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.models.stage import N_Q, N_V
from uvms_ocp.model.spatial import quaternion_to_matrix

_AHEAD = 1.0  # [s] that the spring looks ahead


def kept_inside(given: Assignment, rollout: Rollout, wanted: np.ndarray, step: float) -> np.ndarray:
    """(n, n_u) [N, N m] within thrust and slew; wanted: (n, 6) [-] of what each axis can get alone, held for a step [s].

    At a wall the spring balances all that an axis can get; the vehicle is as it is believed to be.
    """
    B, p, joints = given.vehicle.actuators.wrench, given.unknowns, given.still
    spread = np.linalg.pinv(B)
    most = 1.0 / (np.abs(spread) / np.abs(given.limits.thrust).min(axis=1)[:, None]).max(axis=0).clip(1e-9)
    stiff = most / np.concatenate([given.limits.room, [given.limits.tilt, given.limits.tilt, np.inf]])
    x, found, before = np.zeros(rollout.stage.n_x), [], np.zeros(len(spread))
    x[N_Q - 1] = 1.0
    for one in wanted:
        back = stiff * (_away(x) + _AHEAD * x[N_Q : N_Q + N_V])
        before = given.limits.after(before, spread @ (one * most - back), step)
        found.append(before)
        x = np.asarray(rollout.step(x, before, joints, p, step)).ravel()
    return np.array(found)


def _away(x: np.ndarray) -> np.ndarray:
    """(6,) [m, rad] from where it began and from upright, in B; yaw is free."""
    R = np.array(quaternion_to_matrix(x[3:N_Q]))
    return np.concatenate([R.T @ x[:3], [R[2, 1], -R[2, 0], 0.0]])

"""Predict that a vehicle does not move: baselines, which other predictions are worth as much as they are
better than.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from uvms_ocp.identification.model import N_Q, Vehicle, as_measured, vehicle_dynamics
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.resampling import interpolated
from uvms_ocp.identification.segments import Segment

# Quaternions (xyzw) of the attitudes whose vertical in B is each of B's axes.
_UPRIGHT = ((0.0, -(0.5**0.5), 0.0, 0.5**0.5), (0.5**0.5, 0.0, 0.0, 0.5**0.5), (0.0, 0.0, 0.0, 1.0))


def static_baseline(segment: Segment, start_window: float) -> Predicted:
    """Predict that a vehicle does not move and stays as it was seen last, `start_window` [s] after
    the beginning of a segment.
    """
    samples = np.flatnonzero(segment.t[2] <= segment.edges[0] + start_window)
    vertical = segment.measured[2][samples[-1] if len(samples) else 0]
    return _resting(segment, np.broadcast_to(vertical, (len(segment.t[2]), 3)))


class StaticBalance:
    """The vertical in B at which weight and buoyancy turn a vehicle no further, its arm as it was
    measured.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Build the function of joints and unknowns for a vehicle."""
        n_j = vehicle.dynamics.model.nq - N_Q
        shared = ca.SX.sym("shared", len(vehicle.shared.start))
        joints = ca.SX.sym("joints", n_j)
        values = vehicle.values(ca.vertcat(shared, ca.DM(vehicle.per_recording.start)))
        dynamics = vehicle_dynamics(vehicle.dynamics, values, vehicle.link)
        poses = [ca.vertcat(ca.DM.zeros(3), ca.DM(turn), joints) for turn in _UPRIGHT]
        g = float(np.linalg.norm(vehicle.dynamics.model.gravity.linear))
        moment = as_measured(
            values, ca.vertcat(*(dynamics.potential_energy(pose) for pose in poses)) / g
        )
        self._function = ca.Function("balance", [joints, shared], [ca.densify(moment)])
        """``joints (n_j,), shared (n,) -> first moment (3,)`` [kg m] of mass, what is displaced
        counting negative.
        """

    def vertical(self, joints: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """Compute the vertical (3, m) [-] in B for joints (n_j, m) [rad or m], where unknowns are
        shared (n,) [as `Unknowns.start`].
        """
        m = joints.shape[1]
        moment = np.asarray(self._function.map(m)(joints, np.repeat(shared[:, None], m, axis=1)))
        return np.asarray(-moment / np.maximum(np.linalg.norm(moment, axis=0), 1e-300))

    def of_segment(self, segment: Segment, shared: np.ndarray) -> Predicted:
        """Predict that a vehicle stays where it is in balance, with unknowns shared (n,) [as
        `Unknowns.start`].
        """
        middle = (segment.edges[1:] + segment.edges[:-1]) / 2
        vertical = self.vertical(segment.joints[: segment.joints.shape[0] // 3], shared)
        return _resting(segment, interpolated(segment.t[2], middle, vertical.T))


def _resting(segment: Segment, vertical: np.ndarray) -> Predicted:
    resting = tuple(np.broadcast_to(0.0, values.shape) for values in segment.measured[:2])
    return Predicted(t=segment.t, rows=(*resting, vertical), measured=segment.measured)

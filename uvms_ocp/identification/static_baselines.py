"""Predict that a vehicle does not move: baselines, by which predictions are judged."""

from __future__ import annotations

import casadi as ca
import numpy as np

from uvms_ocp.identification.model import N_Q, Vehicle, as_measured, vehicle_dynamics
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.resampling import interpolated
from uvms_ocp.identification.segments import Segment

_HALF = 0.5**0.5
_UPRIGHT = ((0.0, -_HALF, 0.0, _HALF), (_HALF, 0.0, 0.0, _HALF), (0.0, 0.0, 0.0, 1.0))
"""Quaternions (xyzw) of the attitudes in which W's vertical is the x, the y and the z axis of B."""


def static_baseline(segment: Segment, start_window: float) -> Predicted:
    """Predict that a vehicle does not move and keeps its last attitude of the first `start_window`
    [s] of a segment.
    """
    samples = np.flatnonzero(segment.t[2] <= segment.edges[0] + start_window)
    last_sample = 0
    if len(samples):
        last_sample = samples[-1]
    vertical = segment.measured[2][last_sample]
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
        energies = ca.vertcat(*(dynamics.potential_energy(pose) for pose in poses))
        moment = as_measured(values, energies / g)
        self._function = ca.Function("balance", [joints, shared], [ca.densify(moment)])
        """``joints (n_j,), shared (n,) -> first moment (3,)`` [kg m] of mass in B, less that of the
        displaced water.
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
    """Predict zero velocities, and the vertical (m, 3) [-] in B."""
    resting = tuple(np.broadcast_to(0.0, values.shape) for values in segment.measured[:2])
    return Predicted(t=segment.t, rows=(*resting, vertical), measured=segment.measured)

"""Vehicles that do not move, as predictors: others are worth as much as they are better."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.identification.answers.predictions import Predicted
from uvms_ocp.identification.methods.stretch import Stretch
from uvms_ocp.identification.models.stage import N_Q, Vehicle, as_seen
from uvms_ocp.identification.models.vehicle_dynamics import vehicle_dynamics

# Quaternions (xyzw) of the attitudes whose vertical in B is each of B's axes.
_UPRIGHT = ((0.0, -(0.5**0.5), 0.0, 0.5**0.5), (0.5**0.5, 0.0, 0.0, 0.5**0.5), (0.0, 0.0, 0.0, 1.0))


def still(stretch: Stretch, known: float) -> Predicted:
    """A vehicle that stays as it was seen last, `known` [s] after the beginning of a stretch, and does not move."""
    before = np.flatnonzero(stretch.t[2] <= stretch.edges[0] + known)
    vertical = stretch.seen[2][before[-1] if len(before) else 0]
    return _resting(stretch, np.repeat(vertical[None], len(stretch.t[2]), axis=0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Balance:
    """The vertical in B at which weight and buoyancy turn a vehicle no further, its arm as it was measured."""

    function: ca.Function
    """``joints (n_j,), shared (n,) -> first moment (3,)`` [kg m] of mass, what is displaced counting negative."""

    @staticmethod
    def of(vehicle: Vehicle) -> Balance:
        """Of a vehicle, at any values of its unknowns."""
        n_j, shared = vehicle.dynamics.model.nq - N_Q, ca.SX.sym("shared", len(vehicle.shared.start))
        joints = ca.SX.sym("joints", n_j)
        values = vehicle.values(ca.vertcat(shared, ca.DM(vehicle.own.start)))
        dynamics = vehicle_dynamics(vehicle.dynamics, values, vehicle.link)
        poses = [ca.vertcat(ca.DM.zeros(3), ca.DM(turn), joints) for turn in _UPRIGHT]
        g = float(np.linalg.norm(vehicle.dynamics.model.gravity.linear))
        moment = as_seen(values, ca.vertcat(*(dynamics.potential_energy(pose) for pose in poses)) / g)
        return Balance(function=ca.Function("balance", [joints, shared], [ca.densify(moment)]))

    def vertical(self, joints: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """(3, m) [-] for joints (n_j, m) [rad or m], where unknowns are shared (n,) [as `Unknowns.start`]."""
        m = joints.shape[1]
        moment = np.asarray(self.function.map(m)(joints, np.repeat(shared[:, None], m, axis=1)))
        return np.asarray(-moment / np.maximum(np.linalg.norm(moment, axis=0), 1e-300))

    def of_stretch(self, stretch: Stretch, shared: np.ndarray) -> Predicted:
        """A vehicle that is where it is in balance and does not move, with unknowns shared (n,) [as `Unknowns.start`]."""
        middle = (stretch.edges[1:] + stretch.edges[:-1]) / 2
        vertical = self.vertical(stretch.joints[: stretch.joints.shape[0] // 3], shared)
        rows = np.column_stack([np.interp(stretch.t[2], middle, column) for column in vertical])
        return _resting(stretch, rows)


def _resting(stretch: Stretch, vertical: np.ndarray) -> Predicted:
    resting = tuple(np.zeros_like(values) for values in stretch.seen[:2])
    return Predicted(t=stretch.t, rows=(*resting, vertical), seen=stretch.seen)

"""The vehicle of the pool recordings with what is learnt of it, by the package's own
identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pool.sensors import IMU, MOCAP
from pool.vehicle import pool_dynamics
from uvms_ocp.identification.estimates import Estimate, Noise
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Prior, Unknowns
from uvms_ocp.identification.predictor import Predicted, Predictor
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    NominalParameters,
    vehicle_declaration,
)

STEP = 0.04  # [s] of the simulation
KNOWN = 2.0  # [s] of the beginning, from which a start and the offset of the attitude are found
NOISE = {
    IMU: Noise(velocity=0.05, rate=0.02, vertical=0.005),
    MOCAP: Noise(velocity=0.05, rate=0.06, vertical=0.01),
}
_HULL = np.array([[-0.25, -0.2, -0.2], [0.25, 0.2, 0.2]])
_TILT = ("roll", "pitch")
LEARNT = {
    "centre_of_buoyancy": Prior(sigma=0.1),
    "volume": Prior(sigma=0.01),
    "added_mass": Prior(sigma=1.0, only=_TILT),
    "linear_drag": Prior(sigma=1.5, only=_TILT),
    "quadratic_drag": Prior(sigma=1.5, only=_TILT),
    "attitude_turn": Prior(sigma=0.1),
    "attitude_offset": Prior(sigma=0.01, only=("x", "y")),
}
"""What is learnt, and how sure we are of where it starts: of the author's figures."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Learner:
    """The vehicle and the recordings of one sensor, prepared for it."""

    vehicle: Vehicle
    rollout: Rollout
    noise: Noise

    def trained(
        self,
        chosen: Sequence[PreparedRecording],
        shared: np.ndarray | None = None,
        iterations: int = 15,
    ) -> Estimate:
        """Identified on whole recordings."""
        stretches = [prepared.segments(STEP)[0] for prepared in chosen]
        error = OutputErrorProblem(self.vehicle, stretches, self.noise, self.rollout)
        return error.solve(error.start(shared), iterations=iterations, tolerance=1e-3)

    def predicted(self, prepared: PreparedRecording, shared: np.ndarray) -> Predicted:
        """A whole recording, with unknowns shared (n,) [as `Unknowns.start`]."""
        predictor = Predictor(
            vehicle=self.vehicle,
            rollout=self.rollout,
            shared=shared,
            noise=self.noise,
            start_window=KNOWN,
            fits_per_recording=True,
        )
        return predictor.of(prepared.segments(STEP)[0])


def pool_learner(noise: Noise) -> Learner:
    """Nothing drives the vehicle."""
    no_thrusters = ActuatorModel(names=(), wrench=np.zeros((6, 0)), allocation=np.zeros((0, 6)))
    dynamics = pool_dynamics()
    nominal = vehicle_declaration(NominalParameters.of(dynamics), _HULL, no_thrusters)
    declaration = nominal.with_status(**LEARNT)
    vehicle = Vehicle(
        dynamics=dynamics,
        shared=Unknowns(declaration),
        per_recording=Unknowns(declaration, per_recording=True),
        actuators=no_thrusters,
    )
    return Learner(vehicle=vehicle, rollout=Rollout(stage_of(vehicle)), noise=noise)

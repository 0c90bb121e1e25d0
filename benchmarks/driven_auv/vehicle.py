"""The vehicle of the recordings, as far as it is known, and what may be learnt of it.

Mass, volume and thrusters are those of the team's public configuration (Tartan-AUV/tauv-mono,
kingfisher_description, controller.yaml and thrusters.yaml): the driver shares a wrench out by the
pseudo-inverse of the thruster matrix. All other numbers are where the search begins.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.parameters import (
    Declaration,
    Prior,
    Unknowns,
)
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    AxisCouplings,
    NominalParameters,
    vehicle_declaration,
)
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

MASS = 21.0  # [kg]
VOLUME = 0.0214  # [m3]
DENSITY = 1000.0  # [kg/m3] of the water
# [-], then [m], of the thruster matrix
_ROOT = np.sqrt(0.5)
_YAW = 0.466302
_ROLL = 0.213083
_PITCH = 0.23876
_HULL = np.array([[-0.5, -0.4, -0.3], [0.5, 0.4, 0.3]])
# Body axes are forward-left-up: the rows of sway, heave, pitch and yaw have other signs than in the
# file.
_THRUSTERS = np.array(
    [
        _ROOT * np.array([1, 1, -1, -1, 0, 0, 0, 0]),
        _ROOT * np.array([1, -1, 1, -1, 0, 0, 0, 0]),
        np.array([0, 0, 0, 0, 1, 1, 1, 1]),
        _ROLL * np.array([0, 0, 0, 0, 1, -1, 1, -1]),
        -_PITCH * np.array([0, 0, 0, 0, 1, 1, -1, -1]),
        -_YAW * np.array([-1, 1, 1, -1, 0, 0, 0, 0]),
    ]
)
ACTUATORS = ActuatorModel(
    names=tuple(f"T{k}" for k in range(8)),
    wrench=_THRUSTERS,
    allocation=np.linalg.pinv(_THRUSTERS),
    lag=0.1,
    dead_zone=2.5,
    delay=0.15,
)
# Those of a body that is symmetric from left to right.
_PAIRS = ((1, 3), (0, 4), (1, 5), (2, 4), (3, 5), (0, 2))
LEARNT = {
    "added_mass": Prior(sigma=0.6),
    "linear_drag": Prior(sigma=1.0),
    "quadratic_drag": Prior(sigma=1.0),
    "volume": Prior(sigma=0.05),
    "centre_of_mass": Prior(sigma=0.1),
    "centre_of_buoyancy": Prior(sigma=1.0),
    "gain": Prior(sigma=0.2),
    "reverse": Prior(sigma=0.3),
    "dead_zone": Prior(sigma=0.4),
    "dead_zone_reverse": Prior(sigma=0.4),
    "lag": Prior(sigma=1.0),
    "bias": Prior(sigma=3.0),
    "delay": Prior(sigma=0.5),
    "velocity_point": Prior(sigma=0.2),
    "velocity_delay": Prior(sigma=0.5),
}
"""What is learnt, and how sure we are of where it starts."""


def dynamics() -> SymbolicDynamics:
    """One rigid body."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.addFrame(pin.Frame("base_link", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    model.appendBodyToJoint(
        joint, pin.Inertia(MASS, np.zeros(3), np.diag([0.5, 0.5, 0.6])), pin.SE3.Identity()
    )
    link = LinkHydrodynamics(
        frame="base_link",
        added_mass=np.array([40.0, 50.0, 60.0, 3.0, 3.0, 4.0]),
        linear_drag=np.array([30.0, 50.0, 40.0, 1.0, 1.0, 8.0]),
        quadratic_drag=np.array([100.0, 200.0, 300.0, 5.0, 5.0, 8.0]),
        volume=VOLUME,
        centre_of_buoyancy=np.array([0.0, 0.0, 0.035]),
    )
    return SymbolicDynamics(model=model, links=(link,), density=DENSITY)


def declaration(**learnt: Prior) -> Declaration:
    """Declare which parameters are learnt, and how sure we are of their start."""
    pairs = AxisCouplings(added_mass=_PAIRS, linear_drag=_PAIRS)
    nominal = vehicle_declaration(NominalParameters.of(dynamics()), _HULL, ACTUATORS, pairs)
    return nominal.with_start(velocity_delay=np.array([0.2])).with_status(**(LEARNT | learnt))


def vehicle(**learnt: Prior) -> Vehicle:
    """Make the vehicle with its unknowns."""
    parameters = declaration(**learnt)
    return Vehicle(
        dynamics=dynamics(),
        shared=Unknowns(parameters),
        per_recording=Unknowns(parameters, per_recording=True),
        actuators=ACTUATORS,
    )

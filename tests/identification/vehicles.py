"""Vehicles of the tests: numbers with every coupling, alone and with an arm."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.identification.parameters import Declaration
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    AxisCouplings,
    NominalParameters,
    vehicle_declaration,
)
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

HULL = np.array([[-0.4, -0.3, -0.2], [0.4, 0.3, 0.2]])
PAIRS = tuple((i, j) for i in range(6) for j in range(i))
COUPLED = AxisCouplings(
    added_mass=PAIRS, linear_drag=PAIRS, quadratic_drag=((0, 4), (1, 5), (5, 1), (2, 4))
)


def vehicle(n_joints: int = 0) -> SymbolicDynamics:
    """A vehicle in fresh water, its centre of mass off the origin, with an arm of some joints in
    water too.
    """
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.addFrame(pin.Frame("base_link", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    model.appendBodyToJoint(
        joint,
        pin.Inertia(20.0, np.array([0.02, -0.01, -0.03]), np.diag([0.5, 0.6, 0.7])),
        pin.SE3.Identity(),
    )
    links = [base()]
    for k in range(n_joints):
        joint = model.addJoint(
            joint, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])), f"joint{k}"
        )
        model.addFrame(pin.Frame(f"link{k}", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
        inertia = pin.Inertia(1.0, np.array([0.15, 0.0, 0.0]), np.diag([1e-3, 0.01, 0.01]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        links.append(
            LinkHydrodynamics(
                frame=f"link{k}", added_mass=[0.1, 0.6, 0.6, 0.001, 0.01, 0.01], volume=8e-4
            )
        )
    return SymbolicDynamics(model=model, links=tuple(links), density=998.0)


def base() -> LinkHydrodynamics:
    """Water on the vehicle itself."""
    return LinkHydrodynamics(
        frame="base_link",
        added_mass=[10.0, 25.0, 30.0, 0.4, 0.5, 0.3],
        linear_drag=[8.0, 12.0, 15.0, 0.4, 0.5, 0.3],
        quadratic_drag=[40.0, 70.0, 90.0, 1.0, 1.2, 0.8],
        volume=0.0205,
        centre_of_buoyancy=[0.01, 0.0, 0.05],
    )


def declaration(
    couplings: AxisCouplings = COUPLED, actuators: ActuatorModel | None = None
) -> Declaration:
    """Of the vehicle alone, all known."""
    return vehicle_declaration(NominalParameters.of(vehicle()), HULL, actuators, couplings)

"""The equations of motion of a vehicle whose quantities are expressions: those of the symbolic dynamics, nothing new."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from uvms_ocp.identification.parameters.rigid_body import spatial_inertia
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics
from uvms_ocp.model.symbolic.wet_links import WaterCoefficients


def vehicle_dynamics(dynamics: SymbolicDynamics, values: Mapping[str, ca.SX], link: int = 0) -> SymbolicDynamics:
    """The dynamics with the quantities of `vehicle_declaration` for the body that carries a link, and the water on it."""
    water = WaterCoefficients(
        added_mass=values["added_mass"],
        linear_drag=values["linear_drag"],
        quadratic_drag=values["quadratic_drag"],
        displaced_mass=dynamics.density * values["volume"],
        p_LB=values["centre_of_buoyancy"],
    )
    inertia = spatial_inertia(values["mass"], values["centre_of_mass"], values["second_moment"])
    return dynamics.with_coefficients(rigid={dynamics.joint_of(link): inertia}, links={link: water})

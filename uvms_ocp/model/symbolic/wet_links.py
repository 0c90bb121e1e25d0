"""Links in water on the joint bodies that carry them, with numbers or expressions for coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.model.symbolic.bodies import Pose
from uvms_ocp.model.symbolic.joint_types import sparse
from uvms_ocp.model.symbolic.tree import find_frame
from uvms_ocp.model.water.hydrodynamics import LinkHydrodynamics

Coefficient: TypeAlias = float | np.ndarray | ca.DM | ca.SX
"""A number or an expression."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WaterCoefficients:
    """What the water does to one link, in its frame L."""

    added_mass: Coefficient
    """(6, 6) [kg, kg m, kg m2]"""
    linear_drag: Coefficient
    """(6, 6) [N/(m/s), N m/(rad/s)]"""
    quadratic_drag: Coefficient
    """(6, 6) [N/(m/s)^2, N m/(rad/s)^2]"""
    displaced_mass: Coefficient
    """[kg]"""
    p_LB: Coefficient
    """(3,) [m]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WetLink:
    """A link's coefficients with its placement on the joint body that carries it."""

    joint: int
    R_JL: ca.DM
    """(3, 3) [-]"""
    p_JL: ca.DM
    """(3,) [m]"""
    motion_LJ: ca.DM
    """(6, 6) [-, m] twist of the joint body at J -> at L; transposed, wrench at L -> at J."""
    water: WaterCoefficients

    def point(self, poses: tuple[Pose, ...], p_L: Coefficient) -> ca.SX:
        """Position (3,) [m] in W of p_L (3,) [m] in L, where the joint bodies are at `poses`."""
        pose = poses[self.joint]
        return pose.p + pose.R @ (self.p_JL + self.R_JL @ p_L)


def wet_link(model: pin.Model, link: LinkHydrodynamics, density: float) -> WetLink:
    """Read one link, in water of a density [kg/m3]. Raises FrameNotFound."""
    frame = find_frame(model, link.frame)
    X_JL = frame.placement * link.X_FL
    return WetLink(
        joint=frame.parentJoint,
        R_JL=sparse(X_JL.rotation),
        p_JL=sparse(X_JL.translation),
        motion_LJ=sparse(X_JL.toActionMatrixInverse()),
        water=WaterCoefficients(
            added_mass=sparse(link.added_mass),
            linear_drag=sparse(link.linear_drag),
            quadratic_drag=sparse(link.quadratic_drag),
            displaced_mass=density * link.volume,
            p_LB=link.p_LB,
        ),
    )

"""An independent, slow reference: Fossen's matrices link by link, carried to the joints by
Pinocchio's Jacobians.

Nothing here is shared with the package but the coefficients: rigid bodies come from Pinocchio, nu
and nu_dot of a link from its Jacobian and the Jacobian's rate, Coriolis terms from the
skew-symmetric matrices of the textbook.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics


@dataclass(frozen=True, kw_only=True)
class LinkMotion:
    """A link's Jacobian J (6, n_v) and its rate in the coefficient frame L, and the rotation
    R_WL.
    """

    J: np.ndarray
    J_dot: np.ndarray
    R: np.ndarray
    p: np.ndarray


def link_motions(dynamics: SymbolicDynamics, q: np.ndarray, v: np.ndarray) -> list[LinkMotion]:
    model = dynamics.model.copy()
    indices = [_add_frame(model, link.frame, link.X_FL) for link in dynamics.links]
    data = model.createData()
    pin.computeJointJacobiansTimeVariation(model, data, q, v)
    pin.framesForwardKinematics(model, data, q)
    shape = (6, model.nv)
    return [
        LinkMotion(
            J=pin.getFrameJacobian(model, data, i, pin.LOCAL).reshape(shape),
            J_dot=pin.getFrameJacobianTimeVariation(model, data, i, pin.LOCAL).reshape(shape),
            R=data.oMf[i].rotation,
            p=data.oMf[i].translation,
        )
        for i in indices
    ]


def inverse_dynamics(
    dynamics: SymbolicDynamics,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    u: np.ndarray,
    Du_Dt: np.ndarray,
) -> np.ndarray:
    """Generalized force for the acceleration a in water of velocity u and acceleration Du_Dt
    (n_links, 3).
    """
    model = dynamics.model
    tau = pin.rnea(model, model.createData(), q, v, a)
    wrenches = water_wrenches(dynamics, q, v, a, u, Du_Dt)
    for motion, (added, dragged, pressure) in zip(
        link_motions(dynamics, q, v), wrenches, strict=True
    ):
        tau += motion.J.T @ (added + dragged - pressure)
    return tau if dynamics.damping is None else tau + dynamics.damping * v


def water_wrenches(
    dynamics: SymbolicDynamics,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    u: np.ndarray,
    Du_Dt: np.ndarray,
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Per link, in L: wrench (6,) on the water by added mass, by drag, and wrench (6,) of the
    water's pressure on the link.
    """
    rho = dynamics.density
    gravity = dynamics.model.gravity.linear
    wrenches = []
    for link, motion, u_W, Du_Dt_W in zip(
        dynamics.links, link_motions(dynamics, q, v), u, Du_Dt, strict=True
    ):
        nu = motion.J @ v
        nu_dot = motion.J @ a + motion.J_dot @ v
        u_L = motion.R.T @ u_W
        nu_r = nu - np.r_[u_L, 0, 0, 0]
        nu_r_dot = nu_dot + np.r_[np.cross(nu[3:], u_L) - motion.R.T @ Du_Dt_W, 0, 0, 0]
        added = link.added_mass @ nu_r_dot + coriolis(link.added_mass, nu_r) @ nu_r
        pressure = rho * link.volume * motion.R.T @ (Du_Dt_W - gravity)
        centre = link.X_FL.inverse().act(link.centre_of_buoyancy)
        wrenches.append((added, drag(link, nu_r), np.r_[pressure, np.cross(centre, pressure)]))
    return wrenches


def mass_matrix(dynamics: SymbolicDynamics, q: np.ndarray) -> np.ndarray:
    model = dynamics.model
    upper = np.triu(pin.crba(model, model.createData(), q))
    M = upper + np.triu(upper, 1).T
    for link, motion in zip(
        dynamics.links, link_motions(dynamics, q, np.zeros(model.nv)), strict=True
    ):
        M += motion.J.T @ link.added_mass @ motion.J
    return M


def damping_matrix(
    dynamics: SymbolicDynamics, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> np.ndarray:
    D = np.zeros((v.size, v.size)) if dynamics.damping is None else np.diag(dynamics.damping)
    for link, motion, u_W in zip(dynamics.links, link_motions(dynamics, q, v), u, strict=True):
        nu_r = motion.J @ v - np.r_[motion.R.T @ u_W, 0, 0, 0]
        D += (
            motion.J.T
            @ (link.linear_drag + link.quadratic_drag @ np.diag(counted(link, nu_r)))
            @ motion.J
        )
    return (D + D.T) / 2


def dissipated_power(
    dynamics: SymbolicDynamics, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> float:
    """Power [W] that drag and joint friction take out of the motion relative to a uniform current u
    (3,).
    """
    power = 0.0 if dynamics.damping is None else float(dynamics.damping @ v**2)
    for link, motion in zip(dynamics.links, link_motions(dynamics, q, v), strict=True):
        nu_r = motion.J @ v - np.r_[motion.R.T @ u, 0, 0, 0]
        power += float(nu_r @ drag(link, nu_r))
    return power


def coriolis(M: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """C_A(nu) of a full added-mass matrix, [Fossen2021] eq. (3.61)."""
    linear = M[:3] @ nu
    angular = M[3:] @ nu
    return np.block(
        [[np.zeros((3, 3)), -pin.skew(linear)], [-pin.skew(linear), -pin.skew(angular)]]
    )


def drag(link: LinkHydrodynamics, nu_r: np.ndarray) -> np.ndarray:
    return link.linear_drag @ nu_r + link.quadratic_drag @ (counted(link, nu_r) * nu_r)


def counted(link: LinkHydrodynamics, nu_r: np.ndarray) -> np.ndarray:
    """Speeds (6,) that quadratic drag counts: along each axis, or in translation of the whole
    flow.
    """
    return np.r_[[np.linalg.norm(nu_r[:3])] * 3, np.abs(nu_r[3:])] if link.by_flow else np.abs(nu_r)


def _add_frame(model: pin.Model, name: str, X_FL: pin.SE3) -> int:
    carrier = model.frames[model.getFrameId(name)]
    return model.addFrame(
        pin.Frame(
            f"L {model.nframes}",
            carrier.parentJoint,
            0,
            carrier.placement * X_FL,
            pin.FrameType.OP_FRAME,
        )
    )

"""Equations of motion of a robot in water as CasADi SX expressions.

M(q) a + C(q, v_r) v_r + D(q, v_r) v_r + g(q) = tau

M is rigid body plus added mass of every link; velocity and acceleration of the water enter link by
link.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from inspect import signature
from typing import TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import FieldTable
from uvms_ocp.robot import hydrodynamics as water
from uvms_ocp.robot.symbolic_bodies import SymbolicPose, Wrench, inertial_wrench, sparse
from uvms_ocp.robot.symbolic_model import BodyMotions, SymbolicModel, find_frame, function

Coefficient: TypeAlias = float | np.ndarray | ca.DM | ca.SX
"""A number or an expression."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WaterCoefficients:
    """Hydrodynamic coefficients of one link, in its frame L."""

    added_mass: Coefficient
    """Added mass (6, 6) [kg, kg m, kg m2]."""
    linear_drag: Coefficient
    """Wrench per velocity (6, 6) [N/(m/s), N m/(rad/s)]."""
    quadratic_drag: Coefficient
    """Wrench per squared velocity (6, 6) [N/(m/s)^2, N m/(rad/s)^2]."""
    by_flow: bool = False
    """Drag acts along the flow, not axis by axis; see `LinkHydrodynamics`."""
    displaced_mass: Coefficient
    """Density times volume [kg]."""
    p_LB: Coefficient
    """Centre of buoyancy (3,) [m] in L."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WetLink:
    """A link's coefficients with its placement on the joint body that carries it."""

    joint: int
    """Index of the joint."""
    R_JL: ca.DM
    """Rotation (3, 3) of L in J."""
    p_JL: ca.DM
    """Position (3,) [m] of L in J."""
    motion_LJ: ca.DM
    """Motion transform (6, 6) [-, m]: twist of the joint body at J to that at L; transposed, wrench
    at L to that at J.
    """
    water: WaterCoefficients

    def point(self, poses: tuple[SymbolicPose, ...], p_L: Coefficient) -> ca.SX:
        """Return the position (3,) [m] in W of p_L (3,) [m] in L, where the joint bodies are at
        `poses`.
        """
        pose = poses[self.joint]
        return pose.p + pose.R @ (self.p_JL + self.R_JL @ p_L)


def wet_link(model: pin.Model, link: water.LinkHydrodynamics, density: float) -> WetLink:
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
            by_flow=link.by_flow,
            displaced_mass=density * link.volume,
            p_LB=link.p_LB,
        ),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class SymbolicDynamics(FieldTable):
    """Dynamics of a kinematic tree with water on some of its links.

    Velocity u and acceleration ``Du_Dt = du/dt + (u . grad) u`` of the water are (3, n_links) in W,
    one column per link, in the order of ``links``. Raises FrameNotFound and InvalidInput.
    """

    model: pin.Model
    links: tuple[water.LinkHydrodynamics, ...] = ()
    density: float = 998.0
    """Density of the water [kg/m3]."""
    damping: np.ndarray | None = None
    """Viscous friction of the joints (n_v,) [N m/(rad/s), N/(m/s)]; none by default."""
    symbolic: SymbolicModel = field(init=False, repr=False)
    _wet: tuple[WetLink, ...] = field(init=False, repr=False)
    _rigid: tuple[ca.DM | ca.SX, ...] = field(init=False, repr=False)
    """Inertia (6, 6) [kg, kg m, kg m2] of every joint body, universe included."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.density) and self.density >= 0.0):
            raise InvalidInput(f"density {self.density} kg/m3 given; allowed: 0 or more")
        if self.damping is not None and np.shape(self.damping) != (self.model.nv,):
            raise InvalidInput(
                f"damping of shape {np.shape(self.damping)} given; allowed: ({self.model.nv},)"
            )
        friction = np.asarray(0.0 if self.damping is None else self.damping)
        if not (np.isfinite(friction).all() and (friction >= 0.0).all()):
            raise InvalidInput(
                f"damping {friction.tolist()} given; allowed: finite, 0 or more: less feeds energy"
            )
        self._set(
            symbolic=SymbolicModel(self.model),
            _wet=tuple(wet_link(self.model, link, self.density) for link in self.links),
            _rigid=(
                ca.DM(6, 6),
                *(sparse(inertia.matrix()) for inertia in list(self.model.inertias)[1:]),
            ),
        )

    def with_coefficients(
        self,
        *,
        rigid: Mapping[int, ca.SX] | None = None,
        links: Mapping[int, WaterCoefficients] | None = None,
    ) -> SymbolicDynamics:
        """Replace numbers of the equations by expressions.

        rigid: spatial inertias (6, 6) of joint bodies at their joints, by joint. links: what water
        does to links, by their place in ``links``. What is left out stays.
        """
        changed = copy(self)
        bodies = dict(enumerate(self._rigid)) | dict(rigid or {})
        wet = dict(enumerate(self._wet))
        for index, coefficients in (links or {}).items():
            wet[index] = replace(wet[index], water=coefficients)
        changed._set(_rigid=tuple(bodies.values()), _wet=tuple(wet.values()))
        return changed

    def joint_of(self, link: int) -> int:
        """Return the joint body that carries a link, given by its place in ``links``."""
        return self._wet[link].joint

    # --- expressions ------------------------------------------------------------------------------

    def inverse_dynamics(self, q: ca.SX, v: ca.SX, a: ca.SX, u: ca.SX, Du_Dt: ca.SX) -> ca.SX:
        """Compute the generalized force (n_v,) for the acceleration a: one outward and one inward
        pass over the tree.
        """
        local = self.symbolic.local_poses(q)
        motions = self.symbolic.body_motions(local, v, a)
        bodies = zip(self._rigid, motions.velocities, motions.accelerations, strict=True)
        wrenches = [inertial_wrench(inertia, twist, rate) for inertia, twist, rate in bodies]
        for index, link in enumerate(self._wet):
            wrenches[link.joint] += self._water_wrench(link, motions, u[:, index], Du_Dt[:, index])
        tau = self.symbolic.generalized_force(local, wrenches) + self.model.armature * a
        if self.damping is None:
            return tau
        return tau + self.damping * v

    def bias_force(self, q: ca.SX, v: ca.SX, u: ca.SX, Du_Dt: ca.SX) -> ca.SX:
        """Compute the generalized force (n_v,) for zero acceleration: ``C v + D v + g`` and the
        accelerating water.
        """
        return self.inverse_dynamics(q, v, ca.SX(self.model.nv, 1), u, Du_Dt)

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        """Compute the rigid-body plus added mass (n_v, n_v)."""
        M = self.symbolic.congruence(self.symbolic.local_poses(q), self._total_inertias())
        return M + ca.diag(sparse(np.asarray(self.model.armature)))

    def damping_matrix(self, q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """Compute the symmetric part of Fossen's D(q, v_r) with the joint friction (n_v, n_v), for
        implicit integration.

        ``v.T D v`` is the dissipated power in still water; with a diagonal quadratic drag D is
        positive semidefinite, so that ``M + h D`` damps at any step h.
        """
        return self._summed_damping(q, v, u, quadratic_factor=1)

    def forward_dynamics(self, q: ca.SX, v: ca.SX, tau: ca.SX, u: ca.SX, Du_Dt: ca.SX) -> ca.SX:
        """Compute the acceleration (n_v,) under the generalized force tau.

        For numeric use: differentiate `inverse_dynamics` instead, the derivative of the solution is
        ten times as long.
        """
        D, L_transposed, order = ca.ldl(self.mass_matrix(q), False)
        return ca.ldl_solve(tau - self.bias_force(q, v, u, Du_Dt), D, L_transposed, order)

    def drag_slope(self, q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """Compute the derivative (n_v, n_v) of ``D v_r`` and joint friction with respect to v, its
        symmetric part.

        Of drag by the flow twice D, which is the derivative along the flow, and more than that
        across it. ``M + h drag_slope`` makes a step of length h implicit in the drag, so that it
        cannot overshoot.
        """
        return self._summed_damping(q, v, u, quadratic_factor=2)

    def kinetic_energy(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Compute the kinetic energy ``1/2 v.T M v`` [J] of the bodies and the water they carry
        along.
        """
        local = self.symbolic.local_poses(q)
        motions = self.symbolic.body_motions(local, v, ca.SX(self.model.nv, 1))
        bodies = zip(self._total_inertias(), motions.velocities, strict=True)
        twice = sum(
            ca.bilin(ca.SX(inertia), velocity.stacked(), velocity.stacked())
            for inertia, velocity in bodies
        )
        return (twice + ca.dot(sparse(np.asarray(self.model.armature)), v * v)) / 2

    def potential_energy(self, q: ca.SX) -> ca.SX:
        """Compute the potential energy of weight and buoyancy [J], zero at the origin of W."""
        poses = self.symbolic.joint_poses(self.symbolic.local_poses(q))
        moment = ca.SX(3, 1)  # sum of mass times position, displaced mass counting negative
        for pose, inertia in zip(poses[1:], self._rigid[1:], strict=True):
            # in the coupling block
            mass_times_lever = ca.vertcat(inertia[5, 1], inertia[3, 2], inertia[4, 0])
            moment += inertia[0, 0] * pose.p + pose.R @ mass_times_lever
        for link in self._wet:
            moment -= link.water.displaced_mass * link.point(poses, link.water.p_LB)
        return -ca.dot(sparse(self.model.gravity.linear), moment)

    def link_positions(self, q: ca.SX) -> ca.SX:
        """Return the origins p_WL (3, n_links) [m] of the coefficient frames, where a sheared
        current acts.
        """
        poses = self.symbolic.joint_poses(self.symbolic.local_poses(q))
        return ca.horzcat(ca.SX(3, 0), *(link.point(poses, ca.DM(3, 1)) for link in self._wet))

    def inertias(self) -> list[np.ndarray]:
        """Return the rigid-body plus added inertia (6, 6) of every joint body at its joint frame,
        universe included.
        """
        return [np.asarray(ca.DM(total)) for total in self._total_inertias()]

    def _total_inertias(self) -> list[ca.DM | ca.SX]:
        """Return the inertia (6, 6) of each joint's body with the added mass of its links."""
        total = list(self._rigid)
        for link in self._wet:
            total[link.joint] = (
                total[link.joint] + link.motion_LJ.T @ link.water.added_mass @ link.motion_LJ
            )
        for k, inertia in enumerate(total):
            if isinstance(inertia, ca.DM):
                total[k] = sparse(np.asarray(inertia))
        return total

    def _water_wrench(self, link: WetLink, motions: BodyMotions, u: ca.SX, Du_Dt: ca.SX) -> Wrench:
        """Compute the wrench of the link on the water, at the joint that carries it."""
        R_LW = link.R_JL.T @ motions.poses[link.joint].R.T
        u_L = R_LW @ u
        w_L = R_LW @ (Du_Dt - self.model.gravity.linear)
        nu = link.motion_LJ @ motions.velocities[link.joint].stacked()
        a = link.motion_LJ @ motions.accelerations[link.joint].stacked()
        nu_r = water.relative_velocity(nu, u_L)
        nu_r_dot = water.relative_acceleration(a, nu, u_L, w_L)
        wrench = link.motion_LJ.T @ (
            water.added_mass_wrench(link.water.added_mass, nu_r, nu_r_dot)
            + water.drag_wrench(
                link.water.linear_drag, link.water.quadratic_drag, nu_r, link.water.by_flow
            )
            - water.pressure_wrench(link.water.displaced_mass, link.water.p_LB, w_L)
        )
        return Wrench(force=wrench[:3], moment=wrench[3:])

    def _summed_damping(self, q: ca.SX, v: ca.SX, u: ca.SX, *, quadratic_factor: int) -> ca.SX:
        """Sum of the links' damping, quadratic drag counting `quadratic_factor` times, and joint
        friction.
        """
        local = self.symbolic.local_poses(q)
        motions = self.symbolic.body_motions(local, v, ca.SX(self.model.nv, 1))
        bodies = [ca.SX(6, 6) for _ in range(self.model.njoints)]
        for index, link in enumerate(self._wet):
            bodies[link.joint] += self._link_damping(link, motions, u[:, index], quadratic_factor)
        D = self.symbolic.congruence(local, bodies)
        if self.damping is None:
            return D
        return D + ca.diag(ca.SX(self.damping))

    def _link_damping(
        self, link: WetLink, motions: BodyMotions, u: ca.SX, quadratic_factor: int
    ) -> ca.SX:
        """Compute the symmetric part of the link's D(nu_r) (6, 6), at the joint that carries it."""
        u_L = link.R_JL.T @ (motions.poses[link.joint].R.T @ u)
        nu_r = water.relative_velocity(
            link.motion_LJ @ motions.velocities[link.joint].stacked(), u_L
        )
        D = water.damping_matrix(
            link.water.linear_drag,
            quadratic_factor * link.water.quadratic_drag,
            nu_r,
            link.water.by_flow,
        )
        return link.motion_LJ.T @ ((D + D.T) / 2) @ link.motion_LJ

    # --- ready-made functions ---------------------------------------------------------------------

    def function(self, term: str) -> ca.Function:
        """Build the function of one of these expressions, such as ``"mass_matrix"``, with the names
        of its arguments.
        """
        expression = getattr(self, term)
        x = self._symbols(*signature(expression).parameters)
        return function(term, x, {term: expression(*x.values())})

    def inverse_dynamics_function(self) -> ca.Function:
        """Build the function ``q, v, a, u, Du_Dt -> tau``."""
        return self.function("inverse_dynamics")

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _symbols(self, *names: str) -> dict[str, ca.SX]:
        n_v = self.model.nv
        n_links = len(self.links)
        shapes = {"q": (self.model.nq, 1), "u": (3, n_links), "Du_Dt": (3, n_links)}
        return {name: ca.SX.sym(name, *shapes.get(name, (n_v, 1))) for name in names}

"""Derivatives of the expressions of a step along its states and controls.

State: the displacement of q in its tangent space (n_v,) [m, rad], v [m/s, rad/s] and, where durations are free, the length
of the step h [s]. Controls: the acceleration a [m/s2, rad/s2], and the thrust that cancels out [-]. Forces follow from both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from uvms_ocp.model.symbolic.tree import SymbolicModel
from uvms_ocp.ocp.transcription.stage import StageModel


@dataclass(frozen=True, kw_only=True, eq=False)
class Tangent:
    """Where the states and controls of a step are, and derivatives along them."""

    model: StageModel
    """With forces `eliminated`."""

    @property
    def free(self) -> bool:
        """The length of the step is a state."""
        return self.model.problem.free_time

    @property
    def n_v(self) -> int:
        return self.model.layout.n_v

    @property
    def n_x(self) -> int:
        return 2 * self.n_v + self.free

    @property
    def n_u(self) -> int:
        return self.n_v + self.model.layout.n_null

    @property
    def controls(self) -> slice:
        """Of z."""
        return slice(self.model.layout.a.start, self.model.layout.n_z)

    @cached_property
    def symbolic(self) -> SymbolicModel:
        return SymbolicModel(self.model.robot.model)

    @cached_property
    def _turned(self) -> ca.SX:
        """(n_q, n_v) derivative of q along its tangent space."""
        z, d = self.model.z, ca.SX.sym("d", self.n_v)
        moved = self.symbolic.integrate(z[self.model.layout.q], d)
        return ca.sparsify(ca.substitute(ca.jacobian(moved, d), d, ca.SX.zeros(self.n_v)))

    @cached_property
    def _force_slope(self) -> ca.SX:
        return ca.jacobian(self.model.wanted, self.model.z)

    def _slope(self, rows: ca.SX) -> ca.SX:
        """(m, n_z) derivative of rows (m,) in z, through the forces as well."""
        own, through = ca.jacobian(rows, self.model.z), ca.jacobian(rows, self.model.force)
        return own + through @ self._force_slope if through.nnz() else own

    def expanded(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Expressions with forces as what they are in z."""
        return ca.substitute(list(expressions), [self.model.force], [self.model.wanted])

    def jacobian(self, rows: ca.SX, *, controls: bool = True) -> ca.SX:
        """(m, n_x + n_u) derivative of rows (m,) in z; (m, n_x) without the controls."""
        return self._along(self._slope(rows), controls)

    def _along(self, slope: ca.SX, controls: bool) -> ca.SX:
        """Of a derivative (m, n_z) in z."""
        layout = self.model.layout
        parts = [slope[:, layout.q] @ self._turned, slope[:, layout.v]]
        parts += [slope[:, layout.h]] if self.free else []
        parts += [slope[:, self.controls]] if controls else []
        return ca.horzcat(*parts)

    def curvature(self, value: ca.SX, *, controls: bool = True) -> ca.SX:
        """(n, n) second derivative of a scalar in z along states and controls: of geodesics, hence symmetric.

        What forces bend is `bent`, with the weights that the scalar gives them.
        """
        slope = self._along(ca.jacobian(value, self.model.z), controls).T
        weights, H = self.weights(value), self.jacobian(slope, controls=controls)
        if weights.nnz():
            forces = self._along(self._force_slope, controls)
            H += forces.T @ self.jacobian(weights, controls=controls) + self._bend(controls)
        return (H + H.T) / 2

    def weights(self, value: ca.SX) -> ca.SX:
        """(n_v, 1) that a scalar gives the forces."""
        return ca.jacobian(value, self.model.force).T

    @cached_property
    def bent(self) -> ca.SX:
        """What `forces_bent` gives, as symbols: code too long for the memory it is read from takes three times as long."""
        return ca.SX.sym("bent", self.forces_bent(ca.SX(self.n_v, 1)).numel())

    def forces_bent(self, weights: ca.SX) -> ca.SX:
        """Slope, and nonzeros of the curvature, of a sum of forces by the motion in the middle of a step, which they come from.

        weights (n_v,) [any]: of the sum.
        """
        motion, w, slope, H = self._force_curvature
        found = ca.vertcat(slope, *H.nonzeros())
        return ca.substitute([found], [motion, w], [self.model.middle, ca.densify(weights)])[0]

    @cached_property
    def _force_curvature(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Motion, weights, slope and curvature."""
        n_q, n_v = self.model.layout.n_q, self.n_v
        motion, w, v = ca.SX.sym("motion", n_q + 2 * n_v), ca.SX.sym("w", n_v), slice(n_q, n_q + n_v)
        slope = ca.gradient(ca.dot(w, self.model.forces_of(motion)), motion)
        # Forces are linear in the acceleration, with a factor in which no velocity is.
        H, fast = ca.jacobian(slope[:n_q], motion), ca.jacobian(slope[v], motion)[:, v]
        whole = ca.blockcat([[H[:, :n_q], H[:, n_q:]], [H[:, n_q:].T, ca.diagcat(fast, ca.SX(n_v, n_v))]])
        return motion, w, slope, ca.sparsify(whole)

    def _bend(self, controls: bool) -> ca.SX:
        """(n, n) of forces, with the curvature of the motion in the middle."""
        middle, pattern = self.model.middle, self._force_curvature[-1].sparsity()
        n, g = middle.numel(), ca.SX.sym("g", middle.numel())
        D, H = self.jacobian(middle, controls=controls), ca.SX(pattern, self.bent[n:])
        return D.T @ H @ D + ca.substitute(self.curvature(ca.dot(g, middle), controls=controls), g, self.bent[:n])

    def motion(self, z_next: ca.SX) -> ca.SX:
        """By how much the state after a step is ahead of that of z_next (n_z,), in its tangent space (n_x,)."""
        z, layout, model = self.model.z, self.model.layout, self.model
        q, v, h, a = z[layout.q], z[layout.v], z[layout.h], z[layout.a]
        ahead = self.symbolic.difference(z_next[layout.q], model.moved(q, v, a, h))
        parts = [ahead, v + h * a - z_next[layout.v]]
        return ca.vertcat(*parts, *([h - z_next[layout.h]] if self.free else []))

    def moved(self, x: ca.SX) -> ca.SX:
        """z (n_z,) after the displacement x (n_x + n_u,) of its states and controls."""
        z, layout, n = self.model.z, self.model.layout, self.n_v
        q = self.symbolic.integrate(z[layout.q], x[:n])
        h = z[layout.h] + (x[2 * n] if self.free else 0)
        return ca.vertcat(q, z[layout.v] + x[n : 2 * n], h, z[self.controls] + x[self.n_x :])

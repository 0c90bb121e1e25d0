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
        model = self.model
        own, through = ca.jacobian(rows, model.z), ca.jacobian(rows, model.force)
        if not through.nnz():
            return own
        if rows.numel() > 1:
            return own + through @ self._force_slope
        weight = ca.SX.sym("weight", model.robot.n_v)
        backwards = ca.jacobian(ca.dot(weight, model.wanted), model.z)  # which costs as much as the forces
        return own + ca.substitute(backwards, weight, through.T)

    def expanded(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Expressions with forces as what they are in z."""
        return ca.substitute(list(expressions), [self.model.force], [self.model.wanted])  # type: ignore[no-any-return]

    def jacobian(self, rows: ca.SX, *, controls: bool = True) -> ca.SX:
        """(m, n_x + n_u) derivative of rows (m,) in z; (m, n_x) without the controls."""
        layout, J = self.model.layout, self._slope(rows)
        parts = [J[:, layout.q] @ self._turned, J[:, layout.v]]
        parts += [J[:, layout.h]] if self.free else []
        parts += [J[:, self.controls]] if controls else []
        return ca.horzcat(*parts)

    def curvature(self, value: ca.SX, *, controls: bool = True) -> ca.SX:
        """(n, n) second derivative of a scalar in z along states and controls: of geodesics, hence symmetric."""
        slope = self.jacobian(value, controls=controls).T
        H = self.jacobian(slope, controls=controls)
        return (H + H.T) / 2

    def bent(self, value: ca.SX) -> ca.SX:
        """(n, n) the same for a value in which nothing but q bends a and h: half as long."""
        layout, n = self.model.layout, self.n_v
        slope = self._slope(value)
        H = self.jacobian((slope[:, layout.q] @ self._turned).T)
        fast = self._slope(slope[:, layout.v].T)[:, layout.v]
        own, rest = (H[:, :n] + H[:, :n].T) / 2, H[:, n:]
        rest_too = ca.diagcat(fast, ca.SX(rest.shape[1] - n, rest.shape[1] - n))
        return ca.blockcat([[own, rest], [rest.T, rest_too]])

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

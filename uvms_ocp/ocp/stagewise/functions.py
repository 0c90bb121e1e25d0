"""Compiled functions of single steps: motion, rows of limits and terms, and their dense derivatives along states and controls.

State: the displacement of q in its tangent space (n_v,) [m, rad], v [m/s, rad/s] and, where durations are free, the length
of the step h [s]. Controls: the acceleration a [m/s2, rad/s2], and the thrust that cancels out. Forces follow from both.

Rows come in groups, each an output of its own, so that a level takes what it needs: what is held (limits of forces and
constraints first, then each level above), and the residuals whose half square is the cost of each level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from uvms_ocp.codegen.compile import compile_function
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermBlock, TermRows
from uvms_ocp.robot.symbolic_model import SymbolicModel

# Derivatives of the expressions of a step along its states and controls.


@dataclass(frozen=True, kw_only=True, eq=False)
class Tangent:
    """Tangent space of states and controls of a step, and derivatives along it."""

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
        """Return the range of the controls in z."""
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
        return ca.jacobian(self.model.required_force, self.model.z)

    def expanded(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Expressions with forces as what they are in z."""
        return ca.substitute(list(expressions), [self.model.force], [self.model.required_force])

    def jacobian(self, rows: ca.SX, *, controls: bool = True) -> ca.SX:
        """(m, n_x + n_u) derivative of rows (m,) in z; (m, n_x) without the controls."""
        own, through = ca.jacobian(rows, self.model.z), ca.jacobian(rows, self.model.force)
        return self._along(own + through @ self._force_slope if through.nnz() else own, controls)

    def _along(self, slope: ca.SX, controls: bool) -> ca.SX:
        """Project a derivative (m, n_z) in z."""
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
        """Entries of `force_curvature_terms` as symbols: code too long for the instruction cache takes three times as long."""
        return ca.SX.sym("bent", self.force_curvature_terms(ca.SX(self.n_v, 1)).numel())

    def force_curvature_terms(self, weights: ca.SX) -> ca.SX:
        """Slope, and nonzeros of the curvature, of a sum of forces by the motion in the middle of a step, which they come from.

        weights (n_v,) [any]: of the sum.
        """
        motion, w, slope, H = self._force_curvature
        found = ca.vertcat(slope, *H.nonzeros())
        return ca.substitute([found], [motion, w], [self.model.midpoint, ca.densify(weights)])[0]

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
        middle, pattern = self.model.midpoint, self._force_curvature[-1].sparsity()
        n, g = middle.numel(), ca.SX.sym("g", middle.numel())
        D, H = self.jacobian(middle, controls=controls), ca.SX(pattern, self.bent[n:])
        return D.T @ H @ D + ca.substitute(self.curvature(ca.dot(g, middle), controls=controls), g, self.bent[:n])

    def motion(self, z_next: ca.SX) -> ca.SX:
        """Return by how much the state after a step is ahead of that of z_next (n_z,), in its tangent space (n_x,)."""
        z, layout, model = self.model.z, self.model.layout, self.model
        q, v, h, a = z[layout.q], z[layout.v], z[layout.h], z[layout.a]
        ahead = self.symbolic.difference(z_next[layout.q], model.moved(q, v, a, h))
        parts = [ahead, v + h * a - z_next[layout.v]]
        return ca.vertcat(*parts, *([h - z_next[layout.h]] if self.free else []))

    def moved(self, x: ca.SX) -> ca.SX:
        """Z (n_z,) after the displacement x (n_x + n_u,) of its states and controls."""
        z, layout, n = self.model.z, self.model.layout, self.n_v
        q = self.symbolic.integrate(z[layout.q], x[:n])
        h = z[layout.h] + (x[2 * n] if self.free else 0)
        return ca.vertcat(q, z[layout.v] + x[n : 2 * n], h, z[self.controls] + x[self.n_x :])


# Compiled functions of single steps: motion, rows of limits and terms, and their dense derivatives, row after row.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceRows:
    """Forces that must stay within limits, in shares of them; last the wrench that no thruster makes, which must be 0."""

    rows: ca.SX
    """(m,) """
    lower: np.ndarray
    """(m,) """
    upper: np.ndarray
    """(m,) """
    inputs: np.ndarray
    """(m,) thruster, or behind them joint, of each row; -1 for wrenches."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HeldRows:
    """Rows that are asked for together."""

    rows: ca.SX
    """(m,) """
    numbers: np.ndarray
    """(n,) rows of the block that they are: the last n of them; residuals of costs are all of their level's."""

    @property
    def n(self) -> int:
        return int(self.rows.numel())


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockFunctions:
    """Rows of one `TermBlock`, at the steps of a phase or at its end."""

    block: TermBlock
    tangent: Tangent
    forces: ForceRows | None
    """At steps only."""
    extra: int = 0
    """Columns of zeros behind those of the state, where the stage has controls and the rows have not."""
    held: tuple[HeldRows, ...] = field(init=False)
    """Constraints, then the rows of each level; those of the last are never held, and have no derivatives."""
    errors: tuple[HeldRows, ...] = field(init=False)
    """Residual groups of each level."""
    values: ca.Function = field(init=False)
    """``z, parameters, water -> errors..., held...``"""
    linear: ca.Function = field(init=False)
    """The same without the last, then their Jacobians (n_z, m): columns are rows, so that in memory row follows row."""

    def __post_init__(self) -> None:
        rows, levels = self.block.rows, range(len(self.block.rows.errors))
        first = [] if self.forces is None else [self.forces.rows]
        held = [_group(rows, CONSTRAINT, first), *(_group(rows, i, []) for i in levels)]
        errors = [HeldRows(rows=rows.errors[i], numbers=np.flatnonzero(rows.level == i)) for i in levels]
        object.__setattr__(self, "held", tuple(held))
        object.__setattr__(self, "errors", tuple(errors))
        groups = [group.rows for group in (*errors, *held)]
        object.__setattr__(self, "values", self._function("values", groups))
        jacobians = [self._jacobian(group) for group in groups[:-1]]
        object.__setattr__(self, "linear", self._function("linear", [*groups[:-1], *jacobians]))

    @cached_property
    def bend(self) -> ca.Function:
        """``z, parameters, water, multipliers of rows that may be held, of residuals -> what forces bend``: for `curvature`."""
        value, y, e = self._weighted
        weights, rows = self.tangent.weights(value), self.block.rows
        found = self.tangent.force_curvature_terms(weights) if weights.nnz() else ca.SX(0, 1)
        inputs = [rows.model.z, rows.parameters, rows.model.water, y, e]
        return compile_dense(f"{rows.name}_bend", inputs, self.tangent.expanded([found]))

    @cached_property
    def curvature(self) -> ca.Function:
        """``z, z_next, parameters, water, costates, multipliers of held rows, of residuals, bend -> H`` (n_z, n_z)."""
        model, tangent, rows = self.tangent.model, self.tangent, self.block.rows
        z_next, costates = ca.SX.sym("z_next", model.layout.n_z), ca.SX.sym("costates", tangent.n_x)
        value, y, e = self._weighted
        bent, step = tangent.bent if tangent.weights(value).nnz() else ca.SX(0, 1), self.forces is not None
        H = tangent.curvature(value + (ca.dot(costates, tangent.motion(z_next)) if step else 0), controls=step)
        whole = ca.diagcat(H, ca.SX(self.extra, self.extra))
        inputs = [model.z, z_next, rows.parameters, model.water, costates, y, e, bent]
        return compile_dense(f"{rows.name}_curvature", inputs, tangent.expanded([whole]))

    @cached_property
    def _weighted(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The sum of all rows by multipliers, and these."""
        held = ca.vertcat(ca.SX(0, 1), *(group.rows for group in self.held[:-1]))
        errors = ca.vertcat(ca.SX(0, 1), *(group.rows for group in self.errors))
        y, e = ca.SX.sym("y", held.numel()), ca.SX.sym("e", errors.numel())
        return ca.dot(y, held) + ca.dot(e, errors), y, e

    def _jacobian(self, rows: ca.SX) -> ca.SX:
        J = self.tangent.jacobian(rows, controls=self.forces is not None)
        return ca.horzcat(J, ca.SX(rows.numel(), self.extra)).T

    def _function(self, kind: str, outputs: Sequence[ca.SX]) -> ca.Function:
        rows = self.block.rows
        inputs = [rows.model.z, rows.parameters, rows.model.water]
        return compile_dense(f"{rows.name}_{kind}", inputs, self.tangent.expanded(outputs))


def _group(rows: TermRows, level: int, before: Sequence[ca.SX]) -> HeldRows:
    numbers = np.flatnonzero(rows.level == level)
    return HeldRows(rows=ca.vertcat(*before, chosen(rows.rows, numbers)), numbers=numbers)


def chosen(rows: ca.SX, numbers: np.ndarray) -> ca.SX:
    """Rows numbered `numbers` (n,) of rows (m,); none of them where an index of CasADi would mean all."""
    return ca.vertcat(ca.SX(0, 1), *(rows[i] for i in numbers.tolist()))


def force_rows(model: StageModel) -> ForceRows:
    """Return the rows of the thrusters and joints that have limits."""
    actuators, limited, n = model.actuators, model.problem.limited, model.robot.n_vehicle
    shares = ca.vertcat(*model.inputs)
    lower = np.concatenate([actuators.thrust_lower, -actuators.torque_limit])
    upper = np.concatenate([actuators.thrust_upper, actuators.torque_limit])
    kept = np.flatnonzero((np.isfinite(lower) | np.isfinite(upper)) & limited)
    beyond = ca.DM(actuators.beyond.T / actuators.force_unit[:n]) @ model.force[:n]
    none = np.zeros(beyond.numel())
    return ForceRows(
        rows=ca.vertcat(chosen(shares, kept), beyond),
        lower=np.concatenate([lower[kept], none]),
        upper=np.concatenate([upper[kept], none]),
        inputs=np.concatenate([kept, np.full(len(none), -1)]),
    )


def motion_functions(tangent: Tangent) -> tuple[ca.Function, ca.Function]:
    """``z, z_next -> b`` (n_x,), and ``z, z_next -> b, F'`` with the derivative F (n_x, n_x + n_u)."""
    z, z_next = tangent.model.z, ca.SX.sym("z_next", tangent.model.layout.n_z)
    ahead = tangent.motion(z_next)
    return (
        compile_dense("motion", [z, z_next], [ahead]),
        compile_dense("motion_linear", [z, z_next], [ahead, tangent.jacobian(ahead).T]),
    )


def moved_function(tangent: Tangent) -> ca.Function:
    """``z, x, u, share -> z`` moved by that share of a step x (n_x,), u (n_u,)."""
    x, u, share = ca.SX.sym("x", tangent.n_x), ca.SX.sym("u", tangent.n_u), ca.SX.sym("share")
    return compile_dense("moved", [tangent.model.z, x, u, share], [tangent.moved(share * ca.vertcat(x, u))])


def compile_dense(name: str, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
    """Dense outputs, in machine code where there is a compiler."""
    return compile_function(ca.Function(name, list(inputs), [ca.densify(one) for one in outputs], {"cse": True}))

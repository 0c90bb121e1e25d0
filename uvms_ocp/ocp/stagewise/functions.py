"""Compiled functions of single steps: motion, rows of limits and terms, and their dense derivatives
along states and controls.

State: the displacement of q in its tangent space (n_v,) [m, rad], v [m/s, rad/s] and, where
durations are free, the length of the step h [s]. Controls: the acceleration a [m/s2, rad/s2], and
the thrust that cancels out. Forces follow from both.

Rows come in groups, each an output of its own, so that a level takes what it needs: what is held
(limits of forces and constraints first, then each level above), and the residuals whose half square
is the cost of each level.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial

import casadi as ca
import numpy as np

from uvms_ocp.codegen.cache_entries import content_of
from uvms_ocp.codegen.compile import compiled_from
from uvms_ocp.ocp.transcription import stage
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermBlock, TermRows
from uvms_ocp.robot.symbolic_model import SymbolicModel
from uvms_ocp.types import Keyed

Expressions = tuple[Sequence[ca.SX], Sequence[ca.SX]]
"""Inputs and outputs of a function."""


class Tangent:
    """Tangent space of states and controls of a step, and derivatives along it."""

    def __init__(self, *, model: stage.StageModel) -> None:
        """model: one that eliminates forces."""
        self.model = model
        self.free = model.problem.free_time
        """The length of the step is a state."""
        self.n_v = model.layout.n_v
        self.n_x = 2 * model.layout.n_v + self.free
        self.n_u = model.layout.n_v + model.layout.n_null
        self.controls = slice(model.layout.a.start, model.layout.n_z)
        """Range of the controls in z."""
        self.symbolic = SymbolicModel(model.robot.model)

    @cached_property
    def _turned(self) -> ca.SX:
        """(n_q, n_v) derivative of q along its tangent space."""
        z = self.model.z
        d = ca.SX.sym("d", self.n_v)
        moved = self.symbolic.integrate(z[self.model.layout.q], d)
        return ca.sparsify(ca.substitute(ca.jacobian(moved, d), d, ca.SX.zeros(self.n_v)))

    @property
    def content(self) -> str:
        """Hash of the robot's motion and forces, which stands for all that is derived from them."""
        model = self.model
        z_next = ca.SX.sym("z_next", model.layout.n_z)
        x = ca.SX.sym("x", self.n_x + self.n_u)

        def compute() -> str:
            expressions = [model.midpoint, self.motion(z_next), self.moved(x)]
            return content_of([model.z, z_next, x], expressions, model.layout, model.content)

        return stage.kept_content(Keyed((*model.kind, self.free), compute))

    @cached_property
    def force_slope(self) -> ca.SX:
        """(n_v, n_x + n_u) derivative of forces as symbols: what terms make of forces and slopes is
        short, whatever the robot.
        """
        return ca.SX.sym("slope", self.forces[1].sparsity_out(1))

    @cached_property
    def forces(self) -> tuple[ca.Function, ca.Function]:
        """``z, water -> forces`` (n_v,) [N, N m], and ``z, water -> forces, force_slope``: of the
        robot, for all terms.
        """
        inputs = [self.model.z, self.model.water]

        def build_forces() -> Expressions:
            return inputs, [ca.densify(self.model.required_force)]

        def build_slopes() -> Expressions:
            forces = self.model.required_force
            return inputs, [ca.densify(forces), self.jacobian(forces)]

        content = self.content
        return (
            compile_made("forces", content, build_forces),
            compile_made("forces_linear", content, build_slopes),
        )

    def jacobian(self, rows: ca.SX, *, controls: bool = True) -> ca.SX:
        """Return the derivative (m, n_x + n_u) of rows (m,) in z; (m, n_x) without the controls."""
        by_z = self._along(ca.jacobian(rows, self.model.z), controls)
        by_force = ca.jacobian(rows, self.model.force)
        if by_force.nnz():
            return by_z + by_force @ self.force_slope[:, : by_z.shape[1]]
        return by_z

    def _along(self, slope: ca.SX, controls: bool) -> ca.SX:
        """Project a derivative (m, n_z) in z on the tangent space."""
        layout = self.model.layout
        parts = [slope[:, layout.q] @ self._turned, slope[:, layout.v]]
        if self.free:
            parts.append(slope[:, layout.h])
        if controls:
            parts.append(slope[:, self.controls])
        return ca.horzcat(*parts)

    def curvature(self, value: ca.SX, *, controls: bool = True) -> ca.SX:
        """Return the second derivative (n, n) of a scalar in z along states and controls: of
        geodesics, hence symmetric.

        What forces bend is not in it, see `step_curvature`.
        """
        slope = self._along(ca.jacobian(value, self.model.z), controls).T
        weights = self.weights(value)
        H = self.jacobian(slope, controls=controls)
        if weights.nnz():
            H += self.force_slope[:, : H.shape[0]].T @ self.jacobian(weights, controls=controls)
        return (H + H.T) / 2

    def weights(self, value: ca.SX) -> ca.SX:
        """Return the weights (n_v, 1) that a scalar gives the forces."""
        return ca.jacobian(value, self.model.force).T

    @cached_property
    def step_curvature(self) -> ca.Function:
        """``z, z_next, costates, bent -> lower triangle`` of what motion and forces bend."""

        def build() -> Expressions:
            middle = self.model.midpoint
            z = self.model.z
            bent, slope, H = self.model.force_curvature_symbols
            z_next = ca.SX.sym("z_next", z.shape)
            costates = ca.SX.sym("costates", self.n_x)
            D = self.jacobian(middle)
            # Derivatives of what is weighted leave the weights as they are, which are symbols.
            weighted = ca.dot(slope, middle) + ca.dot(costates, self.motion(z_next))
            H = D.T @ H @ D + self.curvature(weighted)
            return [z, z_next, costates, bent], [ca.tril(H)]

        return compile_made("step_curvature", self.content, build)

    def motion(self, z_next: ca.SX) -> ca.SX:
        """Return by how much the state after a step is ahead of that of z_next (n_z,), in its
        tangent space (n_x,).
        """
        z = self.model.z
        layout = self.model.layout
        model = self.model
        q = z[layout.q]
        v = z[layout.v]
        h = z[layout.h]
        a = z[layout.a]
        ahead = self.symbolic.difference(z_next[layout.q], model.moved(q, v, a, h))
        parts = [ahead, v + h * a - z_next[layout.v]]
        if self.free:
            parts.append(h - z_next[layout.h])
        return ca.vertcat(*parts)

    def moved(self, x: ca.SX) -> ca.SX:
        """Return z (n_z,) after the displacement x (n_x + n_u,) of its states and controls."""
        z = self.model.z
        layout = self.model.layout
        n = self.n_v
        q = self.symbolic.integrate(z[layout.q], x[:n])
        h = z[layout.h] + (x[2 * n] if self.free else 0)
        return ca.vertcat(q, z[layout.v] + x[n : 2 * n], h, z[self.controls] + x[self.n_x :])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceRows:
    """Forces that must stay within limits, in shares of them; last the wrench that no thruster
    makes, which must be 0.
    """

    rows: ca.SX
    """(m,) [-] expressions of the rows."""
    lower: np.ndarray
    """(m,) [-] lower bounds."""
    upper: np.ndarray
    """(m,) [-] upper bounds."""
    inputs: np.ndarray
    """(m,) thruster, or behind them joint, of each row; -1 for wrenches."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HeldRows:
    """Rows that a function returns together: constraints, a level's rows, or its residuals."""

    rows: ca.SX
    """(m,) expressions."""
    numbers: np.ndarray
    """(n,) indices in the block of the last n of them; residuals of costs are all of their level's.
    """

    @property
    def n(self) -> int:
        """Number of rows."""
        return int(self.rows.numel())


class BlockFunctions:
    """Rows of one `TermBlock`, at the steps of a phase or at its end."""

    def __init__(
        self, *, block: TermBlock, tangent: Tangent, forces: ForceRows | None, extra: int = 0
    ) -> None:
        """Begin to compile values and derivatives.

        forces: at steps only. extra: columns of zeros behind those of the state, where the stage
        has controls and the rows have not.
        """
        self.block = block
        self.tangent = tangent
        self.forces = forces
        self.extra = extra
        rows = block.rows
        levels = range(len(rows.errors))
        limits = [] if forces is None else [forces.rows]
        self.held = (
            _group(rows, CONSTRAINT, limits),
            *(_group(rows, i, []) for i in levels),
        )
        """Constraints, then the rows of each level; those of the last are never held, and have no
        derivatives.
        """
        self.errors = tuple(
            HeldRows(rows=rows.errors[i], numbers=np.flatnonzero(rows.level == i)) for i in levels
        )
        """Residual groups of each level."""
        groups = [group.rows for group in (*self.errors, *self.held)]
        self.forced = ca.depends_on(ca.vertcat(*groups), tangent.model.force)
        """Rows depend on forces."""
        self.errors_forced = tuple(
            ca.depends_on(group.rows, tangent.model.force) for group in self.errors
        )
        """True for each level whose residuals depend on the forces."""
        sizes = [group.numel() for group in groups]
        self._content = content_of(
            self._inputs[:-1], groups, tangent.content, sizes, forces is not None, extra
        )
        self.values = self._function("values", lambda: groups)
        """``z, parameters, water, forces, force_slope -> errors..., held...``"""
        self.linear = self._function("linear", lambda: self._values_and_jacobians(groups[:-1]))
        """Values of all groups but the last, then their Jacobians (n_z, m): columns are rows, so
        that in memory row follows row.
        """

    @cached_property
    def weights(self) -> ca.Function | None:
        """``z, parameters, water, forces, force_slope, multipliers of rows that may be held, of
        residuals -> weights`` of forces.

        None where rows have no forces.
        """
        value, y, e = self._weighted
        forced = ca.depends_on(value, self.tangent.model.force)
        if forced:
            return self._function("weights", lambda: [self.tangent.weights(value)], y, e)
        return None

    @cached_property
    def curvature(self) -> ca.Function:
        """``z, parameters, water, forces, force_slope, multipliers of held rows, of residuals, step
        curvature -> H``.
        """
        value, y, e = self._weighted
        bent = ca.SX.sym("bent", self.tangent.step_curvature.sparsity_out(0))

        def build() -> list[ca.SX]:
            H = self.tangent.curvature(value, controls=self.forces is not None)
            if self.bends:
                H += ca.tril2symm(bent)[: H.shape[0], : H.shape[0]]
            return [ca.diagcat(H, ca.SX(self.extra, self.extra))]

        return self._function("curvature", build, y, e, bent)

    @property
    def bends(self) -> bool:
        """Motion or forces add to the curvature."""
        return self.forces is not None or self.weights is not None

    @cached_property
    def _weighted(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The sum of all rows by multipliers, and these."""
        held = ca.vertcat(ca.SX(0, 1), *(group.rows for group in self.held[:-1]))
        errors = ca.vertcat(ca.SX(0, 1), *(group.rows for group in self.errors))
        y = ca.SX.sym("y", held.numel())
        e = ca.SX.sym("e", errors.numel())
        return ca.dot(y, held) + ca.dot(e, errors), y, e

    def _values_and_jacobians(self, groups: Sequence[ca.SX]) -> list[ca.SX]:
        return [*groups, *(self._jacobian(rows) for rows in groups)]

    def _jacobian(self, rows: ca.SX) -> ca.SX:
        """Return the Jacobian (n_x + n_u, m) of rows, whose columns are rows."""
        jacobian = self.tangent.jacobian(rows, controls=self.forces is not None)
        zeros = ca.SX(rows.numel(), self.extra)
        return ca.horzcat(jacobian, zeros).T

    @property
    def _inputs(self) -> list[ca.SX]:
        model = self.tangent.model
        return [
            model.z,
            self.block.rows.parameters,
            model.water,
            model.force,
            self.tangent.force_slope,
        ]

    def _function(
        self, kind: str, outputs: Callable[[], Sequence[ca.SX]], *more: ca.SX
    ) -> ca.Function:
        def build() -> Expressions:
            return [*self._inputs, *more], [ca.densify(output) for output in outputs()]

        return compile_made(f"{self.block.rows.name}_{kind}", self._content, build)


def _group(rows: TermRows, level: int, before: Sequence[ca.SX]) -> HeldRows:
    """Return the rows of a level or of constraints, behind the ones that come `before` them."""
    numbers = np.flatnonzero(rows.level == level)
    return HeldRows(rows=ca.vertcat(*before, chosen(rows.rows, numbers)), numbers=numbers)


def chosen(rows: ca.SX, numbers: np.ndarray) -> ca.SX:
    """Return the rows numbered `numbers` (n,) of rows (m,); none of them where an index of CasADi
    would mean all.
    """
    return ca.vertcat(ca.SX(0, 1), *(rows[i] for i in numbers.tolist()))


def force_rows(model: stage.StageModel) -> ForceRows:
    """Return the rows of the thrusters and joints that have limits."""
    actuators = model.actuators
    limited = model.problem.limited
    n = model.robot.n_vehicle
    shares = ca.vertcat(*model.inputs)
    lower = np.concatenate([actuators.thrust_lower, -actuators.torque_limit])
    upper = np.concatenate([actuators.thrust_upper, actuators.torque_limit])
    bounded = np.flatnonzero((np.isfinite(lower) | np.isfinite(upper)) & limited)
    beyond = ca.DM(actuators.beyond.T / actuators.force_unit[:n]) @ model.force[:n, 0]
    zeros = np.zeros(beyond.numel())
    return ForceRows(
        rows=ca.vertcat(chosen(shares, bounded), beyond),
        lower=np.concatenate([lower[bounded], zeros]),
        upper=np.concatenate([upper[bounded], zeros]),
        inputs=np.concatenate([bounded, np.full(len(zeros), -1)]),
    )


def motion_functions(tangent: Tangent) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Compile ``z, z_next -> b`` (n_x,), ``z, z_next -> b, F'`` with the derivative F (n_x, n_x +
    n_u), and ``z, x, u, share -> z`` moved by that share of a step x (n_x,), u (n_u,).
    """
    x = ca.SX.sym("x", tangent.n_x)
    u = ca.SX.sym("u", tangent.n_u)
    share = ca.SX.sym("share")
    z = tangent.model.z
    z_next = ca.SX.sym("z_next", tangent.model.layout.n_z)
    content = tangent.content
    ahead = cache(partial(tangent.motion, z_next))

    def build_motion() -> Expressions:
        return [z, z_next], [ca.densify(ahead())]

    def build_motion_linear() -> Expressions:
        transposed = tangent.jacobian(ahead()).T
        return [z, z_next], [ca.densify(ahead()), ca.densify(transposed)]

    def build_moved() -> Expressions:
        step = share * ca.vertcat(x, u)
        return [z, x, u, share], [tangent.moved(step)]

    return (
        compile_made("motion", content, build_motion),
        compile_made("motion_linear", content, build_motion_linear),
        compile_made("moved", content, build_moved),
    )


def compile_made(name: str, content: str, build: Callable[[], Expressions]) -> ca.Function:
    """Compile the function whose inputs and outputs are built, unless that was done before for the
    same content.
    """

    def make() -> ca.Function:
        inputs, outputs = build()
        return ca.Function(name, inputs, outputs, {"cse": True})

    return compiled_from(name, content, make, __file__, stage.__file__)

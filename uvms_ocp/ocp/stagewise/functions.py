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

from uvms_ocp.codegen.compile import compiled_from, content_of
from uvms_ocp.ocp.transcription import stage
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermBlock, TermRows
from uvms_ocp.robot.symbolic_model import SymbolicModel
from uvms_ocp.types import Keyed

# Derivatives of the expressions of a step along its states and controls.


class Tangent:
    """Tangent space of states and controls of a step, and derivatives along it."""

    def __init__(self, *, model: stage.StageModel) -> None:
        """model: with forces `eliminated`."""
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
        m = self.model
        z_next = ca.SX.sym("z_next", self.model.layout.n_z)
        x = ca.SX.sym("x", self.n_x + self.n_u)

        def made() -> str:
            return content_of(
                [m.z, z_next, x],
                [m.midpoint, self.motion(z_next), self.moved(x)],
                m.layout,
                m.content,
            )

        return stage.kept_content(Keyed((*m.kind, self.free), made))

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
        m = self.model
        of = self.content
        inputs = [self.model.z, self.model.water]
        return (
            compile_made("forces", of, lambda: (inputs, [ca.densify(m.required_force)])),
            compile_made(
                "forces_linear",
                of,
                lambda: (inputs, [ca.densify(m.required_force), self.jacobian(m.required_force)]),
            ),
        )

    def jacobian(self, rows: ca.SX, *, controls: bool = True) -> ca.SX:
        """(m, n_x + n_u) derivative of rows (m,) in z; (m, n_x) without the controls."""
        own = self._along(ca.jacobian(rows, self.model.z), controls)
        through = ca.jacobian(rows, self.model.force)
        if through.nnz():
            return own + through @ self.force_slope[:, : own.shape[1]]
        return own

    def _along(self, slope: ca.SX, controls: bool) -> ca.SX:
        """Project a derivative (m, n_z) in z."""
        layout = self.model.layout
        parts = [slope[:, layout.q] @ self._turned, slope[:, layout.v]]
        parts += [slope[:, layout.h]] if self.free else []
        parts += [slope[:, self.controls]] if controls else []
        return ca.horzcat(*parts)

    def curvature(self, value: ca.SX, *, controls: bool = True) -> ca.SX:
        """(n, n) second derivative of a scalar in z along states and controls: of geodesics, hence
        symmetric.

        What forces bend is not in it, see `step_curvature`.
        """
        slope = self._along(ca.jacobian(value, self.model.z), controls).T
        weights = self.weights(value)
        H = self.jacobian(slope, controls=controls)
        if weights.nnz():
            H += self.force_slope[:, : H.shape[0]].T @ self.jacobian(weights, controls=controls)
        return (H + H.T) / 2

    def weights(self, value: ca.SX) -> ca.SX:
        """(n_v, 1) that a scalar gives the forces."""
        return ca.jacobian(value, self.model.force).T

    @cached_property
    def step_curvature(self) -> ca.Function:
        """``z, z_next, costates, bent -> lower triangle`` of what motion and forces bend."""

        def made() -> tuple[list[ca.SX], list[ca.SX]]:
            middle = self.model.midpoint
            z = self.model.z
            (bent, slope, H) = self.model.bent
            z_next = ca.SX.sym("z_next", z.shape)
            costates = ca.SX.sym("costates", self.n_x)
            D = self.jacobian(middle)
            # Derivatives of what is weighted leave the weights as they are, which are symbols.
            H = D.T @ H @ D + self.curvature(
                ca.dot(slope, middle) + ca.dot(costates, self.motion(z_next))
            )
            return [z, z_next, costates, bent], [ca.tril(H)]

        return compile_made("step_curvature", self.content, made)

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
        return ca.vertcat(*parts, *([h - z_next[layout.h]] if self.free else []))

    def moved(self, x: ca.SX) -> ca.SX:
        """Z (n_z,) after the displacement x (n_x + n_u,) of its states and controls."""
        z = self.model.z
        layout = self.model.layout
        n = self.n_v
        q = self.symbolic.integrate(z[layout.q], x[:n])
        h = z[layout.h] + (x[2 * n] if self.free else 0)
        return ca.vertcat(q, z[layout.v] + x[n : 2 * n], h, z[self.controls] + x[self.n_x :])


# Compiled functions of single steps: motion, rows of limits and terms, and their dense derivatives,
# row after row.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceRows:
    """Forces that must stay within limits, in shares of them; last the wrench that no thruster
    makes, which must be 0.
    """

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
    """(n,) rows of the block that they are: the last n of them; residuals of costs are all of their
    level's.
    """

    @property
    def n(self) -> int:
        return int(self.rows.numel())


class BlockFunctions:
    """Rows of one `TermBlock`, at the steps of a phase or at its end."""

    def __init__(
        self, *, block: TermBlock, tangent: Tangent, forces: ForceRows | None, extra: int = 0
    ) -> None:
        """forces: at steps only. extra: columns of zeros behind those of the state, where the stage
        has controls and the rows have not.
        """
        self.block = block
        self.tangent = tangent
        self.forces = forces
        self.extra = extra
        rows = block.rows
        levels = range(len(block.rows.errors))
        self.held = (
            _group(rows, CONSTRAINT, [] if forces is None else [forces.rows]),
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
        self.linear = self._function(
            "linear", lambda: [*groups[:-1], *(self._jacobian(group) for group in groups[:-1])]
        )
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

        def made() -> list[ca.SX]:
            H = self.tangent.curvature(value, controls=self.forces is not None)
            if self.bends:
                H += ca.tril2symm(bent)[: H.shape[0], : H.shape[0]]
            return [ca.diagcat(H, ca.SX(self.extra, self.extra))]

        return self._function("curvature", made, y, e, bent)

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

    def _jacobian(self, rows: ca.SX) -> ca.SX:
        return ca.horzcat(
            self.tangent.jacobian(rows, controls=self.forces is not None),
            ca.SX(rows.numel(), self.extra),
        ).T

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
        def made() -> tuple[list[ca.SX], list[ca.SX]]:
            return [*self._inputs, *more], [ca.densify(one) for one in outputs()]

        return compile_made(f"{self.block.rows.name}_{kind}", self._content, made)


def _group(rows: TermRows, level: int, before: Sequence[ca.SX]) -> HeldRows:
    numbers = np.flatnonzero(rows.level == level)
    return HeldRows(rows=ca.vertcat(*before, chosen(rows.rows, numbers)), numbers=numbers)


def chosen(rows: ca.SX, numbers: np.ndarray) -> ca.SX:
    """Rows numbered `numbers` (n,) of rows (m,); none of them where an index of CasADi would mean
    all.
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
    kept = np.flatnonzero((np.isfinite(lower) | np.isfinite(upper)) & limited)
    beyond = ca.DM(actuators.beyond.T / actuators.force_unit[:n]) @ model.force[:n, 0]
    none = np.zeros(beyond.numel())
    return ForceRows(
        rows=ca.vertcat(chosen(shares, kept), beyond),
        lower=np.concatenate([lower[kept], none]),
        upper=np.concatenate([upper[kept], none]),
        inputs=np.concatenate([kept, np.full(len(none), -1)]),
    )


def motion_functions(tangent: Tangent) -> tuple[ca.Function, ca.Function, ca.Function]:
    """``z, z_next -> b`` (n_x,), ``z, z_next -> b, F'`` with the derivative F (n_x, n_x + n_u), and
    ``z, x, u, share -> z`` moved by that share of a step x (n_x,), u (n_u,).
    """
    x = ca.SX.sym("x", tangent.n_x)
    u = ca.SX.sym("u", tangent.n_u)
    share = ca.SX.sym("share")
    z = tangent.model.z
    z_next = ca.SX.sym("z_next", tangent.model.layout.n_z)
    of = tangent.content
    ahead = cache(partial(tangent.motion, z_next))
    return (
        compile_made("motion", of, lambda: ([z, z_next], [ca.densify(ahead())])),
        compile_made(
            "motion_linear",
            of,
            lambda: ([z, z_next], [*map(ca.densify, (ahead(), tangent.jacobian(ahead()).T))]),
        ),
        compile_made(
            "moved", of, lambda: ([z, x, u, share], [tangent.moved(share * ca.vertcat(x, u))])
        ),
    )


def compile_made(
    name: str, content: str, made: Callable[[], tuple[Sequence[ca.SX], Sequence[ca.SX]]]
) -> ca.Function:
    """Compile the function of the inputs and outputs that are made of a content, unless that was
    done before.
    """
    return compiled_from(
        name, content, lambda: ca.Function(name, *made(), {"cse": True}), __file__, stage.__file__
    )

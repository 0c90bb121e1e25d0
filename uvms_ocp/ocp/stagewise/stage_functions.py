"""Compiled functions of single steps: motion, rows of limits and terms, and their dense derivatives, row after row.

Rows come in groups, each an output of its own, so that a level takes what it needs: what is held (limits of forces and
constraints first, then each level above), and the residuals whose half square is the cost of each level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from uvms_ocp.functions.compile import compile_function
from uvms_ocp.ocp.stagewise.tangent import Tangent
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermBlock, TermRows


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceRows:
    """Forces that must stay within limits, in shares of them; last the wrench that no thruster makes, which must be 0."""

    rows: ca.SX
    """(m,) [-]"""
    lower: np.ndarray
    """(m,) [-]"""
    upper: np.ndarray
    """(m,) [-]"""
    inputs: np.ndarray
    """(m,) [-] thruster, or behind them joint, of each row; -1 for wrenches."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowGroup:
    """Rows that are asked for together."""

    rows: ca.SX
    """(m,) [-]"""
    numbers: np.ndarray
    """(n,) [-] rows of the block that they are: the last n of them; residuals of costs are all of their level's."""

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
    held: tuple[RowGroup, ...] = field(init=False)
    """Constraints, then the rows of each level; those of the last are never held, and have no derivatives."""
    errors: tuple[RowGroup, ...] = field(init=False)
    """Of each level."""
    values: ca.Function = field(init=False)
    """``z, parameters, water -> errors..., held...``"""
    linear: ca.Function = field(init=False)
    """The same without the last, then their Jacobians (n_z, m): columns are rows, so that in memory row follows row."""

    def __post_init__(self) -> None:
        rows, levels = self.block.rows, range(len(self.block.rows.errors))
        first = [] if self.forces is None else [self.forces.rows]
        held = [_group(rows, CONSTRAINT, first), *(_group(rows, i, []) for i in levels)]
        errors = [RowGroup(rows=rows.errors[i], numbers=np.flatnonzero(rows.level == i)) for i in levels]
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
        found = self.tangent.forces_bent(weights) if weights.nnz() else ca.SX(0, 1)
        inputs = [rows.model.z, rows.parameters, rows.model.water, y, e]
        return compiled(f"{rows.name}_bend", inputs, self.tangent.expanded([found]))

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
        return compiled(f"{rows.name}_curvature", inputs, tangent.expanded([whole]))

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
        return compiled(f"{rows.name}_{kind}", inputs, self.tangent.expanded(outputs))


def _group(rows: TermRows, level: int, before: Sequence[ca.SX]) -> RowGroup:
    numbers = np.flatnonzero(rows.level == level)
    return RowGroup(rows=ca.vertcat(*before, chosen(rows.rows, numbers)), numbers=numbers)


def chosen(rows: ca.SX, numbers: np.ndarray) -> ca.SX:
    """Rows numbered `numbers` (n,) [-] of rows (m,); none of them where an index of CasADi would mean all."""
    return ca.vertcat(ca.SX(0, 1), *(rows[i] for i in numbers.tolist()))


def force_rows(model: StageModel) -> ForceRows:
    """Of the thrusters and joints that have limits."""
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
        compiled("motion", [z, z_next], [ahead]),
        compiled("motion_linear", [z, z_next], [ahead, tangent.jacobian(ahead).T]),
    )


def moved_function(tangent: Tangent) -> ca.Function:
    """``z, x, u, share -> z`` moved by that share of a step x (n_x,), u (n_u,)."""
    x, u, share = ca.SX.sym("x", tangent.n_x), ca.SX.sym("u", tangent.n_u), ca.SX.sym("share")
    return compiled("moved", [tangent.model.z, x, u, share], [tangent.moved(share * ca.vertcat(x, u))])


def compiled(name: str, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
    """Dense outputs, in machine code where there is a compiler."""
    return compile_function(ca.Function(name, list(inputs), [ca.densify(one) for one in outputs], {"cse": True}))

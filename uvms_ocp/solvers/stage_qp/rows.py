"""Rows of constraints and bounds of variables in one list, and the primal-dual points of the interior-point method.

Bounds that are reached are guessed from a QP nearby: they are equalities and all others are none, until both prove right. One
factor where the guess is right, one more for every guess that is mended [Hintermueller2002].
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import lru_cache

import numpy as np

from uvms_ocp.solvers.stage_qp import tolerances
from uvms_ocp.solvers.stage_qp.problem import KktResidual, StageQp, StageQpStatus, StageShape, kkt_residual
from uvms_ocp.types import Array, Mask

# Where an interior point is, and how it ends.


class StartMode(IntEnum):
    """Treatment of the start point of a run."""

    EQUALITIES = 0
    """Its z is where the optimum without inequalities is sought, from which the run starts."""
    WARM = 1
    """Z, costates and multipliers, those of all rows in y, are near the optimum."""
    COLD = 2
    """The run starts from z."""
    ACTIVE = 3
    """The optimum without inequalities is all that is sought."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PrimalDualPoint:
    """A point, or a direction. Rows M are those of constraints, then the variables; sides (2, M) the lower and the upper ones."""

    z: Array
    """(n,) [unit of z] variables."""
    costate: Array
    """(n_x,) [1/unit of x]"""
    y: Array
    """(M,) [1/unit of the row] multipliers of equalities."""
    s: Array
    """(2, M) [unit of the row] what is left to each bound."""
    multiplier: Array
    """(2, M) [1/unit of the row] >= 0."""
    e: Array
    """(2, M) [unit of the row] by how much elastic rows are missed."""
    f: Array
    """(2, M) [1/unit of the row] multipliers of e >= 0."""

    def moved(self, step: PrimalDualPoint, share: float) -> PrimalDualPoint:
        """Return the point moved by a share of a step."""
        return PrimalDualPoint(
            **{own.name: getattr(self, own.name) + share * getattr(step, own.name) for own in fields(self)}
        )

    def row_multipliers(self) -> Array:
        """(M,) [1/unit of the row] positive at an upper bound."""
        return np.asarray(self.y + self.multiplier[1] - self.multiplier[0])

    def of_rows(self, rows: Array) -> PrimalDualPoint:
        """With those rows numbered `rows` (m,) alone."""
        sides = {name: getattr(self, name)[:, rows] for name in ("s", "multiplier", "e", "f")}
        return PrimalDualPoint(z=self.z, costate=self.costate, y=self.y[rows], **sides)

    def flat(self) -> Array:
        """All of it in one array."""
        return np.concatenate([getattr(self, own.name).ravel() for own in fields(self)])


def unpack_point(flat: Array, n: int, n_x: int) -> PrimalDualPoint:
    """The point in one array, with n variables and n_x states; flat (n + n_x + 9 M,) [any]."""
    m = (len(flat) - n - n_x) // 9
    parts = flat[n + n_x :].reshape(9, m)
    s, multiplier, e, f = (parts[k : k + 2] for k in (1, 3, 5, 7))
    return PrimalDualPoint(z=flat[:n], costate=flat[n : n + n_x], y=parts[0], s=s, multiplier=multiplier, e=e, f=f)


def point_at(z: Array, n_x: int, m: int) -> PrimalDualPoint:
    """At z (n,) [unit of z], with nothing else; n_x states, m rows."""
    return unpack_point(np.concatenate([z, np.zeros(n_x + 9 * m)]), len(z), n_x)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class IterationResult:
    """Result of one run."""

    status: StageQpStatus
    """SOLVED, NOT_CONVEX, NOT_A_NUMBER, ITERATION_LIMIT, or UNBOUNDED where steps are, which proves nothing."""
    point: PrimalDualPoint
    """The best."""
    value: Array
    """(M,) [unit of the row] of rows and variables."""
    held: Array
    """(n,) [1/unit of z] gradient along fixed variables, which their bounds take."""
    kkt: KktResidual
    """There."""
    worst: float
    """The same, relative to the terms of each condition."""
    iterations: int
    """Factors."""
    approached: Mask | None = None
    """(2, M) sides of which less was left after the last step, by more than their multipliers fell; None without a step."""


def no_result(point: PrimalDualPoint) -> IterationResult:
    """Return the result of a run that was not made, at a point."""
    endless = kkt_residual(stationarity=np.inf, primal=np.inf, complementarity=np.inf)
    held, value = np.zeros_like(point.z), np.full_like(point.y, np.nan)
    return IterationResult(
        status=StageQpStatus.NOT_A_NUMBER, point=point, value=value, held=held, kkt=endless, worst=np.inf, iterations=0
    )


# Rows of constraints and bounds of variables in one list, with what each of them is.

SIGNS = np.array([[1.0], [-1.0]])
"""Signs of the distances to the lower and the upper side."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowTable:
    """M rows: those of constraints, stage after stage, then the variables. Arrays (2, M) hold lower and upper sides."""

    bound: Array
    """(2, M) [unit of the row] 0 where there is none."""
    side: Mask
    """(2, M) inequalities."""
    elastic: Mask
    """(2, M) inequalities that may be missed at a cost that is not smooth."""
    equal: Mask
    """(M,) equalities that are not elastic."""
    target: Array
    """(M,) [unit of the row] their right-hand sides; 0 elsewhere."""
    l1: Array
    """(M,) [1/unit of the row] 0 where the row is not elastic."""
    l2: Array
    """(M,) [1/unit of the row^2] the same."""
    compliance: Array
    """(M,) [unit of the row^2] of rows that are missed in proportion to their multiplier; 0 of the others."""
    norm: Array
    """(M,) [unit of the row/unit of z] largest entry of a row, 1 where all are 0."""
    fixed: Mask
    """(n,) variables that do not move."""

    def violation(self, value: Array) -> float:
        """Largest [unit of z] of hard rows at the value (M,) [unit of the row] of all, relative to their norm."""
        hard = self.compliance == 0.0
        sides = np.where(self.side & ~self.elastic & hard, SIGNS * (self.bound - value), 0.0).max(axis=0, initial=0.0)
        equal = np.where(self.equal & hard, np.abs(value - self.target), 0.0)
        return float(np.max((sides + equal) / self.norm, initial=0.0))


def row_table(qp: StageQp, *, phase_one: bool = False) -> RowTable:
    """Build the row table of a QP; in phase one all hard rows are elastic, at a cost of 1 for the norm of the row, and soft
    ones are none."""
    flat = qp.flat
    lower, upper, l1, l2 = (np.concatenate([flat[name], flat[f"z_{name}"]]) for name in ("lower", "upper", "l1", "l2"))
    n_rows, norm = len(flat["lower"]), _norms(qp)
    fixed = undetermined_variables(qp.shape) & (flat["z_lower"] == flat["z_upper"]) & (flat["z_l1"] == np.inf)
    counts = np.concatenate([np.ones(n_rows, dtype=bool), ~fixed])
    hard = l1 == np.inf
    if phase_one:
        counts &= hard
        l1, l2 = 1.0 / norm, np.zeros_like(l2)
        hard = np.zeros_like(hard)
    counts &= hard | (l1 > 0.0) | (l2 > 0.0)
    elastic = counts & ~hard & (l1 > 0.0)
    equal = counts & (lower == upper) & ~elastic
    side = np.isfinite([lower, upper]) & counts & ~equal
    return RowTable(
        bound=np.where(side, [lower, upper], 0.0),
        side=side,
        elastic=side & elastic,
        equal=equal,
        target=np.where(equal, lower, 0.0),
        l1=np.where(elastic, l1, 0.0),
        l2=np.where(elastic, l2, 0.0),
        compliance=np.divide(1.0, l2, out=np.zeros_like(l2), where=counts & ~hard & ~elastic),
        norm=norm,
        fixed=fixed,
    )


def _norms(qp: StageQp) -> Array:
    """(M,)"""
    rows = [np.abs(C).max(axis=1, initial=0.0) for C in qp.C]
    norm = np.concatenate([*rows, np.ones(sum(qp.shape.n_z))])
    return np.where(norm > 0.0, norm, 1.0)


@lru_cache(maxsize=64)
def undetermined_variables(shape: StageShape) -> Mask:
    """(n,) what the dynamics of a shape do not determine: the first state and all controls."""
    own = [np.ones(n, dtype=bool) for n in shape.n_z]
    for k, n_x in enumerate(shape.n_x[1:], start=1):
        own[k][:n_x] = False
    return np.concatenate(own)


def predict_active(table: RowTable, y: Array, costate: Array) -> Mask:
    """(2, M) sides that hold the solution of a QP nearby where it is.

    y (M,) [1/unit of the row] and costate (n_x,) [1/unit of x]: its multipliers. Where no side is without one, as an interior
    point leaves them, those with a large one.
    """
    most = max(np.abs(y).max(initial=0.0), np.abs(costate).max(initial=0.0))
    least = 0.0 if (table.side & (y == 0.0)).any() else tolerances.COUNTS * most
    return np.asarray(table.side & (-SIGNS * y * table.norm > least))


def hold_active(table: RowTable, active: Mask) -> RowTable:
    """Active (2, M) sides as equalities, without all others."""
    none, rows = np.zeros_like(table.side), active.any(axis=0)
    target = np.where(rows, np.where(active, table.bound, 0.0).sum(axis=0), table.target)
    return replace(table, side=none, equal=table.equal | rows, target=target)


def update_active(table: RowTable, active: Mask, y: Array, value: Array, tolerance: float) -> Mask:
    """(2, M) active sides but for those that pull, and those that a row's value misses.

    y (M,) [1/unit of the row] multipliers; value (M,) [unit of the row]; tolerance relative to the largest variable.
    """
    room = tolerances.SHARP * tolerance * (1.0 + np.abs(value[-len(table.fixed) :]).max()) * table.norm
    missed = table.side & (SIGNS * (table.bound - value) > room)
    return np.asarray((active & (SIGNS * y <= 0.0)) | (missed & ~active))

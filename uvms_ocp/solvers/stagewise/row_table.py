"""Rows of constraints and bounds of variables in one list, with what each of them is.

Bounds that are reached are guessed from a QP nearby: they are equalities and all others are none, until both prove right. One
factor where the guess is right, one more for every guess that is mended [Hintermueller2002].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from uvms_ocp.arrays import Array, Mask
from uvms_ocp.solvers.stagewise.options import STAGE_TOLERANCES
from uvms_ocp.solvers.stagewise.stage_qp import StageQp, StageShape

SIGNS = np.array([[1.0], [-1.0]])
"""Of what is left to the lower and the upper side."""


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
    """Of a QP; in phase one all hard rows are elastic, at a cost of 1 for the norm of the row, and soft ones are none."""
    flat = qp.flat
    lower, upper, l1, l2 = (np.concatenate([flat[name], flat[f"z_{name}"]]) for name in ("lower", "upper", "l1", "l2"))
    n_rows, norm = len(flat["lower"]), _norms(qp)
    fixed = may_be_fixed(qp.shape) & (flat["z_lower"] == flat["z_upper"]) & (flat["z_l1"] == np.inf)
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
def may_be_fixed(shape: StageShape) -> Mask:
    """(n,) what the dynamics of a shape do not determine: the first state and all controls."""
    own = [np.ones(n, dtype=bool) for n in shape.n_z]
    for k, n_x in enumerate(shape.n_x[1:], start=1):
        own[k][:n_x] = False
    return np.concatenate(own)


def reached(table: RowTable, y: Array, costate: Array) -> Mask:
    """(2, M) sides that hold the solution of a QP nearby where it is.

    y (M,) [1/unit of the row] and costate (n_x,) [1/unit of x]: its multipliers. Where no side is without one, as an interior
    point leaves them, those with a large one.
    """
    most = max(np.abs(y).max(initial=0.0), np.abs(costate).max(initial=0.0))
    least = 0.0 if (table.side & (y == 0.0)).any() else STAGE_TOLERANCES.counts * most
    return np.asarray(table.side & (-SIGNS * y * table.norm > least))


def held(table: RowTable, active: Mask) -> RowTable:
    """Active (2, M) sides as equalities, without all others."""
    none, rows = np.zeros_like(table.side), active.any(axis=0)
    target = np.where(rows, np.where(active, table.bound, 0.0).sum(axis=0), table.target)
    return replace(table, side=none, equal=table.equal | rows, target=target)


def mended(table: RowTable, active: Mask, y: Array, value: Array, tolerance: float) -> Mask:
    """(2, M) active sides but for those that pull, and those that a row's value misses.

    y (M,) [1/unit of the row] multipliers; value (M,) [unit of the row]; tolerance [-] relative to the largest variable.
    """
    room = STAGE_TOLERANCES.sharp * tolerance * (1.0 + np.abs(value[-len(table.fixed) :]).max()) * table.norm
    missed = table.side & (SIGNS * (table.bound - value) > room)
    return np.asarray((active & (SIGNS * y <= 0.0)) | (missed & ~active))

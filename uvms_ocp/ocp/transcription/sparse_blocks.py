"""Placing nonzeros into large sparse matrices, as CasADi MX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Entries:
    """Nonzeros with their places. Entries in a negative row or column count for nothing."""

    values: ca.MX
    """(n,)"""
    rows: np.ndarray
    """(n,) [-]"""
    columns: np.ndarray
    """(n,) [-]"""

    def selected(self, position: np.ndarray, none: int) -> Entries:
        """The same with row i moved to entry i of position (n_rows,) [-]; those moved to `none` count for nothing."""
        rows = position[self.rows]
        return Entries(values=self.values, rows=rows, columns=np.where(rows == none, -1, self.columns))


def assemble(entries: Sequence[Entries], shape: tuple[int, int]) -> ca.MX:
    """The matrix of all entries; no two may share a place."""
    rows = np.concatenate([item.rows for item in entries])
    columns = np.concatenate([item.columns for item in entries])
    kept = np.flatnonzero((rows >= 0) & (columns >= 0))
    order = kept[np.lexsort((rows[kept], columns[kept]))]
    starts = np.concatenate([[0], np.cumsum(np.bincount(columns[kept], minlength=shape[1]))])
    sparsity = ca.Sparsity(*shape, starts.tolist(), rows[order].tolist())
    return ca.MX(sparsity, ca.vertcat(*(item.values for item in entries))[order.tolist()])


def summed(entries: Sequence[Entries], n: int, *, upper: bool) -> ca.MX:
    """The square matrix (n, n) of all entries, which add up where they share a place; of `upper` its upper triangle."""
    rows, columns = (np.concatenate([getattr(item, name) for item in entries]) for name in ("rows", "columns"))
    kept = np.flatnonzero((rows >= 0) & (columns >= 0) & ((rows <= columns) | (not upper)))
    places, target = np.unique(columns[kept].astype(np.int64) * n + rows[kept], return_inverse=True)
    # One product instead of sums of large matrices, each of which would be gone through anew.
    sums = ca.DM.triplet(target.tolist(), kept.tolist(), ca.DM.ones(len(kept)), len(places), len(rows))
    sparsity = ca.Sparsity.triplet(n, n, (places % n).tolist(), (places // n).tolist())
    return ca.MX(sparsity, ca.densify(sums @ ca.vertcat(*(ca.densify(item.values) for item in entries))))


def scatter(values: ca.MX, places: np.ndarray, n: int) -> ca.MX:
    """Dense vector (n,) with `values` (m,) at places (m,) [-], no two the same; negative places count for nothing."""
    entries = Entries(values=values, rows=places, columns=np.where(places >= 0, 0, -1))
    return ca.densify(assemble([entries], (n, 1)))

"""A QP with its residuals as rows: where a Hessian is the sum of stiff and weak ones, the weak are lost to rounding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.stagewise.stage_qp import StageQp, StageShape, places

_COPIED = ("dynamics", "b", "H", "g", "damping", "z_lower", "z_upper", "z_l1", "z_l2")
_ROWS = ("C", "lower", "upper", "l1", "l2")


def with_residuals_as_rows(qp: StageQp) -> StageQp:
    """The same QP where every residual is a row behind the others that is missed at the same cost."""
    other = with_rows(qp, qp.J)
    for name in _COPIED:
        other.flat[name][:] = qp.flat[name]
    for k, (J, r) in enumerate(zip(qp.J, qp.r, strict=True)):
        n, norm = qp.shape.n_c[k], norms(J)
        other.lower[k][n:] = other.upper[k][n:] = -r / norm
        other.l1[k][n:], other.l2[k][n:] = 0.0, norm**2
    return other


def own_rows(shape: StageShape, larger: StageShape) -> Array:
    """(M,) [-] where the rows and variables of a QP stand among those of one that has more rows behind them in each stage."""
    firsts, M = places(larger.n_c)[:-1], sum(larger.n_c)
    rows = [np.arange(first, first + n) for first, n in zip(firsts, shape.n_c, strict=True)]
    return np.concatenate([*rows, np.arange(M, M + sum(shape.n_z))])


def with_rows(qp: StageQp, rows: Sequence[Array]) -> StageQp:
    """Its constraints and, without a cost, more `rows` (m, n_z) [any], of largest entry 1, that are to be 0."""
    n_c = tuple(n + len(own) for n, own in zip(qp.shape.n_c, rows, strict=True))
    other = StageQp(replace(qp.shape, n_r=(0,) * len(n_c), n_c=n_c))
    for k, (n, own) in enumerate(zip(qp.shape.n_c, rows, strict=True)):
        for name in _ROWS:
            getattr(other, name)[k][:n] = getattr(qp, name)[k]
        other.C[k][n:] = own / norms(own)[:, None]
        other.lower[k][n:] = other.upper[k][n:] = 0.0
    return other


def norms(rows: Array) -> Array:
    """(m,) Largest entry of each of the rows (m, n) [any], 1 where all are 0."""
    norm = np.abs(rows).max(axis=1, initial=0.0)
    return np.where(norm > 0.0, norm, 1.0)

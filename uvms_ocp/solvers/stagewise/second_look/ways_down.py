"""Ways along which the cost of a QP falls without end: no curvature, no bound and no row ends them."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.intervals import excess
from uvms_ocp.solvers.stagewise.second_look.residual_rows import norms, with_rows
from uvms_ocp.solvers.stagewise.stage_qp import StageQp

_EXACT = 1e-7  # relative violation of what a way has to keep
_STEEP = 1e-6  # least descent along a way, relative to the gradient
_SIDES = (("lower", -np.inf), ("upper", np.inf))


def may_fall_endlessly(qp: StageQp) -> bool:
    """Whether some variable has neither curvature of its own nor two bounds."""
    held = np.isfinite(qp.flat["z_lower"]) & np.isfinite(qp.flat["z_upper"]) & (qp.flat["z_l1"] == np.inf)
    return bool((~held & (qp.flat["damping"] == 0.0)).any())


def ways_down(qp: StageQp) -> StageQp:
    """The QP whose optimum is the steepest of all ways along which no cost but the linear one changes, and no hard row breaks.

    Ways are a cone, and the optimum is what of the gradient lies in it: 0 where there is none.
    """
    curved = [H[np.abs(H).any(axis=1)] for H in qp.H]
    other = with_rows(qp, [np.vstack(pair) for pair in zip(qp.J, curved, strict=True)])
    steepest = max(np.abs(qp.flat["g"]).max(), 1e-300)
    other.flat["dynamics"][:], other.flat["damping"][:] = qp.flat["dynamics"], 1.0
    other.flat["g"][:] = qp.flat["g"] / steepest
    for name in ("z_lower", "z_upper", "z_l1", "z_l2"):
        other.flat[name][:] = qp.flat[name]
    for z in ("", "z_"):
        _make_cone(other, z, steepest)
    bent = qp.flat["damping"] > 0.0
    other.flat["z_lower"][bent], other.flat["z_upper"][bent], other.flat["z_l1"][bent] = 0.0, 0.0, np.inf
    return other


def _make_cone(other: StageQp, z: str, steepest: float) -> None:
    """Bounds of ways; what is missed at a cost that bends is not missed at all."""
    for side, endless in _SIDES:
        bound = other.flat[f"{z}{side}"]
        bound[bound != endless] = 0.0
    l1, l2 = other.flat[f"{z}l1"], other.flat[f"{z}l2"]
    l1 /= steepest
    l1[l2 > 0.0], l2[:] = np.inf, 0.0


def leads_down(other: StageQp, z: tuple[Array, ...]) -> bool:
    """Whether the optimum z (n_z,) [unit of z] of `ways_down` is such a way, by its own numbers."""
    longest = max(np.abs(own).max(initial=0.0) for own in z)
    if not 0.0 < longest < np.inf:
        return False
    way, worst, rise = [own / longest for own in z], 0.0, 0.0
    for k, d in enumerate(way):
        missed = excess(other.C[k] @ d, other.lower[k], other.upper[k])
        beyond = excess(d, other.z_lower[k], other.z_upper[k])
        for l1, by, norm in ((other.l1[k], missed, norms(other.C[k])), (other.z_l1[k], beyond, 1.0)):
            worst = max(worst, (by / norm)[l1 == np.inf].max(initial=0.0))
            soft = l1 < np.inf
            rise += float(l1[soft] @ by[soft])
        rise += float(other.g[k] @ d)
        if k:
            ahead = other.dynamics[k - 1] @ way[k - 1] - d[: other.shape.n_x[k]]
            worst = max(worst, np.abs(ahead).max(initial=0.0))
    return bool(worst <= _EXACT and rise <= -_STEEP)

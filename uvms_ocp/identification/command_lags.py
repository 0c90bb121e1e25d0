"""Measure by how much the motion of a vehicle comes after its commands, with a standard error.

Of all times by which a command may come before an acceleration, it explains most at one: the lag of the
actuators and the delay of messages together. A parabola through the best of the times that are tried and
its neighbours has its peak there; the jackknife over parts of the recording gives the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.explained_motion import SHIFTS, ExplainedMotion, commanded
from uvms_ocp.identification.resampling import GRID, ZeroOrderHold

_PARTS = 10  # parts of a recording, of which the jackknife leaves one out at a time
_MIN_EXPLAINED = 0.3  # share of what drag leaves of an axis, from which on the axis is looked at
_RANK = 1e-12  # of the largest eigenvalue, below which commands are the same


@dataclass(frozen=True, kw_only=True, slots=True)
class CommandLag:
    """Lag of a vehicle behind its commands."""

    lag: float
    """[s] by which accelerations come after commands; below 0 where they come before."""
    sigma: float
    """[s] standard error of the lag."""
    share: float
    """[-] share of what drag and weight leave of accelerations, which commands explain at this lag."""


def measured_lag(
    held: ZeroOrderHold, motion: ExplainedMotion, *, signed: bool
) -> CommandLag | None:
    """Measure the lag behind a command; `None` where it explains too little of the motion.

    signed: True for a wrench, each of whose components accelerates along its own axis.
    """
    sums = np.array([_sums(motion, commanded(held, motion, shift)) for shift in SHIFTS])
    shares = _shares(sums.sum(axis=1), signed)
    moves = shares.max(axis=0) > _MIN_EXPLAINED
    if not moves.any():
        return None
    lag, share = _peak(shares[:, moves].mean(axis=1))
    lags = []
    for part in range(_PARTS):
        rest = np.delete(sums, part, axis=1).sum(axis=1)
        lags.append(_peak(_shares(rest, signed)[:, moves].mean(axis=1))[0])
    deviations = np.array(lags) - np.mean(lags)
    sigma = float(np.sqrt((_PARTS - 1) / _PARTS * (deviations**2).sum()))
    return CommandLag(lag=lag, sigma=sigma, share=share)


def _sums(motion: ExplainedMotion, forces: np.ndarray) -> np.ndarray:
    """Sum products of forces (m, k) and accelerations over each part: (parts, k + 6, k + 6)."""
    rows = np.hstack([forces, motion.acceleration])
    return np.array([part.T @ part for part in np.array_split(rows, _PARTS)])


def _shares(sums: np.ndarray, signed: bool) -> np.ndarray:
    """Compute shares (shifts, 6) of accelerations that commands explain, by sums (shifts, k + 6,
    k + 6).
    """
    k = sums.shape[1] - 6
    squares = np.maximum(np.diagonal(sums[:, k:, k:], axis1=1, axis2=2), 1e-9)
    common = sums[:, :k, k:]
    if signed:
        along = np.maximum(np.diagonal(common, axis1=1, axis2=2), 0.0)
        sizes = np.maximum(np.diagonal(sums[:, :k, :k], axis1=1, axis2=2), 1e-300)
        return np.asarray(along**2 / (sizes * squares))
    inverse = np.linalg.pinv(sums[:, :k, :k], rcond=_RANK, hermitian=True)
    return np.asarray((common * (inverse @ common)).sum(axis=1) / squares)


def _peak(share: np.ndarray) -> tuple[float, float]:
    """Return the shift [s] at which shares (shifts,) are largest, between those tried, and the largest
    share.
    """
    best = int(np.argmax(share))
    if not 0 < best < len(share) - 1:
        return float(SHIFTS[best]), float(share[best])
    before, middle, after = share[best - 1 : best + 2]
    curvature = before - 2.0 * middle + after
    offset = 0.0
    if curvature < 0.0:
        offset = 0.5 * (before - after) / curvature
    return float(SHIFTS[best] + offset * GRID), float(middle)

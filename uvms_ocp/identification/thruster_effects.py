"""Estimate which share of its commanded thrust each thruster gives, beside the others: one that gives next
to none is dead, one that gives much less than the others is weak.

Along each axis, what drag and weight leave of the acceleration is a factor, one over the inertia, of
the force of all thrusters, each of which gives a share of its command. Factors and shares are found by
alternating least squares, with axes weighed by what is left of them; the jackknife over parts of the
recording gives standard errors. Shares are relative to the median of the thrusters that push along the
same axis: inertias are not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.explained_motion import (
    MAY,
    SHIFTS,
    ExplainedMotion,
    commanded,
    motion_of,
)
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import ZeroOrderHold

_PARTS = 10  # parts of a recording, of which the jackknife leaves one out at a time
_ROUNDS = 30  # of alternating least squares
_MIN_EXPLAINED = (
    0.4  # share of what drag leaves of the driven axes, from which on thrusters are judged
)
_SURE = 4.0  # [standard errors] below the others from which on a thruster counts as weak or dead
_DEAD = 0.35  # share of its command below which a thruster counts as dead
_WEAK = 0.7  # share below which it counts as weak
_UNSURE = 0.15  # standard error from which on an estimate says nothing
_SAME_AXIS = (
    0.3  # share of the largest effect along an axis from which on a thruster pushes along it
)
_NEXT_TO_NOTHING = 1e-9  # of the largest entry, so that no matrix is singular


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterEffects:
    """Shares of their commands that thrusters give, relative to the median of those along the same axis."""

    shares: np.ndarray
    """(n,) [-] share of each thruster."""
    sigmas: np.ndarray
    """(n,) [-] standard errors of the shares."""
    explained: float
    """[-] share of the acceleration along the driven axes that they explain together."""


def weak_thrusters(
    recording: Recording, thrust: Channel, B: np.ndarray, names: Sequence[str]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Find thrusters that give much less than the others: the share (n,) [-] of its command that each
    gives, 0 for a dead one and 1 for a sound one, and a doubt about each that is not sound.

    thrust: [N] columns in the order of names, which push by B (6, n) [-, m].
    """
    given = np.ones(B.shape[1])
    doubts = list[str]()
    effects = estimated_effects(recording, thrust, B)
    if effects is None or effects.explained < _MIN_EXPLAINED:
        return given, ()
    for k, (share, sigma) in enumerate(zip(effects.shares, effects.sigmas, strict=True)):
        if sigma > _UNSURE:
            continue
        measured = (
            f"{names[k]} gives {share:.2f} +- {sigma:.2f} of what it is commanded, measured by the"
            " others"
        )
        if abs(share) + sigma < _DEAD and share + _SURE * sigma < 1.0:
            given[k] = 0.0
            doubts.append(f"{measured}: dead? give its column scale: 0")
        elif 0.0 < share < _WEAK - _SURE * sigma:
            given[k] = share
            doubts.append(
                f"{measured}: weak, or of another kind? give its column scale: {share:.2f}"
            )
    return given, tuple(doubts)


def estimated_effects(
    recording: Recording, thrust: Channel, B: np.ndarray
) -> ThrusterEffects | None:
    """Estimate the shares of thrusters that push by B (6, n) [-, m]; `None` where nothing moves that
    they push, or the recording is too short.
    """
    motion = motion_of(recording)
    if motion is None or thrust.values.shape[1] != B.shape[1]:
        return None
    held = ZeroOrderHold(thrust)
    best = None
    for shift in SHIFTS[MAY]:
        sums = _sums(motion, commanded(held, motion, float(shift)))
        shares, explained = _shares(sums.sum(axis=0), B)
        if best is None or explained > best[2]:
            best = sums, shares, explained
    if best is None:
        return None
    sums, shares, explained = best
    left_out = []
    for part in range(_PARTS):
        left_out.append(_shares(np.delete(sums, part, axis=0).sum(axis=0), B)[0])
    deviations = np.array(left_out) - np.mean(left_out, axis=0)
    sigmas = np.sqrt((_PARTS - 1) / _PARTS * (deviations**2).sum(axis=0))
    return ThrusterEffects(shares=shares, sigmas=sigmas, explained=explained)


def _sums(motion: ExplainedMotion, commands: np.ndarray) -> np.ndarray:
    """Sum products of commands (m, n) and accelerations over each part: (parts, n + 6, n + 6)."""
    rows = np.hstack([commands, motion.acceleration])
    parts = np.array_split(rows, _PARTS)
    return np.array([part.T @ part for part in parts])


def _shares(sums: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, float]:
    """Find shares (n,) of thrusters by sums (n + 6, n + 6) of products; return them with the share of
    the acceleration along the driven axes that they explain.
    """
    n = B.shape[1]
    gram = sums[:n, :n]
    common = sums[n:, :n]
    squares = np.diag(sums)[n:]
    is_driven = ((B**2) @ np.diag(gram) > 0.0) & (squares > 0.0)
    if not is_driven.any():
        return np.ones(n), 0.0
    B = B[is_driven]
    common = common[is_driven]
    squares = squares[is_driven]
    shares = np.ones(n)
    for _ in range(_ROUNDS):
        effective = B * shares
        along = (effective * common).sum(axis=1)
        sizes = np.maximum(np.einsum("ij,jk,ik->i", effective, gram, effective), 1e-300)
        factors = along / sizes
        left = np.maximum(squares - along**2 / sizes, _NEXT_TO_NOTHING * squares)
        weights = factors**2 / left
        H = gram * (B.T @ (weights[:, None] * B))
        g = (B * common).T @ (factors / left)
        H += _NEXT_TO_NOTHING * float(np.diag(H).max()) * np.eye(n)
        shares = np.linalg.lstsq(H, g, rcond=None)[0]
        shares = shares / max(float(np.abs(shares).max()), 1e-300)
    explained = float(1.0 - (left / squares).mean())
    return _relative(shares, B, factors), explained


def _relative(shares: np.ndarray, B: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Divide shares (n,) by the medians of thrusters that push along the same axis; factors: one over
    the inertia of each axis of B (k, n).
    """
    accelerations = np.abs(B) * np.abs(factors)[:, None]
    relative = np.empty(len(shares))
    for k, share in enumerate(shares):
        axis = int(np.argmax(accelerations[:, k] / accelerations.max(axis=1)))
        is_alike = np.abs(B[axis]) > _SAME_AXIS * np.abs(B[axis]).max()
        middle = float(np.median(shares[is_alike]))
        if abs(middle) > _NEXT_TO_NOTHING:
            relative[k] = share / middle
        else:
            relative[k] = np.inf
    return relative

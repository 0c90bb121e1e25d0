"""Detect thrusters that were exchanged or reversed: a vehicle then accelerates as if their order or
signs were different.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

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

_MIN_GAIN = 0.5  # share of one axis that changed thrusters must explain more
_MIN_EXPLAINED = 0.4
"""Share of the driven axes that changed thrusters must explain: thrust that holds a vehicle against
waves pushes against its motion.
"""
_MAX_CHANGES = 4  # changes that are looked for, one after the other


def mixed_thrusters(
    recording: Recording, thrust: Channel, B: np.ndarray, names: Sequence[str]
) -> str:
    """Detect thrusters that were exchanged or reversed, by commands that explain the motion better;
    empty if none is clear.

    thrust: [N] columns in the order of names, which push by B (6, n) [-, m].
    """
    motion = motion_of(recording)
    if motion is None or thrust.values.shape[1] != B.shape[1]:
        return ""
    agreement = _agreement(motion, thrust)
    changes = list[str]()
    best = agreement(B)
    for _ in range(_MAX_CHANGES):
        candidates = {text: B @ Q for text, Q in _changes(names).items()}
        agreements = {text: agreement(candidate) for text, candidate in candidates.items()}
        text = max(agreements, key=lambda change: agreements[change])
        if agreements[text] < best + _MIN_GAIN:
            break
        best = agreements[text]
        B = candidates[text]
        changes.append(text)
    n_driven_axes = int((np.abs(B) > 1e-9).any(axis=1).sum())
    if best <= _MIN_EXPLAINED * n_driven_axes:
        return ""
    return " and ".join(changes)


def _agreement(motion: ExplainedMotion, thrust: Channel) -> Callable[[np.ndarray], float]:
    """Make the function from thrusters B (6, n) [-, m] to the shares that they explain, summed over
    the axes; negative where a vehicle accelerates against them.

    From correlations of accelerations, in units of their own size, with thrust, at time shifts of
    the one before the other.
    """
    held = ZeroOrderHold(thrust)
    commands = np.array([commanded(held, motion, shift) for shift in SHIFTS[MAY]])
    acceleration_size = np.maximum(np.linalg.norm(motion.acceleration, axis=0), 1e-300)
    correlations = (motion.acceleration / acceleration_size).T @ commands
    gram = commands.swapaxes(1, 2) @ commands

    def agreement(B: np.ndarray) -> float:
        along = (B * correlations).sum(axis=2)
        size = np.sqrt(np.maximum(np.einsum("ij,mjk,ik->mi", B, gram, B), 0.0))
        is_pushed = size > 1e-9 * max(float(size.max()), 1e-300)
        cosine = np.where(is_pushed, along / np.where(is_pushed, size, 1.0), 0.0)
        return float((cosine * np.abs(cosine)).sum(axis=1).max())

    return agreement


def _changes(names: Sequence[str]) -> dict[str, np.ndarray]:
    """Build matrices (n, n) that reverse or exchange thrusters, by a description of the change."""
    n = len(names)
    changes = {"all reversed": -np.eye(n)}
    for k, name in enumerate(names):
        signs = np.ones(n)
        signs[k] = -1.0
        changes[f"{name} reversed"] = np.diag(signs)
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        changes[f"{names[i]} and {names[j]} exchanged"] = np.eye(n)[order]
    return changes

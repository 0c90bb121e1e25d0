"""Whether a vehicle accelerates as its thrusters push, or as if some were exchanged or reversed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from uvms_ocp.identification.recordings.doubts.accelerations import MAY, SHIFTS, Motion, commanded, motion_of
from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.identification.recordings.sampling import Held

_BETTER = 0.5  # [-] of one axis, by which another way must explain more
_WELL = 0.4  # [-] of what moves, that it must explain: what holds a vehicle against waves pushes against its motion
_MOST = 4  # [-] changes that are looked for, one after the other


@dataclass(frozen=True, slots=True, eq=False)
class _Agreement:
    """Of accelerations with thrust, at m times of the one before the other."""

    common: np.ndarray
    """(m, 6, n) [N] of accelerations in units of their own size."""
    gram: np.ndarray
    """(m, n, n) [N2] of thrust."""

    def of(self, B: np.ndarray) -> float:
        """Shares [-] that thrusters B (6, n) [-, m] explain, less where a vehicle accelerates against them; mean over axes."""
        along = (B * self.common).sum(axis=2)
        size = np.sqrt(np.maximum(np.einsum("ij,mjk,ik->mi", B, self.gram, B), 0.0))
        pushed = size > 1e-9 * max(float(size.max()), 1e-300)
        cosine = np.where(pushed, along / np.where(pushed, size, 1.0), 0.0)
        return float((cosine * np.abs(cosine)).sum(axis=1).max())


def mixed_thrusters(recording: Recording, thrust: Channel, B: np.ndarray, names: Sequence[str]) -> str:
    """What was done to thrusters whose commands explain the motion better; empty where nothing is clear.

    thrust: [N] columns in the order of names, which push by B (6, n) [-, m].
    """
    motion = motion_of(recording)
    if motion is None or thrust.values.shape[1] != B.shape[1]:
        return ""
    agreement, told, axes = _agreement(motion, thrust), list[str](), int((np.abs(B) > 1e-9).any(axis=1).sum())
    best = agreement.of(B)
    for _ in range(_MOST):
        ways = {text: B @ Q for text, Q in _ways(names).items()}
        found: Mapping[str, float] = {text: agreement.of(way) for text, way in ways.items()}
        text = max(found, key=lambda one: found[one])
        if found[text] < best + _BETTER:
            break
        best, B = found[text], ways[text]
        told.append(text)
    return " and ".join(told) if best > _WELL * axes else ""


def _agreement(motion: Motion, thrust: Channel) -> _Agreement:
    held = Held(thrust)
    given = np.array([commanded(held, motion, shift) for shift in SHIFTS[MAY]])
    size = np.maximum(np.linalg.norm(motion.acceleration, axis=0), 1e-300)
    return _Agreement((motion.acceleration / size).T @ given, given.swapaxes(1, 2) @ given)


def _ways(names: Sequence[str]) -> dict[str, np.ndarray]:
    """(n, n) [-] each, by what they do."""
    n = len(names)
    return {"all reversed": -np.eye(n)} | dict(_reversed(names)) | dict(_exchanged(names))


def _reversed(names: Sequence[str]) -> Iterator[tuple[str, np.ndarray]]:
    for k, name in enumerate(names):
        yield f"{name} reversed", np.diag(np.where(np.arange(len(names)) == k, -1.0, 1.0))


def _exchanged(names: Sequence[str]) -> Iterator[tuple[str, np.ndarray]]:
    for i, j in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[i, j]] = j, i
        yield f"{names[i]} and {names[j]} exchanged", np.eye(len(names))[order]

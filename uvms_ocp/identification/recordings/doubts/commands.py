"""Whether motion follows its commands: after them, soon, and along the axes of a wrench.

An acceleration is explained by a command at an earlier time, beside drag, weight and the turning of the frame. Where one at a
time that cannot be explains much more than all that can be, the clocks differ.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recordings.doubts.accelerations import MAY, SHIFTS, Motion, commanded, motion_of
from uvms_ocp.identification.recordings.doubts.agreement import WAYS, named
from uvms_ocp.identification.recordings.recording import KINDS, Recording
from uvms_ocp.identification.recordings.sampling import Held

_COMMANDS = tuple(name for name, kind in KINDS.items() if kind.command)
_CLEARER, _CLEAR = 0.1, 0.3  # [-] of what drag leaves: by how much more another time must explain, and how much
_MORE = 0.3  # [-] by which other axes of a wrench must explain more, of one axis
_PARTS = {"forces": slice(0, 3), "moments": slice(3, 6)}


def of_commands(recording: Recording) -> Iterator[tuple[str, str]]:
    """Channels and what speaks against them."""
    given = [name for name in _COMMANDS if name in recording.channels]
    motion = motion_of(recording) if given else None
    for name in given if motion is not None else ():
        assert motion is not None
        yield from ((name, text) for text in _against(name, Held(recording.channels[name]), motion))


def _against(name: str, held: Held, motion: Motion) -> Iterator[str]:
    signed = name == "wrench"
    shares = np.array([_shares(motion, commanded(held, motion, shift), signed) for shift in SHIFTS])
    moved = shares.max(axis=0) > _CLEAR
    if not moved.any():
        return
    share = shares[:, moved].mean(axis=1)
    late = float(SHIFTS[int(np.argmax(share))])
    if share.max() > share[MAY].max() + _CLEARER:
        told = f"{late:.2f} s after" if late > 0 else f"{-late:.2f} s before"
        yield f"the vehicle accelerates {told} what it says: a clock of its own?"
    if signed:
        yield from _axes(held, motion, late)


def _axes(held: Held, motion: Motion, late: float) -> Iterator[str]:
    """Other axes of a wrench, along which the vehicle accelerates more than along those that it has."""
    inside, outside = (commanded(held, motion, late, turned=turned) for turned in (False, True))
    for part, rows in _PARTS.items():
        ways = {named(Q): _along(motion.acceleration[:, rows], inside[:, rows], Q) for Q in WAYS}
        ways["in W"] = _along(motion.acceleration[:, rows], outside[:, rows], np.eye(3)) - _MORE / 2
        best = max(ways, key=lambda way: ways[way])
        if ways[best] > max(ways[named(np.eye(3))], 0.0) + _MORE:
            yield f"its {part} fit the acceleration as {best}"


def _along(acceleration: np.ndarray, seen: np.ndarray, Q: np.ndarray) -> float:
    """Shares [-] that each axis of Q seen (m, 3) explains of its acceleration (m, 3), less where it points away; their sum."""
    along = np.diag(_correlations(acceleration, seen @ Q.T))
    return float((along * np.abs(along)).sum())


def _shares(motion: Motion, seen: np.ndarray, signed: bool) -> np.ndarray:
    """Shares (6,) [-] of all accelerations that a command explains; signed: of its own axis, and along it."""
    if signed:
        return np.maximum(np.diag(_correlations(motion.acceleration, seen)), 0.0) ** 2
    size = np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    base, values, _ = np.linalg.svd(seen / size, full_matrices=False)
    base = base[:, values > 1e-6 * max(values[0], 1e-300)]
    return np.asarray(
        ((base.T @ motion.acceleration) ** 2).sum(axis=0) / np.maximum((motion.acceleration**2).sum(axis=0), 1e-9)
    )


def _correlations(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of columns (k, l) [-]."""
    sizes = np.outer(np.linalg.norm(x, axis=0), np.linalg.norm(y, axis=0))
    return np.asarray(x.T @ y / np.maximum(sizes, 1e-300))

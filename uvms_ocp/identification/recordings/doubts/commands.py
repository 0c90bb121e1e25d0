"""Whether motion follows its commands: after them, soon, and along the axes of a wrench.

An acceleration is explained by a command at an earlier time, beside drag, weight and the turning of the frame. Where one at a
time that cannot be explains much more than all that can be, the clocks differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.recordings.doubts.agreement import WAYS, named
from uvms_ocp.identification.recordings.doubts.samples import WINDOW
from uvms_ocp.identification.recordings.recording import KINDS, Channel, Recording
from uvms_ocp.identification.recordings.sampling import GRID, Held, angular_rate, rotations, smoothed

_COMMANDS = tuple(name for name, kind in KINDS.items() if kind.command)
_SHIFTS = np.arange(-2.0, 3.0 + 1e-9, GRID)  # [s] by which motion comes after a command
_SOON, _LATE = -0.15, 1.2  # [s] between which it may: thrusters lag, and messages take their time
_CLEARER, _CLEAR = 0.1, 0.3  # [-] of what drag leaves: by how much more another time must explain, and how much
_MORE = 0.3  # [-] by which other axes of a wrench must explain more, of one axis
_PARTS = {"forces": slice(0, 3), "moments": slice(3, 6)}
_MOVES = 0.01  # [m/s, rad/s] standard deviation of what moves
_LEAST = 200  # [-] samples
_STILL = 1e-6  # [-] of a command's size, left of it beside drag and weight: nothing by itself


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """At uniform times."""

    t: np.ndarray
    acceleration: np.ndarray
    """(m, 6) linear and angular in B, in units of their own spread, without what drag and weight explain."""
    beside: np.ndarray
    """(m, l) orthonormal: drag, weight and the turning of the frame."""
    R: np.ndarray
    """(m, 3, 3) from B to W."""

    def rest(self, values: np.ndarray) -> np.ndarray:
        """What these do not explain of values (m, k)."""
        return values - self.beside @ (self.beside.T @ values)


def of_commands(recording: Recording) -> Iterator[tuple[str, str]]:
    """Channels and what speaks against them."""
    given = [name for name in _COMMANDS if name in recording.channels]
    motion = _motion(recording) if given else None
    for name in given if motion is not None else ():
        assert motion is not None
        yield from ((name, text) for text in _against(name, Held(recording.channels[name]), motion))


def _motion(recording: Recording) -> _Motion | None:
    """None where the attitude or all velocities are not known."""
    channels = recording.channels
    if "attitude" not in channels or "linear_velocity" not in channels:
        return None
    t, _ = smoothed(channels["attitude"].known_t, channels["attitude"].values, WINDOW)
    start, end = recording.span
    t = t[(t > start - _SHIFTS[0]) & (t < end - _SHIFTS[-1])]
    if len(t) < _LEAST:
        return None
    turning = channels.get("angular_velocity")
    if turning is None or np.ptp(turning.values) < 1e-3:
        when, omega = angular_rate(channels["attitude"], WINDOW)
        turning = Channel(t=when, values=omega)
    parts = [_at(t, one) for one in (channels["linear_velocity"], turning)]
    v, a = (np.hstack([part[k] for part in parts]) for k in range(2))
    R = rotations(channels["attitude"], t)
    beside, _ = np.linalg.qr(np.hstack([np.ones((len(t), 1)), v, v * np.abs(v), R[:, 2], np.cross(v[:, 3:], v[:, :3])]))
    left = np.where(v.std(axis=0) > _MOVES, a - beside @ (beside.T @ a), 0.0)
    return _Motion(t, left / np.maximum(left.std(axis=0), 1e-9), beside, R)


def _at(t: np.ndarray, channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Values and rates (m, k) at t (m,)."""
    grid, values = smoothed(channel.known_t, channel.values, WINDOW)
    _, rates = smoothed(channel.known_t, channel.values, WINDOW, derivative=1)
    return _interpolated(t, grid, values), _interpolated(t, grid, rates)


def _interpolated(t: np.ndarray, grid: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t, grid, column) for column in values.T])


def _against(name: str, held: Held, motion: _Motion) -> Iterator[str]:
    signed = name == "wrench"
    shares = np.array([_shares(motion, _seen(held, motion, shift), signed) for shift in _SHIFTS])
    moved = shares.max(axis=0) > _CLEAR
    if not moved.any():
        return
    share, may = shares[:, moved].mean(axis=1), (_SHIFTS > _SOON) & (_SHIFTS < _LATE)
    late = float(_SHIFTS[int(np.argmax(share))])
    if share.max() > share[may].max() + _CLEARER:
        told = f"{late:.2f} s after" if late > 0 else f"{-late:.2f} s before"
        yield f"the vehicle accelerates {told} what it says: a clock of its own?"
    if signed:
        yield from _axes(held, motion, late)


def _axes(held: Held, motion: _Motion, late: float) -> Iterator[str]:
    """Other axes of a wrench, along which the vehicle accelerates more than along those that it has."""
    inside, outside = (_seen(held, motion, late, turned=turned) for turned in (False, True))
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


def _seen(held: Held, motion: _Motion, shift: float, *, turned: bool = False) -> np.ndarray:
    """Means (m, k) of a command over the window of the rates, that much [s] before them, without what drag and weight explain.

    turned: from W, which a wrench would be in, to B.
    """
    edges = motion.t - shift
    values = (held.total(edges + WINDOW / 2) - held.total(edges - WINDOW / 2)) / WINDOW
    if turned:
        values = np.einsum("nji,nkj->nki", motion.R, values.reshape(-1, 2, 3)).reshape(-1, 6)
    rest = motion.rest(values)
    return np.where(rest.std(axis=0) > _STILL * np.abs(values).max(axis=0), rest, 0.0)


def _shares(motion: _Motion, seen: np.ndarray, signed: bool) -> np.ndarray:
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

"""What accelerates a vehicle beside drag, weight and the turning of its frame, and what of a command stands beside these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.recordings.doubts.samples import WINDOW
from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.identification.recordings.sampling import GRID, Held, angular_rate, rotations, smoothed

SHIFTS = np.arange(-2.0, 3.0 + 1e-9, GRID)
"""[s] by which motion comes after a command."""
MAY = (SHIFTS > -0.15) & (SHIFTS < 1.2)
"""Of these, whether it may: thrusters lag, and messages take their time."""
_MOVES = 0.01  # [m/s, rad/s] standard deviation of what moves
_LEAST = 200  # [-] samples
_STILL = 1e-6  # [-] of a command's size, left of it beside drag and weight: nothing by itself


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """At uniform times."""

    t: np.ndarray
    """(m,) [s]"""
    acceleration: np.ndarray
    """(m, 6) [-] linear and angular in B, in units of their own spread, without what drag and weight explain."""
    beside: np.ndarray
    """(m, l) [-] orthonormal: drag, weight and the turning of the frame."""
    R: np.ndarray
    """(m, 3, 3) [-] from B to W."""

    def rest(self, values: np.ndarray) -> np.ndarray:
        """What these do not explain of values (m, k) [any]."""
        return values - self.beside @ (self.beside.T @ values)


def motion_of(recording: Recording) -> Motion | None:
    """None where the attitude or all velocities are not known."""
    channels = recording.channels
    if "attitude" not in channels or "linear_velocity" not in channels:
        return None
    t, _ = smoothed(channels["attitude"].known_t, channels["attitude"].values, WINDOW)
    start, end = recording.span
    t = t[(t > start - SHIFTS[0]) & (t < end - SHIFTS[-1])]
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
    return Motion(t, left / np.maximum(left.std(axis=0), 1e-9), beside, R)


def _at(t: np.ndarray, channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Values and rates (m, k) at t (m,)."""
    grid, values = smoothed(channel.known_t, channel.values, WINDOW)
    _, rates = smoothed(channel.known_t, channel.values, WINDOW, derivative=1)
    return _interpolated(t, grid, values), _interpolated(t, grid, rates)


def _interpolated(t: np.ndarray, grid: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t, grid, column) for column in values.T])


def commanded(held: Held, motion: Motion, shift: float, *, turned: bool = False) -> np.ndarray:
    """Means (m, k) of a command over the window of the rates, without what drag and weight explain.

    shift: [s] before the rates. turned: from W, which a wrench would be in, to B.
    """
    edges = motion.t - shift
    values = (held.total(edges + WINDOW / 2) - held.total(edges - WINDOW / 2)) / WINDOW
    if turned:
        values = np.einsum("nji,nkj->nki", motion.R, values.reshape(-1, 2, 3)).reshape(-1, 6)
    rest = motion.rest(values)
    return np.where(rest.std(axis=0) > _STILL * np.abs(values).max(axis=0), rest, 0.0)

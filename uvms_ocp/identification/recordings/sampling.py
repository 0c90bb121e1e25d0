"""Channels at any times: commands as they are held, measurements smoothed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.recordings.recording import Channel
from uvms_ocp.model.spatial import quaternion_to_matrix

GRID = 0.05
"""[s] of uniform samples before they are smoothed."""
_MOST = 20_000_000  # of these: 11 days


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """A command that stays from one sample to the next; before the first it is as the first."""

    channel: Channel
    _whole: np.ndarray = field(init=False)
    """(n, k) [unit of the channel times s] integral up to each sample."""

    def __post_init__(self) -> None:
        t, values = self.channel.known_t, self.channel.values
        whole = np.vstack([np.zeros(values.shape[1]), np.cumsum(values[:-1] * np.diff(t)[:, None], axis=0)])
        object.__setattr__(self, "_whole", whole)

    def at(self, t: np.ndarray) -> np.ndarray:
        """Values (m, k) [unit of the channel] at t (m,) [s]."""
        return self.channel.values[self._index(t)]

    def mean(self, edges: np.ndarray) -> np.ndarray:
        """Means (m - 1, k) [unit of the channel] between edges (m,) [s]: smooth in these, whatever the samples do."""
        return np.asarray(np.diff(self.total(edges), axis=0) / np.diff(edges)[:, None])

    def total(self, t: np.ndarray) -> np.ndarray:
        """Integral (m, k) [unit of the channel times s] from the first sample to t (m,) [s]."""
        index = self._index(t)
        return self._whole[index] + self.channel.values[index] * (t - self.channel.known_t[index])[:, None]

    def mean_slope(self, edges: np.ndarray) -> np.ndarray:
        """Rate (m - 1, k) [unit of the channel per s] of these means where all edges (m,) [s] move together."""
        return np.asarray(np.diff(self.at(edges), axis=0) / np.diff(edges)[:, None])

    def _index(self, t: np.ndarray) -> np.ndarray:
        index = np.searchsorted(self.channel.known_t, t, side="right") - 1
        return np.asarray(np.clip(index, 0, len(self.channel.t) - 1))


def smoothed(t: np.ndarray, values: np.ndarray, window: float, derivative: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Uniform times (m,) [s] and there, by local quadratics over `window` [s], values or their derivative (m, k) [any].

    t: (n,) [s] and values: (n, k) [any] of the samples, interpolated between them. Raises InvalidInput for times that are
    too far apart or too near to each other.
    """
    from scipy.signal import savgol_filter  # half a second, which few need

    if not 2 * window < t[-1] - t[0] < GRID * _MOST:
        raise InvalidInput(f"times from {t[0]:g} to {t[-1]:g} s given; allowed: {2 * window:g} s to {GRID * _MOST:g} s")
    grid = np.arange(t[0], t[-1], GRID)
    uniform = np.column_stack([np.interp(grid, t, column) for column in values.T])
    length = max(3, round(window / GRID) // 2 * 2 + 1)
    return grid, savgol_filter(uniform, length, 2, deriv=derivative, delta=GRID, axis=0)


def unwound(quaternions: np.ndarray) -> np.ndarray:
    """The same attitudes (n, 4) [-] by those quaternions (n, 4) [-] of the two for each that do not jump."""
    signs = np.cumprod(np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    return quaternions * np.concatenate([[1.0], signs])[:, None]


def angular_rate(attitude: Channel, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Uniform times (m,) [s] and the angular velocity in B (m, 3) [rad/s] of an attitude, smoothed over `window` [s]."""
    t, quaternions = smoothed(attitude.known_t, attitude.values, window)
    _, rates = smoothed(attitude.known_t, attitude.values, window, derivative=1)
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    a, b, c, d = rates.T
    # Twice the vector part of the conjugate times the rate.
    omega = 2 * np.column_stack(
        [w * a - x * d - y * c + z * b, w * b - y * d - z * a + x * c, w * c - z * d - x * b + y * a]
    )
    return t, omega


def rotations(attitude: Channel, t: np.ndarray) -> np.ndarray:
    """R_WB (m, 3, 3) [-] at t (m,) [s], between samples interpolated."""
    found = np.column_stack([np.interp(t, attitude.known_t, column) for column in attitude.values.T])
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return np.moveaxis(np.array(quaternion_to_matrix(found.T)), -1, 0)

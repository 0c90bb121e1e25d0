"""Evaluate channels at any times: commands as they are held, measurements interpolated or smoothed."""

from __future__ import annotations

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.recording import Channel
from uvms_ocp.robot.spatial import quaternion_to_matrix

GRID = 0.05
"""[s] between uniform samples before they are smoothed."""
_MOST = 20_000_000  # uniform samples: 11 days


class ZeroOrderHold:
    """A command that stays from one sample to the next; before the first it is as the first."""

    def __init__(self, channel: Channel) -> None:
        t = channel.undelayed_t
        values = channel.values
        self.channel = channel
        self._t = t
        self._whole = np.cumsum(
            np.vstack([np.zeros(values.shape[1]), values[:-1] * np.diff(t)[:, None]]), axis=0
        )
        """(n, k) [unit of the channel times s] integral up to each sample."""

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return values (m, k) [unit of the channel] at t (m,) [s]."""
        return self.channel.values[self._index(t)]

    def mean(self, edges: np.ndarray) -> np.ndarray:
        """Compute means (m - 1, k) [unit of the channel] between edges (m,) [s]: smooth in these,
        whatever the samples do.
        """
        return np.asarray(np.diff(self.total(edges), axis=0) / np.diff(edges)[:, None])

    def total(self, t: np.ndarray) -> np.ndarray:
        """Integral (m, k) [unit of the channel times s] from the first sample to t (m,) [s]."""
        index = self._index(t)
        return self._whole[index] + self.channel.values[index] * (t - self._t[index])[:, None]

    def mean_slope(self, edges: np.ndarray) -> np.ndarray:
        """Rate (m - 1, k) [unit of the channel per s] of these means where all edges (m,) [s] move
        together.
        """
        return np.asarray(np.diff(self.at(edges), axis=0) / np.diff(edges)[:, None])

    def _index(self, t: np.ndarray) -> np.ndarray:
        return np.asarray(
            np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, len(self.channel.t) - 1)
        )


def interpolated(at: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (m, k) [any] at times at (m,) [s], linear between samples (n, k) [any] at t
    (n,) [s].
    """
    return np.column_stack([np.interp(at, t, column) for column in values.T])


def smoothed(
    t: np.ndarray, values: np.ndarray, window: float, derivative: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Uniform times (m,) [s] and there, by local quadratics over `window` [s], values or their
    derivative (m, k) [any].

    t: (n,) [s] and values: (n, k) [any] of the samples, interpolated between them. Raises
    InvalidInput for times that are too far apart or too near to each other.
    """
    from scipy.signal import savgol_filter  # half a second, which few need

    if not 2 * window < t[-1] - t[0] < GRID * _MOST:
        raise InvalidInput(
            f"times from {t[0]:g} to {t[-1]:g} s given; allowed: {2 * window:g} s to"
            f" {GRID * _MOST:g} s"
        )
    grid = np.arange(t[0], t[-1], GRID)
    length = max(3, round(window / GRID) // 2 * 2 + 1)
    return grid, savgol_filter(
        interpolated(grid, t, values), length, 2, deriv=derivative, delta=GRID, axis=0
    )


def angular_rate(attitude: Channel, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Uniform times (m,) [s] and the angular velocity in B (m, 3) [rad/s] of an attitude, smoothed
    over `window` [s].
    """
    t, quaternions = smoothed(attitude.undelayed_t, attitude.values, window)
    _, rates = smoothed(attitude.undelayed_t, attitude.values, window, derivative=1)
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    a, b, c, d = rates.T
    # Twice the vector part of the conjugate times the rate.
    omega = 2 * np.column_stack(
        [
            w * a - x * d - y * c + z * b,
            w * b - y * d - z * a + x * c,
            w * c - z * d - x * b + y * a,
        ]
    )
    return t, omega


def pose_velocity(position: Channel, attitude: Channel, interval: float) -> Channel:
    """Compute mean velocities in B (m, 3) [m/s] between poses about `interval` [s] apart, in the
    middle of each.
    """
    times = position.undelayed_t
    span = attitude.undelayed_t[[0, -1]]
    stride = max(1, round(interval / float(np.median(np.diff(times)))))
    chosen = np.flatnonzero((times >= span[0]) & (times <= span[1]))[::stride]
    t = times[chosen]
    rates = np.diff(position.values[chosen], axis=0) / np.diff(times[chosen])[:, None]
    at = (t[1:] + t[:-1]) / 2
    return Channel(t=at, values=np.einsum("nji,nj->ni", rotations(attitude, at), rates))


def rotations(attitude: Channel, t: np.ndarray) -> np.ndarray:
    """Return R_WB (m, 3, 3) at t (m,) [s], interpolated between samples."""
    quaternions = interpolated(t, attitude.undelayed_t, attitude.values)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.moveaxis(np.array(quaternion_to_matrix(quaternions.T)), -1, 0)

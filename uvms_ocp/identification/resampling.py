"""Evaluate channels at any times: commands as they are held, measurements interpolated or smoothed."""

from __future__ import annotations

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.recording import Channel
from uvms_ocp.robot.spatial import quaternion_to_matrix

GRID = 0.05
"""[s] between uniform samples before they are smoothed."""
_MOST_SAMPLES = 20_000_000  # uniform ones: 11 days


class ZeroOrderHold:
    """A command that stays from one sample to the next; before the first it is as the first."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self._t = channel.undelayed_t
        values = channel.values
        increments = values[:-1] * np.diff(self._t)[:, None]
        self._totals = np.cumsum(np.vstack([np.zeros(values.shape[1]), increments]), axis=0)
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
        """Compute the integral (m, k) [unit of the channel times s] from the first sample to t (m,)
        [s].
        """
        index = self._index(t)
        return self._totals[index] + self.channel.values[index] * (t - self._t[index])[:, None]

    def mean_slope(self, edges: np.ndarray) -> np.ndarray:
        """Compute the rate (m - 1, k) [unit of the channel per s] at which the means change where all
        edges (m,) [s] move together.
        """
        return np.asarray(np.diff(self.at(edges), axis=0) / np.diff(edges)[:, None])

    def _index(self, t: np.ndarray) -> np.ndarray:
        """Return the index (m,) of the sample that is held at t (m,) [s]."""
        last_before = np.searchsorted(self._t, t, side="right") - 1
        return np.asarray(np.clip(last_before, 0, len(self._t) - 1))


def interpolated(at: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (m, k) [any] at times at (m,) [s], linear between samples (n, k) [any] at t
    (n,) [s].
    """
    return np.column_stack([np.interp(at, t, column) for column in values.T])


def smoothed(
    t: np.ndarray, values: np.ndarray, window: float, derivative: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth samples by local quadratics over `window` [s]: return uniform times (m,) [s], and values or
    their derivative (m, k) [any] at these.

    t: (n,) [s] and values: (n, k) [any] of the samples, interpolated between them. Raises
    InvalidInput for times that are too far apart or too near to each other.
    """
    from scipy.signal import savgol_filter  # half a second, which few need

    if not 2 * window < t[-1] - t[0] < GRID * _MOST_SAMPLES:
        raise InvalidInput(
            f"times from {t[0]:g} to {t[-1]:g} s given; allowed: {2 * window:g} s to"
            f" {GRID * _MOST_SAMPLES:g} s"
        )
    grid = np.arange(t[0], t[-1], GRID)
    length = max(3, round(window / GRID) // 2 * 2 + 1)
    uniform = interpolated(grid, t, values)
    return grid, savgol_filter(uniform, length, 2, deriv=derivative, delta=GRID, axis=0)


def angular_rate(attitude: Channel, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate an attitude, smoothed over `window` [s]: return uniform times (m,) [s], and the
    angular velocity in B (m, 3) [rad/s].
    """
    t, quaternions = smoothed(attitude.undelayed_t, attitude.values, window)
    _, rates = smoothed(attitude.undelayed_t, attitude.values, window, derivative=1)
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    dx, dy, dz, dw = rates.T
    # Twice the vector part of the conjugate times the rate.
    omega_x = w * dx - x * dw - y * dz + z * dy
    omega_y = w * dy - y * dw - z * dx + x * dz
    omega_z = w * dz - z * dw - x * dy + y * dx
    return t, 2 * np.column_stack([omega_x, omega_y, omega_z])


def pose_velocity(position: Channel, attitude: Channel, interval: float) -> Channel:
    """Compute mean velocities in B (m, 3) [m/s] between poses about `interval` [s] apart, in the
    middle of each.
    """
    times = position.undelayed_t
    begin, end = attitude.undelayed_t[[0, -1]]
    stride = max(1, round(interval / float(np.median(np.diff(times)))))
    chosen = np.flatnonzero((times >= begin) & (times <= end))[::stride]
    t = times[chosen]
    rates = np.diff(position.values[chosen], axis=0) / np.diff(t)[:, None]
    middles = (t[1:] + t[:-1]) / 2
    R = rotations(attitude, middles)
    return Channel(t=middles, values=np.einsum("nji,nj->ni", R, rates))


def rotations(attitude: Channel, t: np.ndarray) -> np.ndarray:
    """Return R_WB (m, 3, 3) at t (m,) [s], interpolated between samples."""
    quaternions = interpolated(t, attitude.undelayed_t, attitude.values)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.moveaxis(np.array(quaternion_to_matrix(quaternions.T)), -1, 0)

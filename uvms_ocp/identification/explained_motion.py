"""Compute the accelerations of a vehicle that drag, weight and the turning of its frame do not explain,
and the part of a command that they do not explain either.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.recording import CHANNEL_KINDS, Channel, Recording
from uvms_ocp.identification.resampling import (
    GRID,
    ZeroOrderHold,
    angular_rate,
    interpolated,
    rotations,
    smoothed,
)
from uvms_ocp.identification.series_agreement import WINDOW

SHIFTS = np.arange(-2.0, 3.0 + 1e-9, GRID)
"""[s] by which motion comes after a command."""
MAY = (SHIFTS > -0.15) & (SHIFTS < 1.2)
"""Mask of the plausible shifts: thrusters lag, and messages take their time."""
_MOVING_VEHICLE = 0.01  # [m/s, rad/s] standard deviation from which on an axis moves
_MIN_SAMPLES = 200
_NO_REST = 1e-6  # share of a command's size below which drag and weight explain all of it


@dataclass(frozen=True, slots=True, eq=False)
class ExplainedMotion:
    """Accelerations of a vehicle, without the part that drag, weight and the turning of its frame
    explain.
    """

    t: np.ndarray
    """(m,) [s] uniform times."""
    acceleration: np.ndarray
    """(m, 6) linear and angular accelerations in B, without what drag and weight explain, over their
    standard deviations.
    """
    basis: np.ndarray
    """(m, l) orthonormal basis of drag, weight and the turning of the frame."""
    R: np.ndarray
    """(m, 3, 3) rotations from B to W."""

    def rest(self, values: np.ndarray) -> np.ndarray:
        """Return the part of values (m, k) [any] that drag, weight and turning do not explain."""
        return values - self.basis @ (self.basis.T @ values)


def commands_and_motion(
    recording: Recording,
) -> Iterator[tuple[str, ZeroOrderHold, ExplainedMotion]]:
    """Yield the name of each channel of commands, what it commands at any time, and the motion that
    it has to explain; nothing where that is not known.
    """
    names = [name for name, kind in CHANNEL_KINDS.items() if kind.command]
    recorded = [name for name in names if name in recording.channels]
    if not recorded:
        return
    motion = motion_of(recording)
    if motion is None:
        return
    for name in recorded:
        yield name, ZeroOrderHold(recording.channels[name]), motion


def motion_of(recording: Recording) -> ExplainedMotion | None:
    """Compute the accelerations that commands have to explain; `None` where attitude or velocity are not
    recorded, or too few samples.
    """
    channels = recording.channels
    if "attitude" not in channels or "linear_velocity" not in channels:
        return None
    start, end = recording.span
    if end - start <= SHIFTS[-1] - SHIFTS[0]:
        return None
    t, _ = smoothed(channels["attitude"].undelayed_t, channels["attitude"].values, WINDOW)
    t = t[(t > start - SHIFTS[0]) & (t < end - SHIFTS[-1])]
    if len(t) < _MIN_SAMPLES:
        return None
    turning = channels.get("angular_velocity")
    if turning is None or np.ptp(turning.values) < 1e-3:
        t_turning, omega = angular_rate(channels["attitude"], WINDOW)
        turning = Channel(t=t_turning, values=omega)
    linear, linear_rates = _at(t, channels["linear_velocity"])
    angular, angular_rates = _at(t, turning)
    v = np.hstack([linear, angular])
    a = np.hstack([linear_rates, angular_rates])
    R = rotations(channels["attitude"], t)
    ones = np.ones((len(t), 1))
    coriolis = np.cross(v[:, 3:], v[:, :3])
    basis, _ = np.linalg.qr(np.hstack([ones, v, v * np.abs(v), R[:, 2], coriolis]))
    is_moving = v.std(axis=0) > _MOVING_VEHICLE
    unexplained = np.where(is_moving, a - basis @ (basis.T @ a), 0.0)
    scaled = unexplained / np.maximum(unexplained.std(axis=0), 1e-9)
    return ExplainedMotion(t, scaled, basis, R)


def _at(t: np.ndarray, channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Smooth values and their rates (m, k), and interpolate them at t (m,) [s]."""
    grid, values = smoothed(channel.undelayed_t, channel.values, WINDOW)
    _, rates = smoothed(channel.undelayed_t, channel.values, WINDOW, derivative=1)
    return interpolated(t, grid, values), interpolated(t, grid, rates)


def commanded(
    held: ZeroOrderHold, motion: ExplainedMotion, shift: float, *, turned: bool = False
) -> np.ndarray:
    """Compute means (m, k) of a command over the window of the rates, without what drag and weight
    explain.

    shift: [s] before the rates. turned: True for a wrench that is given in W.
    """
    middles = motion.t - shift  # [s]
    totals = held.total(middles + WINDOW / 2) - held.total(middles - WINDOW / 2)
    values = totals / WINDOW
    if turned:
        values = np.einsum("nji,nkj->nki", motion.R, values.reshape(-1, 2, 3)).reshape(-1, 6)
    rest = motion.rest(values)
    return np.where(rest.std(axis=0) > _NO_REST * np.abs(values).max(axis=0), rest, 0.0)

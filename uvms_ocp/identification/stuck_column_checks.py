"""Find single columns that stay exactly as they are while the vehicle moves along their axis, such as a
depth that stands while the velocity goes on.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recording import (
    CHANNEL_KINDS,
    Channel,
    Recording,
)
from uvms_ocp.identification.resampling import (
    angular_rate,
    rotations,
    smoothed,
)
from uvms_ocp.identification.series_agreement import WINDOW
from uvms_ocp.identification.stuck_checks import DIFFER, LONG, longest_rest

_MIN_REACH = 5.0  # usual steps of the column that the motion must go beyond meanwhile
_DEAD = 0.9  # share of a recording from which on a column is dead, of which other checks tell


def of_stuck_columns(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about one or two of their columns that stop for a while."""
    channels = recording.channels
    attitude = channels.get("attitude")
    if attitude is None:
        return
    if "angular_velocity" in channels:
        t, omega = angular_rate(attitude, WINDOW)
        yield from _frozen(channels["angular_velocity"], "angular_velocity", "attitude", t, omega)
    if "position" in channels and "linear_velocity" in channels:
        position = channels["position"]
        velocity = channels["linear_velocity"]
        t, rate = smoothed(position.undelayed_t, position.values, WINDOW, derivative=1)
        R = rotations(attitude, t)
        rate_in_body = np.einsum("nji,nj->ni", R, rate)
        yield from _frozen(velocity, "linear_velocity", "position", t, rate_in_body)
        t, smooth_velocity = smoothed(velocity.undelayed_t, velocity.values, WINDOW)
        R = rotations(attitude, t)
        velocity_in_world = np.einsum("nij,nj->ni", R, smooth_velocity)
        yield from _frozen(position, "position", "linear_velocity", t, velocity_in_world)


def _frozen(
    channel: Channel, name: str, partner: str, t: np.ndarray, motion: np.ndarray
) -> Iterator[tuple[str, str]]:
    """Yield columns that stand still for long, while motion (m, 3) [m/s, rad/s] at t (m,) [s], by
    another channel, does not.
    """
    is_rate = name != "position"
    times = channel.undelayed_t
    spans = [longest_rest(times, column[:, None]) for column in channel.values.T]
    labels = CHANNEL_KINDS[name].columns
    stopped = []
    for k, (begin, end) in enumerate(spans):
        duration = end - begin
        if k in channel.constants or not LONG < duration < _DEAD * (times[-1] - times[0]):
            continue
        inside = (t > begin + WINDOW) & (t < end - WINDOW)
        if not inside.any():
            continue
        expected = motion[inside, k]
        column = channel.values[:, k]
        steps = np.abs(np.diff(column))
        usual_step = float(np.median(steps[steps > 0.0]))
        if is_rate:
            missed = expected - float(np.interp(0.5 * (begin + end), times, column))
            reach = float(np.ptp(expected))
        else:
            missed = expected
            reach = float(np.ptp(np.cumsum(expected))) * float(t[1] - t[0])
        if np.sqrt((missed**2).mean()) > DIFFER and reach > _MIN_REACH * usual_step:
            stopped.append(k)
    if len(stopped) == len(labels):  # which is said of the channel
        return
    for k in stopped:
        begin, end = spans[k]
        problem = (
            f"{labels[k]} alone stays exactly as it is from {begin:.1f} to {end:.1f} s, and the"
            f" {partner} says otherwise: stopped?"
        )
        yield name, problem

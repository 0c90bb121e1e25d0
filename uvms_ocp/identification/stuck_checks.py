"""Check for values that do not change while the vehicle moves: of a sensor that has stopped, or of
commands that were not recorded.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recording import CHANNEL_KINDS, Recording
from uvms_ocp.identification.resampling import angular_rate, smoothed
from uvms_ocp.identification.series_agreement import WINDOW

LONG = 2.0  # [s] for which no sensor of what moves repeats itself
DIFFER = 0.05  # [m/s, rad/s] root mean square by which a velocity and the rate of a pose then do
_DRIVEN = 0.05  # [m/s] standard deviation of a velocity that does not come to rest
_PAIRS = (("position", "linear_velocity"), ("attitude", "angular_velocity"))
"""Poses and the velocities that are their rates."""


def of_stuck(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about values that do not change."""
    for pose, velocity in _PAIRS:
        if {pose, velocity} <= recording.channels.keys():
            yield from _stopped(recording, pose, velocity)
    yield from _unrecorded(recording)


def _stopped(recording: Recording, pose: str, velocity: str) -> Iterator[tuple[str, str]]:
    """Check the longest time in which pose or velocity stays as it is while the other moves, by
    magnitudes, which have no axes.
    """
    pose_channel = recording.channels[pose]
    velocity_channel = recording.channels[velocity]
    if pose == "position":
        t, rate = smoothed(pose_channel.undelayed_t, pose_channel.values, WINDOW, derivative=1)
    else:
        t, rate = angular_rate(pose_channel, WINDOW)
    measured_speeds = np.linalg.norm(velocity_channel.values, axis=1)
    speed = np.interp(t, velocity_channel.undelayed_t, measured_speeds)
    excess = np.linalg.norm(rate, axis=1) - speed
    for name, partner, channel in (
        (pose, velocity, pose_channel),
        (velocity, pose, velocity_channel),
    ):
        begin, end = longest_rest(channel.undelayed_t, channel.values)
        inside = (t > begin + WINDOW) & (t < end - WINDOW)
        if end - begin > LONG and np.sqrt((excess[inside] ** 2).mean()) > DIFFER:
            yield (
                name,
                (
                    f"stays exactly as it is from {begin:.1f} to {end:.1f} s, and the {partner} says"
                    " otherwise: stopped?"
                ),
            )


def longest_rest(t: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Find the longest time in which values (n, n_columns) at times t (n,) [s] stay the same; returns its
    begin and end [s].
    """
    changes = (np.diff(values, axis=0) != 0.0).any(axis=1)
    starts = np.flatnonzero(changes) + 1
    first = np.r_[0, starts]
    last = np.r_[starts - 1, len(t) - 1]
    longest = int(np.argmax(t[last] - t[first]))
    return float(t[first[longest]]), float(t[last[longest]])


def _unrecorded(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield commands that are all zero of a vehicle that never comes to rest."""
    velocity = recording.channels.get("linear_velocity")
    if velocity is None:
        return
    second_half = velocity.values[len(velocity.values) // 2 :]
    moves_to_the_end = np.linalg.norm(second_half.std(axis=0)) > _DRIVEN
    for name, channel in recording.channels.items():
        is_zero = CHANNEL_KINDS[name].command and not channel.values.any()
        if is_zero and moves_to_the_end:
            yield name, "zero throughout, and the vehicle moves to the end: what drove it?"

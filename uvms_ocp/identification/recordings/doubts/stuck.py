"""What stays as it is while the vehicle moves: a sensor that has stopped, and commands that were not recorded."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recordings.doubts.samples import WINDOW
from uvms_ocp.identification.recordings.recording import KINDS, Channel, Recording
from uvms_ocp.identification.recordings.sampling import angular_rate, smoothed

_LONG = 2.0  # [s] for which no sensor of what moves repeats itself
_DIFFER = 0.05  # [m/s, rad/s] root mean square by which a velocity and the rate of a pose then do
_DRIVEN = 0.05  # [m/s] standard deviation of a velocity that does not come to rest
_PAIRS = (("position", "linear_velocity"), ("attitude", "angular_velocity"))


def of_stuck(recording: Recording) -> Iterator[tuple[str, str]]:
    """Channels and what speaks against them."""
    for pose, velocity in _PAIRS:
        if {pose, velocity} <= recording.channels.keys():
            yield from _frozen(recording, pose, velocity)
    yield from _unrecorded(recording)


def _frozen(recording: Recording, pose: str, velocity: str) -> Iterator[tuple[str, str]]:
    """By magnitudes, which have no axes."""
    one, other = recording.channels[pose], recording.channels[velocity]
    if pose == "position":
        t, rate = smoothed(one.known_t, one.values, WINDOW, derivative=1)
    else:
        t, rate = angular_rate(one, WINDOW)
    speed = np.interp(t, other.known_t, np.linalg.norm(other.values, axis=1))
    apart = np.linalg.norm(rate, axis=1) - speed
    for name, mate, channel in ((pose, velocity, one), (velocity, pose, other)):
        begin, end = _longest(channel)
        inside = (t > begin + WINDOW) & (t < end - WINDOW)
        if end - begin > _LONG and np.sqrt((apart[inside] ** 2).mean()) > _DIFFER:
            yield (
                name,
                f"stays exactly as it is from {begin:.1f} to {end:.1f} s, and the {mate} says otherwise: stopped?",
            )


def _longest(channel: Channel) -> tuple[float, float]:
    """[s] from when to when its samples are the same for longest."""
    new = np.flatnonzero((np.diff(channel.values, axis=0) != 0.0).any(axis=1)) + 1
    first, last = np.r_[0, new], np.r_[new - 1, len(channel.t) - 1]
    k = int(np.argmax(channel.known_t[last] - channel.known_t[first]))
    return float(channel.known_t[first[k]]), float(channel.known_t[last[k]])


def _unrecorded(recording: Recording) -> Iterator[tuple[str, str]]:
    """Commands that are all zero of a vehicle that never comes to rest."""
    zero = [n for n, one in recording.channels.items() if KINDS[n].command and not one.values.any()]
    if not zero or "linear_velocity" not in recording.channels:
        return
    values = recording.channels["linear_velocity"].values
    spread = float(np.linalg.norm(values[len(values) // 2 :].std(axis=0)))
    if spread > _DRIVEN:
        yield from ((name, "zero throughout, and the vehicle moves to the end: what drove it?") for name in zero)

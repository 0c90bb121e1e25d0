"""Recordings with silences, cut there: what was commanded while nothing was recorded is known to nobody.

A clock that is set while it records leaves one too, as long as it was moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.recordings.recording import Channel, Recording

SILENT = 2.0
"""[s] without a sample of any channel, from which on a recording is cut."""
SHORTEST = 5.0
"""[s] of a part that is kept: less tells next to nothing."""


def parted(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """The same, those with silences in parts. Raises InvalidInput for one that has no part of `SHORTEST`."""
    return tuple(part for one in recordings for part in _parts(one))


def _parts(one: Recording) -> tuple[Recording, ...]:
    silences, (begin, end) = _silences(one), one.span
    if not len(silences) or begin >= end:  # channels without a time in common are no matter of silences
        return (one,)
    ends = [-np.inf, *silences.ravel(), np.inf]
    found = [part for pair in zip(ends[::2], ends[1::2], strict=True) if (part := _between(one, *pair))]
    longest = float(np.diff(silences).max())
    if not found:
        given = f"{one.name}: nothing is recorded for up to {longest:.3g} s, again and again"
        raise InvalidInput(
            f"{given}; allowed: {SHORTEST:g} s at least without {SILENT:g} s of silence: look at its times"
        )
    told = f"nothing is recorded for {longest:.3g} s at {silences[int(np.argmax(np.diff(silences))), 0]:.3g} s"
    known = (*one.known_doubts, ("times", f"{told}: lost, or a clock that was set? It is cut where it is silent"))
    return tuple(
        replace(part, name=f"{one.name} part {k}", known_doubts=known if k == 1 else one.known_doubts)
        for k, part in enumerate(found, start=1)
    )


def _silences(one: Recording) -> np.ndarray:
    """(n, 2) [s] from the last sample before each to the first after it."""
    t = np.unique(np.concatenate([channel.known_t for channel in one.channels.values()]))
    last = np.flatnonzero(np.diff(t) > SILENT)
    return np.column_stack([t[last], t[last + 1]])


def _between(one: Recording, begin: float, end: float) -> Recording | None:
    """From one time [s] to another, or none that is too short."""
    cut = {name: _cut(channel, begin, end) for name, channel in one.channels.items()}
    channels = {name: channel for name, channel in cut.items() if channel is not None}
    part = replace(one, channels=channels) if len(channels) == len(cut) else None
    return None if part is None or part.span[1] - part.span[0] < SHORTEST else part


def _cut(channel: Channel, begin: float, end: float) -> Channel | None:
    inside = (channel.known_t >= begin) & (channel.known_t <= end)
    return replace(channel, t=channel.t[inside], values=channel.values[inside]) if inside.sum() > 1 else None

"""Cut recordings at their silences: what was commanded while nothing was recorded is known to nobody.

A clock that is set while it records leaves a silence, too, as long as it was moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.recording import Recording

LONGEST_GAP = 2.0
"""[s] without a sample of any channel, from which on a recording is cut."""
SHORTEST = 5.0
"""[s] shortest part that is kept."""


def split_at_gaps(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Cut recordings into parts at their silences. Raises InvalidInput for one that has no part of
    `SHORTEST`.
    """
    parts: list[Recording] = []
    for recording in recordings:
        parts += _parts(recording)
    return tuple(parts)


def _parts(recording: Recording) -> list[Recording]:
    """Cut a recording at its silences, which the first part doubts; one whose channels have no time in
    common is left whole.
    """
    silences = _silences(recording)
    begin, end = recording.span
    if not len(silences) or begin >= end:
        return [recording]
    lengths = silences[:, 1] - silences[:, 0]
    longest = int(np.argmax(lengths))
    begins = [-np.inf, *silences[:, 1]]
    ends = [*silences[:, 0], np.inf]
    parts: list[Recording] = []
    for begin, end in zip(begins, ends, strict=True):
        part = _between(recording, begin, end)
        if part is not None:
            name = f"{recording.name} part {len(parts) + 1}"
            parts.append(replace(part, name=name, whole=recording.name))
    if not parts:
        problem = (
            f"{recording.name}: nothing is recorded for up to {lengths[longest]:.3g} s, again and"
            " again"
        )
        raise InvalidInput(
            f"{problem}; allowed: {SHORTEST:g} s at least without {LONGEST_GAP:g} s of silence: look"
            " at its times"
        )
    silence = f"nothing is recorded for {lengths[longest]:.3g} s at {silences[longest, 0]:.3g} s"
    issue = ("times", f"{silence}: lost, or a clock that was set? It is cut where it is silent")
    parts[0] = replace(parts[0], issues_in_file=(*recording.issues_in_file, issue))
    return parts


def _silences(recording: Recording) -> np.ndarray:
    """Return silences (n, 2) [s]: the last sample before each, and the first after it."""
    t = np.unique(np.concatenate([channel.undelayed_t for channel in recording.channels.values()]))
    last = np.flatnonzero(np.diff(t) > LONGEST_GAP)
    return np.column_stack([t[last], t[last + 1]])


def _between(recording: Recording, begin: float, end: float) -> Recording | None:
    """Cut a recording from one time [s] to another; `None` if that is too short."""
    channels = {}
    for name, channel in recording.channels.items():
        inside = (channel.undelayed_t >= begin) & (channel.undelayed_t <= end)
        if inside.sum() < 2:
            return None
        channels[name] = replace(channel, t=channel.t[inside], values=channel.values[inside])
    part = replace(recording, channels=channels)
    first, last = part.span
    if last - first < SHORTEST:
        return None
    return part

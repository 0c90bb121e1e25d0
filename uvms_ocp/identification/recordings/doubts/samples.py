"""What speaks against a channel by itself: its times, and values that no sensor and no vehicle has."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recordings.recording import KINDS, Channel, Recording
from uvms_ocp.identification.recordings.sampling import angular_rate, smoothed

WINDOW = 0.6
"""[s] over which rates are taken."""
DEAD = 1e-5
"""[unit] below which nothing that a sensor measures stays."""
MOVES = {"linear_velocity": 0.01, "angular_velocity": 0.01}
"""[m/s, rad/s] Less says nothing."""
_GAP, _BURST = 8.0, 0.5  # [-] of the usual interval; of the mean one
_OFTEN = 0.02  # [-] of all intervals, from which on gaps are what bursts leave
_SHORTEST, _LONGEST = 1e-5, 5.0  # [s] between samples, of any sensor
_SELDOM = ("current", *(name for name, kind in KINDS.items() if kind.command))
"""What may be told when it changes alone."""
_LEAST, _SPARSEST = 5.0, 100.0  # [s] of a recording; [-] of it over what its samples take up
_FASTEST = {
    "linear_velocity": (10.0, "mm/s"),
    "current": (10.0, "mm/s"),
    "angular_velocity": (4 * np.pi, "deg/s"),
    "joint_positions": (4 * np.pi, "deg"),
    "joint_velocities": (4 * np.pi, "deg/s"),
}
"""[unit] that no channel has for long, and the unit which it would be in."""
_FOR_LONG = 90.0  # [%] of samples below a peak


def of_samples(recording: Recording) -> Iterator[tuple[str, str]]:
    """Channels and what speaks against them."""
    for name, channel in recording.channels.items():
        yield from ((name, text) for check in (_times, _dead, _lost, _units) for text in check(name, channel))


def has_times(channel: Channel) -> bool:
    """Whether its times are such that rates can be taken."""
    usual, span = float(np.median(np.diff(channel.t))), channel.t[-1] - channel.t[0]
    return bool(_SHORTEST < usual < _LONGEST and _LEAST < span < _SPARSEST * usual * len(channel.t))


def of_poses(recording: Recording) -> Iterator[tuple[str, str]]:
    """Poses and what their rates say against them."""
    if "position" in recording.channels:
        channel = recording.channels["position"]
        _, rate = smoothed(channel.known_t, channel.values, WINDOW, derivative=1)
        yield from (("position", text) for text in _too_fast(rate, 10.0, "m/s", "mm"))
    if "attitude" in recording.channels:
        _, omega = angular_rate(recording.channels["attitude"], WINDOW)
        yield from (("attitude", text) for text in _too_fast(omega, 4 * np.pi, "rad/s", "deg, or of another format"))


def _times(name: str, channel: Channel) -> Iterator[str]:
    if channel.back > 0.0:
        yield f"times go back by up to {channel.back:.3g} s in the file: a clock that was set?"
    if channel.repeated > len(channel.t) / 10:
        yield f"{channel.repeated} samples had the time of another and are left out: times with too few digits?"
    steps = np.diff(channel.t)
    usual = float(np.median(steps))
    gaps = steps > max(_GAP * usual, WINDOW / 2)
    if name not in _SELDOM and not _SHORTEST < usual < _LONGEST:
        yield f"{usual:.3g} s between samples: the unit of its times?"
    elif usual < _BURST * steps.mean() and gaps.mean() > _OFTEN:
        yield f"arrives in bursts, half of the intervals below {usual:.3g} s at a mean of {steps.mean():.3g} s: sent_every?"
    elif gaps.any() and (name not in _SELDOM or np.percentile(steps, _FOR_LONG) < 2 * usual):
        at, n = channel.t[int(np.argmax(steps))], int(gaps.sum())
        yield f"{n} gaps, the longest {steps.max():.3g} s at {at:.3g} s: lost, or a clock that was set?"


def _dead(name: str, channel: Channel) -> Iterator[str]:
    kind, spread = KINDS[name], np.ptp(channel.values, axis=0)
    if kind.command:
        if spread.max() == 0.0 and channel.values.any():
            yield "dead: nothing in it ever changes"
        return
    if not kind.columns or name == "current":  # a joint may rest, and a current be steady
        return
    dead = [label for label, width in zip(kind.columns, spread, strict=True) if width < DEAD]
    if dead and (name != "attitude" or len(dead) == len(kind.columns)):  # whose numbers have no sensor each
        yield f"dead: {', '.join(dead)} stay within {DEAD:g} {kind.unit}"


def _lost(name: str, channel: Channel) -> Iterator[str]:
    """Zeros between samples that move."""
    size = np.linalg.norm(channel.values, axis=1)
    zero = size == 0.0
    if name not in MOVES or not zero.any() or zero.all():
        return
    moved, at = channel.t[~zero], channel.t[zero]
    at = at[(at > moved[0]) & (at < moved[-1])]  # before and after it may have been at rest
    lost = int((np.interp(at, moved, size[~zero]) > MOVES[name]).sum())
    if lost:
        yield f"{lost} of {len(channel.t)} samples are exactly zero: lost ones?"


def _units(name: str, channel: Channel) -> Iterator[str]:
    if name in _FASTEST:
        most, other = _FASTEST[name]
        yield from _too_fast(channel.values, most, KINDS[name].unit, other)


def _too_fast(values: np.ndarray, most: float, unit: str, other: str) -> Iterator[str]:
    usual = float(np.percentile(np.abs(values).max(axis=1), _FOR_LONG))
    if usual > most:
        yield f"up to {usual:.3g} {unit} for a tenth of the time: is it in {other}?"

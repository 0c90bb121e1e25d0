"""Check whether velocities are the rates of poses: axes, frames, units, clocks.

Axes are searched among all 48 ways to swap and turn them; others are reported where they explain
much more than the axes as they are, so that axes in which nothing moved raise no issue.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from uvms_ocp.identification import recording as recordings
from uvms_ocp.identification.gravity_checks import G
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import (
    GRID,
    angular_rate,
    interpolated,
    rotations,
    smoothed,
)
from uvms_ocp.identification.series_agreement import (
    DEAD,
    MOVES,
    WAYS,
    WINDOW,
    Offset,
    correlation,
    describe_delay,
    describe_factor,
    explained,
    named,
    offset,
)

_INSIDE = slice(round(WINDOW / GRID), -round(WINDOW / GRID))
"""Places of smoothed samples whose window lies inside the recording."""
_MIN_EXPLAINED = 0.5  # share of the motion that axes must explain to be named
_OF_AGREEMENT = 0.8  # share of the correlation of magnitudes that they must explain, too
_GAIN_OF_AXES = 0.15  # share of the motion by which other axes must explain more
_MARGIN = 0.03  # share of the motion by which axes must explain more where little speaks for them
_TILTED = 0.5  # mean cosine of the tilt below which no vehicle stays
_LEVEL = 0.9  # cosine of the tilt of a vehicle that is nearly level
_SAME_SIZE = 0.7  # correlation of magnitudes from which on two series are of the same motion
PARTNER = {
    "linear_velocity": "position",
    "angular_velocity": "attitude",
    "specific_force": "attitude",
}
"""Channels whose rate, or tilt, a channel must agree with, by the name of that channel."""
_READINGS = recordings.CHANNEL_TABLE["readings"]
"""Ways to read an attitude: names with the order and the signs of its numbers."""
_JUMP = (
    "its clock and that of the {} differ at the end by another time than at the beginning: a jump?"
)

_Agreement = dict[str, tuple[float, float]]
"""By channel: share of its motion that its reference explains with the axes as they are, and with the
axes that fit best.
"""


def of_rates(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about them; where the attitude is read wrong that doubt alone, as the
    others follow from it.
    """
    attitude_issues = list(_attitude_reading(recording))
    if attitude_issues:
        yield from attitude_issues
        return
    for name, reference in _references(recording):
        yield from _rate_issues(recording, name, reference)


def _attitude_reading(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield a way to read the attitude with which all channels agree better, which no other axes of
    these channels would reach.
    """
    attitude = recording.channels.get("attitude")
    if attitude is None:
        return
    agreement = _agreement(recording)
    readings = {}
    for reading, (order, signs) in _READINGS:
        readings[reading] = replace(attitude, values=attitude.values[:, order] * signs)
    # No vehicle is level for long by numbers in another order.
    if not agreement and _level(attitude) < _TILTED:
        for reading, channel in readings.items():
            if reading.startswith("format") and _level(channel) > _LEVEL:
                yield (
                    "attitude",
                    f"reads better with {reading}: it is level then, which it is not as it is",
                )
    if not agreement:
        return
    candidates = {}
    for reading, channel in readings.items():
        channels = {**recording.channels, "attitude": channel}
        candidates[reading] = _agreement(replace(recording, channels=channels))
    best_first = sorted(candidates, key=lambda reading: -_total_share(candidates[reading]))
    for reading in best_first:
        candidate = candidates[reading]
        if _agrees_better(candidate, agreement):
            shares = ", ".join(
                f"{100 * share:.0f} % of {name}" for name, (share, _) in candidate.items()
            )
            before = ", ".join(f"{100 * share:.0f} %" for share, _ in agreement.values())
            yield (
                "attitude",
                f"reads better with {reading}: it agrees with {shares}, and as it is with {before}",
            )
            return


def _total_share(agreement: _Agreement) -> float:
    """Sum the shares with the axes as they are."""
    return sum(share for share, _ in agreement.values())


def _agrees_better(candidate: _Agreement, present: _Agreement) -> bool:
    """Check that all channels agree with a candidate, none worse than at present, and that several
    agree better, or one better than by any axes of its channel.
    """
    shares = {name: candidate.get(name, (0.0, 0.0))[0] for name in present}
    gains = [shares[name] - share for name, (share, _) in present.items()]
    if min(shares.values()) <= _MIN_EXPLAINED or min(gains) <= -_MARGIN:
        return False
    n_better = sum(gain > _GAIN_OF_AXES for gain in gains)
    if n_better != 1:
        return n_better > 1
    for name, (_, share_with_best_axes) in present.items():
        if name in candidate and shares[name] <= share_with_best_axes + _MARGIN:
            return False
    return True


def _level(attitude: Channel) -> float:
    """Compute the mean cosine of the tilt."""
    return float(rotations(attitude, attitude.undelayed_t)[:, 2, 2].mean())


def _agreement(recording: Recording) -> _Agreement:
    """Compute the share of each channel's motion that its reference explains."""
    agreements = {}
    for name, reference in _references(recording):
        aligned = _aligned(recording, name, reference)
        if aligned is None:
            continue
        share = explained(aligned.values, reference.body)
        best_share = max(_ways(reference, aligned.values, name).values())
        agreements[name] = (share, best_share)
    return agreements


def _references(recording: Recording) -> Iterator[tuple[str, _Reference]]:
    """Yield the channels that can be checked, with the references that follow from other channels."""
    channels = recording.channels
    attitude = channels.get("attitude")
    if attitude is None:
        return
    if "angular_velocity" in channels:
        t, omega = angular_rate(attitude, WINDOW)
        t = t[_INSIDE]
        omega = omega[_INSIDE]
        R = rotations(attitude, t)
        yield "angular_velocity", _Reference(t, omega, np.einsum("nij,nj->ni", R, omega), R)
    if "specific_force" in channels:
        t, _ = smoothed(attitude.undelayed_t, attitude.values, WINDOW)
        t = t[_INSIDE]
        up = G * rotations(attitude, t)[:, 2]
        mean_force = channels["specific_force"].values.mean(axis=0)
        sign = np.sign(up.mean(axis=0) @ mean_force)  # where down is another matter
        yield "specific_force", _Reference(t, sign * (up - up.mean(axis=0)))
    if "linear_velocity" in channels and "position" in channels:
        position = channels["position"]
        t, rate = smoothed(position.undelayed_t, position.values, WINDOW, derivative=1)
        t = t[_INSIDE]
        rate = rate[_INSIDE]
        R = rotations(attitude, t)
        yield "linear_velocity", _Reference(t, np.einsum("nji,nj->ni", R, rate), rate, R)


@dataclass(frozen=True, slots=True, eq=False)
class _AlignedChannel:
    """A channel at the times of its reference, shifted and scaled to agree with it."""

    values: np.ndarray
    """(m, 3) [unit of the channel] values as shifted and scaled."""
    offset: Offset = field(default_factory=Offset)
    """Offset by which the channel was late."""
    factor: float = 1.0
    """Factor by which the channel was larger."""


def _aligned(recording: Recording, name: str, reference: _Reference) -> _AlignedChannel | None:
    """Align a channel to its reference; `None` where one of them does not move."""
    channel = recording.channels[name]
    is_dead = np.ptp(channel.values, axis=0).max() < DEAD
    if is_dead or reference.body.std(axis=0).max() < MOVES[name]:
        return None
    t, values = smoothed(channel.undelayed_t, channel.values, WINDOW)
    if name == "specific_force":  # whose mean is gravity
        deviations = values - values.mean(axis=0)
        return _AlignedChannel(interpolated(reference.t, t, deviations))
    found = offset(reference.t, reference.body, t, values)
    shifted = interpolated(reference.t + found.delay, t, values)
    factor = float(np.linalg.norm(shifted) / np.linalg.norm(reference.body))
    return _AlignedChannel(shifted / factor, found, factor)


def _rate_issues(
    recording: Recording, name: str, reference: _Reference
) -> Iterator[tuple[str, str]]:
    """Yield doubts about the clock, the unit and the axes of one channel."""
    aligned = _aligned(recording, name, reference)
    if aligned is None:
        return
    if name != "specific_force":
        if aligned.offset.is_constant:
            delay_text = describe_delay(aligned.offset)
        else:
            delay_text = _JUMP
        factor_text = describe_factor(reference.body, aligned.factor * aligned.values)
        for text in (delay_text, factor_text):
            if text:
                yield name, text.format(PARTNER[name])
    yield from _rate_axes(reference, aligned.values, name)


def _rate_axes(reference: _Reference, measured: np.ndarray, name: str) -> Iterator[tuple[str, str]]:
    """Yield other axes that explain more of the motion than the axes as they are."""
    present_share = explained(measured, reference.body)
    ways = _ways(reference, measured, name)
    best = max(ways, key=lambda way: ways[way])
    sizes = np.linalg.norm(measured, axis=1)
    agreement = correlation(sizes, np.linalg.norm(reference.body, axis=1))
    if ways[best] > max(present_share + _GAIN_OF_AXES, _MIN_EXPLAINED, _OF_AGREEMENT * agreement):
        channel, text = best
        yield (
            channel,
            f"{text} ({100 * ways[best]:.0f} % of it, {100 * present_share:.0f} % as they are)",
        )
        return
    if name != "linear_velocity" or agreement <= _SAME_SIZE:
        return
    if reference.R is None or reference.world is None:
        return
    turn, share = _turn(np.einsum("nij,nj->ni", reference.R, measured), reference.world)
    share_with_turn = share - _GAIN_OF_AXES if share > _MIN_EXPLAINED else 0.0
    if present_share < max(_MIN_EXPLAINED * agreement, share_with_turn):
        text = "with it the velocity is as large as the rate of the position, and points elsewhere"
        yield "attitude", f"{text}, by {np.rad2deg(turn):.0f} deg about z: format, axes, yaw?"


def _ways(reference: _Reference, measured: np.ndarray, name: str) -> dict[tuple[str, str], float]:
    """List ways to read axes, as a channel and a text, with the share of the motion that each
    explains.
    """
    motion = "tilt" if name == "specific_force" else "rate"
    shares = {}
    for Q in WAYS:
        text = f"its axes fit the {motion} of the {PARTNER[name]} as {named(Q)}"
        shares[name, text] = explained(measured @ Q.T, reference.body)
    return shares | _in_world(reference, measured, name)


def _turn(measured: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Compute the angle about z [rad] from expected (m, 3) to measured (m, 3), and the share that
    is explained without it.
    """
    plane = measured[:, 0] + 1j * measured[:, 1]
    expected_plane = expected[:, 0] + 1j * expected[:, 1]
    turn = float(np.angle(np.vdot(expected_plane, plane)))
    turned_plane = plane * np.exp(-1j * turn)
    turned = np.column_stack([turned_plane.real, turned_plane.imag, measured[:, 2]])
    return turn, explained(turned, expected)


def _in_world(
    reference: _Reference, measured: np.ndarray, name: str
) -> dict[tuple[str, str], float]:
    """List ways to read axes in which a world frame is involved, each with the share of the motion that
    it explains; the shares are lowered, as ways in B are likelier.
    """
    if reference.world is None or reference.R is None:
        return {}
    partner = PARTNER[name]
    world = reference.world
    shares = {}
    in_world = f"its axes fit the rate of the {partner} in W"
    shares[name, in_world] = explained(measured, world)
    if name == "linear_velocity":
        turned = np.einsum("nij,nj->ni", reference.R, measured)
        for Q in WAYS:
            text = (
                f"its rate fits the velocity with axes {named(Q)}: NED against ENU? give columns so"
            )
            shares[partner, text] = explained(turned, world @ Q.T)
    return {way: share - _GAIN_OF_AXES / 2 for way, share in shares.items()}


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """Series that a channel must agree with: the rate of its partner, or gravity by the attitude."""

    t: np.ndarray
    """(m,) [s] uniform times."""
    body: np.ndarray
    """(m, 3) [unit of the channel] series in B."""
    world: np.ndarray | None = None
    """(m, 3) [unit of the channel] series in W."""
    R: np.ndarray | None = None
    """(m, 3, 3) rotations from B to W."""

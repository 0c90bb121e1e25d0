"""Check whether velocities are the rates of poses: axes, frames, units, clocks.

Axes are searched among all 48 ways to swap and turn them; others are reported where they explain
much more than the axes as they are, so that axes in which nothing moved raise no issue.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

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
    EXPLAINED,
    MOVES,
    WAYS,
    WINDOW,
    correlation,
    describe_delay,
    describe_factor,
    explained,
    named,
    offset,
)

_INSIDE = slice(round(WINDOW / GRID), -round(WINDOW / GRID))
"""Smoothed samples whose window is whole."""
# of the motion that a way to read axes must explain: at least, and as magnitudes agree
_HALF = 0.5
_MOST = 0.8
_EVEN = 0.03  # by which one way must explain more than another where little speaks for it
_LEVEL = 0.9  # cosine of tilt of a vehicle that is level, or nearly
_AS_LARGE = 0.7  # correlation of magnitudes from which on two things are the same
PARTNER = {
    "linear_velocity": "position",
    "angular_velocity": "attitude",
    "specific_force": "attitude",
}
"""Channel whose rate, or tilt, each channel must agree with."""
_READINGS = recordings.CHANNEL_TABLE["readings"]
"""Other ways to read an attitude: places and signs of its numbers."""
_JUMP = (
    "its clock and that of the {} differ at the end by another time than at the beginning: a jump?"
)

_Agreement = dict[str, tuple[float, float]]
"""Share of each channel's motion that its reference explains with the axes as they are, and with
those that fit best.
"""


def of_rates(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about them; of an attitude that is read wrong that doubt alone, as
    all others follow from it.
    """
    attitude_issues = list(_other_attitude(recording))
    if attitude_issues:
        yield from attitude_issues
        return
    for name, reference in _references(recording):
        yield from _rate_issues(recording, name, reference)


def _other_attitude(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield another way to read the attitude, with which all that depends on it agrees better, and
    other axes alone would not.
    """
    attitude = recording.channels.get("attitude")
    if attitude is None:
        return
    agreement = _agreement(recording)
    readings = {}
    for reading, (order, signs) in _READINGS:
        readings[reading] = replace(attitude, values=attitude.values[:, order] * signs)
    # No vehicle is level for long by numbers in another order.
    if not agreement and _level(attitude) < _HALF:
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
    return sum(share for share, _ in agreement.values())


def _agrees_better(candidate: _Agreement, present: _Agreement) -> bool:
    """Check that all channels agree with another attitude, none worse than now, and that several
    agree better, or more than other axes alone could make them.
    """
    shares = {name: candidate.get(name, (0.0, 0.0))[0] for name in present}
    gains = [shares[name] - share for name, (share, _) in present.items()]
    if min(shares.values()) <= _HALF or min(gains) <= -_EVEN:
        return False
    n_better = sum(gain > EXPLAINED for gain in gains)
    if n_better != 1:
        return n_better > 1
    for name, (_, share_with_other_axes) in present.items():
        if name in candidate and shares[name] <= share_with_other_axes + _EVEN:
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
    """Yield the channels that other channels tell something of, with what they tell."""
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
    """(m, 3) [unit of the channel]"""
    delay: float = 0.0
    """[s] by which it was late."""
    has_constant_delay: bool = True
    factor: float = 1.0
    """By which it was larger."""


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
    delay, is_constant = offset(reference.t, reference.body, t, values)
    shifted = interpolated(reference.t + delay, t, values)
    factor = float(np.linalg.norm(shifted) / np.linalg.norm(reference.body))
    return _AlignedChannel(shifted / factor, delay, is_constant, factor)


def _rate_issues(
    recording: Recording, name: str, reference: _Reference
) -> Iterator[tuple[str, str]]:
    """Yield doubts about the clock, the unit and the axes of one channel."""
    aligned = _aligned(recording, name, reference)
    if aligned is None:
        return
    if name != "specific_force":
        if aligned.has_constant_delay:
            delay_text = describe_delay(aligned.delay)
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
    if ways[best] > max(present_share + EXPLAINED, _HALF, _MOST * agreement):
        channel, text = best
        yield (
            channel,
            f"{text} ({100 * ways[best]:.0f} % of it, {100 * present_share:.0f} % as they are)",
        )
        return
    if name != "linear_velocity" or agreement <= _AS_LARGE:
        return
    if reference.R is None or reference.world is None:
        return
    turn, share = _turn(np.einsum("nij,nj->ni", reference.R, measured), reference.world)
    share_with_turn = share - EXPLAINED if share > _HALF else 0.0
    if present_share < max(_HALF * agreement, share_with_turn):
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
    """List ways of which a world frame alone tells; less likely than those of B, where both will
    do.
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
    return {way: share - EXPLAINED / 2 for way, share in shares.items()}


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """What a channel must agree with: the rate of its partner, or gravity by the attitude."""

    t: np.ndarray
    """(m,) [s] uniform times."""
    body: np.ndarray
    """(m, 3) [unit of the channel] in B."""
    world: np.ndarray | None = None
    """(m, 3) [unit of the channel] in W."""
    R: np.ndarray | None = None
    """(m, 3, 3) from B to W."""

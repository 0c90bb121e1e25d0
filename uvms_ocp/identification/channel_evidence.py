"""List what the reading of each channel rests on: what is *known*, as the file or a mapping states it;
what is *shown*, as other channels agree with it, by how much; and what is *assumed*.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from typing import Literal

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.identification.command_lags import measured_lag
from uvms_ocp.identification.data_quality import QualityIssue, check_data_quality
from uvms_ocp.identification.explained_motion import commands_and_motion
from uvms_ocp.identification.gravity_checks import G
from uvms_ocp.identification.mounting_checks import estimated_mounting
from uvms_ocp.identification.recording import ASPECTS, CHANNEL_KINDS, Recording
from uvms_ocp.identification.turning_checks import estimated_gyro_mounting

_MIN_SHARE = 0.8  # of a motion that is explained, from which on it shows anything
_NEAR_G = (0.9, 1.1)  # shares of G that show the unit of an accelerometer
_VERTICAL = 0.9  # share of the mean force along z that shows its vertical axis
_SAME = {
    "source": "the columns that are named, taken for this channel",
    "unit": "that of the channel",
    "axes": "those of the channel, in its order",
    "time": "s, of one clock with the other channels",
    "delay": "none",
    "offset": "none, no scale either",
}
"""What is assumed of each aspect where nothing is stated."""

_Shown = Mapping[tuple[str, str], str]
"""Evidence by channel and aspect."""


@checked_dataclass()
class Evidence:
    """What one aspect of a channel's reading rests on."""

    channel: str
    """Name of the channel, as in `CHANNEL_KINDS`."""
    aspect: str
    """One of `uvms_ocp.identification.recording.ASPECTS`."""
    status: Literal["known", "shown", "assumed"]
    """``known`` from the file or the mapping, ``shown`` by other channels, else ``assumed``."""
    evidence: str
    """What states it, what shows it and how well, or what is assumed."""


@checked
def channel_evidence(
    recording: Recording, issues: Sequence[QualityIssue] | None = None
) -> tuple[Evidence, ...]:
    """List for each channel of a recording what each aspect of its reading rests on.

    issues: doubts about the recording, where they are known already. What a doubt is about is not
    shown, whatever agrees with it.
    """
    if issues is None:
        issues = check_data_quality(recording)
    doubted = {issue.channel for issue in issues}
    shown = dict(_shown(recording, doubted))
    rows = []
    for name in recording.channels:
        stated = recording.stated.get(name, {})
        for aspect in ASPECTS:
            status: Literal["known", "shown", "assumed"]
            if aspect in stated:
                status = "known"
                text = stated[aspect]
            elif (name, aspect) in shown and name not in doubted:
                status = "shown"
                text = shown[name, aspect]
            else:
                status = "assumed"
                text = _SAME[aspect]
                if aspect == "unit" and CHANNEL_KINDS[name].unit:
                    text = CHANNEL_KINDS[name].unit
                if name in doubted:
                    text = f"{text}; the channel is doubted"
            rows.append(Evidence(channel=name, aspect=aspect, status=status, evidence=text))
    return tuple(rows)


def _shown(recording: Recording, doubted: Set[str]) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield what channels show of each other; a doubted one shows nothing of others."""
    if not doubted & {"position", "linear_velocity", "attitude"}:
        yield from _by_velocity(recording)
    if not doubted & {"attitude", "angular_velocity"}:
        yield from _by_gyro(recording)
    if not doubted & {"attitude", "linear_velocity", "angular_velocity"}:
        yield from _by_motion(recording)
    force = recording.channels.get("specific_force")
    if force is not None:
        size = float(np.median(np.linalg.norm(force.values, axis=1)))
        if _NEAR_G[0] < size / G < _NEAR_G[1]:
            yield ("specific_force", "unit"), f"{size:.3g} m/s2 in the median, as at rest"
        mean = force.values.mean(axis=0)
        if mean[2] > _VERTICAL * np.linalg.norm(mean):
            share = mean[2] / np.linalg.norm(mean)
            yield ("specific_force", "axes"), f"z: {100 * share:.0f} % of its mean points up"


def _by_velocity(recording: Recording) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield what position, velocity and attitude show of each other."""
    needed = ("position", "linear_velocity", "attitude")
    if not set(needed) <= recording.channels.keys():
        return
    if any(recording.channels[name].constants for name in needed):
        return
    mounting = estimated_mounting(recording)
    if mounting is None or mounting.share < _MIN_SHARE:
        return
    share = f"{100 * mounting.share:.1f} % of the ways of two seconds explained"
    factor = f"{mounting.scale:.3f} +- {mounting.scale_sigma:.3f}"
    scale = f"the velocity reads {factor} times the way of the position, but for an error that both have"
    turn = _angles(mounting.turn, mounting.turn_sigma)
    axes = (
        f"the axes of the velocity are turned by {turn} deg against those by position and attitude"
    )
    for name in needed:
        if name != "attitude":
            yield (name, "unit"), f"{scale}; {share}"
        yield (name, "axes"), f"{axes}; {share}"
        yield (name, "time"), share


def _by_gyro(recording: Recording) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield what gyro and attitude show of each other."""
    if not {"attitude", "angular_velocity"} <= recording.channels.keys():
        return
    if any(recording.channels[name].constants for name in ("attitude", "angular_velocity")):
        return
    mounting = estimated_gyro_mounting(recording)
    if mounting is None or mounting.share < _MIN_SHARE:
        return
    share = f"{100 * mounting.share:.1f} % of the turns of a second explained"
    factor = f"{mounting.scale:.3f} +- {mounting.scale_sigma:.3f}"
    scale = f"the gyro reads {factor} times the turns of the attitude"
    turn = _angles(mounting.turn, mounting.turn_sigma)
    axes = f"the axes of the gyro are turned by {turn} deg against those of the attitude"
    biases = []
    for axis, bias, sigma in zip("xyz", mounting.bias, mounting.bias_sigma, strict=True):
        biases.append(f"{axis} {bias:.4f} +- {sigma:.4f}")
    delay = f"{mounting.delay:.3f} +- {mounting.delay_sigma:.3f} s against the attitude"
    yield ("angular_velocity", "unit"), f"{scale}; {share}"
    yield ("angular_velocity", "offset"), f"bias of {', '.join(biases)} rad/s"
    yield ("angular_velocity", "delay"), delay
    for name in ("angular_velocity", "attitude"):
        yield (name, "axes"), f"{axes}; {share}"
        yield (name, "time"), share


def _by_motion(recording: Recording) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield what the motion shows of the times of commands."""
    for name, held, motion in commands_and_motion(recording):
        measured = measured_lag(held, motion, signed=name == "wrench")
        if measured is not None:
            yield (
                (name, "delay"),
                (
                    f"the vehicle accelerates {measured.lag:.3f} +- {measured.sigma:.3f} s after it, the"
                    f" lag of actuators included; {100 * measured.share:.0f} % of what drag leaves"
                    " explained"
                ),
            )


def _angles(turn: Sequence[float] | np.ndarray, sigma: Sequence[float] | np.ndarray) -> str:
    """Write a rotation vector (3,) [rad] with standard errors (3,) [rad] in degrees."""
    parts = []
    for axis, angle, error in zip("xyz", np.rad2deg(turn), np.rad2deg(sigma), strict=True):
        parts.append(f"{axis} {angle:.1f} +- {error:.1f}")
    return ", ".join(parts)

"""All that the monitor knows, as layouts that kernels work on: one part per channel, and what channels share."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.control.navigation.filter.memory import N_CHANNELS
from uvms_ocp.control.navigation.health.laws.disagreement import (
    DepthAgainstPosition,
    RateAgainstAttitude,
    VelocityAgainstPosition,
)
from uvms_ocp.control.navigation.health.laws.floor_watch import FloorWatch
from uvms_ocp.control.navigation.health.laws.history import Estimate, History
from uvms_ocp.control.navigation.health.laws.plausible import Gate
from uvms_ocp.control.navigation.health.laws.repeats import Repeats
from uvms_ocp.control.navigation.health.laws.still_encoders import StillEncoders
from uvms_ocp.control.navigation.health.reasons import Why
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector

N_ESTIMATES = 1024
"""[-] that are remembered: five seconds of ticks of 5 ms; shorter ticks are not all kept."""


class ChannelMemory(Layout):
    """The newest reading of one channel, the last that was used, and a verdict with its reason."""

    # What is set once.
    number: int
    """`Channel`"""
    present: bool
    size: int
    """[-] numbers of its value."""
    delay: float
    """[s]"""
    period: float
    """[s] between two readings, 0 for once per tick."""
    losses: float
    """[-] readings in a row that are lost by chance."""
    rival: int
    """A channel that may be why the estimate does not agree with this one, -1 for none."""
    other_rival: int
    """Another one."""
    gate: Gate
    # The newest reading.
    fresh: bool
    """Whether there is one since the last tick."""
    misshapen: int
    """Number of the text of its wrong shape, 0 where that is right."""
    stamp: float
    """[s] when it was taken."""
    value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] of which `size` numbers count."""
    # What is remembered.
    seen: float
    """[s] stamp of the last reading that was looked at."""
    started: bool
    """Whether there was one."""
    behind: bool
    """The filter sees an older reading."""
    used: float
    """[s] stamp of the reading that the filter sees, -inf before the first."""
    used_value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] its value."""
    taken: float
    """[s] when the last reading was taken that the estimate rests on, nan before the first."""
    used_at: float
    """[s] when it arrived; before the first, when the run began."""
    refused_at: float
    """[s] when a reading was last refused, by whomever."""
    impossible_at: float
    """[s] when one was last refused before the filter saw it: one that could not be, whatever else is wrong."""
    bad_at: float
    """[s] when something last spoke against the channel."""
    barred_until: float
    """[s] when its readings may be used again."""
    heard: float
    """[s] stamp of the last reading whose outcome was heard."""
    agreed: int
    """[-] readings in a row that agreed with the estimate."""
    off_in_a_row: int
    """[-] readings in a row that did not."""
    empty: bool
    """The sensor works but has nothing to tell."""
    gated: bool
    """The filter has a gate of its own for it."""
    complaint: Why
    refusal: Why
    """What the filter's gate last said."""
    trust: int
    """`Trust`"""
    changed: bool
    """Whether the verdict did, in the last tick."""
    repeats: Repeats


class Rules(Layout):
    """Of `HealthTuning`, what the verdict on any channel takes."""

    periods_to_suspect: float
    """[-]"""
    periods_to_lose: float
    """[-]"""
    least_to_suspect: float
    """[s]"""
    least_to_lose: float
    """[s]"""
    clean: float
    """[s]"""
    clock: float
    """[s]"""
    late: float
    """[s]"""
    too_late: float
    """[s]"""


class Belief(Layout):
    """What to do with a reading."""

    used: bool
    """Whether it is passed on."""
    sane: bool
    """Whether what speaks against it is the estimate alone, if anything."""
    why: Why
    """What does."""


class HealthMemory(Layout):
    """All of it."""

    n: int
    """[-] channels that the robot has."""
    order: Annotated[list[int], Sized(N_CHANNELS)]
    """(9,) [-] their numbers, in the order of `Readings`."""
    rules: Rules
    started: bool
    t: float
    """[s] of the tick."""
    dt: float
    """[s]"""
    n_behind: int
    """[-] channels that the filter sees an older reading of than the newest."""
    exposed: bool
    """What told the velocity has been found out in this tick."""
    adrift: bool
    """Nothing has told it for too long, by this tick."""
    adrift_at: float
    """[s] when that was so last, 0 before."""
    now: Estimate
    history: History
    belief: Belief
    channels: Annotated[list[ChannelMemory], Sized(N_CHANNELS)]
    """By `Channel`."""
    encoders: StillEncoders
    floor: FloorWatch
    velocity: VelocityAgainstPosition
    rate: RateAgainstAttitude
    depth: DepthAgainstPosition

"""Degraded modes: what the controller may do without some channels, as one table and the
restriction of a tick.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Annotated, Any

import tomllib

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.signals import SAME_TIME, ChannelHealth, Trust

ALTIMETER = "altimeter_range"
ENCODERS = "joint_positions"
JOINT_RATES = "joint_velocities"

_TABLE = tomllib.loads(
    (files("uvms_ocp.estimation") / "degraded_modes.toml").read_text(encoding="utf-8")
)

_N_CHANNELS = len(CHANNELS)
_ATTITUDE = CHANNELS.index("attitude")
_FLAGS = ("no_descent", "joints_held", "hold", "blind", "attitude_open", "can_ascend")


@dataclass(frozen=True, kw_only=True, slots=True)
class ModeLimits:
    """Limits on the controller while some channels are lost, or suspect."""

    speed: float = 1.0
    """More than 0; share of what the tasks and limits make it otherwise."""
    no_descent: bool = False
    """The robot does not sink, landing is off; tasks on altitude take the floor for higher, the
    farther the robot has moved.
    """
    joints_held: bool = False
    """The arm stops, its brakes lock."""
    hold: bool = False
    """The robot comes to rest; the mission waits."""
    blind: bool = False
    """Without feedback of the vehicle's velocity."""
    attitude_open: bool = False
    """The attitude may be off by any angle: the vehicle is taken for level, its turns are damped
    alone, and the rest is left to its righting moment.
    """
    feedback: float = 1.0
    """More than 0; share of the usual bandwidth of the velocity loop: a late velocity allows
    less.
    """
    joint_feedback: float = 1.0
    """More than 0; share of the usual bandwidth of the velocity loops of joints whose rates no
    sensor of their own tells.
    """
    can_ascend: bool = True
    """The state allows the abort phase; otherwise the thrust is cut."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DegradedMode(ModeLimits):
    """Limits on the controller without some channels."""

    without: frozenset[str]
    """Channels that are lost or suspect, fields of `Readings`."""
    trust: Trust
    """Trust from which on it applies; what is lost is suspect too."""
    substitute: str
    """Source of that part of the state meanwhile."""
    max_duration: float = math.inf
    """[s] after which the mission is given up."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Restriction(ModeLimits):
    """Restriction by all modes that apply at a tick: the smallest of their shares, and all that any
    of them forbids.
    """

    abort: str = ""
    """Reason why the mission cannot go on; empty where it can."""
    bad: tuple[ChannelHealth, ...] = ()
    """Channels that are not good: what rests on them ends no phase."""

    @property
    def lost(self) -> tuple[ChannelHealth, ...]:
        """Channels that are lost."""
        return tuple(item for item in self.bad if item.trust is Trust.LOST)


FREE = Restriction()
"""Restriction of a robot whose channels are all good, or not monitored."""


def _mode(row: dict[str, Any]) -> DegradedMode:
    """Read a row of the table of modes."""
    channels = frozenset(row["without"])
    return DegradedMode(**row | {"without": channels, "trust": Trust[row["trust"]]})


DEGRADED_MODES = tuple(_mode(row) for row in _TABLE["modes"])
"""Modes of the table; depth and joint velocities are not in it alone, as other channels replace
them.
"""
_N_MODES = len(DEGRADED_MODES)


def degraded_channels(health: Sequence[ChannelHealth]) -> list[ChannelHealth]:
    """Return the channels that are not good."""
    return [item for item in health if item.trust is not Trust.GOOD]


class RestrictionMemory(Layout):
    """`DEGRADED_MODES`, how far each of `CHANNELS` can be trusted, and what applies."""

    needs: Annotated[list[list[int]], Sized(_N_MODES, _N_CHANNELS)]
    """(n_modes, n_channels) 1 for the channels that each mode is without."""
    trust: Annotated[list[int], Sized(_N_MODES)]
    """(n_modes,) `Trust` in these channels from which on each mode applies."""
    mode_speed: Annotated[Vector, Sized(_N_MODES)]
    """(n_modes,) share of the usual speed in each mode."""
    mode_feedback: Annotated[Vector, Sized(_N_MODES)]
    """(n_modes,) share of the usual bandwidth of the vehicle's velocity loop in each mode."""
    mode_joint_feedback: Annotated[Vector, Sized(_N_MODES)]
    """(n_modes,) share of the usual bandwidth of the joints' velocity loops in each mode."""
    max_duration: Annotated[Vector, Sized(_N_MODES)]
    """(n_modes,) [s] time in a mode after which the mission is given up."""
    flags: Annotated[list[list[int]], Sized(_N_MODES, len(_FLAGS))]
    """(n_modes, 6) consequences of each mode: no descent, joints held, hold, blind, attitude open,
    climbs.
    """
    of_altitude: Annotated[list[int], Sized(_N_MODES)]
    """(n_modes,) 1 for modes without the altimeter alone."""

    level: Annotated[list[int], Sized(_N_CHANNELS)]
    """(n_channels,) `Trust` in each channel."""
    since: Annotated[Vector, Sized(_N_CHANNELS)]
    """(n_channels,) [s] time since when it has been that."""

    speed: float
    """Share of the usual speed that all modes leave."""
    feedback: float
    joint_feedback: float
    no_descent: bool
    joints_held: bool
    hold: bool
    blind: bool
    attitude_open: bool
    open_until: float
    """[s] time after which an open attitude ends the mission, whatever mode still applies."""
    can_ascend: bool
    any_bad: bool
    """Some channel is not good."""
    any_lost: bool
    """Some channel is lost."""
    ended: bool
    """The mission cannot go on."""
    at_fault: Annotated[list[int], Sized(_N_CHANNELS)]
    """(n_channels,) 1 for channels that end the mission."""


def restrict(restriction: RestrictionMemory, t: float, altitude_matters: bool) -> None:
    """Combine all modes that apply at t [s] to the channels in the memory. A kernel.

    An attitude that was open is so until it is good again: what it was believed to be meanwhile may
    be any. It ends the mission as soon as the mode would have that opened it.
    """
    was_open = restriction.attitude_open
    if not was_open:
        restriction.open_until = math.inf
    _nothing(restriction)
    for c in range(len(restriction.level)):
        restriction.at_fault[c] = False
        restriction.any_bad = restriction.any_bad or restriction.level[c] != Trust.GOOD
        restriction.any_lost = restriction.any_lost or restriction.level[c] == Trust.LOST
    for k in range(len(restriction.trust)):
        if restriction.any_bad and _applies(restriction, k):
            _apply(restriction, k, t, altitude_matters)
    if was_open and restriction.level[_ATTITUDE] != Trust.GOOD:
        restriction.attitude_open = True
        restriction.hold = True
        if t > restriction.open_until + SAME_TIME:
            restriction.ended = True
            restriction.at_fault[_ATTITUDE] = True


def _nothing(restriction: RestrictionMemory) -> None:
    restriction.speed = restriction.feedback = restriction.joint_feedback = 1.0
    restriction.can_ascend = True
    restriction.no_descent = restriction.joints_held = restriction.hold = restriction.blind = (
        restriction.attitude_open
    ) = restriction.ended = restriction.any_bad = restriction.any_lost = False


def _applies(restriction: RestrictionMemory, k: int) -> bool:
    needs = restriction.needs[k]
    applies = True
    for c in range(len(restriction.level)):
        applies = applies and (needs[c] == 0 or restriction.level[c] >= restriction.trust[k])
    return applies


def _apply(restriction: RestrictionMemory, k: int, t: float, altitude_matters: bool) -> None:
    needs = restriction.needs[k]
    flags = restriction.flags[k]
    since = -math.inf
    restriction.speed = min(restriction.speed, restriction.mode_speed[k])
    restriction.feedback = min(restriction.feedback, restriction.mode_feedback[k])
    restriction.joint_feedback = min(restriction.joint_feedback, restriction.mode_joint_feedback[k])
    restriction.no_descent = restriction.no_descent or flags[0] != 0
    restriction.joints_held = restriction.joints_held or flags[1] != 0
    restriction.hold = restriction.hold or flags[2] != 0
    restriction.blind = restriction.blind or flags[3] != 0
    restriction.attitude_open = restriction.attitude_open or flags[4] != 0
    restriction.can_ascend = restriction.can_ascend and flags[5] != 0
    for c in range(len(restriction.level)):
        if needs[c] != 0:
            since = max(since, restriction.since[c])
    if flags[4] != 0:
        restriction.open_until = min(restriction.open_until, since + restriction.max_duration[k])
    if t - since > restriction.max_duration[k] + SAME_TIME and (
        altitude_matters or restriction.of_altitude[k] == 0
    ):
        restriction.ended = True
        for c in range(len(restriction.level)):
            if needs[c] != 0:
                restriction.at_fault[c] = True


def write_modes(memory: RestrictionMemory) -> None:
    """Write `DEGRADED_MODES` into a `RestrictionMemory`."""
    for k, mode in enumerate(DEGRADED_MODES):
        memory.trust[k] = mode.trust
        memory.mode_speed[k] = mode.speed
        memory.mode_feedback[k] = mode.feedback
        memory.mode_joint_feedback[k] = mode.joint_feedback
        memory.max_duration[k] = mode.max_duration
        memory.of_altitude[k] = mode.without == {ALTIMETER}
        for c, channel in enumerate(CHANNELS):
            memory.needs[k][c] = channel in mode.without
        for i, name in enumerate(_FLAGS):
            memory.flags[k][i] = getattr(mode, name)
    memory.speed = 1.0
    memory.feedback = 1.0
    memory.joint_feedback = 1.0
    memory.can_ascend = True


def write_trust(level: Any, since: Any, health: Sequence[ChannelHealth]) -> None:
    """Write the trust in each of `CHANNELS`, and since when [s] it is as it is; channels that are not
    in `health` are good.
    """
    health_of = {item.channel: item for item in health}
    for c, channel in enumerate(CHANNELS):
        level[c] = Trust.GOOD
        since[c] = 0.0
        if channel in health_of:
            level[c] = health_of[channel].trust
            since[c] = health_of[channel].since


def read_restriction(memory: RestrictionMemory, bad: Sequence[ChannelHealth]) -> Restriction:
    """Read the restriction that `restrict` has found."""
    if not bad:
        return FREE
    at_fault = list[ChannelHealth]()
    for item in sorted(bad, key=lambda item: item.channel):
        if item.channel in CHANNELS and memory.at_fault[CHANNELS.index(item.channel)]:
            at_fault.append(item)
    return Restriction(
        speed=memory.speed,
        feedback=memory.feedback,
        joint_feedback=memory.joint_feedback,
        no_descent=bool(memory.no_descent),
        joints_held=bool(memory.joints_held),
        hold=bool(memory.hold),
        blind=bool(memory.blind),
        attitude_open=bool(memory.attitude_open),
        can_ascend=bool(memory.can_ascend),
        abort=describe_channels(at_fault),
        bad=tuple(bad),
    )


def describe_channels(channels: Iterable[ChannelHealth]) -> str:
    """Describe channels that are not good, in a few words each."""
    texts = list[str]()
    for item in channels:
        reason = f": {item.why}" if item.why else ""
        trust = item.trust.name.lower()
        texts.append(f"{item.channel} {trust}{reason} since {item.since:.1f} s")
    return ", ".join(texts)

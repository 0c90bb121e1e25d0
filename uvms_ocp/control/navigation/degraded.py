"""What the controller does without a sensor: one table, by what can still be known, and what it comes to at one tick."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

from uvms_ocp.model.health import ChannelHealth, Trust

ALTIMETER, ENCODERS = "altimeter_range", "joint_positions"
_GOOD = Trust.GOOD
_SLOW = 0.5
_SOFT = 0.25  # of Case 1 without DVL: at 1 it runs away, at 0.5 it swings by 0.4 m, at 0.25 by less than 0.1 m


@dataclass(frozen=True, kw_only=True, slots=True)
class Mode:
    """What is done while some channels are lost, or suspect."""

    without: frozenset[str]
    """All of them, fields of `Readings`."""
    trust: Trust = Trust.LOST
    """From which on; what is lost is suspect too."""
    known: str
    """By what their part is still known."""
    speed: float = 1.0
    """[-] more than 0; share of what the tasks and limits make it otherwise."""
    no_descent: bool = False
    """Nothing sinks, landing is off; tasks on altitude take the floor for higher, the farther the robot has moved."""
    joints_held: bool = False
    """The arm stops, its brakes lock."""
    hold: bool = False
    """The robot comes to rest; the mission waits."""
    blind: bool = False
    """Without feedback of the vehicle's velocity."""
    feedback: float = 1.0
    """[-] more than 0; share of the usual bandwidth of the velocity loop: a velocity that is known late bears less."""
    bears: float = math.inf
    """[s] after which the mission is given up."""
    climbs: bool = True
    """Enough is known for the abort phase; otherwise the thrust is cut."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Restriction:
    """All modes that apply at one tick, as one."""

    speed: float = 1.0
    """[-] as that of `Mode`."""
    no_descent: bool = False
    joints_held: bool = False
    hold: bool = False
    blind: bool = False
    feedback: float = 1.0
    """[-] as that of `Mode`."""
    climbs: bool = True
    """As the fields of `Mode`."""
    abort: str = ""
    """Why the mission cannot go on, or nothing."""
    bad: tuple[ChannelHealth, ...] = ()
    """Channels that are not good: what rests on them ends no phase."""

    @property
    def doubted(self) -> frozenset[str]:
        """Their names."""
        return frozenset(item.channel for item in self.bad)

    @property
    def lost(self) -> tuple[ChannelHealth, ...]:
        """Those that are lost."""
        return tuple(item for item in self.bad if item.trust is Trust.LOST)


FREE = Restriction()
"""Of a robot whose channels are all good, or that nobody judges."""


def _mode(*without: str, **what: object) -> Mode:
    return Mode(without=frozenset(without), **what)  # type: ignore[arg-type]


_VEHICLE = ("position", "attitude", "linear_velocity", "angular_velocity")

MODES = (
    _mode(ALTIMETER, trust=Trust.SUSPECT, known="the last floor", no_descent=True),
    _mode(ALTIMETER, known="the last floor", no_descent=True, bears=5.0),
    _mode("position", trust=Trust.SUSPECT, known="velocity, integrated", speed=_SLOW),
    _mode("position", known="velocity, integrated", speed=_SLOW, no_descent=True, bears=30.0),
    _mode("position", "depth", known="velocity, integrated", bears=10.0),
    _mode("linear_velocity", trust=Trust.SUSPECT, known="the change of position", speed=_SLOW, feedback=_SOFT),
    _mode("angular_velocity", trust=Trust.SUSPECT, known="the change of attitude", speed=_SLOW),
    _mode("attitude", trust=Trust.SUSPECT, known="angular velocity, integrated", speed=_SLOW),
    _mode("attitude", known="angular velocity, integrated", hold=True, bears=10.0, climbs=False),
    _mode(ENCODERS, trust=Trust.SUSPECT, known="commands, integrated", speed=_SLOW),
    _mode(ENCODERS, known="where the brakes hold the arm", joints_held=True, bears=10.0),
    *(
        _mode(*pair, known="too little", hold=True, blind=True, bears=3.0, climbs=False)
        for pair in combinations(_VEHICLE, 2)
    ),
)
"""Depth and joint velocities are not in it alone: others tell the same."""


def bad_of(health: Sequence[ChannelHealth]) -> list[ChannelHealth]:
    """Channels that are not good."""
    return [item for item in health if item.trust is not _GOOD]


def restriction_of(health: Sequence[ChannelHealth], t: float, *, altitude_matters: bool = True) -> Restriction:
    """What applies at time t [s]; `FREE` where nobody judges.

    altitude_matters: some task on altitude is on. Without, a mission goes on without altimeter.
    """
    bad = {item.channel: item for item in bad_of(health)}
    if not bad:
        return FREE
    modes = [mode for mode in MODES if all(c in bad and bad[c].trust >= mode.trust for c in mode.without)]
    over = [mode for mode in modes if _is_over(mode, bad, t) and (altitude_matters or mode.without != {ALTIMETER})]
    return Restriction(
        speed=min((mode.speed for mode in modes), default=1.0),
        no_descent=any(mode.no_descent for mode in modes),
        joints_held=any(mode.joints_held for mode in modes),
        hold=any(mode.hold for mode in modes),
        blind=any(mode.blind for mode in modes),
        feedback=min((mode.feedback for mode in modes), default=1.0),
        climbs=all(mode.climbs for mode in modes),
        abort=told(_all_of(over, bad)),
        bad=tuple(bad.values()),
    )


def _is_over(mode: Mode, bad: dict[str, ChannelHealth], t: float) -> bool:
    return t - max(bad[name].since for name in mode.without) > mode.bears


def _all_of(modes: Iterable[Mode], bad: dict[str, ChannelHealth]) -> list[ChannelHealth]:
    return [bad[name] for name in sorted({name for mode in modes for name in mode.without})]


def told(channels: Iterable[ChannelHealth]) -> str:
    """A few words on each of some channels that are not good."""
    return ", ".join(f"{_complaint(item)} since {item.since:.1f} s" for item in channels)


def _complaint(item: ChannelHealth) -> str:
    return f"{item.channel} {item.trust.name.lower()}{': ' if item.why else ''}{item.why}"

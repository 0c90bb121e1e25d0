"""Thrusters that do not give what they are asked, found in the residual wrench and named, as kernels.

The residual wrench is what the disturbance observer finds beyond model and commands. A thruster is faulty once its
asked thrust has explained nearly all changes of it, and no other thruster as well, look after look.
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.control.actuator_health.blame import BlameWindow, find_culprit, take_in_look
from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.manner import Manner, find_manner
from uvms_ocp.control.actuator_health.verdicts import FaultKind, Health
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector

_STUCK_SIGMAS = 4.0  # standard deviations from which on a constant thrust is told from none
_STUCK_SHARE = 0.1  # of the limit, likewise
_BEYOND = 1.1  # of the limits: no thruster sticks farther out
_TINY = 1e-12


class ThrusterWatch(Layout):
    """Verdicts on all thrusters, and what they rest on."""

    lower: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] limits of what may be asked."""
    upper: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N]"""
    settling: float
    """[s] as the next three of `ActuatorHealthTuning`."""
    clear_lead: float
    """[-]"""
    looks: float
    """[-]"""
    sound_share: float
    """[-]"""
    window: BlameWindow
    manner: Manner
    started: bool
    quiet_until: float
    """[s]"""
    last: int
    """Thruster that the last look blamed; -1 for none."""
    evidence: float
    """[-] looks that agree."""
    suspect: int
    """Counted from 0 [-]; -1 for none."""
    health: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) each a `Health`."""
    kind: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) each a `FaultKind`."""
    confidence: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [-] as that of `ThrusterVerdict`."""
    since: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [s] likewise."""


def look_at_thrusters(w: ThrusterWatch, e: Effect, residual: Vector, asked: Vector, t: float) -> int:
    """Take in the residual (6,) [N, N m] at time t [s], and the thrust asked (n_thrusters,) [N] that it tells of, of thrusters
    that all follow; the thruster that was found faulty now, and whose effect is changed, or -1."""
    if not w.started:
        _restart(w, t)
    if t < w.quiet_until:
        return -1
    slot = take_in_look(w.window, residual, t)
    for i in range(len(w.health)):
        w.window.asked[slot][i] = e.share[i] * asked[i]
    find_culprit(w.window)
    again = w.window.thruster >= 0 and w.window.thruster == w.last
    counts = min(w.window.lead / w.clear_lead, 1.0)
    w.evidence = w.evidence + counts * counts if again else 0.0
    w.last = w.window.thruster
    if w.last != w.suspect:
        _mark(w)
    return _name(w, e, t) if w.evidence > w.looks else -1


def _restart(w: ThrusterWatch, t: float) -> None:
    w.started = True
    w.quiet_until = t + w.settling
    w.last = -1
    w.evidence = 0.0
    w.window.count = 0


def _mark(w: ThrusterWatch) -> None:
    w.suspect = w.last
    for i in range(len(w.health)):
        if w.health[i] != Health.FAULTY:
            w.health[i] = Health.SUSPECT if i == w.suspect else Health.GOOD


def _name(w: ThrusterWatch, e: Effect, t: float) -> int:
    """The verdict, unless so little is missing that it does no harm, and what comes of commands from now on."""
    i = w.last
    _tell(w, i)
    find_manner(w.manner)
    if w.manner.share > w.sound_share:
        w.evidence = 0.0
        return -1
    e.share[i] = e.share[i] * w.manner.share
    e.constant[i] = 0.0 if e.share[i] != 0.0 else _constant(w, i)
    w.health[i] = Health.FAULTY
    w.kind[i] = _kind(e.share[i], e.constant[i])
    w.confidence[i] = w.window.lead
    w.since[i] = w.manner.onset
    _restart(w, t)
    return i


def _tell(w: ThrusterWatch, i: int) -> None:
    """All that is kept of thruster i."""
    b = w.window
    w.manner.count = min(b.count, len(b.time))
    for j in range(w.manner.count):
        slot = (b.count - w.manner.count + j) % len(b.time)
        along = 0.0
        for k in range(6):
            along += b.seen[slot][k] * b.directions[k][i]
        w.manner.time[j] = b.time[slot]
        w.manner.asked[j] = b.asked[slot][i]
        w.manner.along[j] = along / max(b.square[i], _TINY)


def _constant(w: ThrusterWatch, i: int) -> float:
    """Thrust [N] at which it is stuck; 0 where that cannot be told from none."""
    lower, upper, constant = w.lower[i], w.upper[i], w.manner.constant
    possible = _BEYOND * lower <= constant <= _BEYOND * upper
    clear = abs(constant) > max(_STUCK_SIGMAS * w.manner.sigma, _STUCK_SHARE * upper)
    return min(max(constant, lower), upper) if possible and clear else 0.0


def _kind(share: float, constant: float) -> int:
    kind = FaultKind.STUCK if constant != 0.0 else FaultKind.DEAD
    if share != 0.0:
        kind = FaultKind.REVERSED if share < 0.0 else FaultKind.WEAK
    return kind

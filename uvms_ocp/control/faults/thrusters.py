"""Detect, isolate and classify thruster faults from the residual wrench, as kernels.

The residual wrench is what the disturbance observer finds beyond model and commands. Thruster i
that gives ``(1 - theta) T_i + c`` in place of T_i leaves ``b_i (c - theta T_i)`` in the residual:
along one known direction, as its command goes, and at the same time. Water, loads and the floor
push along others, and what is asked follows them late, so that little of what they do is explained
by any thruster, and about as much by several. The ratio of what is left is that of likelihoods of
an additive fault of unknown size (generalized likelihood ratio test, [Willsky1976]). A thruster is
faulty once it has explained nearly all changes, and no other thruster as well, look after look.
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.control.faults.fault_classification import FaultFit, classify_fault
from uvms_ocp.control.faults.fault_isolation import IsolationWindow, append_sample, isolate_fault
from uvms_ocp.control.faults.verdicts import ActuatorHealth, FaultKind, ThrusterEffectiveness

_CLEAR_LEAD = (
    16.0  # lead from which on a look counts fully; those of a smaller one count by its square
)
_LOOKS = 8.0  # in a row that must agree
_SOUND_SHARE = 0.75  # of its command that a sound thruster gives at least, else it is weak
_STUCK_SIGMAS = 4.0  # standard deviations from which on a constant thrust is told from none
_STUCK_SHARE = 0.1  # of the limit, likewise
_BEYOND = 1.1  # of the limits: no thruster sticks farther out
_TINY = 1e-12


class ThrusterFaultMemory(Layout):
    """Verdicts on all thrusters, and what they rest on."""

    lower: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] limits of what may be asked."""
    upper: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N]"""
    settling: float
    """[s] as that of `ActuatorHealthTuning`."""
    window: IsolationWindow
    fault_fit: FaultFit
    started: bool
    quiet_until: float
    """[s]"""
    last: int
    """Thruster that the last look blamed; -1 for none."""
    evidence: float
    """Looks that agree."""
    suspect: int
    """Counted from 0; -1 for none."""
    health: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) each a `ActuatorHealth`."""
    kind: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) each a `FaultKind`."""
    confidence: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) as that of `ThrusterVerdict`."""
    since: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [s] likewise."""


def detect_thruster_faults(
    w: ThrusterFaultMemory,
    e: ThrusterEffectiveness,
    residual: Vector,
    commanded_thrust: Vector,
    t: float,
) -> int:
    """Take in the residual (6,) [N, N m] at time t [s], and the thrust asked (n_thrusters,) [N]
    that it tells of, of thrusters that all follow; the thruster that was found faulty now, and
    whose effect is changed, or -1.
    """
    if not w.started:
        _restart(w, t)
    if t < w.quiet_until:
        return -1
    slot = append_sample(w.window, residual, t)
    for i in range(len(w.health)):
        w.window.asked[slot][i] = e.share[i] * commanded_thrust[i]
    isolate_fault(w.window)
    again = w.window.thruster >= 0 and w.window.thruster == w.last
    counts = min(w.window.lead / _CLEAR_LEAD, 1.0)
    w.evidence = w.evidence + counts * counts if again else 0.0
    w.last = w.window.thruster
    if w.last != w.suspect:
        _mark(w)
    if w.evidence > _LOOKS:
        return _conclude_fault(w, e, t)
    return -1


def _restart(w: ThrusterFaultMemory, t: float) -> None:
    w.started = True
    w.quiet_until = t + w.settling
    w.last = -1
    w.evidence = 0.0
    w.window.count = 0


def _mark(w: ThrusterFaultMemory) -> None:
    w.suspect = w.last
    for i in range(len(w.health)):
        if w.health[i] != ActuatorHealth.FAULTY:
            w.health[i] = ActuatorHealth.SUSPECT if i == w.suspect else ActuatorHealth.GOOD


def _conclude_fault(w: ThrusterFaultMemory, e: ThrusterEffectiveness, t: float) -> int:
    """The verdict, unless so little is missing that it does no harm, and what comes of commands
    from now on.
    """
    i = w.last
    _select_thruster(w, i)
    classify_fault(w.fault_fit)
    if w.fault_fit.share > _SOUND_SHARE:
        w.evidence = 0.0
        return -1
    e.share[i] = e.share[i] * w.fault_fit.share
    if e.share[i] != 0.0:
        e.constant[i] = 0.0
    else:
        e.constant[i] = _constant(w, i)
    w.health[i] = ActuatorHealth.FAULTY
    kind = FaultKind.STUCK if e.constant[i] != 0.0 else FaultKind.DEAD
    if e.share[i] != 0.0:
        kind = FaultKind.REVERSED if e.share[i] < 0.0 else FaultKind.WEAK
    w.kind[i] = kind
    w.confidence[i] = w.window.lead
    w.since[i] = w.fault_fit.onset
    _restart(w, t)
    return i


def _select_thruster(w: ThrusterFaultMemory, i: int) -> None:
    """All that is kept of thruster i."""
    b = w.window
    w.fault_fit.count = min(b.count, len(b.time))
    for j in range(w.fault_fit.count):
        slot = (b.count - w.fault_fit.count + j) % len(b.time)
        along = 0.0
        for k in range(6):
            along += b.seen[slot][k] * b.directions[k][i]
        w.fault_fit.time[j] = b.time[slot]
        w.fault_fit.asked[j] = b.asked[slot][i]
        w.fault_fit.along[j] = along / max(b.square[i], _TINY)


def _constant(w: ThrusterFaultMemory, i: int) -> float:
    """Thrust [N] at which it is stuck; 0 where that cannot be told from none."""
    lower = w.lower[i]
    upper = w.upper[i]
    constant = w.fault_fit.constant
    possible = _BEYOND * lower <= constant <= _BEYOND * upper
    clear = abs(constant) > max(_STUCK_SIGMAS * w.fault_fit.sigma, _STUCK_SHARE * upper)
    if possible and clear:
        return min(max(constant, lower), upper)
    return 0.0

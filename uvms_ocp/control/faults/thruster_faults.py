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

_CLEAR_LEAD = 16.0  # from which on a look counts fully; those of a smaller one by its square
_LOOKS = 8.0  # in a row that must agree
_SOUND_SHARE = 0.75  # of its command that a sound thruster gives at least, else it is weak
_STUCK_SIGMAS = 4.0  # standard deviations from which on a constant thrust is told from none
_STUCK_SHARE = 0.1  # of the limit from which on a constant thrust is told from none
_BEYOND = 1.1  # of the limits: no thruster sticks farther out
_TINY = 1e-12


class ThrusterFaultMemory(Layout):
    """Verdicts on all thrusters, and what they rest on."""

    lower: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] lower limits of what may be asked."""
    upper: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] upper limits of what may be asked."""
    settling: float
    """[s] after a start or a verdict that are not looked at."""
    window: IsolationWindow
    fault_fit: FaultFit
    started: bool
    quiet_until: float
    """[s] time until which nothing is looked at."""
    last: int
    """Thruster that the last look blamed; -1 for none."""
    evidence: float
    """Number of looks in a row that agree, those of a small lead as parts of one."""
    suspect: int
    """Thruster that is suspected, counted from 0; -1 for none."""
    health: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) each a `ActuatorHealth`."""
    kind: Annotated[list[int], Sized("n_thrusters")]
    """(n_thrusters,) each a `FaultKind`."""
    confidence: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) residual of the next best explanation, over that of the fault."""
    since: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [s] time from which on the fault explains the motion."""


def detect_thruster_faults(
    thruster_faults: ThrusterFaultMemory,
    effectiveness: ThrusterEffectiveness,
    residual: Vector,
    commanded_thrust: Vector,
    t: float,
) -> int:
    """Take in the residual (6,) [N, N m] at time t [s], and the thrust asked (n_thrusters,) [N]
    that it tells of, of thrusters that all follow; the thruster that was found faulty now, and
    whose effect is changed, or -1.
    """
    if not thruster_faults.started:
        _restart(thruster_faults, t)
    if t < thruster_faults.quiet_until:
        return -1
    slot = append_sample(thruster_faults.window, residual, t)
    for i in range(len(thruster_faults.health)):
        thruster_faults.window.asked[slot][i] = effectiveness.share[i] * commanded_thrust[i]
    isolate_fault(thruster_faults.window)
    again = (
        thruster_faults.window.thruster >= 0
        and thruster_faults.window.thruster == thruster_faults.last
    )
    counts = min(thruster_faults.window.lead / _CLEAR_LEAD, 1.0)
    thruster_faults.evidence = thruster_faults.evidence + counts * counts if again else 0.0
    thruster_faults.last = thruster_faults.window.thruster
    if thruster_faults.last != thruster_faults.suspect:
        _mark(thruster_faults)
    if thruster_faults.evidence > _LOOKS:
        return _conclude_fault(thruster_faults, effectiveness, t)
    return -1


def _restart(thruster_faults: ThrusterFaultMemory, t: float) -> None:
    thruster_faults.started = True
    thruster_faults.quiet_until = t + thruster_faults.settling
    thruster_faults.last = -1
    thruster_faults.evidence = 0.0
    thruster_faults.window.count = 0


def _mark(thruster_faults: ThrusterFaultMemory) -> None:
    thruster_faults.suspect = thruster_faults.last
    for i in range(len(thruster_faults.health)):
        if thruster_faults.health[i] != ActuatorHealth.FAULTY:
            thruster_faults.health[i] = (
                ActuatorHealth.SUSPECT if i == thruster_faults.suspect else ActuatorHealth.GOOD
            )


def _conclude_fault(
    thruster_faults: ThrusterFaultMemory, effectiveness: ThrusterEffectiveness, t: float
) -> int:
    """Write the verdict, and what comes of commands from now on, unless so little is missing that it
    does no harm; return the thruster, or -1.
    """
    i = thruster_faults.last
    _select_thruster(thruster_faults, i)
    classify_fault(thruster_faults.fault_fit)
    if thruster_faults.fault_fit.share > _SOUND_SHARE:
        thruster_faults.evidence = 0.0
        return -1
    effectiveness.share[i] = effectiveness.share[i] * thruster_faults.fault_fit.share
    if effectiveness.share[i] != 0.0:
        effectiveness.constant[i] = 0.0
    else:
        effectiveness.constant[i] = _constant(thruster_faults, i)
    thruster_faults.health[i] = ActuatorHealth.FAULTY
    kind = FaultKind.STUCK if effectiveness.constant[i] != 0.0 else FaultKind.DEAD
    if effectiveness.share[i] != 0.0:
        kind = FaultKind.REVERSED if effectiveness.share[i] < 0.0 else FaultKind.WEAK
    thruster_faults.kind[i] = kind
    thruster_faults.confidence[i] = thruster_faults.window.lead
    thruster_faults.since[i] = thruster_faults.fault_fit.onset
    _restart(thruster_faults, t)
    return i


def _select_thruster(thruster_faults: ThrusterFaultMemory, i: int) -> None:
    """Copy what the window keeps of thruster i into the memory of the fit."""
    window = thruster_faults.window
    thruster_faults.fault_fit.count = min(window.count, len(window.time))
    for j in range(thruster_faults.fault_fit.count):
        slot = (window.count - thruster_faults.fault_fit.count + j) % len(window.time)
        along = 0.0
        for k in range(6):
            along += window.seen[slot][k] * window.directions[k][i]
        thruster_faults.fault_fit.time[j] = window.time[slot]
        thruster_faults.fault_fit.asked[j] = window.asked[slot][i]
        thruster_faults.fault_fit.along[j] = along / max(window.square[i], _TINY)


def _constant(thruster_faults: ThrusterFaultMemory, i: int) -> float:
    """Return the thrust [N] at which thruster i is stuck; 0 where that cannot be told from none."""
    lower = thruster_faults.lower[i]
    upper = thruster_faults.upper[i]
    constant = thruster_faults.fault_fit.constant
    possible = _BEYOND * lower <= constant <= _BEYOND * upper
    clear = abs(constant) > max(
        _STUCK_SIGMAS * thruster_faults.fault_fit.sigma, _STUCK_SHARE * max(upper, -lower)
    )
    if possible and clear:
        return min(max(constant, lower), upper)
    return 0.0

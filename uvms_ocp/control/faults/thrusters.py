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

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros
from uvms_ocp.control.faults.verdicts import ActuatorHealth, FaultKind, ThrusterEffectiveness

# Which thruster the residual wrench of the last seconds blames: how much of its changes the thrust
# asked of it explains.
#
# Thruster i that gives ``(1 - theta) T_i + c`` in place of T_i leaves ``b_i (c - theta T_i)`` in
# the residual: along one known direction, as its command goes, and at the same time. Water, loads
# and the floor push along others, and what is asked follows them late, so that little of what they
# do is explained by any thruster, and about as much by several. The ratio of what is left is that
# of likelihoods of an additive fault of unknown size ([Willsky1976]).

_TINY_CHANGE = 1e-12
_LEAST_CHANGE = (
    1.5  # root mean square of the changes, in their scales, below which nothing is looked for
)
# times as much as it leaves unexplained must be left where commands are taken a moment later
_PRECEDES = 1.25
# theta; a thruster that sticks far from what is asked looks like more than 2 at first
_LEAST = 0.25
_MOST = 3.5
LATE = 2  # looks by which what is measured of the motion may lag what is asked, at most
EARLY = (
    4  # looks by which what is asked lags what pushes, where it only answers it; and half of them
)


class IsolationWindow(Layout):
    """Window of recent samples for fault isolation, a ring, and the likeliest faulty thruster."""

    directions: Annotated[list[Vector], Sized(6, "n_thrusters")]
    """(6, n_thrusters) wrench of a newton in those scales."""
    scale: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] what counts as one on each axis."""
    square: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) of the size of each direction."""
    length: int
    """Looks in which a culprit is sought."""
    least_explained: float
    """This and the next as in `ActuatorHealthTuning`."""
    least_lead: float
    seen: Annotated[list[Vector], Sized("n_looks", 6)]
    """(n_looks, 6) residual in those scales."""
    asked: Annotated[list[Vector], Sized("n_looks", "n_thrusters")]
    """(n_looks, n_thrusters) [N]"""
    time: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [s]"""
    count: int
    """Samples so far."""
    along: Annotated[list[Vector], Sized("n_looks", "n_thrusters")]
    """(n_looks, n_thrusters) changes of the residual along each direction."""
    # the likeliest culprit
    thruster: int
    """Counted from 0; -1 where none explains enough."""
    explained: float
    """Share of the changes."""
    lead: float
    """Residual of the next best explanation, over that of this one."""


def append_sample(w: IsolationWindow, residual: Vector, t: float) -> int:
    """The residual (6,) [N, N m] at time t [s]; where to write the thrust asked."""
    slot = w.count % len(w.time)
    for k in range(6):
        w.seen[slot][k] = residual[k] / w.scale[k]
    w.time[slot] = t
    w.count += 1
    return slot


def isolate_fault(w: IsolationWindow) -> None:
    """In the last `window` seconds, or half of it at the beginning."""
    n = min(w.length, w.count - LATE - EARLY)
    w.thruster = -1
    w.explained = 0.0
    w.lead = 1.0
    if n >= w.length // 2:
        first = w.count - EARLY - n
        total = _changes(w, first, n)
        if total >= n * (_LEAST_CHANGE * _LEAST_CHANGE):
            best = _lead(w, total, first, n)
            if (
                w.explained >= w.least_explained
                and w.lead >= w.least_lead
                and _precedes(w, best, total, first, n)
            ):
                w.thruster = best


def _precedes(w: IsolationWindow, best: int, total: float, first: int, n: int) -> bool:
    """Return whether what a thruster is asked comes before the changes, and does not answer
    them.
    """
    answers = max(_explained(w, best, first + EARLY // 2, n), _explained(w, best, first + EARLY, n))
    return total - answers >= _PRECEDES * (1.0 - w.explained) * total


def _lead(w: IsolationWindow, total: float, first: int, n: int) -> int:
    """The thruster that explains most, at the delay at which any does."""
    best_explained = -1.0
    best = 0
    delay = 0
    for late in range(LATE + 1):
        for i in range(len(w.square)):
            explained = _explained(w, i, first - late, n)
            if explained > best_explained:
                best_explained = explained
                best = i
                delay = late
    unexplained = max(total - best_explained, _TINY_CHANGE * total)
    second = 0.0
    for i in range(len(w.square)):
        second = max(second, _explained(w, i, first - delay, n) if i != best else 0.0)
    w.explained = 1.0 - unexplained / total
    w.lead = (total - second) / unexplained
    return best


def _changes(w: IsolationWindow, first: int, n: int) -> float:
    """Sum of squares of the changes of the residual in n looks, which are laid out along all
    directions.
    """
    mean = zeros(6)
    total = 0.0
    for k in range(6):
        for j in range(n):
            mean[k] += w.seen[(first + j) % len(w.time)][k]
        mean[k] /= n
    for j in range(n):
        slot = (first + j) % len(w.time)
        for i in range(len(w.square)):
            w.along[j][i] = 0.0
        for k in range(6):
            change = w.seen[slot][k] - mean[k]
            total += change * change
            for i in range(len(w.square)):
                w.along[j][i] += change * w.directions[k][i]
    return total


def _explained(w: IsolationWindow, i: int, first: int, n: int) -> float:
    """Compute the share of the sum of squares that the commands of thruster i explain in n
    samples.
    """
    mean = 0.0
    size = 0.0
    along = 0.0
    for j in range(n):
        mean += w.asked[(first + j) % len(w.time)][i]
    mean /= n
    for j in range(n):
        change = w.asked[(first + j) % len(w.time)][i] - mean
        size += change * change
        along += change * w.along[j][i]
    size = max(w.square[i] * size, _TINY_CHANGE)
    theta = -along / size
    if _LEAST < theta < _MOST:
        return theta * theta * size
    return 0.0


# In which manner a thruster fails, and since when: every onset of late, against a share and against
# no answer at all.

_AFTER = 6  # looks that an onset must be back at least
_TINY_SCATTER = 1e-12
# share, the other way, from which a thruster counts as reversed; one that sticks may look like less
_REVERSED = 0.5
_NOTHING = 0.3  # share below which a thruster is dead, not weak
_STUCK = 0.1  # of what a dead thruster would leave unexplained


class LineFit(Layout):
    """Fitted to y over x."""

    x: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [any]"""
    y: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N]"""
    slope: float
    """[N/any]"""
    left: float
    """[N^2] sum of squares that is left."""
    best_slope: float
    """[N/any] of all that were tried, the one that leaves least."""
    best_sigma: float
    """[N/any] standard deviation of that."""
    least: float
    """[N^2] that it leaves."""
    onset: float
    """[s] for which it was tried."""


class FaultFit(Layout):
    """The likeliest, of one thruster."""

    count: int
    """Looks at it."""
    time: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [s]"""
    asked: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] thrust, as filtered."""
    along: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] thrust along the thruster that the residual comes to."""
    bandwidth: float
    """[rad/s] of the filter."""
    faded: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) what the filter still has of the time before an onset."""
    lost: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [N] of what was asked since."""
    shares: LineFit
    stops: LineFit
    dead: float
    """[N^2] that is left where it gives nothing, at least."""
    # found
    share: float
    """Share of its command that it gives; 0 where it does not follow."""
    constant: float
    """[N] that it gives instead, where it does not follow."""
    sigma: float
    """[N] of the constant."""
    onset: float
    """[s]"""


def classify_fault(m: FaultFit) -> None:
    """Fit share and constant to commands and residuals."""
    m.shares.least = math.inf
    m.stops.least = math.inf
    m.dead = math.inf
    for k in range(max(m.count - _AFTER, 1)):
        _try_onset(m, k)
    loss = m.shares.best_slope
    follows = m.stops.least > m.shares.least and not 1.0 - _NOTHING < loss < 1.0 + _REVERSED
    stuck = m.stops.least < _STUCK * m.dead
    m.share = 1.0 - loss if follows else 0.0
    if stuck and not follows:
        m.constant = m.stops.best_slope
    else:
        m.constant = 0.0
    m.sigma = math.inf if follows else m.stops.best_sigma
    m.onset = m.shares.onset if follows else m.stops.onset


def _try_onset(m: FaultFit, k: int) -> None:
    """At look k."""
    for j in range(m.count):
        if j >= k:
            m.faded[j] = math.exp(-m.bandwidth * max(m.time[j] - m.time[k], 0.0))
        else:
            m.faded[j] = 1.0
        m.lost[j] = m.asked[j] - m.asked[k] * m.faded[j] if m.faded[j] < 1.0 else 0.0
        m.shares.x[j] = -m.lost[j]
        m.shares.y[j] = m.along[j]
        m.stops.x[j] = 1.0 - m.faded[j]
        m.stops.y[j] = m.along[j] + m.lost[j]
    m.dead = min(m.dead, _scatter(m.stops.y, m.count))
    _try_line(m.shares, m.count, m.time[k])
    _try_line(m.stops, m.count, m.time[k])


def _scatter(y: Vector, n: int) -> float:
    """Sum of squares of what is not the mean."""
    mean = 0.0
    total = 0.0
    for j in range(n):
        mean += y[j] / n
    for j in range(n):
        total += (y[j] - mean) * (y[j] - mean)
    return total


def _try_line(f: LineFit, n: int, onset: float) -> None:
    mean_x = 0.0
    mean_y = 0.0
    size = 0.0
    along = 0.0
    for j in range(n):
        mean_x += f.x[j] / n
        mean_y += f.y[j] / n
    for j in range(n):
        size += (f.x[j] - mean_x) * (f.x[j] - mean_x)
        along += (f.x[j] - mean_x) * (f.y[j] - mean_y)
    size = max(size, _TINY_SCATTER)
    f.slope = along / size
    f.left = 0.0
    for j in range(n):
        rest = f.y[j] - mean_y - f.slope * (f.x[j] - mean_x)
        f.left += rest * rest
    if f.left < f.least:
        f.least = f.left
        f.best_slope = f.slope
        f.best_sigma = math.sqrt(f.left / max(n - 2, 1) / size)
        f.onset = onset


# Thrusters that do not give what they are asked, found in the residual wrench and named, as
# kernels.
#
# The residual wrench is what the disturbance observer finds beyond model and commands. A thruster
# is faulty once its asked thrust has explained nearly all changes of it, and no other thruster as
# well, look after look.

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

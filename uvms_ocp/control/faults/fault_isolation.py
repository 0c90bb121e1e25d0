"""Isolate the thruster whose commands explain the changes of the residual wrench of the last
seconds.

Thruster i that gives ``(1 - theta) T_i + c`` in place of T_i leaves ``b_i (c - theta T_i)`` in
the residual: along one known direction, as its command goes, and at the same time. Water, loads
and the floor push along others, and what is asked follows them late, so that little of what they
do is explained by any thruster, and about as much by several. The ratio of what is left is that
of likelihoods of an additive fault of unknown size ([Willsky1976]).
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros

FORCE_SCALE = 0.02
"""Change of the residual force that counts as one, share of what all thrusters together give on that
axis.
"""
MOMENT_SCALE = 0.005
"""The same of moments, of which water and loads make less for their force than thrusters do."""
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
    """(6, n_thrusters) wrench of 1 N of each thruster, in units of `scale`."""
    scale: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] unit of each axis, so that forces and moments compare."""
    square: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) squared norm of each direction."""
    length: int
    """Looks in which a culprit is sought."""
    least_explained: float
    """Share of the changes that the fault of a thruster must explain."""
    least_lead: float
    """How many times as much as this one the next best must leave unexplained."""
    seen: Annotated[list[Vector], Sized("n_looks", 6)]
    """(n_looks, 6) residual, in units of `scale`."""
    asked: Annotated[list[Vector], Sized("n_looks", "n_thrusters")]
    """(n_looks, n_thrusters) [N] commanded thrust."""
    time: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [s] times of the samples."""
    count: int
    """Samples so far."""
    along: Annotated[list[Vector], Sized("n_looks", "n_thrusters")]
    """(n_looks, n_thrusters) changes of the residual along each direction."""
    # the likeliest culprit
    thruster: int
    """Thruster that explains most, counted from 0; -1 where none explains enough."""
    explained: float
    """Share of the changes that it explains."""
    lead: float
    """Ratio of what the next best explanation leaves unexplained to what this one leaves."""


def append_sample(window: IsolationWindow, residual: Vector, t: float) -> int:
    """Add the residual (6,) [N, N m] at time t [s]; return the row of `asked` for the thrust of
    then.
    """
    slot = window.count % len(window.time)
    for k in range(6):
        window.seen[slot][k] = residual[k] / window.scale[k]
    window.time[slot] = t
    window.count += 1
    return slot


def isolate_fault(window: IsolationWindow) -> None:
    """Find the thruster that explains the residual of the last `window` seconds, or of half of it
    at the beginning.
    """
    n = min(window.length, window.count - LATE - EARLY)
    window.thruster = -1
    window.explained = 0.0
    window.lead = 1.0
    if n >= window.length // 2:
        first = window.count - EARLY - n
        total = _changes(window, first, n)
        if total >= n * (_LEAST_CHANGE * _LEAST_CHANGE):
            best = _lead(window, total, first, n)
            if (
                window.explained >= window.least_explained
                and window.lead >= window.least_lead
                and _precedes(window, best, total, first, n)
            ):
                window.thruster = best


def _precedes(window: IsolationWindow, best: int, total: float, first: int, n: int) -> bool:
    """Return whether what a thruster is asked comes before the changes, and does not answer
    them.
    """
    answers = max(
        _explained(window, best, first + EARLY // 2, n), _explained(window, best, first + EARLY, n)
    )
    return total - answers >= _PRECEDES * (1.0 - window.explained) * total


def _lead(window: IsolationWindow, total: float, first: int, n: int) -> int:
    """Return the thruster that explains most, at the delay at which any explains most."""
    best_explained = -1.0
    best = 0
    delay = 0
    for late in range(LATE + 1):
        for i in range(len(window.square)):
            explained = _explained(window, i, first - late, n)
            if explained > best_explained:
                best_explained = explained
                best = i
                delay = late
    unexplained = max(total - best_explained, _TINY_CHANGE * total)
    second = 0.0
    for i in range(len(window.square)):
        second = max(second, _explained(window, i, first - delay, n) if i != best else 0.0)
    window.explained = 1.0 - unexplained / total
    window.lead = (total - second) / unexplained
    return best


def _changes(window: IsolationWindow, first: int, n: int) -> float:
    """Compute the sum of squares of the changes of the residual in n samples, and project these on
    all directions.
    """
    mean = zeros(6)
    total = 0.0
    for k in range(6):
        for j in range(n):
            mean[k] += window.seen[(first + j) % len(window.time)][k]
        mean[k] /= n
    for j in range(n):
        slot = (first + j) % len(window.time)
        for i in range(len(window.square)):
            window.along[j][i] = 0.0
        for k in range(6):
            change = window.seen[slot][k] - mean[k]
            total += change * change
            for i in range(len(window.square)):
                window.along[j][i] += change * window.directions[k][i]
    return total


def _explained(window: IsolationWindow, i: int, first: int, n: int) -> float:
    """Compute the share of the sum of squares that the commands of thruster i explain in n
    samples.
    """
    mean = 0.0
    size = 0.0
    along = 0.0
    for j in range(n):
        mean += window.asked[(first + j) % len(window.time)][i]
    mean /= n
    for j in range(n):
        change = window.asked[(first + j) % len(window.time)][i] - mean
        size += change * change
        along += change * window.along[j][i]
    size = max(window.square[i] * size, _TINY_CHANGE)
    theta = -along / size
    if _LEAST < theta < _MOST:
        return theta * theta * size
    return 0.0

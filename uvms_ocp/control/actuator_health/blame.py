"""Which thruster the residual wrench of the last seconds blames: how much of its changes the thrust asked of it explains.

Thruster i that gives ``(1 - theta) T_i + c`` in place of T_i leaves ``b_i (c - theta T_i)`` in the residual: along one known
direction, as its command goes, and at the same time. Water, loads and the floor push along others, and what is asked
follows them late, so that little of what they do is explained by any thruster, and about as much by several. The ratio of
what is left is that of likelihoods of an additive fault of unknown size ([Willsky1976]).
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, zeros

_TINY = 1e-12
_LEAST, _MOST = 0.25, 3.5  # theta; a thruster that sticks far from what is asked looks like more than 2 at first
LATE = 2  # looks by which what is measured of the motion may lag what is asked, at most
EARLY = 4  # looks by which what is asked lags what pushes, where it only answers it; and half of them


class BlameWindow(Layout):
    """What was seen lately, in a ring of looks, and the likeliest culprit."""

    directions: Annotated[list[Vector], Sized(6, "n_thrusters")]
    """(6, n_thrusters) [-] wrench of a newton in those scales."""
    scale: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] what counts as one on each axis."""
    square: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [-] of the size of each direction."""
    length: int
    """[-] looks in which a culprit is sought."""
    least_change: float
    """[-] as the next three of `ActuatorHealthTuning`."""
    least_explained: float
    """[-]"""
    least_lead: float
    """[-]"""
    precedes: float
    """[-]"""
    seen: Annotated[list[Vector], Sized("n_looks", 6)]
    """(n_looks, 6) [-] residual in those scales."""
    asked: Annotated[list[Vector], Sized("n_looks", "n_thrusters")]
    """(n_looks, n_thrusters) [N]"""
    time: Annotated[Vector, Sized("n_looks")]
    """(n_looks,) [s]"""
    count: int
    """[-] of all looks."""
    along: Annotated[list[Vector], Sized("n_looks", "n_thrusters")]
    """(n_looks, n_thrusters) [-] changes of the residual along each direction."""
    # the likeliest culprit
    thruster: int
    """[-] counted from 0; -1 where none explains enough."""
    explained: float
    """[-] share of the changes."""
    lead: float
    """[-] what the next best leaves unexplained, over what this one does."""


def take_in_look(w: BlameWindow, residual: Vector, t: float) -> int:
    """The residual (6,) [N, N m] at time t [s]; where to write the thrust asked."""
    slot = w.count % len(w.time)
    for k in range(6):
        w.seen[slot][k] = residual[k] / w.scale[k]
    w.time[slot] = t
    w.count += 1
    return slot


def find_culprit(w: BlameWindow) -> None:
    """In the last `window` seconds, or half of it at the beginning."""
    n = min(w.length, w.count - LATE - EARLY)
    w.thruster = -1
    w.explained = 0.0
    w.lead = 1.0
    if n >= w.length // 2:
        first = w.count - EARLY - n
        total = _changes(w, first, n)
        if total >= n * (w.least_change * w.least_change):
            best = _lead(w, total, first, n)
            if w.explained >= w.least_explained and w.lead >= w.least_lead and _precedes(w, best, total, first, n):
                w.thruster = best


def _precedes(w: BlameWindow, best: int, total: float, first: int, n: int) -> bool:
    """Whether what a thruster is asked comes before the changes, and does not answer them."""
    answers = max(_explained(w, best, first + EARLY // 2, n), _explained(w, best, first + EARLY, n))
    return total - answers >= w.precedes * (1.0 - w.explained) * total


def _lead(w: BlameWindow, total: float, first: int, n: int) -> int:
    """The thruster that explains most, at the delay at which any does."""
    most, best, delay = -1.0, 0, 0
    for late in range(LATE + 1):
        for i in range(len(w.square)):
            explained = _explained(w, i, first - late, n)
            if explained > most:
                most = explained
                best = i
                delay = late
    left, second = max(total - most, _TINY * total), 0.0
    for i in range(len(w.square)):
        second = max(second, _explained(w, i, first - delay, n) if i != best else 0.0)
    w.explained = 1.0 - left / total
    w.lead = (total - second) / left
    return best


def _changes(w: BlameWindow, first: int, n: int) -> float:
    """Sum of squares of the changes of the residual in n looks, which are laid out along all directions."""
    mean, total = zeros(6), 0.0
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


def _explained(w: BlameWindow, i: int, first: int, n: int) -> float:
    """Of the sum of squares, by what thruster i was asked in n looks."""
    mean, size, along = 0.0, 0.0, 0.0
    for j in range(n):
        mean += w.asked[(first + j) % len(w.time)][i]
    mean /= n
    for j in range(n):
        change = w.asked[(first + j) % len(w.time)][i] - mean
        size += change * change
        along += change * w.along[j][i]
    size = max(w.square[i] * size, _TINY)
    theta = -along / size
    return theta * theta * size if _LEAST < theta < _MOST else 0.0

"""The last estimates, to ask what was estimated when a late reading was taken."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector


class Estimate(Layout):
    """Where the robot was taken to be at one tick."""

    t: float
    """[s]"""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad]"""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s]"""
    beam_at: Annotated[Vector, Sized(3)]
    """(3,) [m] the altimeter in B."""
    beam_up: Annotated[Vector, Sized(3)]
    """(3,) [-] its z axis in B."""


class History(Layout):
    """Estimates in the order of time, in a ring."""

    length: float
    """[s] for which they are kept."""
    spacing: float
    """[s] between two at least, the newest aside: so many fit."""
    first: int
    count: int
    kept: Annotated[list[Estimate], Sized("n_estimates")]


def remember(h: History, now: Estimate) -> None:
    """Keep the estimate of a tick."""
    if h.count >= 2 and _time(h, h.count - 1) - _time(h, h.count - 2) < h.spacing:
        h.count -= 1
    if h.count == len(h.kept):
        _drop(h)
    _copy_estimate(h.kept[(h.first + h.count) % len(h.kept)], now)
    h.count += 1
    while _time(h, 0) < now.t - h.length:
        _drop(h)


def slot_at(h: History, t: float) -> int:
    """Where the estimate is kept that was made nearest to time t [s]; -1 before the first."""
    if h.count == 0:
        return -1
    low, high = 0, h.count - 1
    if t >= _time(h, high):
        low = high
    while high - low > 1:
        middle = (low + high) // 2
        if _time(h, middle) <= t:
            low = middle
        else:
            high = middle
    nearest = low if abs(_time(h, low) - t) <= abs(_time(h, high) - t) else high
    return (h.first + nearest) % len(h.kept)


def _time(h: History, k: int) -> float:
    return h.kept[(h.first + k) % len(h.kept)].t


def _drop(h: History) -> None:
    h.first = (h.first + 1) % len(h.kept)
    h.count -= 1


def _copy_estimate(to: Estimate, now: Estimate) -> None:
    to.t = now.t
    for i in range(len(to.q)):
        to.q[i] = now.q[i]
    for i in range(len(to.v)):
        to.v[i] = now.v[i]
    for i in range(3):
        to.beam_at[i] = now.beam_at[i]
        to.beam_up[i] = now.beam_up[i]

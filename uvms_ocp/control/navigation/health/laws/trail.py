"""Values of the last seconds with their times, in a ring."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, zeros

LONGEST = 64


class Trail(Layout):
    """In the order of time."""

    first: int
    count: int
    t: Annotated[Vector, Sized(LONGEST)]
    """(64,) [s]"""
    value: Annotated[list[Vector], Sized(LONGEST, 4)]
    """(64, 4) of any unit."""


def ring_slot(s: Trail, k: int) -> int:
    """Of entry k [-], from the oldest."""
    return (s.first + k) % len(s.t)


def time_at(s: Trail, k: int) -> float:
    """[s] of entry k [-], from the oldest."""
    return s.t[ring_slot(s, k)]


def append_value(s: Trail, t: float, value: Vector, n: int) -> None:
    """Add n [-] numbers of time t [s]; where all places are taken the oldest go."""
    if s.count == len(s.t):
        drop_oldest(s)
    slot = ring_slot(s, s.count)
    s.t[slot] = t
    for i in range(n):
        s.value[slot][i] = value[i]
    s.count += 1


def drop_oldest(s: Trail) -> None:
    """One goes."""
    s.first = ring_slot(s, 1)
    s.count -= 1


def span_of(s: Trail) -> float:
    """[s] from the oldest to the newest."""
    return time_at(s, s.count - 1) - time_at(s, 0)


def mean_time(s: Trail, start: int, n: int) -> float:
    """[s] of n [-] entries from `start` [-] on."""
    total = 0.0
    for k in range(start, start + n):
        total += time_at(s, k)
    return total / n


def median_of(s: Trail, i: int, start: int, n: int) -> float:
    """Of number i [-] of n [-] entries from `start` [-] on."""
    x = zeros(LONGEST)
    for k in range(n):
        value, place = s.value[ring_slot(s, start + k)][i], k
        while place > 0 and x[place - 1] > value:
            x[place] = x[place - 1]
            place -= 1
        x[place] = value
    return x[n // 2] if n % 2 == 1 else 0.5 * (x[n // 2 - 1] + x[n // 2])


def value_at(s: Trail, i: int, t: float) -> float:
    """Number i [-] at time t [s], straight between entries, the oldest before them and the newest after."""
    after = s.count - 1
    while after > 0 and time_at(s, after - 1) > t:
        after -= 1
    old, new = s.value[ring_slot(s, max(after - 1, 0))][i], s.value[ring_slot(s, after)][i]
    from_t, to_t = time_at(s, max(after - 1, 0)), time_at(s, after)
    if t >= to_t or to_t == from_t:
        return new
    return old if t <= from_t else (new - old) / (to_t - from_t) * (t - from_t) + old

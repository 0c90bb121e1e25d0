"""Kernels that use all that kernels can do."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Annotated, Any

from uvms_ocp.codegen.kernel_layout import (
    CallbackField,
    FunctionField,
    Layout,
    Sized,
    Vector,
    zeros,
)

LIMIT = 0.75


class Mood(IntEnum):
    CALM = 0
    ALARMED = 2


class Window(Layout):
    """The last readings of something."""

    mood: int
    count: int
    full: bool
    values: Annotated[Vector, Sized(7)]


class Motion(Layout):
    """Of `advance`."""

    dynamics: FunctionField
    x: Annotated[Vector, Sized(2)]
    rate: Annotated[Vector, Sized(2)]
    slope: Annotated[Vector, Sized(4)]
    energy: Annotated[Vector, Sized(1)]


def advance(m: Motion, push: float, n: int) -> float:
    """n steps of 10 ms, by a function that also tells its slope."""
    for _ in range(n):
        m.dynamics(m.x, push, m.rate, m.slope, None)
        for i in range(len(m.x)):
            m.x[i] += 0.01 * m.rate[i]
    m.dynamics(m.x, None, None, None, m.energy)
    return m.energy[0]


class Column(Layout):
    """Numbers alone, which may be expressions elsewhere."""

    first: Annotated[Vector, Sized(1)]
    rest: Annotated[Any, Sized(3)]


class Roots(Layout):
    """Of `take_roots`."""

    root: FunctionField
    given: Column
    told: Column


def take_roots(m: Roots) -> None:
    """Column by column."""
    m.root(m.given, m.told)


class Memory(Layout):
    """Of `tick`."""

    now: float
    now_of_next: float
    windows: Annotated[list[Window], Sized("n")]
    double: Annotated[list[Vector], Sized("n", 3)]
    out: Annotated[Vector, Sized(4)]
    before: Annotated[Vector, Sized(4)]


def push(window: Window, x: float) -> bool:
    """Add x; whether the window is full."""
    window.values[window.count % len(window.values)] = x
    window.count += 1
    window.full = window.full or window.count >= len(window.values)
    window.mood = Mood.ALARMED if not -LIMIT <= x <= LIMIT else Mood.CALM
    return window.full


def median(x: Vector, n: int) -> float:
    """The one in the middle, by counting those that are smaller."""
    for i in range(n):
        smaller = 0
        for k in range(n):
            if x[k] < x[i] or (x[k] == x[i] and k < i):
                smaller += 1
        if smaller == n // 2:
            return x[i]
    return math.nan


def halvings(x: float) -> int:
    """Until x is below the limit, eight at most."""
    n = 0
    while abs(x) > LIMIT:
        if n == 8:
            break
        n += 1
        x *= 0.5
    return n


def tick(m: Memory, x: float, quiet: bool) -> float:
    """All of it."""
    total = 0.0
    s = 0.0
    medians = zeros(4)
    m.before[:] = m.out
    for i in range(len(m.windows)):
        window = m.windows[i]
        if quiet and i == 1:
            continue
        if push(window, x + i):
            total += window.count / (i + 2)
        row = m.double[i]
        row[2] = max(x, 0.3, min(m.now, x - i)) * math.copysign(1.0, x)
        m.double[0][: i // 2] = row[: i // 2]
        medians[i] = median(window.values, len(window.values))
        s -= math.atan2(row[2], medians[i]) + math.sqrt(abs(x))
    for i in range(1, len(m.out)):
        m.out[i] = medians[i - 1] if math.isfinite(medians[i - 1]) else math.inf
    m.out[0] = m.windows[0].values[6] = s + math.erf(x) + math.remainder(x, LIMIT)
    m.now, m.double[0][1] = m.now_of_next, abs(x)
    m.now_of_next += 0.1
    return total + halvings(x) + int(x) + float(m.windows[0].mood)


class Curious(Layout):
    """What somebody in Python changes when asked."""

    ask: CallbackField
    x: float


def inquire(m: Curious, n: int) -> float:
    """Ask so often."""
    for i in range(n):
        m.x += i
        m.ask()
    return m.x

"""Whether a sensor repeats itself although it has noise: it is frozen.

A sensor repeats a value by chance where its resolution is no finer than its noise. All its changes are multiples of its
resolution, whose upper bound is their greatest common measure; so the chance p of one repetition is at most that of noise
staying within it, and n repetitions speak against the sensor where p^n is below a chance that one does not expect to
meet. A sensor at rest whose resolution is much coarser than its noise has p near 1 and never alarms; nor does one
without noise.
"""

from __future__ import annotations

import ctypes
import math
from typing import Annotated

from uvms_ocp.control.navigation.health.reasons import Reason, Why, give
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector

_SHARE = 0.5  # of the noise that a sensor is said to have, which it is taken to have at least
_FINE = 1e-3  # of the noise: a resolution that is finer makes no difference
_ENOUGH = 5e-3  # of the noise: what is known to be finer is not looked at any more
_LEAST = 3  # repetitions, however unlikely: some sensors send a reading twice
_NEVER = 1e-300


class Repeats(Layout):
    """How often each component of a channel has repeated itself."""

    noise: float
    """[unit of the channel] that it has at least."""
    each: bool
    """Judge every component by itself, not all together alone."""
    chance: float
    """[-] logarithm of that which repetitions have without a fault."""
    size: int
    """[-] components."""
    started: bool
    finest: float
    """[unit of the channel] greatest common measure of all changes so far; no finer than `_FINE` of the noise."""
    last: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] the newest value, `size` numbers."""
    runs: Annotated[list[int], Sized("n_width")]
    """(n_width,) [-] repetitions of each."""


def expect_repeats(memory: ctypes.Structure, sigma: float, *, size: int, each: bool, chance: float) -> None:
    """Prepare a `Repeats`: noise sigma [unit of the channel] of size [-] components; chance [-] of a false alarm."""
    memory.noise, memory.each, memory.chance = _SHARE * sigma, each, math.log(chance)
    memory.size, memory.finest = size, math.inf


def repeated(r: Repeats, value: Vector, why: Why) -> bool:
    """Whether the channel counts as frozen, by its newest value (size,) [unit of the channel]."""
    if r.noise == 0.0:
        return False
    fresh, same = not r.started, False
    refine = r.finest > _ENOUGH * r.noise
    for i in range(r.size):
        if fresh:
            r.runs[i] = 0
        elif value[i] == r.last[i]:
            r.runs[i] += 1
            same = True
        else:
            r.runs[i] = 0
            if refine:
                r.finest = _common(r.finest, abs(value[i] - r.last[i]), _FINE * r.noise)
        r.last[i] = value[i]
    r.started = True
    return same and _too_often(r, why)


def _too_often(r: Repeats, why: Why) -> bool:
    worst, most, together = 0, r.runs[0], r.runs[0]
    for i in range(1, r.size):
        if r.runs[i] > most:
            worst = i
            most = r.runs[i]
        together = min(together, r.runs[i])
    if most < _LEAST or not _unlikely(r, most, together):
        return False
    give(why, Reason.REPEATED, most + 1, 0 if together >= _LEAST or r.size == 1 else worst + 1)
    return True


def _unlikely(r: Repeats, most: int, together: int) -> bool:
    p = math.erf(r.finest / (2.0 * r.noise)) if math.isfinite(r.finest) else 1.0
    one = math.log(max(p, _NEVER))
    if together >= _LEAST and together * r.size * one < r.chance:
        return True
    return r.each and most * one < r.chance


def _common(measure: float, step: float, tolerance: float) -> float:
    """The greatest common measure of two lengths > 0, by Euclid, not below the tolerance; inf is a multiple of all."""
    while step > tolerance:
        rest = abs(math.remainder(measure, step)) if math.isfinite(measure) else 0.0
        measure = step
        step = rest
    return max(measure, tolerance)

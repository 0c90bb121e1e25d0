"""Values that repeat themselves bit by bit although the sensor has noise: it is frozen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

_SHARE = 0.5  # of the noise that a sensor is said to have, which it is taken to have at least
_FINE = 1e-3  # of the noise: a resolution that is finer makes no difference
_ENOUGH = 5e-3  # of the noise: what is known to be finer is not looked at any more
_LEAST = 3  # repetitions, however unlikely: some sensors send a reading twice


class Repeats:
    """Counts how often each component of a channel has repeated itself.

    A sensor repeats a value by chance where its resolution is no finer than its noise. All its changes are multiples of its
    resolution, whose upper bound is their greatest common measure; so the chance p of one repetition is at most that of noise
    staying within it, and n repetitions speak against the sensor where p^n is below a chance that one does not expect to
    meet. A sensor at rest whose resolution is much coarser than its noise has p near 1 and never alarms; nor does one
    without noise.
    """

    def __init__(self, sigma: float, *, each: bool, chance: float) -> None:
        """sigma [unit of the channel]: noise. each: judge every component by itself, not all together alone.

        chance [-]: that repetitions have without a fault.
        """
        self._noise, self._each, self._chance = _SHARE * sigma, each, math.log(chance)
        self._last: np.ndarray | None = None
        self._runs = np.zeros(0, dtype=int)
        self._finest = math.inf
        """[unit of the channel] greatest common measure of all changes so far; no finer than `_FINE` of the noise."""

    def frozen(self, value: Any) -> str | None:
        """Why the channel counts as frozen, by the newest value."""
        if self._noise == 0.0:
            return None
        new = np.atleast_1d(np.asarray(value, dtype=float))
        if self._last is None:
            self._last, self._runs = new.copy(), np.zeros(len(new), dtype=int)
            return None
        same = new == self._last
        if self._finest > _ENOUGH * self._noise:
            self._refine(np.abs(new - self._last)[~same])
        self._last = new.copy()
        self._runs = (self._runs + 1) * same
        return self._verdict() if same.any() else None

    def _refine(self, changes: np.ndarray) -> None:
        for change in changes.tolist():
            self._finest = _common(self._finest, change, _FINE * self._noise)

    def _verdict(self) -> str | None:
        most, all_together = int(self._runs.max()), int(self._runs.min())
        if most < _LEAST or not self._unlikely(most, all_together):
            return None
        which = "" if all_together >= _LEAST or len(self._runs) == 1 else f", component {int(self._runs.argmax()) + 1}"
        return f"the same value {most + 1} times{which}"

    def _unlikely(self, most: int, all_together: int) -> bool:
        p = math.erf(self._finest / (2.0 * self._noise)) if math.isfinite(self._finest) else 1.0
        one = math.log(max(p, 1e-300))
        together = all_together >= _LEAST and all_together * len(self._runs) * one < self._chance
        return together or (self._each and most * one < self._chance)


def _common(measure: float, step: float, tolerance: float) -> float:
    """The greatest common measure of two lengths > 0, by Euclid, not below the tolerance; inf is a multiple of all."""
    while step > tolerance:
        rest = abs(math.remainder(measure, step)) if math.isfinite(measure) else 0.0
        measure, step = step, rest
    return max(measure, tolerance)

"""Continue times of a clock that begins anew in a file: a counter that wraps goes on where that is
certain, and samples recorded after another boot come behind those before it, as a part of their own.

Late messages, which are older than those before them, are no boot: time jumps forward again by as
much.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

_MODULI = tuple(2.0**bits * unit for bits, unit in product((16, 32), (1.0, 1e-3, 1e-6, 1e-9)))
"""[s] after which counters of so many bits begin anew, in each unit."""
_WRAP_INTERVALS = 5.0  # usual intervals within which a counter that wrapped goes on
_MIN_STEP_BACK = 1.0  # [s] by which a boot sets a clock back
_MIN_SAMPLES = 10  # of a boot
_LATER_SAMPLES = 5  # that are all earlier than the one before the boot
_BOOT_GAP = 3.0  # [s] put between boots, so that a recording is cut there
_JUMP_ERROR = 0.5  # [s] by which late messages jump forward more, or less, than back


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ContinuedTimes:
    """Times of several channels, that go on where their clock began anew."""

    times: Mapping[str, np.ndarray]
    """(n,) [s] times of each channel, in the order of the file."""
    wraps: int = 0
    """Largest number of times that the counter of a channel wrapped."""
    boots: int = 0
    """Number of times that the clock began anew."""
    back: float = 0.0
    """[s] largest step back at a boot."""


def continued(times: Mapping[str, np.ndarray]) -> ContinuedTimes:
    """Continue times (n,) [s] of each channel, in the order of its file; NaN stay."""
    unwrapped = {}
    largest_n_wraps = 0
    for name, t in times.items():
        unwrapped[name], n_wraps = _unwrapped(t)
        largest_n_wraps = max(largest_n_wraps, n_wraps)
    begins = {name: _boots(t) for name, t in unwrapped.items()}
    numbers = {len(places) for places in begins.values()}
    n_boots = max(numbers, default=0)
    if len(numbers) != 1 or n_boots == 0:
        return ContinuedTimes(times=unwrapped, wraps=largest_n_wraps)
    back = 0.0
    for name, places in begins.items():
        for place in places:
            back = max(back, float(unwrapped[name][place - 1] - unwrapped[name][place]))
    return ContinuedTimes(
        times=_in_sequence(unwrapped, begins),
        wraps=largest_n_wraps,
        boots=n_boots,
        back=back,
    )


def _unwrapped(t: np.ndarray) -> tuple[np.ndarray, int]:
    """Add the modulus of a counter wherever t (n,) [s] falls by nearly that, and count these."""
    steps = np.diff(t)
    falls = np.flatnonzero(steps < 0.0)
    if not len(falls) or len(t) < _MIN_SAMPLES:
        return t, 0
    forward = steps[steps > 0.0]
    if not len(forward):
        return t, 0
    longest_step = _WRAP_INTERVALS * float(np.median(forward))
    for modulus in _MODULI:
        is_within = np.nanmin(t) >= 0.0 and np.nanmax(t) < modulus
        is_frequent = longest_step < 0.1 * modulus
        unwrapped_steps = steps[falls] + modulus
        goes_on = (unwrapped_steps > 0.0) & (unwrapped_steps <= longest_step)
        if is_within and is_frequent and goes_on.all():
            n_before = np.zeros(len(t))
            n_before[falls + 1] = 1.0
            return t + modulus * np.cumsum(n_before), len(falls)
    return t, 0


def _boots(t: np.ndarray) -> list[int]:
    """List the places in t (n,) [s] at which a clock begins anew."""
    places = []
    falls = np.flatnonzero(np.diff(t) < -_MIN_STEP_BACK) + 1
    for place in falls.tolist():
        before = t[place - 1]
        after = t[place : place + _LATER_SAMPLES]
        is_lasting = len(t) - place >= _MIN_SAMPLES and bool((after < before).all())
        if is_lasting and not _returns(t[place:], before - t[place]):
            places.append(place)
    lengths = np.diff([0, *places, len(t)])
    if lengths.min() < _MIN_SAMPLES:
        return []
    return places


def _returns(t: np.ndarray, fall: float) -> bool:
    """Check whether t (n,) [s], after a fall [s], jumps forward again by as much."""
    steps = np.diff(t)
    next_falls = np.flatnonzero(steps < -_MIN_STEP_BACK)
    if len(next_falls):
        steps = steps[: next_falls[0]]
    return bool((np.abs(steps - fall) < _JUMP_ERROR).any())


def _in_sequence(
    times: Mapping[str, np.ndarray], begins: Mapping[str, list[int]]
) -> dict[str, np.ndarray]:
    """Shift the times after each boot to after those before it, in all channels alike."""
    shifted = {name: t.copy() for name, t in times.items()}
    n_boots = len(next(iter(begins.values())))
    for k in range(n_boots):
        ends = []
        starts = []
        for name, places in begins.items():
            first = places[k - 1] if k else 0
            last = places[k + 1] if k + 1 < n_boots else None
            ends.append(np.nanmax(shifted[name][first : places[k]]))
            starts.append(np.nanmin(shifted[name][places[k] : last]))
        shift = max(ends) + _BOOT_GAP - min(starts)
        for name, places in begins.items():
            shifted[name][places[k] :] += shift
    return shifted

"""Times of a clock that begins anew in a file: a counter that wraps goes on where that is certain, and
what was recorded after another boot comes after it, as a part of its own.

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
_NEXT = 5.0  # usual intervals within which a counter that wrapped goes on
_BACK = 1.0  # [s] by which a boot is set back, at least
_FEWEST = 10  # samples of a boot
_AFTER = 5  # samples after it which are all earlier than the one before it
_APART = 3.0  # [s] between boots, so that a recording is cut there
_AS_MUCH = 0.5  # [s] by which a jump forward differs from that back, of late messages


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ContinuedTimes:
    """Times of several channels, that go on where their clock began anew."""

    times: Mapping[str, np.ndarray]
    """(n,) [s] of each channel, in the order of the file."""
    wraps: int = 0
    """How often a counter wrapped."""
    boots: int = 0
    """How often a clock began anew."""
    back: float = 0.0
    """[s] by which it was set back at most."""


def continued(times: Mapping[str, np.ndarray]) -> ContinuedTimes:
    """Continue times (n,) [s] of each channel, in the order of its file; NaN stay."""
    unwrapped = {}
    most_wraps = 0
    for name, t in times.items():
        unwrapped[name], n_wraps = _unwrapped(t)
        most_wraps = max(most_wraps, n_wraps)
    begins = {name: _boots(t) for name, t in unwrapped.items()}
    numbers = {len(places) for places in begins.values()}
    n_boots = max(numbers, default=0)
    if len(numbers) != 1 or n_boots == 0:
        return ContinuedTimes(times=unwrapped, wraps=most_wraps)
    back = 0.0
    for name, places in begins.items():
        for place in places:
            back = max(back, float(unwrapped[name][place - 1] - unwrapped[name][place]))
    return ContinuedTimes(
        times=_one_after_the_other(unwrapped, begins),
        wraps=most_wraps,
        boots=n_boots,
        back=back,
    )


def _unwrapped(t: np.ndarray) -> tuple[np.ndarray, int]:
    """Add the modulus of a counter wherever t (n,) [s] falls by nearly that, and count these."""
    steps = np.diff(t)
    falls = np.flatnonzero(steps < 0.0)
    if not len(falls) or len(t) < _FEWEST:
        return t, 0
    forward = steps[steps > 0.0]
    if not len(forward):
        return t, 0
    near = _NEXT * float(np.median(forward))
    for modulus in _MODULI:
        is_within = np.nanmin(t) >= 0.0 and np.nanmax(t) < modulus
        goes_on = steps[falls] + modulus
        if is_within and near < 0.1 * modulus and ((goes_on > 0.0) & (goes_on <= near)).all():
            n_before = np.zeros(len(t))
            n_before[falls + 1] = 1.0
            return t + modulus * np.cumsum(n_before), len(falls)
    return t, 0


def _boots(t: np.ndarray) -> list[int]:
    """List the places in t (n,) [s] at which a clock begins anew."""
    places = []
    falls = np.flatnonzero(np.diff(t) < -_BACK) + 1
    for place in falls.tolist():
        before = t[place - 1]
        after = t[place : place + _AFTER]
        is_lasting = len(t) - place >= _FEWEST and bool((after < before).all())
        if is_lasting and not _returns(t[place:], before - t[place]):
            places.append(place)
    lengths = np.diff([0, *places, len(t)])
    return places if places and lengths.min() >= _FEWEST else []


def _returns(t: np.ndarray, fall: float) -> bool:
    """Check whether t (n,) [s], after a fall [s], jumps forward again by as much."""
    steps = np.diff(t)
    falls_again = np.flatnonzero(steps < -_BACK)
    until = falls_again[0] if len(falls_again) else len(steps)
    return bool((np.abs(steps[:until] - fall) < _AS_MUCH).any())


def _one_after_the_other(
    times: Mapping[str, np.ndarray], begins: Mapping[str, list[int]]
) -> dict[str, np.ndarray]:
    """Shift what follows each boot to after what comes before it, in all channels alike."""
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
        shift = max(ends) + _APART - min(starts)
        for name, places in begins.items():
            shifted[name][places[k] :] += shift
    return shifted

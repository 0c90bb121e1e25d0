"""Guess what columns without names hold: by their values, and by what those of some say of others.

What is looked for, one after the other, stands in ``proposed_mapping.toml`` as guesses; the names there are such as files with a
header have, and known by the forms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from uvms_ocp.identification import sample_checks as checks
from uvms_ocp.identification.recording import smoothed

_LEAST, _MOST = 100, 20_000  # rows that are looked at
_STEP, _WINDOW = 0.1, 1.5  # [s] assumed between rows, and to smooth over: magnitudes are compared, whatever their scale
_AGREES, _PLANAR, _SMOOTH = 0.8, 0.98, 0.15  # correlations; steps beside what values spread
_PEAKS, _PULSES = 95.0, (900.0, 2200.0)  # [%] of samples below peaks, as where an angle jumps; [us]


def guessed_names(places: Sequence[str], values: np.ndarray, guesses: Sequence[Mapping[str, Any]]) -> dict[str, tuple[str, str]]:
    """Guess a name, with the evidence for it, for columns (n, k) [as they are], by their places; unknown ones are left out."""
    known, labels = np.isfinite(values), dict[str, tuple[str, str]]()
    values = np.where(known.any(axis=0), values, 0.0)[known[:, known.any(axis=0)].all(axis=1)][:_MOST]
    if len(values) < _LEAST:
        return labels
    table = _Columns(values)
    for guess in (one for one in guesses if one["names"] not in table.found):
        conditions, names = guess.keys() & _CONDITIONS.keys(), guess["names"].split()
        for group in table.left(len(names)):
            if all(_CONDITIONS[key](table, group, guess[key]) for key in conditions):
                table.found[guess["names"]] = group
                said = f"{' to '.join(dict.fromkeys((places[group[0]], places[group[-1]])))}: {guess['why']}"
                labels |= {places[k]: (name, said) for k, name in zip(group, names, strict=True)}
                break
    return labels


class _Columns:
    """Columns of numbers, and those that have been found, by their names."""

    def __init__(self, values: np.ndarray) -> None:
        t = _STEP * np.arange(len(values))
        self.values, self.steps, self.spread = values, np.diff(values, axis=0), values.std(axis=0)
        self.smooth, self.rates = (smoothed(t, values, _WINDOW, derivative=k)[1] for k in (0, 1))
        self.found: dict[str, range] = {}

    def left(self, width: int) -> list[range]:
        free = np.ptp(self.values, axis=0) > 0.0
        free[[k for group in self.found.values() for k in group]] = False
        return [range(k, k + width) for k in range(len(free) - width + 1) if free[k : k + width].all()]

    def rates_of(self, pose: range) -> Iterator[range]:
        """Groups that are as large as the rate of a pose, whatever their axes."""
        for group in (one for one in self.left(3) if not set(one) & set(pose)):
            sizes = [np.linalg.norm(x, axis=1) for x in (self.rates[:, pose], self.smooth[:, group])]
            if checks.correlation(*(np.minimum(size, np.percentile(size, _PEAKS)) for size in sizes)) > _AGREES:
                yield group

    def is_planar(self, pose: range, group: range) -> bool:
        """Check whether a rate is turned by the third number of a pose, its heading."""
        plane, moved = (x[:, 0] + 1j * x[:, 1] for x in (self.rates[:, pose], self.smooth[:, group]))
        turned = float(np.vdot(plane * np.exp(-1j * self.smooth[:, pose[2]]), moved).real)
        return turned > _PLANAR * float(np.linalg.norm(plane) * np.linalg.norm(moved))

    def differ(self, group: range, size: float) -> float:
        """Share by which norms differ from a size, most of the time."""
        return float(np.percentile(np.abs(np.linalg.norm(self.values[:, group], axis=1) / size - 1.0), 90.0))

    def are_commands(self, group: range) -> bool:
        """Recognise pulse widths, and what stays from row to row."""
        pulses, held = (self.values > _PULSES[0]) & (self.values < _PULSES[1]), self.steps == 0.0
        return bool((pulses.all(axis=0) | (held.mean(axis=0) > 0.5))[list(group)].all())


_CONDITIONS: Mapping[str, Callable[[_Columns, range, Any], bool]] = {
    "rises": lambda of, one, by: bool((of.steps[:, one] >= 0.0).all() and (of.steps[:, one] > 0.0).mean() > by),
    "counts": lambda of, one, given: bool((of.steps[:, one] == 1.0).all()) is given,
    "size": lambda of, one, is_: of.differ(one, is_[0]) < is_[1],
    "rate_of": lambda of, one, names: names in of.found and one in of.rates_of(of.found[names]),
    "has_rate": lambda of, one, planar: any(of.is_planar(one, other) or not planar for other in of.rates_of(one)),
    "commands": lambda of, one, given: of.are_commands(one) is given,
    "smooth": lambda of, one, given: bool((of.steps[:, one].std(axis=0) < _SMOOTH * of.spread[one]).all()) is given,
    "begins_at": lambda of, one, within: bool(np.abs(of.values[:, one]).min() < within),
    "unless": lambda of, one, names: not set(names) & {name for group in of.found for name in group.split()},
}

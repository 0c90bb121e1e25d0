"""Guess the contents of columns without names, by their values and by how they agree: a column that
rises throughout is time, columns as large as the rate of a pose are its velocity.

The guesses, in their order, stand in ``proposed_mapping.toml``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.identification.resampling import smoothed
from uvms_ocp.identification.series_agreement import correlation

_MIN_ROWS = 100
_MAX_ROWS = 20_000
# [s] assumed between rows, and to smooth over: magnitudes are compared, whatever their scale
_STEP = 0.1
_WINDOW = 1.5
_MIN_CORRELATION = 0.8  # of the size of a rate with that of a velocity
_MIN_PLANAR_CORRELATION = 0.98  # of a rate, turned by a heading, with a velocity
_SMOOTH = 0.15  # largest standard deviation of steps, in those of the values
_PEAKS = 95.0  # [%] of samples below peaks, as where an angle jumps
_PULSES = (900.0, 2200.0)  # [us] of pulse widths


@dataclass(frozen=True, kw_only=True, slots=True)
class GuessedName:
    """A name for a column that has none."""

    name: str
    """Heading of a column of the same contents, such as ``roll``."""
    evidence: str
    """Columns that were guessed together, and the reason for the guess."""


def guessed_names(
    places: Sequence[str], values: np.ndarray, guesses: Sequence[Mapping[str, Any]]
) -> dict[str, GuessedName]:
    """Guess names for columns (n, k) [as they are], by their places; unknown ones are left out."""
    finite = np.isfinite(values)
    has_values = finite.any(axis=0)
    is_complete = finite[:, has_values].all(axis=1)
    complete_rows = np.where(has_values, values, 0.0)[is_complete][:_MAX_ROWS]
    guessed = dict[str, GuessedName]()
    if len(complete_rows) < _MIN_ROWS:
        return guessed

    columns = _Columns(complete_rows)
    for guess in guesses:
        group = _first_that_fits(columns, guess)
        if group is None:
            continue
        columns.groups[guess["names"]] = group
        ends = dict.fromkeys((places[group[0]], places[group[-1]]))
        evidence = f"{' to '.join(ends)}: {guess['why']}"
        for k, name in zip(group, guess["names"].split(), strict=True):
            guessed[places[k]] = GuessedName(name=name, evidence=evidence)
    return guessed


def _first_that_fits(columns: _Columns, guess: Mapping[str, Any]) -> range | None:
    """Return the first free group of columns that meets all conditions of a guess."""
    if guess["names"] in columns.groups:
        return None
    conditions = [key for key in _CONDITIONS if key in guess]
    n_names = len(guess["names"].split())
    for group in columns.free_groups(n_names):
        if all(_CONDITIONS[key](columns, group, guess[key]) for key in conditions):
            return group
    return None


class _Columns:
    """Columns of numbers, with the groups of them that have been named."""

    def __init__(self, values: np.ndarray) -> None:
        """values: (n, k) [as they are], finite."""
        t = _STEP * np.arange(len(values))
        self.values = values
        self.steps = np.diff(values, axis=0)
        self.std = values.std(axis=0)
        self.smooth = smoothed(t, values, _WINDOW, derivative=0)[1]
        self.rates = smoothed(t, values, _WINDOW, derivative=1)[1]
        self.groups: dict[str, range] = {}
        """Places of the columns of each guess that fits, by its names."""

    def free_groups(self, width: int) -> list[range]:
        """List groups of neighbouring columns that vary and have no name."""
        is_free = np.ptp(self.values, axis=0) > 0.0
        for group in self.groups.values():
            is_free[list(group)] = False
        groups = []
        for first in range(len(is_free) - width + 1):
            group = range(first, first + width)
            if is_free[list(group)].all():
                groups.append(group)
        return groups

    def rates_of(self, pose: range) -> Iterator[range]:
        """Yield groups as large as the rate of a pose, with any axes."""
        rate = _without_peaks(np.linalg.norm(self.rates[:, pose], axis=1))
        for group in self.free_groups(3):
            if set(group) & set(pose):
                continue
            size = _without_peaks(np.linalg.norm(self.smooth[:, group], axis=1))
            if correlation(rate, size) > _MIN_CORRELATION:
                yield group

    def is_planar_rate(self, pose: range, group: range) -> bool:
        """Check whether a group is the rate of a pose, turned by its third number, its heading."""
        rates = self.rates[:, pose]
        velocities = self.smooth[:, group]
        rate = rates[:, 0] + 1j * rates[:, 1]
        velocity = velocities[:, 0] + 1j * velocities[:, 1]
        heading = self.smooth[:, pose[2]]
        agreement = float(np.vdot(rate * np.exp(-1j * heading), velocity).real)
        largest = float(np.linalg.norm(rate) * np.linalg.norm(velocity))
        return agreement > _MIN_PLANAR_CORRELATION * largest

    # Conditions of guesses; the last argument is their value in the table.

    def rises(self, group: range, min_share: float) -> bool:
        """Check that values never fall, and rise in a share of all rows."""
        steps = self.steps[:, group]
        return bool((steps >= 0.0).all() and (steps > 0.0).mean() > min_share)

    def counts(self, group: range, expected: bool) -> bool:
        """Check whether values count the rows."""
        return bool((self.steps[:, group] == 1.0).all()) is expected

    def has_size(self, group: range, size_and_share: tuple[float, float]) -> bool:
        """Check that norms are of a size, within a share of it, most of the time."""
        size, max_share = size_and_share
        differences = np.abs(np.linalg.norm(self.values[:, group], axis=1) / size - 1.0)
        return float(np.percentile(differences, 90.0)) < max_share

    def is_rate_of(self, group: range, pose_names: str) -> bool:
        """Check that values are as large as the rate of a pose that has been named."""
        pose = self.groups.get(pose_names)
        return pose is not None and group in self.rates_of(pose)

    def has_rate(self, pose: range, planar: bool) -> bool:
        """Check that a free group is the rate of a pose, in a plane turned by its heading."""
        candidates = self.rates_of(pose)
        return any(self.is_planar_rate(pose, group) or not planar for group in candidates)

    def are_commands(self, group: range, expected: bool) -> bool:
        """Check whether values are pulse widths, or stay from row to row."""
        is_pulse = (self.values > _PULSES[0]) & (self.values < _PULSES[1])
        is_held = self.steps == 0.0
        is_command = is_pulse.all(axis=0) | (is_held.mean(axis=0) > 0.5)
        return bool(is_command[list(group)].all()) is expected

    def is_smooth(self, group: range, expected: bool) -> bool:
        """Check whether values change little from row to row."""
        steps_std = self.steps[:, group].std(axis=0)
        return bool((steps_std < _SMOOTH * self.std[group]).all()) is expected

    def begins_at(self, group: range, max_size: float) -> bool:
        """Check that a value comes near zero."""
        return bool(np.abs(self.values[:, group]).min() < max_size)

    def lacks(self, _: range, names: Sequence[str]) -> bool:
        """Check that no column has been given any of some names."""
        known_names = set(" ".join(self.groups).split())
        return known_names.isdisjoint(names)


def _without_peaks(values: np.ndarray) -> np.ndarray:
    """Clip values (n,) [any] from above at their percentile `_PEAKS`."""
    return np.minimum(values, np.percentile(values, _PEAKS))


_CONDITIONS: Mapping[str, Callable[[_Columns, range, Any], bool]] = {
    "rises": _Columns.rises,
    "counts": _Columns.counts,
    "size": _Columns.has_size,
    "rate_of": _Columns.is_rate_of,
    "has_rate": _Columns.has_rate,
    "commands": _Columns.are_commands,
    "smooth": _Columns.is_smooth,
    "begins_at": _Columns.begins_at,
    "unless": _Columns.lacks,
}

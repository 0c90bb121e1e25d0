"""Find swings: of an error, or of a vehicle that no thruster holds, while they happen and at the
end of a run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from functools import lru_cache

import numpy as np

from uvms_ocp.checks import checked_dataclass

WINDOW = 20.0
"""[s] Time in which a swing is looked for."""
_MIN_TILT = 0.035
"""[rad] Half a regular swing of roll or pitch that counts."""
_MIN_TUMBLE = 0.15
"""[rad] Half an irregular swing of roll or pitch that counts."""
_MAX_IRREGULARITY = 0.3
"""Standard deviation of the half periods of a regular swing over their mean."""
_MIN_HALVES = 4
"""Half periods of a swing."""
_SAMPLE_PERIOD = 0.1
"""[s] Time between values, while a run lasts."""
_SEARCH_PERIOD = 1.0
"""[s] Time between searches, while a run lasts."""


@checked_dataclass()
class Swing:
    """An oscillation at the end of a run, or of the time so far."""

    what: str
    """Name of the quantity that swings, or roll or pitch of the vehicle."""
    period: float
    """[s] Period."""
    amplitude: float
    """[unit of the quantity, or rad] Half of what it covers at the end."""
    growth: float
    """[-] Ratio of the amplitude to that of one period before."""
    regular: bool = True
    """True where its periods are alike."""

    def __str__(self) -> str:
        if self.growth > 1.02:
            trend = "growing"
        elif self.growth < 0.98:
            trend = "dying away"
        else:
            trend = "neither growing nor dying away"
        if self.regular:
            rhythm = f"every {self.period:.2g} s"
        else:
            rhythm = f"irregularly, every {self.period:.2g} s or so"
        return f"{self.what} swings by +-{self.amplitude:.2g} {rhythm}, {trend}"


def swing_of(name: str, values: np.ndarray, dt: float) -> Swing | None:
    """Return the oscillation of values (n,) about their trend at the period dt [s]; `None` for
    none.
    """
    n = len(values)
    if n < 2 * _MIN_HALVES or not np.isfinite(values).all():
        return None
    parabolas = _parabolas(n)
    deviations = values - parabolas @ (parabolas.T @ values)
    # Where the sign turns, among deviations that are not small.
    large = np.flatnonzero(np.abs(deviations) > 0.5 * deviations.std())
    turns = large[1:][np.diff(np.sign(deviations[large])) != 0]
    half_periods = np.diff(turns)  # in values
    if len(half_periods) < _MIN_HALVES:
        return None
    amplitudes = []
    for start, end in zip(turns[:-2], turns[2:], strict=True):
        amplitudes.append(np.ptp(deviations[start : end + 1]) / 2)
    periods = np.arange(len(amplitudes)) / 2
    log_growth, _ = np.polyfit(periods, np.log(np.maximum(amplitudes, 1e-12)), 1)
    return Swing(
        what=name,
        period=float(2 * dt * half_periods.mean()),
        amplitude=float(amplitudes[-1]),
        growth=float(np.exp(log_growth)),
        regular=bool(half_periods.std() <= _MAX_IRREGULARITY * half_periods.mean()),
    )


@lru_cache(maxsize=8)
def _parabolas(n: int) -> np.ndarray:
    """Return orthonormal columns (n, 3) whose sums are all parabolas over n points; cached, as
    every search needs them.
    """
    return np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n), 3))[0]


def tilts_of(q: np.ndarray) -> dict[str, np.ndarray]:
    """Return roll and pitch (n,) [rad] of configurations q (n, n_q) [m, rad] of a free-flyer, by
    name.
    """
    x, y, z, w = q[:, 3:7].T
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return {"roll": roll, "pitch": np.arcsin(np.clip(2 * (w * y - x * z), -1, 1))}


def swings_among(
    errors: Mapping[str, tuple[np.ndarray, float]], tilts: Mapping[str, np.ndarray], dt: float
) -> Iterator[Swing]:
    """Yield what swings among errors (n,) with the limit that each must fall below, and roll and
    pitch (n,) [rad].

    dt [s]: between values. An error counts where half a regular swing is more than half of its
    limit and it grows again by half of that, so that one that only falls, now slower and now
    faster, is none; a tilt by more than 2 deg, or by more than 9 deg with whatever periods.
    """
    for name, (values, limit) in errors.items():
        swing = swing_of(name, values, dt)
        if swing is None or not swing.regular or swing.amplitude <= limit / 2:
            continue
        if np.max(values - np.minimum.accumulate(values)) > swing.amplitude / 2:
            yield swing
    for name, values in tilts.items():
        swing = swing_of(name, values, dt)
        if swing is None:
            continue
        smallest_amplitude = _MIN_TILT if swing.regular else _MIN_TUMBLE
        if swing.amplitude > smallest_amplitude:
            yield swing


class SwingWatch:
    """Tells of each swing of a phase once, while it happens. Remembers the last seconds: build one
    per run.
    """

    def __init__(self, dt: float, *, floating: bool) -> None:
        """dt [s]: control period; floating: the vehicle has roll and pitch."""
        self._ticks = max(1, round(_SAMPLE_PERIOD / dt))
        """Ticks from value to value."""
        self._floating = floating
        self._dt = self._ticks * dt
        n_values = max(round(WINDOW / self._dt), 2 * _MIN_HALVES)
        self._q = deque[np.ndarray](maxlen=n_values)
        self._errors = deque[np.ndarray](maxlen=n_values)
        self._count = 0
        """Number of ticks so far."""
        self._phase = -1
        self._reported: set[str] = set()
        """Names of quantities that were reported to swing in this phase."""

    @property
    def due(self) -> int:
        """Ticks until the next that is looked at."""
        return self._ticks - self._count % self._ticks

    def after(
        self,
        phase: int,
        q: np.ndarray,
        errors: np.ndarray,
        limits: Mapping[int, tuple[str, float]],
        ticks: int = 1,
    ) -> list[Swing]:
        """Return what is seen to swing for the first time in a phase at q (n_q,) [m, rad] with
        errors (n,) [in their units].

        limits: of the errors that the phase waits for, by index, with their names. ticks: since the
        last call, at most `due`.
        """
        if phase != self._phase:
            self._phase = phase
            self._reported = set()
            self._errors.clear()
        self._count += ticks
        if self._count % self._ticks:
            return []
        self._q.append(q.copy())
        self._errors.append(errors.copy())
        if self._count % (self._ticks * round(_SEARCH_PERIOD / _SAMPLE_PERIOD)):
            return []
        past_errors = np.array(self._errors)
        awaited_errors = {name: (past_errors[:, k], limit) for k, (name, limit) in limits.items()}
        tilts = dict[str, np.ndarray]()
        if self._floating:
            tilts = tilts_of(np.array(self._q))
        new_swings = list[Swing]()
        for swing in swings_among(awaited_errors, tilts, self._dt):
            if swing.what not in self._reported:
                new_swings.append(swing)
        for swing in new_swings:
            self._reported.add(swing.what)
        return new_swings

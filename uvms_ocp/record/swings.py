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
"""[s] in which a swing is looked for."""
# [rad] half a swing of roll or pitch that counts, and one that does without being regular
_TILT = 0.035
_TUMBLE = 0.15
# spread of the half periods, as a share of their mean, from which on it is no regular swing
_REGULAR = 0.3
_HALVES = 4  # half periods at least
# [s] between values, and between searches, while a run lasts
_EVERY = 0.1
_ASKED = 1.0


@checked_dataclass()
class Swing:
    """An oscillation at the end of a run, or of the time so far."""

    what: str
    """Quantity, or roll or pitch of the vehicle."""
    period: float
    """Period [s]."""
    amplitude: float
    """Half of what it covers at the end [unit of the quantity, or rad]."""
    growth: float
    """Ratio of the amplitude to that of one period before [-]."""
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
    if n < 2 * _HALVES or not np.isfinite(values).all():
        return None
    parabolas = _parabolas(n)
    deviations = values - parabolas @ (parabolas.T @ values)
    large = np.flatnonzero(np.abs(deviations) > 0.5 * deviations.std())
    turns = large[1:][np.diff(np.sign(deviations[large])) != 0]
    halves = np.diff(turns)
    if len(halves) < _HALVES:
        return None
    peaks = np.array(
        [np.ptp(deviations[a : b + 1]) / 2 for a, b in zip(turns[:-2], turns[2:], strict=True)]
    )
    growth = float(
        np.exp(np.polyfit(np.arange(len(peaks)) / 2, np.log(np.maximum(peaks, 1e-12)), 1)[0])
    )
    regular = bool(halves.std() <= _REGULAR * halves.mean())
    return Swing(
        what=name,
        period=float(2 * dt * halves.mean()),
        amplitude=float(peaks[-1]),
        growth=growth,
        regular=regular,
    )


@lru_cache(maxsize=8)
def _parabolas(n: int) -> np.ndarray:
    """Return orthonormal columns (n, 3) whose sums are all parabolas over n points: what is kept,
    as this is asked every second.
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
        if swing is not None and swing.amplitude > (_TILT if swing.regular else _TUMBLE):
            yield swing


class SwingWatch:
    """Tells of each swing of a phase once, while it happens. Remembers the last seconds: build one
    per run.
    """

    def __init__(self, dt: float, *, floating: bool) -> None:
        """dt [s]: control period; floating: the vehicle has roll and pitch."""
        self._ticks = max(1, round(_EVERY / dt))
        self._floating = floating
        self._dt = self._ticks * dt
        self._q, self._errors = (
            deque[np.ndarray](maxlen=max(round(WINDOW / self._dt), 2 * _HALVES)) for _ in range(2)
        )
        self._count = 0
        self._phase = -1
        self._known: set[str] = set()

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
            self._known = set()
            self._errors.clear()
        self._count += ticks
        if self._count % self._ticks:
            return []
        self._q.append(q.copy())
        self._errors.append(errors.copy())
        if self._count % (self._ticks * round(_ASKED / _EVERY)):
            return []
        past_errors = np.array(self._errors)
        awaited_errors = {name: (past_errors[:, k], limit) for k, (name, limit) in limits.items()}
        if self._floating:
            tilts = tilts_of(np.array(self._q))
        else:
            tilts = {}
        new_swings = [
            swing
            for swing in swings_among(awaited_errors, tilts, self._dt)
            if swing.what not in self._known
        ]
        self._known |= {swing.what for swing in new_swings}
        return new_swings

"""Draw motions as a person would choose them, steps and chirps, with which designs are compared."""

from __future__ import annotations

import numpy as np

_HOLD = 2.0  # [s] of a step
_SLOWEST = 0.1  # [Hz] of chirps
_FASTEST = 1.0  # [Hz] of chirps


def steps(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Push axis after axis ahead and back, (n, 6) [-] at t (n,) [s]; half as far in every other
    turn.
    """
    place = (t / _HOLD).astype(int)
    size = np.where(place // 12 % 2, 0.5, 1.0)
    sign = np.where(place % 2, -1.0, 1.0)
    is_pushed = place[:, None] // 2 % 6 == np.arange(6)
    return np.asarray((size * sign)[:, None] * is_pushed)


def chirps(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Swing axis after axis, from slow to fast, (n, 6) [-] at t (n,) [s]."""
    duration = (t[-1] + t[1]) / 6
    since = t % duration
    mean_frequency = _SLOWEST + (_FASTEST - _SLOWEST) * since / duration / 2
    wave = np.cos(2 * np.pi * mean_frequency * since)
    is_swung = (t / duration).astype(int)[:, None] == np.arange(6)
    return np.asarray(wave[:, None] * is_swung)


def both(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw steps and chirps of all axes at once, (n, 6) [-] at t (n,) [s]."""
    shape = (int(t[-1] / 3) + 1, 6)
    sizes = rng.uniform(-1, 1, size=shape)
    is_pushed = rng.uniform(size=shape) < 0.5
    mean_frequency = 0.05 + 0.15 * t / t[-1]
    chirp = 0.3 * np.sin(2 * np.pi * mean_frequency[:, None] * t[:, None] + np.arange(6))
    return np.asarray((sizes * is_pushed)[(t / 3).astype(int)] + chirp)


BY_HAND = {"steps": steps, "chirps": chirps, "steps and chirps": both}
"""Thrust as one would think of it, by name."""

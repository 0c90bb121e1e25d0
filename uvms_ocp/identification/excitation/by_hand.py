"""Thrust as one would think of it: steps, chirps, and both at once; each flown within the same pool, as large as it allows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uvms_ocp.identification.excitation.assignment import Assignment
from uvms_ocp.identification.excitation.expected import DesignStatus, Excitation, excitation_of
from uvms_ocp.identification.excitation.keeping import kept_inside
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.recordings.recording import Channel

STEP = 0.05
"""[s] for which a command is held."""
_SHARES = np.linspace(1.0, 0.05, 20)  # of the largest thrust, tried one after the other
_HOLD = 2.0  # [s] of a step
_SLOWEST, _FASTEST = 0.1, 1.0  # [Hz] of chirps


def steps(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Axis after axis ahead and back, (n, 6) [-] at t (n,) [s]; half as far in every other turn."""
    place = (t / _HOLD).astype(int)
    size = np.where(place // 12 % 2, 0.5, 1.0) * np.where(place % 2, -1.0, 1.0)
    return np.asarray(size[:, None] * (place[:, None] // 2 % 6 == np.arange(6)))


def chirps(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Axis after axis, from slow to fast, (n, 6) [-] at t (n,) [s]."""
    each = (t[-1] + t[1]) / 6
    since = t % each
    wave = np.cos(2 * np.pi * (_SLOWEST + (_FASTEST - _SLOWEST) * since / each / 2) * since)
    return np.asarray(wave[:, None] * ((t / each).astype(int)[:, None] == np.arange(6)))


def both(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Drawn steps of all axes at once, chirps beside them, (n, 6) [-] at t (n,) [s]."""
    shape = int(t[-1] / 3) + 1, 6
    drawn = rng.uniform(-1, 1, size=shape) * (rng.uniform(size=shape) < 0.5)
    chirp = 0.3 * np.sin(2 * np.pi * (0.05 + 0.15 * t / t[-1])[:, None] * t[:, None] + np.arange(6))
    return np.asarray(drawn[(t / 3).astype(int)] + chirp)


BY_HAND: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {
    "steps": steps,
    "chirps": chirps,
    "steps and chirps": both,
}


def largest(given: Assignment, rollout: Rollout, name: str, seed: int = 0) -> Excitation:
    """One of these, as large as it may be."""
    t = STEP * np.arange(round(given.duration / STEP))
    wanted = BY_HAND[name](t, np.random.default_rng(seed))
    for share in _SHARES:
        told = kept_inside(given, rollout, share * wanted, STEP)
        found = excitation_of(given, rollout, Channel(t=t, values=told))
        if found.status is DesignStatus.INSIDE:
            break
    return found

"""A probe: a wave of thrust whose wrench is zero while all thrusters are sound, and tells which is not.

Water does not know the wave, so that what follows it in the residual is a fault, whatever else pushes. A thruster that
falls short by theta leaves ``-theta b_i`` of its part of the wave.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.control.actuator_health.innovation import Innovation
from uvms_ocp.control.actuator_health.thresholds import HealthTuning

_CANCELLED = 1e-6  # relative wrench that counts as none
_LEAST_PART = 0.2  # of the thruster in question in a wave
_PLAUSIBLE = (-0.25, 2.5)  # theta
_BESIDE = (-2, -1, 1, 2)  # periods per window, more than those of the wave, that tell the noise


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Answer:
    """What a probe says."""

    thrusters: tuple[int, ...]
    """Those that fall short."""
    theta: np.ndarray
    """(k,) [-] by how much each of them, share of what it is asked."""
    gain: float
    """[-] over all being sound, in variances."""
    lead: float
    """[-] over the next best answer."""
    sigma: float = math.inf
    """[-] largest standard deviation of theta, of any thruster that was moved."""


def wave_of(matrix: np.ndarray, thruster: int) -> np.ndarray | None:
    """Shares (n,) [-], at most 1, that move a thruster and cancel in the wrench of matrix (6, n) [N/N, N m/N]; or `None`."""
    moved = np.linalg.norm(matrix, axis=0) > 0.0
    _, s, Vt = np.linalg.svd(matrix)
    rank = int((s > _CANCELLED * s.max(initial=1e-300)).sum())
    N = Vt[rank:].T * moved[:, None]
    wave = N @ N[thruster]
    largest = float(np.abs(wave).max(initial=0.0))
    if largest == 0.0 or abs(wave[thruster]) < _LEAST_PART * largest:
        return None
    return wave / largest


class Probe:
    """One wave, and what followed it; the noise is that of the frequencies beside it in the same window."""

    def __init__(self, matrix: np.ndarray, wave: np.ndarray, t: float, tuning: HealthTuning) -> None:
        """matrix (6, n) [N/N, N m/N]; wave (n,) [N] amplitudes; t [s] now."""
        self._matrix, self._wave, self._begin, self._tuning = matrix, wave, t, tuning
        self._omega = 2.0 * math.pi / tuning.probe_period
        self._looked_from = t + tuning.probe_period
        self._mean: np.ndarray | None = None
        self._seen: list[np.ndarray] = []
        self._asked: list[np.ndarray] = []
        self._floor = np.zeros(6)

    def thrust(self, t: float) -> np.ndarray:
        """(n,) [N] to add at time t [s]."""
        return self._wave * math.sin(self._omega * (t - self._begin))

    @property
    def cycles(self) -> int:
        """Complete periods that were looked at, if there was no more than that, else 0."""
        per_cycle = self._tuning.probe_period / self._tuning.sample_time
        n = round(len(self._seen) / per_cycle)
        return n if n and abs(n * per_cycle - len(self._seen)) < 0.5 else 0

    def look(self, thrust: np.ndarray, innovation: Innovation, t: float) -> None:
        """Take in the filtered thrust (n,) [N] asked and the newest innovation at time t [s]."""
        if self._mean is None:
            self._mean = thrust.copy()
        change = thrust - self._mean
        self._mean = self._mean + innovation.share * change
        if t >= self._looked_from - 1e-9:
            self._seen.append(innovation.value)
            self._asked.append(change)
            self._floor = innovation.floor

    def answer(self) -> Answer:
        """The fewest thrusters that explain what followed the wave."""
        columns, y = self._whitened()
        sigma = float(1.0 / np.linalg.norm(columns[:, self.moved], axis=0).min())
        found = sorted(self._fits(columns, y), key=lambda fit: -fit.gain)
        single = [fit for fit in found if len(fit.thrusters) == 1]
        return replace(self._chosen(single, found), sigma=sigma)

    @property
    def moved(self) -> list[int]:
        """Thrusters that the wave moves."""
        return [int(i) for i in np.flatnonzero(np.abs(self._wave) > _LEAST_PART * np.abs(self._wave).max())]

    def single(self, thruster: int) -> tuple[float, float]:
        """Theta [-] of one thruster, were it the only one, and its standard deviation."""
        columns, y = self._whitened()
        size = max(float(columns[:, thruster] @ columns[:, thruster]), np.finfo(float).tiny)
        return float(columns[:, thruster] @ y) / size, 1.0 / math.sqrt(size)

    def _chosen(self, single: list[Answer], found: list[Answer]) -> Answer:
        best = single[0] if single else None
        if best is None or (found and found[0].gain > best.gain + self._tuning.fault_gain):
            best = found[0] if found else Answer(thrusters=(), theta=np.zeros(0), gain=0.0, lead=0.0)
        rivals = [fit.gain for fit in found if len(fit.thrusters) <= len(best.thrusters) and fit is not best]
        lead = best.gain - max(rivals, default=0.0)
        return replace(best, lead=lead)

    def _whitened(self) -> tuple[np.ndarray, np.ndarray]:
        """Residual of a thruster that gives nothing (12, n), and what was seen (12,), in standard deviations."""
        n, seen = len(self._seen), np.array(self._seen)
        bins = self.cycles + np.array([0, *_BESIDE])
        turns = np.exp(-2j * np.pi / n * np.outer(bins, np.arange(n)))
        at, beside = turns[0] @ seen, turns[1:] @ seen
        variance = 0.5 * np.mean(np.abs(beside) ** 2, axis=0) + 0.5 * n * self._floor
        scale = 1.0 / np.sqrt(variance)
        columns = -(scale[:, None] * self._matrix) * (turns[0] @ np.array(self._asked))
        y = scale * at
        return np.vstack([columns.real, columns.imag]), np.concatenate([y.real, y.imag])

    def _fits(self, columns: np.ndarray, y: np.ndarray) -> Iterator[Answer]:
        moved = self.moved
        for chosen in (*((i,) for i in moved), *itertools.combinations(moved, 2)):
            A = columns[:, chosen]
            theta = np.linalg.lstsq(A, y, rcond=None)[0]
            if ((theta > _PLAUSIBLE[0]) & (theta < _PLAUSIBLE[1])).all():
                left = y - A @ theta
                yield Answer(thrusters=chosen, theta=theta, gain=float(y @ y - left @ left), lead=0.0)

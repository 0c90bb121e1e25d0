"""Since when does the fault of one thruster explain the motion best: likelihood ratios over thrusters and onsets.

Generalised likelihood ratio of an additive fault with unknown size and onset ([Willsky1976]). Thruster i that gives
``(1 - theta) T_i + alpha`` in place of T_i leaves a residual ``b_i (alpha - theta T_i)``: two known shapes in time along one
known direction, which pass the same filters as the residual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uvms_ocp.control.actuator_health.innovation import CONSTANT_GAIN, LARGEST_LOSS, TINY, Innovation

_SLOTS = 12  # onsets that are kept
_GAP = 5  # looks between them
_SMALLEST = 0.25  # theta of a fault


@dataclass(frozen=True, kw_only=True, slots=True)
class Suspicion:
    """The thruster that explains the motion best, if it is one."""

    thruster: int
    theta: float
    """[-] what it does not give, share of what it is asked."""
    sigma: float
    """[-] of theta."""
    gain: float
    """[-] over no fault, in variances."""
    lead: float
    """[-] of that over the next best thruster."""
    misfit: float
    """[-] what is left to explain, in its own standard: 1 where noise alone is."""
    onset: float
    """[s]"""


class OnsetBank:
    """Sums of squares of all hypotheses. Holds them: one per run."""

    def __init__(self, matrix: np.ndarray, *, bandwidth: float, correlation: float) -> None:
        """matrix (6, n) [N/N, N m/N] of the thrusters; bandwidth [rad/s] of the filter that the residual has passed;
        correlation [-] as in `HealthTuning`."""
        self._matrix, self._square, self._bandwidth = matrix, matrix**2, bandwidth
        self._correlation = correlation
        n = matrix.shape[1]
        self._onset = np.full(_SLOTS, -np.inf)
        self._thrust0, self._mean1 = np.zeros((_SLOTS, n)), np.zeros((_SLOTS, n))
        self._mean2, self._energy, self._looks = np.zeros(_SLOTS), np.zeros(_SLOTS), np.zeros(_SLOTS)
        self._J, self._y = np.zeros((3, _SLOTS, n)), np.zeros((2, _SLOTS, n))
        self._next, self._count = 0, 0

    def clear(self) -> None:
        """Forget all onsets."""
        self._onset[:], self._count = -np.inf, 0
        for array in (self._mean1, self._mean2, self._energy, self._looks, self._J, self._y):
            array[...] = 0.0

    def look(self, thrust: np.ndarray, innovation: Innovation, t: float, *, keep: bool) -> None:
        """Take in the filtered thrust (n,) [N] asked and the newest innovation at time t [s]; keep: begin no new onset."""
        if not keep:
            if self._count % _GAP == 0:
                self._begin(thrust, t)
            self._count += 1
        decay = np.exp(self._bandwidth * np.minimum(self._onset - t, 0.0))
        shape1 = thrust - self._thrust0 * decay[:, None] - self._mean1
        shape2 = 1.0 - decay - self._mean2
        self._mean1 += innovation.share * shape1
        self._mean2 += innovation.share * shape2
        c, p = innovation.weight @ self._square, (innovation.weight * innovation.value) @ self._matrix
        constant = shape2[:, None]
        self._J += np.array([shape1 * shape1, shape1 * constant, np.broadcast_to(constant**2, shape1.shape)]) * c
        self._y += np.array([shape1, np.broadcast_to(constant, shape1.shape)]) * p
        self._energy += float(innovation.weight @ innovation.value**2)
        self._looks += 1.0

    def best(self, asked: np.ndarray) -> Suspicion:
        """The likeliest single fault of the thrusters that are asked for; asked (n,) [-]: whether each is."""
        gain = np.where(asked, self._gains(), 0.0)
        by_thruster = gain.max(axis=0)
        i = int(by_thruster.argmax())
        slot = int(gain[:, i].argmax())
        rest = np.delete(by_thruster, i).max(initial=0.0)
        size = max(float(self._J[0, slot, i]), TINY)
        expected = 6.0 * max(float(self._looks[slot]), 1.0) / self._correlation
        return Suspicion(
            thruster=i,
            theta=float(-self._y[0, slot, i] / size),
            sigma=1.0 / math.sqrt(size),
            gain=float(by_thruster[i]),
            lead=float(by_thruster[i] - rest),
            misfit=float(self._energy[slot] - by_thruster[i]) / expected,
            onset=float(self._onset[slot]),
        )

    def _begin(self, thrust: np.ndarray, t: float) -> None:
        k = self._next
        self._onset[k], self._thrust0[k] = t, thrust
        for array in (self._mean1, self._mean2, self._energy, self._looks):
            array[k] = 0.0
        self._J[:, k], self._y[:, k] = 0.0, 0.0
        self._next = (k + 1) % _SLOTS

    def _gains(self) -> np.ndarray:
        """Of the better of both: a share that is missing, or a thruster that follows no more, (slots, n) [-]."""
        J11, J12, J22 = np.maximum(self._J[0], TINY), self._J[1], np.maximum(self._J[2], TINY)
        theta = -self._y[0] / J11
        share = np.where((theta > _SMALLEST) & (theta < LARGEST_LOSS), theta**2 * J11, 0.0)
        stuck = -2.0 * self._y[0] - J11 + (self._y[1] + J12) ** 2 / J22 - CONSTANT_GAIN
        return np.where(np.isfinite(self._onset)[:, None], np.maximum(share, stuck), 0.0)

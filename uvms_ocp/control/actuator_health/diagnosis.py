"""Since when and how a thruster fails, from all that was seen lately: every onset against every kind of fault.

The onsets of `OnsetBank` are few, which is enough to suspect. A thruster that is stuck differs from one that is dead by
the step at its onset alone, so that this must be found to a look.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from uvms_ocp.control.actuator_health.innovation import CONSTANT_GAIN, LARGEST_LOSS, TINY, Innovation

_LOOKS = 120  # that are kept
_AFTER = 8  # looks that an onset must be back at least
_SMALLEST = 0.2  # theta of a fault


@dataclass(frozen=True, kw_only=True, slots=True)
class Diagnosis:
    """The likeliest fault of one thruster."""

    missing: float
    """[-] of what it is asked, share."""
    constant: float
    """[N] that it gives instead, if it follows no more; else 0."""
    sigma: float
    """[N] of the constant."""
    onset: float
    """[s]"""
    gain: float
    """[-] over no fault, in variances."""
    stuck_lead: float
    """[-] gain of following no more over missing a share."""


class Window:
    """What was seen lately. Holds it: one per run."""

    def __init__(self, matrix: np.ndarray, *, bandwidth: float) -> None:
        """matrix (6, n) [N/N, N m/N]; bandwidth [rad/s] of the filter that the residual has passed."""
        self._matrix, self._bandwidth = matrix, bandwidth
        self._looks: deque[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=_LOOKS)

    def clear(self) -> None:
        """Forget everything."""
        self._looks.clear()

    def look(self, thrust: np.ndarray, innovation: Innovation, t: float) -> None:
        """Take in the filtered thrust (n,) [N] asked and the newest innovation at time t [s]."""
        self._looks.append((t, thrust.copy(), innovation.value, innovation.weight))

    def diagnosis(self, thruster: int, *, share: float, memory: float, theta: float, sigma: float) -> Diagnosis:
        """Of a thruster that has given `share` [-] so far and of which a probe has found theta +- sigma [-] missing.

        memory [-]: share of a change that is forgotten until the next look, as in `Innovation`.
        """
        t = np.array([look[0] for look in self._looks])
        thrust = np.array([look[1][thruster] for look in self._looks])
        b = self._matrix[:, thruster]
        c = np.array([b**2 @ look[3] for look in self._looks])
        p = np.array([b @ (look[2] * look[3]) for look in self._looks])
        J, y = self._sums(t, thrust, memory, c, p)
        J[0] += 1.0 / sigma**2
        y[0] -= theta / sigma**2
        return _likeliest(t, J, y, share)

    def _sums(
        self, t: np.ndarray, thrust: np.ndarray, memory: float, c: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sums of squares (3, n) and products (2, n) of both shapes for each onset, from it to now."""
        n = len(t)
        J, y = np.zeros((3, n)), np.zeros((2, n))
        mean1, mean2 = np.zeros(n), np.zeros(n)
        for k in range(n):
            decay = np.exp(self._bandwidth * np.minimum(t - t[k], 0.0))[: k + 1]
            shape1 = thrust[k] - thrust[: k + 1] * decay - mean1[: k + 1]
            shape2 = 1.0 - decay - mean2[: k + 1]
            mean1[: k + 1] += memory * shape1
            mean2[: k + 1] += memory * shape2
            J[:, : k + 1] += c[k] * np.array([shape1 * shape1, shape1 * shape2, shape2 * shape2])
            y[:, : k + 1] += p[k] * np.array([shape1, shape2])
        return J, y


def _likeliest(t: np.ndarray, J: np.ndarray, y: np.ndarray, given: float) -> Diagnosis:
    J11, J12, J22 = np.maximum(J[0], TINY), J[1], np.maximum(J[2], TINY)
    missing = -y[0] / J11
    share = np.where((missing > _SMALLEST) & (missing < LARGEST_LOSS), missing**2 * J11, 0.0)
    constant = (y[1] + given * J12) / J22
    stuck = -2.0 * given * y[0] - given**2 * J11 + constant**2 * J22 - CONSTANT_GAIN
    share[-_AFTER:], stuck[-_AFTER:] = 0.0, 0.0
    k, m = int(share.argmax()), int(stuck.argmax())
    lead = float(stuck[m] - share[k])
    best = m if lead > 0.0 else k
    return Diagnosis(
        missing=float(missing[k]),
        constant=float(constant[m]),
        sigma=float(1.0 / np.sqrt(J22[m])),
        onset=float(t[best]),
        gain=float(max(stuck[m], share[k])),
        stuck_lead=lead,
    )

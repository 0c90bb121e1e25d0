"""Net weight and mass of a load from disturbances: an extended Kalman filter of what does not change by itself.

Beside both it knows the current, whose drag pushes the hull and the arm as the model says, and a lasting force on every axis,
for what the model lacks. A weight is told from these by its moment arm and by the torques of the joints.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from uvms_ocp.control.load.learning import LoadLearning
from uvms_ocp.exceptions import InvalidInput

WEIGHT, MASS, CURRENT, LASTING = 0, 1, slice(2, 5), 5
"""Where the state has them."""
_MEMORY = 10.0  # [s] over which the size of the noise is taken
_OUTLIER = 3.0  # times its size, beyond which a change of the noise counts as that
_FIRST_NOISE, _COOLING = 300.0, 1.0  # times that noise is taken for more at first, and [s] after which it is by e less
_PATIENCE = 3  # looks at a surprise, one after the other, that are one
_NO_FORCE = 1e-6  # [N, N m] what rounding leaves of an axis that no thruster acts on
_COLOUR = 4.0  # [-] noise of an observer is alike for so many times 1 / bandwidth, by the integral of its correlation


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Look:
    """At the disturbance, with how it would come about."""

    disturbance: np.ndarray
    """(n_v,) [N, N m] found."""
    weight: np.ndarray
    """(n_v,) [N, N m] that 1 N of net weight makes of it."""
    mass: np.ndarray
    """(n_v,) [N, N m] that 1 kg makes of it."""
    drag: np.ndarray
    """(n_v,) [N, N m] of a current, to which `slopes` times it are to be added."""
    slopes: np.ndarray
    """(n_v, 3) [N s/m, N s]"""
    velocity: np.ndarray
    """(3,) [m/s] of the tool in W."""
    known: np.ndarray
    """(n_v,) [-] whether an axis tells anything."""


class LoadFilter:
    """What is known of a load. Holds it: build one per run."""

    def __init__(self, settings: LoadLearning, limit: np.ndarray, bandwidth: np.ndarray) -> None:
        """limit (n_v,) [N, N m] of thrusters and motors; bandwidth (n_v,) [rad/s] of the observer.

        Raises `InvalidInput` for a limit that is none, or nothing.
        """
        n = require_limits(limit)
        self._settings, self._last = settings, deque[np.ndarray](maxlen=_looks_apart(settings, bandwidth))
        lasting = (settings.lasting * limit) ** 2
        known = [settings.weight**2, settings.mass**2, *3 * [settings.current**2]]
        self._prior = np.concatenate([known, lasting])
        self._least = (settings.unsteady * limit) ** 2
        self._variance = self._least.copy()
        self._colour = np.maximum(_COLOUR / bandwidth, settings.alike) / settings.period
        self._surprised, self._waits, self._heat = 0, 0, _FIRST_NOISE
        self.x = np.zeros(LASTING + n)
        """(5 + n_v,) net weight [N], mass [kg], current (3,) [m/s] in W, lasting force (n_v,) [N, N m]."""
        self.P = np.diag(self._prior)
        """Its covariance."""

    def error(self, place: int) -> float:
        """Standard error of an entry of `x`, in its unit, with that of the scale."""
        return math.hypot(math.sqrt(self.P[place, place]), self._settings.scale * self.x[place])

    def take(self, look: Look) -> None:
        """One look, a period after the last."""
        self._forget()
        H, missed = self._rows(look)
        self._listen(missed, look.known)
        if self._is_another(H, missed, look.known):
            self._begin_anew()
        if self._waits:
            self._waits -= 1
            return
        noise = (1.0 + self._cooled()) * self._colour * self._variance_of(look) + self._unseen(look)
        self._correct(H[look.known], missed[look.known], noise[look.known])

    def _rows(self, look: Look) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (n_v, 5 + n_v) of the disturbance, and what of it is not expected (n_v,) [N, N m]."""
        mass = look.mass if self._accelerates(look) else np.zeros_like(look.mass)
        H = np.column_stack([look.weight, mass, look.slopes, np.eye(len(mass))])
        return H, look.disturbance - H @ self.x - look.drag

    def _accelerates(self, look: Look) -> bool:
        """Whether the tool does, by so much that it shows."""
        least = self._settings.least_acceleration
        return float(np.linalg.norm(look.mass)) > least * float(np.linalg.norm(look.weight))

    def _variance_of(self, look: Look) -> np.ndarray:
        """Of the noise (n_v,), and of drag that is not as the model has it."""
        return self._variance + (self._settings.drag * (look.slopes @ look.velocity)) ** 2

    def _unseen(self, look: Look) -> np.ndarray:
        """Variance (n_v,) that the mass has as noise, where it is not looked at."""
        if self._accelerates(look):
            return np.zeros_like(look.mass)
        return np.asarray((self.P[MASS, MASS] + self.x[MASS] ** 2) * look.mass**2)

    def _forget(self) -> None:
        """The current walks, and the lasting force becomes another."""
        period, settings = self._settings.period, self._settings
        keep = np.ones(len(self.x))
        keep[LASTING:] = math.exp(-period / settings.lasting_time)
        self.x *= keep
        self.P = keep[:, None] * self.P * keep
        self.P[np.diag_indices_from(self.P)] += (1.0 - keep**2) * self._prior
        self.P[CURRENT, CURRENT] += np.eye(3) * settings.current_walk**2 * period

    def _listen(self, missed: np.ndarray, known: np.ndarray) -> None:
        """To the noise: how what is missed changes within the memory of the observer."""
        if len(self._last) == self._last.maxlen:
            square = np.minimum((missed - self._last[0]) ** 2 / 2, _OUTLIER**2 * self._variance)
            gain = np.where(known, self._settings.period / _MEMORY, 0.0)
            self._variance = np.maximum(self._variance + gain * (square - self._variance), self._least)
        self._last.append(missed)

    def _is_another(self, H: np.ndarray, missed: np.ndarray, known: np.ndarray) -> bool:
        """Whether what was known cannot be true any more, for some looks: another load, or another current."""
        variance = np.einsum("ij,jk,ik->i", H, self.P, H) + self._variance
        ratio = float(np.mean(missed[known] ** 2 / variance[known])) if known.any() else 0.0
        self._surprised = self._surprised + 1 if ratio > self._settings.surprise**2 else 0
        return self._surprised >= _PATIENCE

    def _begin_anew(self) -> None:
        """Once the observer has come to what there is now."""
        self._surprised, self._heat = 0, _FIRST_NOISE
        # What was missed was missed by what is forgotten now: at least that look is left out.
        self._waits = max(1, round(self._settings.settling / self._settings.period))
        self.x, self.P = np.zeros_like(self.x), np.diag(self._prior)
        self._last.clear()

    def _cooled(self) -> float:
        """How little looks count until the drag is that of the current there is: its slopes at others mislead for good."""
        self._heat *= math.exp(-self._settings.period / _COOLING)
        return self._heat

    def _correct(self, H: np.ndarray, missed: np.ndarray, noise: np.ndarray) -> None:
        S = H @ self.P @ H.T + np.diag(noise)
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + K @ missed
        kept = np.eye(len(self.x)) - K @ H
        self.P = kept @ self.P @ kept.T + K @ np.diag(noise) @ K.T


def require_limits(limit: np.ndarray) -> int:
    """How many axes [-] a limit (n_v,) [N, N m] is of. Raises `InvalidInput` where one bears no force, or any."""
    wrong = np.flatnonzero(~((limit > _NO_FORCE) & (limit < np.inf)))
    if len(wrong):
        given = f"axes {wrong.tolist()} of {len(limit)} bear no force, or have no limit of it"
        raise InvalidInput(f"{given}; a load is learnt in shares of it: give joints an effort, or load=None")
    return len(limit)


def _looks_apart(settings: LoadLearning, bandwidth: np.ndarray) -> int:
    """[-] looks between two whose noise has little in common."""
    return max(1, round(_COLOUR / (float(bandwidth.min()) * settings.period)))

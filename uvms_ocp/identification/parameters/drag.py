"""Drag that takes energy out of every motion, whatever the coordinates.

Linear drag is a positive definite matrix plus a skew one, whose power is zero. Quadratic drag obeys the condition of
`uvms_ocp.model.water.dissipation` by construction: the diagonal is what the couplings ask for, and a positive number more.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.parameters.coordinates import PositiveDefinite, positive

_SMOOTH = 1e-3  # of the unit of a coupling: below it the size of a coupling is rounded up


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LinearDrag:
    """``D = P + K`` with P positive definite and K skew, both coupled where `symmetric` is."""

    symmetric: PositiveDefinite

    @property
    def names(self) -> tuple[str, ...]:
        """Those of P, then of K."""
        axes = self.symmetric.axes
        return (*self.symmetric.names, *(f"{axes[i]}-{axes[j]} skew" for i, j in self.symmetric.below))

    def decode(self, x: ca.SX) -> ca.SX:
        """D (6, 6) [N/(m/s), N m/(rad/s)]."""
        n = len(self.symmetric.names)
        D = self.symmetric.decode(x[:n])
        for k, (i, j) in enumerate(self.symmetric.below, start=n):
            D[i, j] += x[k] * self._unit(i, j)
            D[j, i] -= x[k] * self._unit(i, j)
        return D

    def encode(self, value: np.ndarray) -> np.ndarray:
        """x of D value (6, 6) [N/(m/s), N m/(rad/s)]. Raises InvalidInput for one that does not dissipate."""
        D = np.asarray(value, dtype=float)
        skew = [(D[i, j] - D[j, i]) / 2 / self._unit(i, j) for i, j in self.symmetric.below]
        return np.concatenate([self.symmetric.encode((D + D.T) / 2), skew])

    def _unit(self, i: int, j: int) -> float:
        return float(self.symmetric.scale[i] * self.symmetric.scale[j])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QuadraticDrag:
    """``Q`` of ``Q (|nu| nu)``, each column with its own axis; couplings are pairs of row and column."""

    axes: tuple[str, ...]
    scale: np.ndarray
    """(6,) [N/(m/s)^2, N m/(rad/s)^2] of the size of the diagonal; axes with 0 have none."""
    speed: np.ndarray
    """(6,) [m/s, rad/s] at which couplings are weighed against each other."""
    couplings: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        """Raises `InvalidInput` for a coupling of an axis with itself, or with one that has no drag of its own."""
        for i, j in self.couplings:
            if i == j or not self.scale[i] * self.scale[j] > 0.0:
                raise InvalidInput(f"quadratic drag: coupling {(i, j)} given; allowed: two axes with drag of their own")

    @property
    def own(self) -> tuple[int, ...]:
        """Axes that have drag of their own."""
        return tuple(int(i) for i in np.flatnonzero(self.scale))

    @property
    def names(self) -> tuple[str, ...]:
        """Axes, then pairs of them."""
        pairs = (f"{self.axes[i]} from {self.axes[j]}" for i, j in self.couplings)
        return (*(self.axes[i] for i in self.own), *pairs)

    def decode(self, x: ca.SX) -> ca.SX:
        """Q (6, 6) [N/(m/s)^2, N m/(rad/s)^2]."""
        Q, n = ca.SX(6, 6), len(self.own)
        for k, (i, j) in enumerate(self.couplings, start=n):
            Q[i, j] = x[k] * self._unit(i, j)
        needed = self._needed({(i, j): _size(x[k]) for k, (i, j) in enumerate(self.couplings, start=n)})
        for k, i in enumerate(self.own):
            Q[i, i] = self.scale[i] * ca.exp(x[k]) + needed[i]
        return Q

    def encode(self, value: np.ndarray) -> np.ndarray:
        """x of Q value (6, 6) [N/(m/s)^2, N m/(rad/s)^2]. Raises InvalidInput where couplings outweigh the diagonal."""
        Q = np.asarray(value, dtype=float)
        coupled = {(i, j): Q[i, j] / self._unit(i, j) for i, j in self.couplings}
        needed = self._needed({pair: float(_size(x)) for pair, x in coupled.items()})
        own = np.array([(Q[i, i] - needed[i]) / self.scale[i] for i in self.own])
        return np.concatenate([np.log(positive(own, "drag left for the diagonal")), list(coupled.values())])

    def _needed(self, sizes: dict[tuple[int, int], ca.SX | float]) -> list[ca.SX | float]:
        """Diagonal (6,) that the couplings need: `dissipation` with these speeds as weights."""
        d: list[ca.SX | float] = [0.0] * 6
        for (i, j), size in sizes.items():
            force, s = size * self._unit(i, j), self.speed
            d[i] += force * s[j] ** 2 / (3 * s[i] ** 2)
            d[j] += 2 * force * s[i] / (3 * s[j])
        return d

    def _unit(self, i: int, j: int) -> float:
        return float(
            np.sqrt(self.scale[i] * self.speed[i] ** 2 * self.scale[j] * self.speed[j] ** 2) / self.speed[j] ** 2
        )


def _size(x: ca.SX | float) -> ca.SX | float:
    return ca.sqrt(x * x + _SMOOTH**2)

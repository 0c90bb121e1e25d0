"""Coordinates of quantities: any real vector stands for values that are physically possible.

A quantity is decoded from its coordinates as a CasADi expression, so that models are differentiated through it, and its
coordinates are found from its value. Standard deviations of priors are those of coordinates: relative ones, about, for what
must be positive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput


class Coordinates(Protocol):
    """A quantity and its coordinates x (n,) [-, or the unit of the quantity]."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the n coordinates, in words that follow the name of the quantity."""

    def decode(self, x: ca.SX) -> ca.SX:
        """The quantity at x (n,)."""

    def encode(self, value: np.ndarray) -> np.ndarray:
        """x (n,) of a value (...) [unit of the quantity]. Raises InvalidInput for one that no x stands for."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Reals:
    """Numbers of any sign, which are their own coordinates."""

    names: tuple[str, ...]

    def decode(self, x: ca.SX) -> ca.SX:
        """As they are."""
        return x

    def encode(self, value: np.ndarray) -> np.ndarray:
        """As they are: value (n,) [unit of the quantity]. Raises InvalidInput for another shape."""
        return _column(value, self.names)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Positives:
    """Positive numbers, by their logarithms."""

    names: tuple[str, ...]

    def decode(self, x: ca.SX) -> ca.SX:
        """``exp(x)``"""
        return ca.exp(x)

    def encode(self, value: np.ndarray) -> np.ndarray:
        """Logarithms of value (n,) [unit of the quantity]. Raises InvalidInput for another shape, or what is not positive."""
        return np.log(positive(_column(value, self.names), "value"))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Interval:
    """Numbers strictly inside an interval each."""

    names: tuple[str, ...]
    lower: np.ndarray
    """(n,) [unit of the quantity]"""
    upper: np.ndarray
    """(n,) [unit of the quantity]"""

    def decode(self, x: ca.SX) -> ca.SX:
        """``tanh(x)``, from the lower to the upper end."""
        return ca.DM(self.lower + self.upper) / 2 + ca.DM(self.upper - self.lower) / 2 * ca.tanh(x)

    def encode(self, value: np.ndarray) -> np.ndarray:
        """x (n,) of value (n,) [unit of the quantity]. Raises InvalidInput for one that is not inside."""
        share = (2 * _column(value, self.names) - self.lower - self.upper) / (self.upper - self.lower)
        if not (np.abs(share) < 1.0).all():
            ends = f"{self.lower.tolist()} to {self.upper.tolist()}"
            raise InvalidInput(f"{np.asarray(value).tolist()} given; allowed: strictly inside {ends}")
        return np.arctanh(share)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PositiveDefinite:
    """A symmetric positive definite matrix ``S L L' S``: L is lower triangular with a positive diagonal.

    Coordinates are the logarithms of that diagonal, then L below it, where rows of `axes` are coupled. Axes whose scale is 0
    have no coordinates, and their rows are 0: the matrix is then semidefinite.
    """

    axes: tuple[str, ...]
    scale: np.ndarray
    """(n,) [root of the unit of the diagonal] S, of the size that roots of the diagonal have."""
    couplings: tuple[tuple[int, int], ...] = ()
    """Pairs of axes, in any order; what two of them imply for a third pair is there too."""

    @property
    def names(self) -> tuple[str, ...]:
        """Axes, then pairs of them."""
        return (*(self.axes[i] for i in self.own), *(f"{self.axes[i]}-{self.axes[j]}" for i, j in self.below))

    @property
    def own(self) -> tuple[int, ...]:
        """Axes that are there."""
        return tuple(int(i) for i in np.flatnonzero(self.scale))

    @property
    def below(self) -> tuple[tuple[int, int], ...]:
        """Places of L under its diagonal, row first."""
        return tuple((max(pair), min(pair)) for pair in self.couplings)

    def decode(self, x: ca.SX) -> ca.SX:
        """The matrix (n, n)."""
        L = ca.SX(len(self.axes), len(self.axes))
        for k, i in enumerate(self.own):
            L[i, i] = ca.exp(x[k])
        for k, (i, j) in enumerate(self.below, start=len(self.own)):
            L[i, j] = x[k]
        scaled = ca.diag(ca.DM(self.scale)) @ L
        return scaled @ scaled.T

    def encode(self, value: np.ndarray) -> np.ndarray:
        """x of a value (n, n) [unit of the quantity]. Raises InvalidInput for one that is not positive definite on its axes."""
        own = np.ix_(self.own, self.own)
        L = np.zeros((len(self.axes),) * 2)
        unit = np.diag(1.0 / self.scale[list(self.own)])
        try:
            L[own] = np.linalg.cholesky(unit @ np.asarray(value, dtype=float)[own] @ unit)
        except np.linalg.LinAlgError:
            raise InvalidInput("a matrix that is not positive definite is given; give one that is") from None
        rows = [np.log(L[i, i]) for i in self.own] + [L[i, j] for i, j in self.below]
        return np.array(rows)


def positive(values: np.ndarray, what: str) -> np.ndarray:
    """The values (...) [any]. Raises InvalidInput for one that is not positive and finite; `what` names them."""
    if not (np.isfinite(values).all() and (values > 0.0).all()):
        raise InvalidInput(f"{what} {values.tolist()} given; allowed: finite, more than 0")
    return values


def _column(value: np.ndarray, names: Sequence[str]) -> np.ndarray:
    array = np.atleast_1d(np.asarray(value, dtype=float))
    if array.shape != (len(names),):
        raise InvalidInput(f"a value of shape {array.shape} given; allowed: ({len(names)},), {', '.join(names)}")
    return array

"""Coordinates of physical quantities: any real vector stands for values that are physically
possible.

Positive numbers, intervals, positive definite matrices (log-Cholesky), drag that dissipates
whatever the motion, inertia of some distribution of mass [Rucker2022]. A quantity is decoded from
its coordinates as a CasADi expression, so that models are differentiated through it. Standard
deviations of priors are those of coordinates; of positive quantities they are about relative ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.spatial import skew

_SMOOTH = 1e-3  # [unit of a coupling] size below which its magnitude is rounded up


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Reals:
    """Numbers of any sign, with themselves as coordinates."""

    names: tuple[str, ...]
    """(n,) names of the numbers."""

    def decode(self, x: ca.SX) -> ca.SX:
        """Return x unchanged."""
        return x

    def encode(self, value: np.ndarray) -> np.ndarray:
        """Return value (n,) [unit of the quantity] unchanged. Raises InvalidInput for another
        shape.
        """
        return _column(value, self.names)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Positives:
    """Positive numbers, by their logarithms."""

    names: tuple[str, ...]
    """(n,) names of the numbers."""

    def decode(self, x: ca.SX) -> ca.SX:
        """Compute ``exp(x)``."""
        return ca.exp(x)

    def encode(self, value: np.ndarray) -> np.ndarray:
        """Compute logarithms of value (n,) [unit of the quantity]. Raises InvalidInput for another
        shape, or a number that is not positive.
        """
        return np.log(positive(_column(value, self.names), "value"))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Interval:
    """Numbers strictly inside an interval each: ``tanh(x)``, from the lower to the upper end."""

    names: tuple[str, ...]
    """(n,) names of the numbers."""
    lower: np.ndarray
    """(n,) [unit of the quantity] lower ends."""
    upper: np.ndarray
    """(n,) [unit of the quantity] upper ends."""

    def decode(self, x: ca.SX) -> ca.SX:
        """Compute the numbers (n,) at coordinates x (n,)."""
        middle = ca.DM(self.lower + self.upper) / 2
        half_width = ca.DM(self.upper - self.lower) / 2
        return middle + half_width * ca.tanh(x)

    def encode(self, value: np.ndarray) -> np.ndarray:
        """Compute x (n,) of a value (n,) [unit of the quantity]. Raises InvalidInput for one that
        is not inside.
        """
        from_middle = 2 * _column(value, self.names) - self.lower - self.upper
        share = from_middle / (self.upper - self.lower)
        if not (np.abs(share) < 1.0).all():
            ends = f"{self.lower.tolist()} to {self.upper.tolist()}"
            raise InvalidInput(
                f"{np.asarray(value).tolist()} given; allowed: strictly inside {ends}"
            )
        return np.arctanh(share)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PositiveDefinite:
    """A symmetric positive definite matrix ``S L L' S``: L is lower triangular with a positive
    diagonal.

    Coordinates are the logarithms of that diagonal, then L below it, where rows of `axes` are
    coupled. Axes whose scale is 0 have no coordinates, and their rows are 0: the matrix is then
    semidefinite.
    """

    axes: tuple[str, ...]
    """(n,) names of rows and columns."""
    scale: np.ndarray
    """(n,) [root of the unit of the diagonal] S, typical sizes of the roots of the diagonal."""
    couplings: tuple[tuple[int, int], ...] = ()
    """Pairs of axes, in any order; products of L also couple axes that two pairs have in common."""

    @property
    def names(self) -> tuple[str, ...]:
        """Axes, then pairs of them."""
        axes = [self.axes[i] for i in self.diagonal]
        pairs = [f"{self.axes[i]}-{self.axes[j]}" for i, j in self.below]
        return (*axes, *pairs)

    @property
    def diagonal(self) -> tuple[int, ...]:
        """Axes with an entry on the diagonal of L: those whose scale is not 0."""
        return tuple(int(i) for i in np.flatnonzero(self.scale))

    @property
    def below(self) -> tuple[tuple[int, int], ...]:
        """Places of L under its diagonal, row first."""
        return tuple((max(pair), min(pair)) for pair in self.couplings)

    def decode(self, x: ca.SX) -> ca.SX:
        """Compute the matrix (n, n) at coordinates x (n_names,)."""
        L = ca.SX(len(self.axes), len(self.axes))
        for k, i in enumerate(self.diagonal):
            L[i, i] = ca.exp(x[k])
        for k, (i, j) in enumerate(self.below, start=len(self.diagonal)):
            L[i, j] = x[k]
        scaled = ca.diag(ca.DM(self.scale)) @ L
        return scaled @ scaled.T

    def encode(self, value: np.ndarray) -> np.ndarray:
        """Compute x of a value (n, n) [unit of the quantity]. Raises InvalidInput for one that is
        not positive definite on its axes.
        """
        block = np.ix_(self.diagonal, self.diagonal)
        L = np.zeros((len(self.axes),) * 2)
        unit = np.diag(1.0 / self.scale[list(self.diagonal)])
        try:
            L[block] = np.linalg.cholesky(unit @ np.asarray(value, dtype=float)[block] @ unit)
        except np.linalg.LinAlgError:
            raise InvalidInput(
                "a matrix that is not positive definite is given; give one that is"
            ) from None
        diagonal = [np.log(L[i, i]) for i in self.diagonal]
        below = [L[i, j] for i, j in self.below]
        return np.array(diagonal + below)


def positive(values: np.ndarray, label: str) -> np.ndarray:
    """Return the values (...) [any]. Raises InvalidInput for values that are not positive and finite;
    label: their name in the message.
    """
    if not (np.isfinite(values).all() and (values > 0.0).all()):
        raise InvalidInput(f"{label} {values.tolist()} given; allowed: finite, more than 0")
    return values


def _column(value: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return a value as a vector (n,). Raises InvalidInput for another length than that of names."""
    array = np.atleast_1d(np.asarray(value, dtype=float))
    if array.shape != (len(names),):
        raise InvalidInput(
            f"a value of shape {array.shape} given; allowed: ({len(names)},), {', '.join(names)}"
        )
    return array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LinearDrag:
    """Linear drag ``D = P + K`` that dissipates: P is positive definite, and K skew, whose power is 0.

    K couples the axes that `symmetric` couples.
    """

    symmetric: PositiveDefinite
    """Coordinates of P."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates of P, then of K."""
        axes = self.symmetric.axes
        skew_names = [f"{axes[i]}-{axes[j]} skew" for i, j in self.symmetric.below]
        return (*self.symmetric.names, *skew_names)

    def decode(self, x: ca.SX) -> ca.SX:
        """Compute D (6, 6) [N/(m/s), N m/(rad/s)]."""
        n = len(self.symmetric.names)
        D = self.symmetric.decode(x[:n])
        for k, (i, j) in enumerate(self.symmetric.below, start=n):
            D[i, j] += x[k] * self._unit(i, j)
            D[j, i] -= x[k] * self._unit(i, j)
        return D

    def encode(self, value: np.ndarray) -> np.ndarray:
        """Compute x of a matrix D, value (6, 6) [N/(m/s), N m/(rad/s)]. Raises InvalidInput where it
        does not dissipate.
        """
        D = np.asarray(value, dtype=float)
        symmetric = self.symmetric.encode((D + D.T) / 2)
        skew_part = (D - D.T) / 2
        couplings = []
        for i, j in self.symmetric.below:
            couplings.append(skew_part[i, j] / self._unit(i, j))
        return np.concatenate([symmetric, couplings])

    def _unit(self, i: int, j: int) -> float:
        """Return the size of a coupling of two axes [N/(m/s), ...]."""
        return float(self.symmetric.scale[i] * self.symmetric.scale[j])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QuadraticDrag:
    """Quadratic drag ``Q (|nu| nu)`` that dissipates, each column with the speed of its axis.

    It meets the condition of `uvms_ocp.robot.drag_passivity` by construction: the diagonal is one
    with which the couplings dissipate, plus positive numbers.
    """

    axes: tuple[str, ...]
    """(6,) names of rows and columns."""
    scale: np.ndarray
    """(6,) [N/(m/s)^2, N m/(rad/s)^2] typical size of the diagonal; axes with 0 have no drag."""
    speed: np.ndarray
    """(6,) [m/s, rad/s] typical speed of each axis, which weighs couplings."""
    couplings: tuple[tuple[int, int], ...] = ()
    """Pairs of row and column: force on the first axis from the motion of the second."""

    def __post_init__(self) -> None:
        """Check couplings. Raises `InvalidInput` for a coupling of an axis with itself, or with one
        that has no drag of its own.
        """
        for i, j in self.couplings:
            if i == j or not self.scale[i] * self.scale[j] > 0.0:
                raise InvalidInput(
                    f"quadratic drag: coupling {(i, j)} given; allowed: two axes with drag of"
                    " their own"
                )

    @property
    def diagonal(self) -> tuple[int, ...]:
        """Axes with drag on the diagonal of Q: those whose scale is not 0."""
        return tuple(int(i) for i in np.flatnonzero(self.scale))

    @property
    def names(self) -> tuple[str, ...]:
        """Axes, then pairs of them."""
        axes = [self.axes[i] for i in self.diagonal]
        pairs = [f"{self.axes[i]} from {self.axes[j]}" for i, j in self.couplings]
        return (*axes, *pairs)

    def decode(self, x: ca.SX) -> ca.SX:
        """Compute Q (6, 6) [N/(m/s)^2, N m/(rad/s)^2]."""
        Q = ca.SX(6, 6)
        sizes: dict[tuple[int, int], ca.SX | float] = {}
        for k, (i, j) in enumerate(self.couplings, start=len(self.diagonal)):
            Q[i, j] = x[k] * self._unit(i, j)
            sizes[i, j] = _magnitude(x[k])
        needed = self._needed_diagonal(sizes)
        for k, i in enumerate(self.diagonal):
            Q[i, i] = self.scale[i] * ca.exp(x[k]) + needed[i]
        return Q

    def encode(self, value: np.ndarray) -> np.ndarray:
        """Compute x of Q, value (6, 6) [N/(m/s)^2, N m/(rad/s)^2]. Raises InvalidInput where
        couplings outweigh the diagonal.
        """
        Q = np.asarray(value, dtype=float)
        couplings = []
        sizes = {}
        for i, j in self.couplings:
            coupling = Q[i, j] / self._unit(i, j)
            couplings.append(coupling)
            sizes[i, j] = float(_magnitude(coupling))
        needed = self._needed_diagonal(sizes)
        remaining = []
        for i in self.diagonal:
            remaining.append((Q[i, i] - needed[i]) / self.scale[i])
        diagonal = np.log(positive(np.array(remaining), "drag left for the diagonal"))
        return np.concatenate([diagonal, couplings])

    def _needed_diagonal(self, sizes: dict[tuple[int, int], ca.SX | float]) -> list[ca.SX | float]:
        """Compute a diagonal (6,) with which couplings of these sizes dissipate, by Young's
        inequality with the speeds as weights.
        """
        diagonal: list[ca.SX | float] = [0.0] * 6
        speed = self.speed
        for (i, j), size in sizes.items():
            force = size * self._unit(i, j)
            diagonal[i] += force * speed[j] ** 2 / (3 * speed[i] ** 2)
            diagonal[j] += 2 * force * speed[i] / (3 * speed[j])
        return diagonal

    def _unit(self, i: int, j: int) -> float:
        """Return the size of a coupling, row i and column j [N/(m/s)^2, ...]: the mean of both
        axes' forces over the speed of the second.
        """
        mean_force = np.sqrt(
            self.scale[i] * self.speed[i] ** 2 * self.scale[j] * self.speed[j] ** 2
        )
        return float(mean_force / self.speed[j] ** 2)


def _magnitude(x: ca.SX | float) -> ca.SX | float:
    """Compute ``|x|``, smooth at 0 and never less."""
    return ca.sqrt(x * x + _SMOOTH**2)


QuantityCoordinates: TypeAlias = (
    Reals | Positives | Interval | PositiveDefinite | LinearDrag | QuadraticDrag
)
"""Map between a quantity and its coordinates x (n,) [-, or the unit of the quantity]: `names` of the
coordinates, `decode` from x to the quantity, and `encode` from a value to x, which raises
InvalidInput for a value that no x stands for.
"""


def second_moment(inertia: np.ndarray) -> np.ndarray:
    """Compute the second moment of mass (3, 3) [kg m2] of a rotational inertia (3, 3) [kg m2], both
    about the centre of mass [Rucker2022].

    A body has mass m, centre of mass c and the second moment ``S = int (r - c)(r - c)' dm``. Exactly
    where m > 0 and S is positive definite, its pseudo-inertia ``[[S + m c c', m c], [m c', m]]`` is,
    and some mass that fills a volume has these numbers: the triangle inequality of inertias follows.
    log m, c and the log-Cholesky factor of S are the factor of the pseudo-inertia, up to a smooth
    change that lets mass and centre be known apart from the rest.

    Raises InvalidInput for an inertia that no body has.
    """
    S = np.trace(inertia) / 2 * np.eye(3) - inertia
    if not np.linalg.eigvalsh(S).min() > 0.0:
        raise InvalidInput(
            "inertia of no body given; allowed: each principal moment less than the sum of the"
            " other two"
        )
    return S


def spatial_inertia(mass: ca.SX, centre: ca.SX, S: ca.SX) -> ca.SX:
    """Compute a spatial inertia (6, 6) [kg, kg m, kg m2] about the origin of the frame in which the
    centre of mass (3,) [m] is given, linear first.
    """
    c = skew(centre)
    rotational = ca.trace(S) * ca.SX.eye(3) - S  # about the centre of mass
    linear_rows = ca.horzcat(mass * ca.SX.eye(3), -mass * c)
    angular_rows = ca.horzcat(mass * c, rotational - mass * c @ c)
    return ca.vertcat(linear_rows, angular_rows)

"""The numbers of a QP of stages, in arrays that are made once and written into, and how many there are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput

_BEYOND = 4  # numbers that compiled code may read after the end


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class StageShape:
    """N + 1 stages: N with states and controls, a last one with states only. Sizes may differ from stage to stage.

    Raises `InvalidInput` for lists of other lengths, negative sizes, and a horizon in which nothing varies.
    """

    n_x: tuple[int, ...]
    """(N + 1,) [-] states."""
    n_u: tuple[int, ...]
    """(N,) [-] controls."""
    n_r: tuple[int, ...]
    """(N + 1,) [-] rows of the residual."""
    n_c: tuple[int, ...]
    """(N + 1,) [-] rows of constraints."""

    def __post_init__(self) -> None:
        for name, length in (("n_x", self.N + 1), ("n_r", self.N + 1), ("n_c", self.N + 1)):
            if len(getattr(self, name)) != length:
                given = len(getattr(self, name))
                raise InvalidInput(f"{name} of {given} stages and n_u of {self.N}; give one stage more than in n_u")
        if min((*self.n_x, *self.n_u, *self.n_r, *self.n_c)) < 0:
            raise InvalidInput("a stage has a negative size; give sizes >= 0")
        if sum(self.n_z) == 0:
            raise InvalidInput("no stage has a state or a control; give at least one")

    @property
    def N(self) -> int:
        """[-] Steps."""
        return len(self.n_u)

    @property
    def n_z(self) -> tuple[int, ...]:
        """(N + 1,) [-] Variables ``z = (x, u)``."""
        return _sums(self.n_x, (*self.n_u, 0))


@lru_cache(maxsize=256)
def _sums(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(one + other for one, other in zip(a, b, strict=True))


def places(sizes: Iterable[int]) -> list[int]:
    """Where parts of such `sizes` [-] begin in one array, and where the last one ends."""
    return [0, *accumulate(sizes)]


@lru_cache(maxsize=256)
def slices(sizes: tuple[int, ...]) -> tuple[slice, ...]:
    """The same as slices; sizes [-]."""
    begin = places(sizes)
    return tuple(slice(a, b) for a, b in pairwise(begin))


@checked
class StageQp:
    """min sum_k 1/2 |J_k z_k + r_k|^2 + 1/2 z_k' H_k z_k + g_k' z_k + 1/2 z_k' diag(damping_k) z_k, z_k = (x_k, u_k), with
    x_{k+1} = A_k x_k + B_k u_k + b_k, lower_k <= C_k z_k <= upper_k, z_lower_k <= z_k <= z_upper_k.

    Every attribute below is a tuple with a view per stage; write with ``qp.A[k][:] = ...``. The views of one name lie one after
    the other in ``qp.flat[name]``, row-major; A and B are columns of ``dynamics`` (n_x[k+1], n_z[k]). A cost that is not convex
    is noticed while solving. Bounds may be infinite, and equal: an equality, or a fixed variable. A state x_0 that is given is
    one whose bounds are equal (`fix_initial_state`).

    A row of constraints or a bound is soft where its ``l1`` is finite: it may be missed by e >= 0 on either side, which costs
    ``l1 e + l2 e^2 / 2``. All are hard at first: ``l1`` is infinite.
    """

    def __init__(self, shape: StageShape) -> None:
        self.shape = shape
        n_z, n_x, n_r, n_c = shape.n_z, shape.n_x, shape.n_r, shape.n_c
        steps = list(zip(n_x[1:], n_z, strict=False))
        self.flat: dict[str, Array] = {}
        self.dynamics = self._matrices("dynamics", steps)
        """(n_x[k+1], n_z[k])"""
        self.A = tuple(F[:, :n] for F, n in zip(self.dynamics, n_x, strict=False))
        """(n_x[k+1], n_x[k])"""
        self.B = tuple(F[:, n:] for F, n in zip(self.dynamics, n_x, strict=False))
        """(n_x[k+1], n_u[k])"""
        self.b = self._vectors("b", n_x[1:])
        """(n_x[k+1],)"""
        self.J = self._matrices("J", list(zip(n_r, n_z, strict=True)))
        """(n_r, n_z)"""
        self.r = self._vectors("r", n_r)
        """(n_r,)"""
        self.H = self._matrices("H", list(zip(n_z, n_z, strict=True)))
        """(n_z, n_z) symmetric."""
        self.g = self._vectors("g", n_z)
        """(n_z,)"""
        self.damping = self._vectors("damping", n_z)
        """(n_z,)"""
        self.C = self._matrices("C", list(zip(n_c, n_z, strict=True)))
        """(n_c, n_z)"""
        self.lower, self.upper = self._vectors("lower", n_c, -np.inf), self._vectors("upper", n_c, np.inf)
        """(n_c,)"""
        self.l1, self.l2 = self._vectors("l1", n_c, np.inf), self._vectors("l2", n_c)
        """(n_c,)"""
        self.z_lower, self.z_upper = self._vectors("z_lower", n_z, -np.inf), self._vectors("z_upper", n_z, np.inf)
        """(n_z,)"""
        self.z_l1, self.z_l2 = self._vectors("z_l1", n_z, np.inf), self._vectors("z_l2", n_z)
        """(n_z,)"""

    @checked
    def fix_initial_state(self, x: Array) -> None:
        """Begin the horizon at x (n,) [unit of x], n the states of the first stage. Raises `InvalidInput` for another shape."""
        if np.shape(x) != (self.shape.n_x[0],):
            raise InvalidInput(f"x of shape {np.shape(x)}; give ({self.shape.n_x[0]},)")
        self.z_lower[0][: self.shape.n_x[0]] = x
        self.z_upper[0][: self.shape.n_x[0]] = x

    def _vectors(self, name: str, sizes: tuple[int, ...], value: float = 0.0) -> tuple[Array, ...]:
        flat = self.flat[name] = np.full(sum(sizes) + _BEYOND, value)[: sum(sizes)]
        return tuple(flat[own] for own in slices(sizes))

    def _matrices(self, name: str, sizes: list[tuple[int, int]]) -> tuple[Array, ...]:
        flat = self._vectors(name, tuple(m * n for m, n in sizes))
        return tuple(part.reshape(size) for part, size in zip(flat, sizes, strict=True))


def is_valid(qp: StageQp) -> bool:
    """Whether entries are finite but for bounds that there are not; slack costs something."""
    flat = qp.flat
    bounds = ("lower", "upper", "l1", "z_lower", "z_upper", "z_l1")
    numbers = all(np.isfinite(array).all() for name, array in flat.items() if name not in bounds)
    sides = all((flat[f"{z}lower"] < np.inf).all() and (flat[f"{z}upper"] > -np.inf).all() for z in ("", "z_"))
    return numbers and sides and all((flat[name] >= 0.0).all() for name in ("l1", "l2", "z_l1", "z_l2"))

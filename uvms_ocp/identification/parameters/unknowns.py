"""The unknowns of a declaration in a row, and the way from them to values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from uvms_ocp.identification.parameters.declaration import Declaration, Quantity

_HELD = 1e-4  # [as start] deviation of what is held


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Unknowns theta (n,) that all recordings share, or kappa (m,) that each has for itself, of a declaration."""

    declaration: Declaration
    own: bool = False
    """Whether they are those that each recording has for itself."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns, as ``added_mass surge``."""
        return tuple(
            f"{name} {coordinate}".strip()
            for name, one in self._items()
            for coordinate, free in zip(one.coordinates.names, one.free, strict=True)
            if free
        )

    @property
    def start(self) -> np.ndarray:
        """(n,) [-, or the unit of the quantity]"""
        return self._free("x")

    @property
    def sigma(self) -> np.ndarray:
        """(n,) [as start] standard deviations of priors, infinite without."""
        return self._free("sigma")

    @property
    def lower(self) -> np.ndarray:
        """(n,) [as start]"""
        return self._free("lower")

    @property
    def upper(self) -> np.ndarray:
        """(n,) [as start]"""
        return self._free("upper")

    def values(self, theta: ca.SX) -> dict[str, ca.SX]:
        """Every quantity of this kind by its name, where theta (n,) [as start] are the unknowns."""
        found, first = {}, 0
        for name, one in self._items():
            n = int(one.free.sum())
            x = ca.SX(ca.DM(one.x))
            if n:
                x[np.flatnonzero(one.free).tolist()] = theta[first : first + n]
            found[name], first = one.coordinates.decode(x), first + n
        return found

    def believed(self, about: np.ndarray, wider: float = 1.0) -> Unknowns:
        """A copy that starts, and whose priors are, about (n,) [as start]; wider: [-] factor of their deviations."""
        found, first = dict(self.declaration.quantities), 0
        for name, one in self._items():
            x, n = one.x.copy(), int(one.free.sum())
            x[one.free] = about[first : first + n]
            found[name], first = replace(one, x=x, sigma=wider * one.sigma), first + n
        return Unknowns(Declaration(quantities=found), self.own)

    def held(self, which: np.ndarray) -> Unknowns:
        """A copy in which those of which (n,) [bool] are next to known: where they start."""
        found, first = dict(self.declaration.quantities), 0
        for name, one in self._items():
            sigma, n = one.sigma.copy(), int(one.free.sum())
            sigma[one.free] = np.where(which[first : first + n], _HELD, sigma[one.free])
            found[name], first = replace(one, sigma=sigma), first + n
        return Unknowns(Declaration(quantities=found), self.own)

    def _items(self) -> Iterator[tuple[str, Quantity]]:
        return ((name, one) for name, one in self.declaration.quantities.items() if one.own == self.own)

    def _free(self, column: str) -> np.ndarray:
        return np.concatenate([np.zeros(0), *(getattr(one, column)[one.free] for _, one in self._items())])

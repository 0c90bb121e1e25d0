"""What of a vehicle may be identified, in one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.identification.parameters.coordinates import Coordinates
from uvms_ocp.identification.parameters.status import Bounded, Fixed, Prior, Status


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Quantity:
    """One quantity with what is known of each of its coordinates; fixed unless it is said otherwise."""

    unit: str
    coordinates: Coordinates
    x: np.ndarray
    """(n,) [-, or the unit of the quantity] where they are, and the middle of priors."""
    free: np.ndarray
    """(n,) [-] whether they may be learnt."""
    sigma: np.ndarray
    """(n,) [as x] standard deviations of priors, infinite without."""
    lower: np.ndarray
    """(n,) [as x]"""
    upper: np.ndarray
    """(n,) [as x]"""
    own: bool = False
    """Whether every recording has its own."""

    @staticmethod
    def fixed(unit: str, coordinates: Coordinates, value: np.ndarray, *, own: bool = False) -> Quantity:
        """Known to be value (...) [unit of the quantity]. Raises InvalidInput for a value that coordinates do not reach."""
        x = coordinates.encode(value)
        none, all_of_them = np.zeros(len(x), dtype=bool), np.full(len(x), np.inf)
        return Quantity(
            unit=unit,
            coordinates=coordinates,
            x=x,
            free=none,
            sigma=all_of_them,
            lower=-all_of_them,
            upper=all_of_them,
            own=own,
        )

    def known(self, status: Status) -> Quantity:
        """A copy of which this is known. Raises NameNotFound for a coordinate that there is not, and InvalidInput."""
        names = self.coordinates.names
        for name in status.only or ():
            if name not in names:
                raise NameNotFound("coordinate", name, names)
        chosen = np.array([status.only is None or name in status.only for name in names], dtype=bool)
        lower, upper = self._bounds(status)
        return replace(
            self,
            free=np.where(chosen, not isinstance(status, Fixed), self.free),
            sigma=np.where(chosen, status.sigma if isinstance(status, Prior) else np.inf, self.sigma),
            lower=np.where(chosen, lower, self.lower),
            upper=np.where(chosen, upper, self.upper),
        )

    def _bounds(self, status: Status) -> tuple[np.ndarray, np.ndarray]:
        n = len(self.x)
        if not isinstance(status, Bounded):
            return np.full(n, -np.inf), np.full(n, np.inf)
        lower, upper = (self.coordinates.encode(np.full(n, value)) for value in (status.lower, status.upper))
        if not ((lower <= self.x) & (self.x <= upper)).all():
            raise InvalidInput(f"bounds {status.lower} and {status.upper} given; allowed: around what the value is")
        return lower, upper


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Declaration:
    """All quantities by their names; see `uvms_ocp.identification.parameters.vehicle_quantities` for those of a vehicle."""

    quantities: Mapping[str, Quantity]

    def learning(self, **known: Status) -> Declaration:
        """A copy in which these quantities are known so. Raises NameNotFound for one that there is not, and InvalidInput."""
        for name in known:
            if name not in self.quantities:
                raise NameNotFound("quantity", name, self.quantities)
        changed = {name: self.quantities[name].known(status) for name, status in known.items()}
        return Declaration(quantities={**self.quantities, **changed})

    def starting(self, **values: np.ndarray) -> Declaration:
        """A copy whose quantities start at other values (...) [unit of the quantity]. Raises NameNotFound, InvalidInput."""
        for name in values:
            if name not in self.quantities:
                raise NameNotFound("quantity", name, self.quantities)
        found = {name: self.quantities[name] for name in values}
        moved = {name: replace(one, x=one.coordinates.encode(values[name])) for name, one in found.items()}
        return Declaration(quantities={**self.quantities, **moved})

"""Parameters of a vehicle: its quantities, each fixed, free, bounded or with a prior, and the vector of
unknowns that follows from them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.identification.coordinates import QuantityCoordinates
from uvms_ocp.robot.thrusters import AXES as AXES
from uvms_ocp.types import Positive

DELAYS = ("delay", "velocity_delay")
"""Quantities that are times, from 0 to the longest."""
AT_ONCE = 1e-6
"""[s] that stands for no delay at all."""
All = None
"""Stands for all coordinates of a quantity."""
_HELD = 1e-4  # [as `Unknowns.start`] standard deviation of a prior that holds an unknown


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Free coordinates of a declaration: unknowns theta (n,) that all recordings share, or kappa (m,)
    that each has for itself.
    """

    declaration: Declaration
    per_recording: bool = False
    """True for kappa, the unknowns that each recording has for itself."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, as ``added_mass surge``."""
        names = []
        for name, quantity in self._items():
            for coordinate, is_free in zip(quantity.coordinates.names, quantity.free, strict=True):
                if is_free:
                    names.append(f"{name} {coordinate}".strip())
        return tuple(names)

    @property
    def start(self) -> np.ndarray:
        """(n,) [-, or the unit of the quantity] values at which a search begins."""
        return self._free("x")

    @property
    def sigma(self) -> np.ndarray:
        """(n,) [as start] standard deviations of priors, infinite without."""
        return self._free("sigma")

    @property
    def lower(self) -> np.ndarray:
        """(n,) [as start] lower bounds, minus infinity without."""
        return self._free("lower")

    @property
    def upper(self) -> np.ndarray:
        """(n,) [as start] upper bounds, infinite without."""
        return self._free("upper")

    def values(self, theta: ca.SX) -> dict[str, ca.SX]:
        """Compute each quantity of this kind, by its name, at unknowns theta (n,) [as start]."""
        quantities = {}
        first = 0
        for name, quantity in self._items():
            n_free = int(quantity.free.sum())
            x = ca.SX(ca.DM(quantity.x))
            if n_free:
                x[np.flatnonzero(quantity.free).tolist()] = theta[first : first + n_free]
            quantities[name] = quantity.coordinates.decode(x)
            first += n_free
        return quantities

    def believed(self, means: np.ndarray, widening: float = 1.0) -> Unknowns:
        """Return a copy that starts at means (n,) [as start], where its priors have their middle;
        widening: factor on the deviations of the priors.
        """
        moved = self._with("x", means)
        quantities = dict(moved.declaration.quantities)
        for name, quantity in moved._items():
            quantities[name] = replace(quantity, sigma=widening * quantity.sigma)
        return Unknowns(Declaration(quantities=quantities), self.per_recording)

    def held(self, is_held: np.ndarray) -> Unknowns:
        """Return a copy that holds the unknowns of a mask (n,) [bool] where they start."""
        return self._with("sigma", np.where(is_held, _HELD, self.sigma))

    def _with(self, column: str, values: np.ndarray) -> Unknowns:
        """Return a copy with other values (n,) of a column of all unknowns."""
        quantities = dict(self.declaration.quantities)
        first = 0
        for name, quantity in self._items():
            n_free = int(quantity.free.sum())
            changed = getattr(quantity, column).copy()
            changed[quantity.free] = values[first : first + n_free]
            quantities[name] = replace(quantity, **{column: changed})
            first += n_free
        return Unknowns(Declaration(quantities=quantities), self.per_recording)

    def _free(self, column: str) -> np.ndarray:
        """Return a column of all unknowns in a row."""
        parts = [getattr(quantity, column)[quantity.free] for _, quantity in self._items()]
        return np.concatenate([np.zeros(0), *parts])

    def _items(self) -> Iterator[tuple[str, Quantity]]:
        """Yield the quantities of this kind by name: shared ones, or those of single recordings."""
        for name, quantity in self.declaration.quantities.items():
            if quantity.per_recording == self.per_recording:
                yield name, quantity


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Declaration:
    """Quantities of a vehicle by name; `vehicle_declaration` gives all of them."""

    quantities: Mapping[str, Quantity]
    """Quantities by their names."""

    def with_status(self, **status: ParameterStatus) -> Declaration:
        """Return a copy in which these quantities have these statuses.

        Raises NameNotFound for an unknown quantity or coordinate, and InvalidInput for bounds.
        """
        changed = {}
        for name, quantity_status in status.items():
            changed[name] = self._quantity(name).with_status(quantity_status, name)
        return Declaration(quantities={**self.quantities, **changed})

    def with_start(self, **values: np.ndarray) -> Declaration:
        """Return a copy whose quantities start at other values (...) [unit of the quantity].

        Raises NameNotFound, InvalidInput.
        """
        changed = {}
        for name, value in values.items():
            quantity = self._quantity(name)
            changed[name] = replace(quantity, x=quantity.coordinates.encode(value))
        return Declaration(quantities={**self.quantities, **changed})

    def _quantity(self, name: str) -> Quantity:
        require_known("quantity", name, self.quantities)
        return self.quantities[name]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Quantity:
    """One quantity with bounds, prior and status of each of its coordinates."""

    unit: str
    """Unit of the value; several where its rows differ, as ``kg, kg m, kg m2``."""
    coordinates: QuantityCoordinates
    """Map between coordinates x (n,) and the value."""
    x: np.ndarray
    """(n,) [-, or the unit of the quantity] values of the coordinates, and the middle of priors."""
    free: np.ndarray
    """(n,) [bool] mask of the coordinates that are unknowns."""
    sigma: np.ndarray
    """(n,) [as x] standard deviations of priors, infinite without."""
    lower: np.ndarray
    """(n,) [as x] lower bounds."""
    upper: np.ndarray
    """(n,) [as x] upper bounds."""
    per_recording: bool = False
    """True where each recording has a value for itself, such as of its current."""
    begin: np.ndarray | None = None
    """(n,) [as x] coordinates at which a search begins, in place of x, which no search leaves at the
    edge of an interval.
    """

    @property
    def value(self) -> np.ndarray:
        """(...) [unit of the quantity] value, where a search begins if it is free."""
        return np.array(ca.evalf(self.coordinates.decode(ca.SX(ca.DM(self.x)))))

    @staticmethod
    def fixed(
        unit: str,
        coordinates: QuantityCoordinates,
        value: np.ndarray,
        *,
        per_recording: bool = False,
    ) -> Quantity:
        """Make a quantity fixed at value (...) [unit of the quantity].

        Raises InvalidInput for a value that coordinates do not reach.
        """
        x = coordinates.encode(value)
        unlimited = np.full(len(x), np.inf)
        return Quantity(
            unit=unit,
            coordinates=coordinates,
            x=x,
            free=np.zeros(len(x), dtype=bool),
            per_recording=per_recording,
            sigma=unlimited,
            lower=-unlimited,
            upper=unlimited,
        )

    def with_status(self, status: ParameterStatus, label: str = "it") -> Quantity:
        """Return a copy with another status; label: name of the quantity in messages.

        Raises NameNotFound for an unknown coordinate, and InvalidInput for bounds.
        """
        chosen = self._chosen(status.only, label)
        is_free = not isinstance(status, Fixed)
        if is_free and self.begin is not None:
            begun = replace(self, x=np.where(chosen, self.begin, self.x), begin=None)
            return begun.with_status(status, label)
        sigma = np.inf
        if isinstance(status, Prior):
            sigma = status.sigma
        lower, upper = self._bounds(status)
        return replace(
            self,
            free=np.where(chosen, is_free, self.free),
            sigma=np.where(chosen, sigma, self.sigma),
            lower=np.where(chosen, lower, self.lower),
            upper=np.where(chosen, upper, self.upper),
        )

    def _chosen(self, only: Sequence[str] | None, label: str) -> np.ndarray:
        """Return the mask (n,) [bool] of coordinates by their names; of all where none are given."""
        names = self.coordinates.names
        if only is All:
            return np.ones(len(names), dtype=bool)
        for name in only:
            require_known(
                f"coordinate of {label}, which has none for what is 0 in the robot's file:",
                name,
                names,
            )
        return np.array([name in only for name in names], dtype=bool)

    def _bounds(self, status: ParameterStatus) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper bounds (n,) [as x] of a status; infinite where it has none."""
        n = len(self.x)
        if not isinstance(status, Bounded):
            return np.full(n, -np.inf), np.full(n, np.inf)
        lower = self.coordinates.encode(np.full(n, status.lower))
        upper = self.coordinates.encode(np.full(n, status.upper))
        if not ((lower <= self.x) & (self.x <= upper)).all():
            raise InvalidInput(
                f"bounds {status.lower} and {status.upper} given; allowed: around what the value is"
            )
        return lower, upper


@dataclass(frozen=True, kw_only=True, slots=True)
class Fixed:
    """Status of a quantity that stays as declared."""

    only: tuple[str, ...] | None = All
    """Coordinates by their names; the others of the quantity stay as they were declared."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Free:
    """Status of a quantity that the recordings alone determine."""

    only: tuple[str, ...] | None = All
    """Coordinates by their names; the others of the quantity stay as they were declared."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Bounded:
    """Status of a quantity within bounds; for quantities whose coordinates are entries: not for
    coupled matrices.
    """

    lower: float
    """[unit of the quantity] lower bound."""
    upper: float
    """[unit of the quantity] upper bound."""
    only: tuple[str, ...] | None = All
    """Coordinates by their names; the others of the quantity stay as they were declared."""

    def __post_init__(self) -> None:
        """Check the bounds. Raises `InvalidInput` for bounds in the wrong order."""
        if not self.lower < self.upper:
            raise InvalidInput(
                f"bounds {self.lower} and {self.upper} given; allowed: lower < upper"
            )


@checked_dataclass()
class Prior:
    """Status of a quantity with a prior about its start."""

    sigma: Positive
    """Standard deviation: relative, for what must be positive; [unit of the quantity] for what may
    have any sign.
    """
    only: tuple[str, ...] | None = All
    """Coordinates by their names; the others of the quantity stay as they were declared."""


ParameterStatus: TypeAlias = Fixed | Free | Bounded | Prior

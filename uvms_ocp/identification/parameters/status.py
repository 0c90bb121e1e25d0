"""What is known of a quantity: fixed, free, bounded, or free with a prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from uvms_ocp.exceptions import InvalidInput

All = None
"""Of the coordinates of a quantity."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fixed:
    """Known: it stays as it is."""

    only: tuple[str, ...] | None = All
    """Coordinates by their names; the others of the quantity stay as they were declared."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Free:
    """Unknown: the recordings alone decide."""

    only: tuple[str, ...] | None = All


@dataclass(frozen=True, kw_only=True, slots=True)
class Bounded:
    """Unknown within bounds; for quantities whose coordinates are entries: not for coupled matrices."""

    lower: float
    """[unit of the quantity]"""
    upper: float
    """[unit of the quantity]"""
    only: tuple[str, ...] | None = All

    def __post_init__(self) -> None:
        """Raises `InvalidInput` for bounds in the wrong order."""
        if not self.lower < self.upper:
            raise InvalidInput(f"bounds {self.lower} and {self.upper} given; allowed: lower < upper")


@dataclass(frozen=True, kw_only=True, slots=True)
class Prior:
    """Believed: as the start has it, give or take a standard deviation."""

    sigma: float
    """[-] relative, for what must be positive; [unit of the quantity] for what may have any sign."""
    only: tuple[str, ...] | None = All

    def __post_init__(self) -> None:
        """Raises `InvalidInput` for a deviation that is not positive."""
        if not self.sigma > 0.0:
            raise InvalidInput(f"sigma = {self.sigma} given; allowed: more than 0")


Status: TypeAlias = Fixed | Free | Bounded | Prior

"""What surrounds the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uvms_ocp.exceptions import InvalidInput


class Seafloor(Protocol):
    """A floor that can be seen by an altimeter."""

    def height(self, x: float, y: float) -> float:
        """z [m] of the floor below or above the point (x, y) [m] in W."""

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """Distance [m] from `origin` (3,) along the unit vector `direction` (3,) to the floor; nan without a hit."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FlatSeafloor:
    """The plane z = `z` [m] in W."""

    z: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.z):
            raise InvalidInput(f"seafloor at z = {self.z}; give a finite height [m]")

    def height(self, x: float, y: float) -> float:
        return self.z

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """See `Seafloor`; 0 or negative where the origin is at or below the floor and the ray points down."""
        descent = -float(direction[2])
        return (float(origin[2]) - self.z) / descent if descent > 1e-9 else math.nan

"""Obstacles: solid shapes that stand in the water."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.exceptions import InvalidInput


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Obstacle:
    """A coal shape at a fixed pose in W. Raises `InvalidInput` for an empty name or a pose that is not finite."""

    name: str
    shape: coal.CollisionGeometry
    X_WO: pin.SE3  # pose [m] of the shape's own frame

    def __post_init__(self) -> None:
        if not self.name:
            raise InvalidInput("an obstacle needs a name; give one that is not empty")
        if not np.isfinite(self.X_WO.homogeneous).all():
            raise InvalidInput(f"pose of obstacle {self.name!r} has NaN or infinite entries; give finite numbers")

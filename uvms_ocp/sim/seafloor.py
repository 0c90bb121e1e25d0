"""Sea floors: a plane, and a plane with smooth protuberances."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

from uvms_ocp.exceptions import InvalidInput, NameNotFound

_LEVEL = 1e-9  # sine of the angle to the horizon below which a ray counts as level
_SAMPLES_PER_RADIUS = 12  # of the smallest protuberance, when a ray looks for the floor
_MAX_SAMPLES = 20_000
_RANGE_TOLERANCE = 1e-10  # [m]


class Seafloor(Protocol):
    """A floor that can be seen by an altimeter and stood upon."""

    def height(self, x: float, y: float) -> float:
        """z [m] of the floor below or above the point (x, y) [m] in W."""

    def normal(self, x: float, y: float) -> np.ndarray:
        """Unit normal (3,) of the floor at (x, y) [m], upwards."""

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """Distance [m] from `origin` (3,) along the unit vector `direction` (3,) to the floor; nan without a hit.

        0 or negative where the origin is at or below the floor and the ray points down.
        """


@dataclass(frozen=True, kw_only=True, slots=True)
class FlatSeafloor:
    """The plane z = `z` [m] in W."""

    z: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.z):
            raise InvalidInput(f"seafloor at z = {self.z}; give a finite height [m]")

    def height(self, x: float, y: float) -> float:
        return self.z

    def normal(self, x: float, y: float) -> np.ndarray:
        return np.array([0.0, 0.0, 1.0])

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """See `Seafloor`."""
        descent = -float(direction[2])
        return (float(origin[2]) - self.z) / descent if descent > _LEVEL else math.nan


@dataclass(frozen=True, kw_only=True, slots=True)
class Relief:
    """How rough a floor is: the ranges from which its protuberances are drawn."""

    height: tuple[float, float]  # [m]
    radius: tuple[float, float]  # [m]
    spacing: float  # [m] mean distance between neighbours

    def __post_init__(self) -> None:
        for name in ("height", "radius"):
            low, high = getattr(self, name)
            if not (math.isfinite(high) and 0 < low <= high):
                raise InvalidInput(f"{name} of protuberances = {(low, high)} m; give 0 < lowest <= highest")
        if not (math.isfinite(self.spacing) and self.spacing > 0):
            raise InvalidInput(f"spacing of protuberances = {self.spacing} m; give a finite distance > 0")


RELIEFS = {
    "flat": Relief(height=(0.02, 0.1), radius=(2.0, 5.0), spacing=4.0),
    "small": Relief(height=(0.3, 1.2), radius=(1.5, 4.0), spacing=4.0),
    "large": Relief(height=(2.0, 6.0), radius=(5.0, 12.0), spacing=12.0),
}
"""The floors of [Gao2022] table 2, which names but does not measure them: the figures are assumed."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HeightField:
    """A plane with bumps ``h (1 - (d/r)^2)^3`` where the distance d to the bump's centre is below r.

    Twice continuously differentiable; overlapping bumps add up.
    """

    z: float  # [m] of the plane
    centres: np.ndarray  # (n, 2) [m] x, y in W
    heights: np.ndarray  # (n,) [m] > 0
    radii: np.ndarray  # (n,) [m] > 0
    _inverse_squares: np.ndarray = field(init=False, repr=False)  # (n,) [1/m2] of the radii
    _top: float = field(init=False, repr=False)  # [m] no point of the floor is higher

    def __post_init__(self) -> None:
        n = len(self.heights)
        for name, shape in (("centres", (n, 2)), ("heights", (n,)), ("radii", (n,))):
            object.__setattr__(self, name, _checked(name, getattr(self, name), shape))
        if not math.isfinite(self.z):
            raise InvalidInput(f"seafloor at z = {self.z}; give a finite height [m]")
        if n and not (self.heights.min() > 0 and self.radii.min() > 0):
            raise InvalidInput("heights and radii of a height field must be > 0")
        object.__setattr__(self, "_inverse_squares", self.radii**-2.0)
        object.__setattr__(self, "_top", self.z + _highest(self.centres, self.heights, self.radii))

    @staticmethod
    def random(
        relief: Relief | str,
        *,
        z: float,
        centre: tuple[float, float] = (0.0, 0.0),
        extent: float = 100.0,
        seed: int = 0,
    ) -> HeightField:
        """Protuberances drawn from `relief` (or its name in `RELIEFS`) over a square of side `extent` [m].

        z [m] is the height of the plane between and around them. Raises `NameNotFound` and `InvalidInput`.
        """
        if isinstance(relief, str):
            if relief not in RELIEFS:
                raise NameNotFound("relief", relief, RELIEFS)
            relief = RELIEFS[relief]
        if not (math.isfinite(extent) and extent > 0):
            raise InvalidInput(f"extent of a height field = {extent} m; give a finite length > 0")
        rng = np.random.default_rng(seed)
        n = max(1, round((extent / relief.spacing) ** 2))
        return HeightField(
            z=z,
            centres=np.asarray(centre) + extent * (rng.random((n, 2)) - 0.5),
            heights=rng.uniform(*relief.height, n),
            radii=rng.uniform(*relief.radius, n),
        )

    def height(self, x: float, y: float) -> float:
        return float(self._rest(x, y) ** 3 @ self.heights) + self.z

    def heights_at(self, points: np.ndarray) -> np.ndarray:
        """z (m,) [m] of the floor at x, y (m, 2) [m] in W."""
        offsets = points[:, None, :] - self.centres
        rest = np.maximum(1.0 - np.sum(offsets * offsets, axis=2) * self._inverse_squares, 0.0)
        return self.z + rest**3 @ self.heights

    def gradient(self, x: float, y: float) -> np.ndarray:
        """Slope (2,) [-] along x and y in W."""
        slope = -6.0 * self.heights * self._rest(x, y) ** 2 * self._inverse_squares
        return np.array([x * slope.sum() - slope @ self.centres[:, 0], y * slope.sum() - slope @ self.centres[:, 1]])

    def normal(self, x: float, y: float) -> np.ndarray:
        upwards = np.array([*-self.gradient(x, y), 1.0])
        return upwards / np.linalg.norm(upwards)

    def _rest(self, x: float, y: float) -> np.ndarray:
        """``1 - (d/r)^2`` (n,) of every bump, 0 beyond its radius."""
        dx, dy = self.centres[:, 0] - x, self.centres[:, 1] - y
        return np.maximum(1.0 - (dx * dx + dy * dy) * self._inverse_squares, 0.0)

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        """See `Seafloor`. Marches with a fraction of the smallest radius, then refines by Brent's method."""
        descent = -float(direction[2])
        above = float(origin[2]) - self.height(float(origin[0]), float(origin[1]))
        if above <= 0:
            return above / descent if descent > _LEVEL else math.nan
        interval = self._where_bumps_are(origin, direction)
        crossing = None if interval is None else self._first_crossing(origin, direction, *interval)
        if crossing is not None:
            return self._crossing_in(origin, direction, *crossing)
        return (float(origin[2]) - self.z) / descent if descent > _LEVEL else math.nan

    def _where_bumps_are(self, origin: np.ndarray, direction: np.ndarray) -> tuple[float, float] | None:
        """Part of the ray inside the box that holds all bumps, by the slab method; `None` where it misses the box."""
        if not len(self.heights):
            return None
        low = np.array([*(self.centres - self.radii[:, None]).min(axis=0), self.z])
        high = np.array([*(self.centres + self.radii[:, None]).max(axis=0), self._top])
        slope = np.where(np.abs(direction) < _LEVEL, _LEVEL, direction)
        to_low, to_high = (low - origin) / slope, (high - origin) / slope
        start = max(0.0, float(np.minimum(to_low, to_high).max()))
        end = float(np.maximum(to_low, to_high).min())
        return (start, end) if start <= end else None

    def _first_crossing(
        self, origin: np.ndarray, direction: np.ndarray, start: float, end: float
    ) -> tuple[float, float] | None:
        step = self.radii.min() / _SAMPLES_PER_RADIUS
        sideways = math.hypot(direction[0], direction[1]) * (end - start)
        distances = np.linspace(start, end, min(2 + math.ceil(sideways / step), _MAX_SAMPLES))
        points = origin + distances[:, None] * direction
        below = points[:, 2] <= self.heights_at(points[:, :2])
        if not below.any():
            return None
        hit = int(np.argmax(below))
        return float(distances[max(hit - 1, 0)]), float(distances[hit])

    def _crossing_in(self, origin: np.ndarray, direction: np.ndarray, above: float, below: float) -> float:
        def clearance(distance: float) -> float:
            x, y, z = (origin + distance * direction).tolist()
            return z - self.height(x, y)

        if clearance(above) <= 0:  # the interval begins at the floor
            return above
        return float(brentq(clearance, above, below, xtol=_RANGE_TOLERANCE))


def _checked(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    array = np.array(values, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InvalidInput(f"{name} of a height field: shape {array.shape}; give finite numbers of shape {shape}")
    array.setflags(write=False)
    return array


def _highest(centres: np.ndarray, heights: np.ndarray, radii: np.ndarray) -> float:
    """Upper bound of the sum of bumps: each bump with all that overlap it, at their full height."""
    if not len(heights):
        return 0.0
    distances = np.linalg.norm(centres[:, None] - centres, axis=2)
    return float(((distances < radii[:, None] + radii) @ heights).max())

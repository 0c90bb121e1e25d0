"""Sea floors with smooth protuberances."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.sim.seafloor import LEVEL_RAY, Points, Seafloor
from uvms_ocp.types import Array, Count, Finite, Positive, Range, Shape, Vector3

_SAMPLES_PER_RADIUS = 12  # of the smallest protuberance, when a ray looks for the floor
_MAX_SAMPLES = 20_000
_MOST_BUMPS = 1_000_000
_RANGE_TOLERANCE = 1e-10  # [m]


@checked_dataclass()
class Relief:
    """Roughness of a floor: the ranges from which its protuberances are drawn.

    Raises `InvalidInput` unless 0 < lowest <= highest, and for a spacing that is not > 0.
    """

    height: tuple[Positive, Positive]
    """[m] lowest and highest."""
    radius: tuple[Positive, Positive]
    """[m] smallest and largest."""
    spacing: Positive
    """[m] mean distance between neighbours."""

    def __post_init__(self) -> None:
        for name in ("height", "radius"):
            low, high = getattr(self, name)
            if low > high:
                raise InvalidInput(
                    f"{name} of protuberances = {(low, high)} m; give 0 < lowest <= highest"
                )


RELIEFS = {
    "flat": Relief(height=(0.02, 0.1), radius=(2.0, 5.0), spacing=4.0),
    "small": Relief(height=(0.3, 1.2), radius=(1.5, 4.0), spacing=4.0),
    "large": Relief(height=(2.0, 6.0), radius=(5.0, 12.0), spacing=12.0),
}
"""The floors of [Gao2022] table 2, which names but does not measure them: the figures are
assumed.
"""


@checked_dataclass(eq=False)
class HeightField(Seafloor):
    """A plane with bumps ``h (1 - (d/r)^2)^3`` where the distance d to the bump's centre is below
    r.

    Twice continuously differentiable; overlapping bumps add up. Raises `InvalidInput` for numbers
    that are not finite, arrays that do not fit together, and heights or radii that are not > 0.
    """

    z: Finite
    """[m] Height of the plane."""
    centres: Annotated[Array, Shape("n", 2), Range(open=True)]
    """(n, 2) [m] x, y in W."""
    heights: Annotated[Array, Shape("n"), Range(0.0, open=True)]
    """(n,) [m] > 0."""
    radii: Annotated[Array, Shape("n"), Range(0.0, open=True)]
    """(n,) [m] > 0."""
    _bumps: np.ndarray = field(init=False, repr=False)
    """(4, n): x, y, height, 1 / radius^2."""
    _low: np.ndarray = field(init=False, repr=False)
    """(3,) [m] corner of a box around all bumps."""
    _high: np.ndarray = field(init=False, repr=False)
    """(3,) [m] opposite corner of that box."""

    def __post_init__(self) -> None:
        bumps = np.vstack([self.centres.T, self.heights, self.radii**-2.0])
        low, high = _box(self.centres, self.radii)
        object.__setattr__(self, "_bumps", bumps)
        object.__setattr__(self, "_low", np.array([*low, self.z]))
        object.__setattr__(
            self,
            "_high",
            np.array([*high, self.z + _highest(self.centres, self.heights, self.radii)]),
        )

    @staticmethod
    def random(
        relief: Relief | str,
        *,
        z: float,
        centre: tuple[float, float] = (0.0, 0.0),
        extent: Positive = 100.0,
        seed: Count = 0,
    ) -> HeightField:
        """Draw protuberances from `relief` (or its name in `RELIEFS`) over a square of side
        `extent` [m].

        z [m]: height of the plane between and around them. centre [m]: x, y of the square in W.
        Raises `NameNotFound` for an unknown name and `InvalidInput` for an extent that is not > 0.
        """
        if isinstance(relief, str):
            require_known("relief", relief, RELIEFS)
            relief = RELIEFS[relief]
        if extent / relief.spacing > math.sqrt(_MOST_BUMPS):
            raise InvalidInput(
                f"extent of a height field = {extent} m; give less: more than {_MOST_BUMPS:,}"
                " protuberances"
            )
        rng = np.random.default_rng(seed)
        n = max(1, round((extent / relief.spacing) ** 2))
        return HeightField(
            z=z,
            centres=np.asarray(centre) + extent * (rng.random((n, 2)) - 0.5),
            heights=rng.uniform(*relief.height, n),
            radii=rng.uniform(*relief.radius, n),
        )

    @property
    def top(self) -> float:
        """Height [m] in W that no part of the floor is above."""
        return float(self._high[2])

    @checked_on_failure
    def height(self, x: float, y: float) -> float:
        return self.z + float(_elevation(self._bumps, x, y))

    def gradient(self, x: float, y: float) -> np.ndarray:
        """Return the slope (2,) along x and y in W, at the point (x, y) [m]."""
        return _slopes(self._bumps, np.array([[x, y]]))[1][0]

    @checked_on_failure
    def normal(self, x: float, y: float) -> np.ndarray:
        return _normals(self.gradient(x, y)[None, :])[0]

    @checked_on_failure
    def ground_at(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (n,) [m] and unit normals (n, 3) of the floor at points (n, 2) [m], x and
        y in W.
        """
        elevations, slopes = _slopes(self._bumps, points)
        return self.z + elevations, _normals(slopes)

    @checked_on_failure
    def range_along(self, origin: Vector3, direction: Vector3) -> float:
        # Marches with a fraction of the smallest radius, then refines by Brent's method.
        descent = -float(direction[2])
        above = float(origin[2]) - self.height(float(origin[0]), float(origin[1]))
        if above > 0:
            crossing = self._crossing(origin, direction)
            if crossing is not None:
                return crossing
        if descent <= LEVEL_RAY:
            return math.nan
        if above <= 0:
            return above / descent
        return (float(origin[2]) - self.z) / descent

    def _crossing(self, origin: np.ndarray, direction: np.ndarray) -> float | None:
        """Return the distance [m] at which a ray meets a bump; `None` where it meets none."""
        # Part of the ray inside the box that holds all bumps, by the slab method; `None` where it
        # misses the box.
        slope = np.where(np.abs(direction) < LEVEL_RAY, LEVEL_RAY, direction)
        to_low = (self._low - origin) / slope
        to_high = (self._high - origin) / slope
        start = max(0.0, float(np.minimum(to_low, to_high).max()))
        end = float(np.maximum(to_low, to_high).min())
        if not start <= end:
            return None
        bumps = self._bumps[:, _near_ray(self._bumps, origin, direction, start, end)]
        bracket = self._first_bracket(bumps, origin, direction, start, end)
        if bracket is None:
            return None
        return self._refined(bumps, origin, direction, *bracket)

    def _first_bracket(
        self, bumps: np.ndarray, origin: np.ndarray, direction: np.ndarray, start: float, end: float
    ) -> tuple[float, float] | None:
        """Find the first two neighbouring samples of a ray of which one is above and one below the
        floor; None for no such.
        """
        if not bumps.size:
            return None
        sideways = math.hypot(direction[0], direction[1]) * (end - start)
        n_samples = 2 + math.ceil(sideways * _SAMPLES_PER_RADIUS * math.sqrt(bumps[3].max()))
        distances = np.linspace(start, end, min(n_samples, _MAX_SAMPLES))
        points = origin + distances[:, None] * direction
        below = points[:, 2] <= self.z + _elevation(bumps, points[:, :1], points[:, 1:2])
        hit = int(np.argmax(below))
        if below[hit]:
            return (float(distances[max(hit - 1, 0)]), float(distances[hit]))
        return None

    def _refined(
        self,
        bumps: np.ndarray,
        origin: np.ndarray,
        direction: np.ndarray,
        above: float,
        below: float,
    ) -> float:
        from scipy.optimize import brentq  # half a second, which few need

        (x, y, z) = origin.tolist()
        (dx, dy, dz) = direction.tolist()
        bump_rows = bumps.T.tolist()

        def clearance(s: float) -> float:
            rise = 0.0
            for bx, by, height, scale in bump_rows:  # few: quicker than arrays
                rest = 1.0 - ((bx - x - s * dx) ** 2 + (by - y - s * dy) ** 2) * scale
                rise += height * rest**3 if rest > 0.0 else 0.0
            return z + s * dz - self.z - rise

        if clearance(above) <= 0 or clearance(below) >= 0:  # the floor is at the end, to rounding
            if clearance(above) <= 0:
                return above
            return below
        return float(brentq(clearance, above, below, xtol=_RANGE_TOLERANCE))


def _elevation(bumps: np.ndarray, x: float | np.ndarray, y: float | np.ndarray) -> np.ndarray:
    """Sum the bumps (4, n) at a point, or (m,) at points whose x and y are columns (m, 1)."""
    dx = bumps[0] - x
    dy = bumps[1] - y
    rest = np.maximum(1.0 - (dx * dx + dy * dy) * bumps[3], 0.0)
    return (rest * rest * rest) @ bumps[2]


def _slopes(bumps: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum the bumps (4, n) at points (m, 2) [m]; return the sum (m,) [m] and its gradient (m, 2)."""
    dx = bumps[0] - points[:, :1]
    dy = bumps[1] - points[:, 1:]
    rest = np.maximum(1.0 - (dx * dx + dy * dy) * bumps[3], 0.0)
    square = rest * rest
    weights = 6.0 * bumps[2] * bumps[3]
    return (square * rest) @ bumps[2], np.stack(
        [(square * dx) @ weights, (square * dy) @ weights], axis=1
    )


def _normals(slopes: np.ndarray) -> np.ndarray:
    """Return the unit normals (m, 3), upwards, of a surface with slopes (m, 2)."""
    upwards = np.ones((len(slopes), 3))
    upwards[:, :2] = -slopes
    return upwards / np.sqrt((upwards * upwards).sum(axis=1))[:, None]


def _near_ray(
    bumps: np.ndarray, origin: np.ndarray, direction: np.ndarray, start: float, end: float
) -> np.ndarray:
    """Return a mask (n,) of the bumps above which the ray passes between two distances."""
    dx = bumps[0] - origin[0]
    dy = bumps[1] - origin[1]
    sideways = max(direction[0] ** 2 + direction[1] ** 2, LEVEL_RAY**2)
    nearest = np.clip((dx * direction[0] + dy * direction[1]) / sideways, start, end)
    dx = dx - nearest * direction[0]
    dy = dy - nearest * direction[1]
    return (dx * dx + dy * dy) * bumps[3] < 1.0


def _box(centres: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (2,) [m] of the rectangle that holds all bumps; an empty rectangle without
    any.
    """
    if not len(radii):
        return np.full(2, math.inf), np.full(2, -math.inf)
    return (centres - radii[:, None]).min(axis=0), (centres + radii[:, None]).max(axis=0)


def _highest(centres: np.ndarray, heights: np.ndarray, radii: np.ndarray) -> float:
    """Return an upper bound [m] of the sum of bumps: each bump with all that overlap it, at their
    full height.
    """
    if not len(heights):
        return 0.0
    distances = np.linalg.norm(centres[:, None] - centres, axis=2)
    return float(((distances < radii[:, None] + radii) @ heights).max())

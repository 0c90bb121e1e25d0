"""A sea floor that was surveyed: heights on a grid, of arrays or of a file."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import printable
from uvms_ocp.record.array_file import read_arrays
from uvms_ocp.sim.seafloor import LEVEL_RAY, Points, Seafloor
from uvms_ocp.types import Array, Finite, Range, Shape, Vector3

_WORD = re.compile(r"[^\s,;]+")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
_FORMS = (
    "give lines x,y,z [m] of a whole grid, as CSV or with blanks between, or an .npz with arrays x"
    " (n,), y (m,) and z (m, n)"
)


@checked_dataclass(eq=False)
class Bathymetry(Seafloor):
    """Heights on a grid, bilinear between its points and level with its border beyond it.

    Raises `InvalidInput` unless x and y ascend, with two values or more each, and every height is
    finite.
    """

    x: Annotated[Array, Shape("n"), Range(open=True)]
    """(n,) [m] grid lines along x in W."""
    y: Annotated[Array, Shape("m"), Range(open=True)]
    """(m,) [m] grid lines along y in W."""
    z: Annotated[Array, Shape("m", "n"), Range(open=True)]
    """(m, n) [m] heights in W, upwards."""

    def __post_init__(self) -> None:
        for name, axis in (("x", self.x), ("y", self.y)):
            if len(axis) < 2 or not (np.diff(axis) > 0).all():
                raise InvalidInput(
                    f"{name} of a bathymetry, shape {axis.shape}; give two values or more that"
                    " ascend"
                )

    @staticmethod
    def read(
        path: Path | str, *, origin: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    ) -> Bathymetry:
        """Read a file: lines ``x,y,z`` or ``x y z`` in any order, with or without a title, or
        NumPy's ``.npz`` with x, y and z.

        origin [m]: of W in the coordinates of the file, such as east, north and height of a chart.
        Raises `InvalidInput` for a file that cannot be read, depths in place of heights, and a grid
        with holes or points twice.
        """
        try:
            if Path(path).suffix == ".npz":
                x, y, z = _of_arrays(Path(path))
            else:
                x, y, z = _of_lines(Path(path))
        except (OSError, ValueError, KeyError) as error:
            why = " ".join(str(error).split())
            raise InvalidInput(f"{printable(path)}: no bathymetry ({why}); {_FORMS}") from None
        return Bathymetry(x=x - origin[0], y=y - origin[1], z=z - origin[2])

    @checked_on_failure
    def height(self, x: float, y: float) -> float:
        return float(self._surface(np.array([[x, y]], dtype=float))[0][0])

    @checked_on_failure
    def normal(self, x: float, y: float) -> np.ndarray:
        return self.ground_at(np.array([[x, y]], dtype=float))[1][0]

    @checked_on_failure
    def ground_at(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (n,) [m] and unit normals (n, 3) of the floor at points (n, 2) [m], x and
        y in W.
        """
        heights, slopes = self._surface(points)
        upwards = np.column_stack([-slopes, np.ones(len(points))])
        return heights, upwards / np.linalg.norm(upwards, axis=1)[:, None]

    @checked_on_failure
    def range_along(self, origin: Vector3, direction: Vector3) -> float:
        # Along a ray the clearance is a parabola between two lines of the grid.
        descent = -float(direction[2])
        above = float(origin[2]) - self.height(float(origin[0]), float(origin[1]))
        if above <= 0:
            if descent > LEVEL_RAY:
                return above / descent
            return math.nan
        knots = [np.zeros(1)]
        for axis, lines in enumerate((self.x, self.y)):
            if abs(direction[axis]) > LEVEL_RAY:
                knots.append((lines - origin[axis]) / direction[axis])
        longest = math.inf
        if descent > LEVEL_RAY:
            longest = (origin[2] - self.z.min()) / descent + 1.0
            knots.append(np.array([longest]))
        s = np.unique(np.concatenate(knots))
        s = s[(s >= 0.0) & (s <= longest)]
        ends = self._clearance(origin, direction, s)
        middles = self._clearance(origin, direction, (s[1:] + s[:-1]) / 2)
        u = _first_zero(ends[:-1], middles, ends[1:])
        hits = np.flatnonzero(np.isfinite(u))
        if len(hits) == 0:
            return math.nan
        first = hits[0]
        return float(s[first] + u[first] * (s[first + 1] - s[first]))

    def _clearance(self, origin: np.ndarray, direction: np.ndarray, s: np.ndarray) -> np.ndarray:
        points = origin + s[:, None] * direction
        return np.asarray(points[:, 2] - self._surface(points[:, :2])[0])

    def _surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (n,) [m] and slopes (n, 2) at points (n, 2) [m]."""
        cells = []
        shares = []
        widths = []
        inside = []
        for lines, values in zip((self.x, self.y), points.T, strict=True):
            at = np.clip(values, lines[0], lines[-1])
            cell = np.clip(np.searchsorted(lines, at, side="right") - 1, 0, len(lines) - 2)
            width = lines[cell + 1] - lines[cell]
            cells.append(cell)
            widths.append(width)
            shares.append((at - lines[cell]) / width)
            inside.append(at == values)
        (i, j) = cells
        (u, v) = shares
        z = self.z
        a = z[j, i]
        b = z[j, i + 1]
        c = z[j + 1, i]
        d = z[j + 1, i + 1]
        east = (1 - v) * (b - a) + v * (d - c)
        north = (1 - u) * (c - a) + u * (d - b)
        slopes = np.column_stack([east / widths[0] * inside[0], north / widths[1] * inside[1]])
        heights = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
        return heights, slopes


def _first_zero(start: np.ndarray, middle: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the first zeros (n,) in [0, 1] of parabolas by their values (n,) at 0, 1/2 and 1, the
    first > 0; NaN for none.
    """
    a = 2 * (start + end - 2 * middle)
    b = end - start - a
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -(b + np.copysign(np.sqrt(b * b - 4 * a * start), b)) / 2
        roots = np.array([start / q, q / a])
        roots[~((roots >= 0.0) & (roots <= 1.0))] = np.inf
    first = roots.min(axis=0)
    first[(first == np.inf) & (end <= 0.0)] = 1.0
    return np.where(np.isfinite(first), first, np.nan)


def _of_arrays(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    arrays = read_arrays(path)
    x, y, z = (np.asarray(arrays[name], dtype=float) for name in ("x", "y", "z"))
    return x, y, z


def _of_lines(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    lines = [
        line for line in path.read_text(encoding="utf-8-sig").splitlines() if _WORD.search(line)
    ]
    rows = [_WORD.findall(line) for line in lines]
    if rows and not _NUMBER.fullmatch(rows[0][0]):
        title, *rows = rows
        if "depth" in _last_column(lines[0].lower()):
            text = (
                "are depths, not heights: change their sign where they count downwards, and call"
                " them z"
            )
            raise InvalidInput(f"{' '.join(title)!r} {text}")
    table = np.array([list(map(float, row)) for row in rows])
    if table.ndim != 2 or table.shape[1] != 3:
        raise InvalidInput(f"{len(rows)} lines of numbers, not of three each")
    x, i = np.unique(table[:, 0], return_inverse=True)
    y, j = np.unique(table[:, 1], return_inverse=True)
    if len(table) != len(x) * len(y) or len(np.unique(j * len(x) + i)) != len(table):
        raise InvalidInput(f"{len(table)} points, and a grid of {len(x)} by {len(y)} lines")
    z = np.zeros((len(y), len(x)))
    z[j, i] = table[:, 2]
    return x, y, z


def _last_column(title: str) -> str:
    """Return the name of the last column, without what stands in brackets; between blanks the last
    two words, as one may be a unit.
    """
    bare = re.sub(r"\(.*?\)|\[.*?\]", " ", title)
    columns = [name for name in re.split(r"[;,\t]", bare) if name.strip()]
    words = _WORD.findall(bare)
    if len(words) <= 2:
        words = _WORD.findall(title)
    if len(columns) > 2:
        return columns[-1]
    return " ".join(words[-2:])

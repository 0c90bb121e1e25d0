"""Check lexicographic optimality independently of the solver: a proven bound of what every level is
short of.

Rows are first scaled to normal units (`normal_rows`); scaling.c and certificate.c are the twins in
C.

All divisors are powers of two, so that nothing is rounded. `[rate]` is the unit of a row,
`[velocity]` that of an entry of v; in normal units both are 1.

Let f_k(y) be the Euclidean norm of the distances of the rows of level k from their bounds, ``a_i``
its rows, and v the velocity found. The levels above are held at the residuals found: row i of them
at most as far beyond either bound as it is at v, and y stays in a region around v,
``-down <= y - v <= up``. **The bound**: for any numbers p_i of the rows of level k with
``|p| <= 1``, any multipliers ``x_j >= 0`` of the held rows and ``r = sum p_i a_i + sum x_j c_j``,
with ``c_j`` the row where x_j belongs to its upper bound and minus the row where to its lower one,
and gap_j >= 0 the distance of v from that bound, as held:

    f_k(v) - f_k(y) <= f_k(v) - sum p_i d_i + sum x_j gap_j + sum_c (r_c > 0 ? r_c down_c : -r_c
    up_c)

for every such y, where d_i is ``a_i v`` minus the upper bound of row i where p_i > 0, minus the
lower one where p_i < 0.

**Proof.** The distance s_i(y) of row i from its interval, negative below it, is at least
``a_i y - upper_i`` and at most ``a_i y - lower_i`` everywhere. So
``f_k(y) = |s(y)| >= sum p_i s_i(y) >= sum p_i d_i + sum p_i a_i (y - v)``. The last sum is
``r (y - v) - sum x_j c_j (y - v)``. Held rows say ``c_j (y - v) <= gap_j``, and x_j >= 0; the
region says ``r (y - v) >= -sum_c (r_c > 0 ? r_c down_c : -r_c up_c)``. Moreover f_k(y) >= 0, so
that f_k(v) is a bound as well. QED.

It holds for any multipliers; how they are found decides only how small it is. Here p = s(v) /
|s(v)|, for which the first two terms cancel, and x comes from non-negative least squares of r and
the gaps, 0 for both at an optimum.

Rounding: a row ``a_i v`` of doubles is wrong by up to
``noise_i = n 2^-52 |a_i| (|v| + |down or up|)``, and a smaller gap cannot be told from 0 and counts
as 0. So the number is a bound up to ``noise_k + sum x_j noise_j``, about 1e-15 of ``|a| |v|``
unless rows are nearly dependent: where it is more than `tolerances.RESOLVED`, it is added. `[rate]`
is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.codegen.elementwise import interval_distance, interval_excess
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.solvers.hierarchy.level import Level, row_slices, stack, widen_bounds
from uvms_ocp.types import Array, Mask


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class VelocityBox:
    """Velocities that the rows of the first level with one entry span: the velocity limits, where
    there are any.
    """

    lower: Array
    """(n,) lower bounds in normal units, -inf where no row is bounded on both sides."""
    upper: Array
    """(n,) upper bounds in normal units, inf where no row is bounded on both sides."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NegligibleRows:
    """Rows that count as nothing beside the largest, as they were given."""

    J: Array
    """(k, n) [rate/velocity] Jacobian."""
    lower: Array
    """(k,) [rate] lower bounds."""
    upper: Array
    """(k,) [rate] upper bounds."""

    def are_missed(self, v: Array, velocity: float) -> bool:
        """Check whether one of them could be noticeably nearer to its bounds than at v (n,)
        [velocity].

        velocity [velocity]: the size of velocities.
        """
        if not len(self.J):
            return False
        missed = np.abs(interval_distance(self.J @ v, self.lower, self.upper))
        nearer = np.minimum(missed, tolerances.REACH * velocity * _norms(self.J))
        return bool(
            (nearer > np.maximum(tolerances.UNNOTICED, tolerances.CERTIFIED * missed)).any()
        )


NO_NEGLIGIBLE_ROWS = NegligibleRows(J=np.zeros((0, 0)), lower=np.zeros(0), upper=np.zeros(0))
"""No negligible row: all rows count."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NormalRows:
    """``lower <= J w <= upper`` with rows of J, and w, of the order of 1."""

    J: Array
    """(M, n) 0 in rows that count as nothing beside the largest."""
    lower: Array
    """(M,) lower bounds."""
    upper: Array
    """(M,) upper bounds."""
    sizes: tuple[int, ...]
    """Rows of each level."""
    box: VelocityBox
    """Velocity box of the first level."""
    level: Array
    """(levels,) [rate/velocity] divisors of the rows of each level."""
    velocity: float
    """[velocity] v = velocity w."""
    unit: float
    """Unit of rates: the largest rate that any row asks for over the largest row of all levels, at
    most 1. It is less where rows that are small beside others ask for large velocities.
    """
    lost: NegligibleRows
    """Rows that are 0 in `J` and were not."""

    def levels(self) -> list[Level]:
        """Return the rows as levels, as solvers take them."""
        levels = list[Level]()
        for rows in row_slices(self.sizes):
            level = Level(jacobian=self.J[rows], lower=self.lower[rows], upper=self.upper[rows])
            levels.append(level)
        return levels


@np.errstate(over="ignore", invalid="ignore")  # what overflows is never called exact
def normal_rows(J: Array, lower: Array, upper: Array, sizes: Sequence[int]) -> NormalRows:
    """Normalise J (M, n) [rate/velocity] and gated bounds lower and upper (M,) [rate]; sizes: rows
    of each level.

    The size of velocities is the largest that a row asks for, or what the box of the first level
    allows if that is less.
    """
    norm = _norms(J)
    largest = norm.max(initial=0.0)
    real = norm > tolerances.VANISHED * largest
    real_norm = np.where(real, norm, 0.0)
    level = np.array([_power(real_norm[rows].max(initial=0.0)) for rows in row_slices(sizes)])
    divisor = np.repeat(level, sizes)
    lost = ~real & (norm > 0.0)
    lost_rows = NegligibleRows(J=J[lost], lower=lower[lost], upper=upper[lost])
    requested_size = 0.0
    if largest > 0.0:
        requested_size = _requested_rate(lower, upper, real) / largest
    J = np.where(real[:, None], J / divisor[:, None], 0.0)
    lower = lower / divisor
    upper = upper / divisor
    first = next((size for size in sizes if size), 0)
    box = _box(J[:first], lower[:first], upper[:first])
    size = _requested_rate(lower, upper, real)
    allowed = float(np.maximum(-box.lower, box.upper).max())
    if allowed > 0.0:
        size = min(size, allowed)
    velocity = _power(size)
    unit = 1.0
    if requested_size > 0.0:
        unit = min(requested_size / velocity, 1.0)
    box = VelocityBox(lower=box.lower / velocity, upper=box.upper / velocity)
    return NormalRows(
        J=J,
        lower=lower / velocity,
        upper=upper / velocity,
        sizes=tuple(sizes),
        box=box,
        level=level,
        velocity=velocity,
        unit=unit,
        lost=lost_rows,
    )


def _requested_rate(lower: Array, upper: Array, real: Array) -> float:
    """Return the largest distance of 0 from the bounds of any row that counts."""
    return float(interval_excess(np.zeros(len(lower)), lower, upper)[real].max(initial=0.0))


def _norms(J: Array) -> Array:
    squares = (J * J).sum(axis=1)
    sound = (squares > tolerances.SMALL_SQUARE) & (squares < np.inf)
    return np.asarray(np.where(sound, np.sqrt(squares), np.abs(J).max(axis=1, initial=0.0)))


def _power(size: float) -> float:
    """Return the power of two above a size; 1 for 0."""
    if 0.0 < size < np.inf:
        return float(np.ldexp(1.0, min(int(np.frexp(size)[1]), 1023)))
    return 1.0


def _box(J: Array, lower: Array, upper: Array) -> VelocityBox:
    n = J.shape[1]
    low = np.full(n, -np.inf)
    up = np.full(n, np.inf)
    has_one_entry = (J != 0.0).sum(axis=1) == 1
    has_two_bounds = (lower > -np.inf) & (upper < np.inf)
    for row in np.flatnonzero(has_one_entry & has_two_bounds):
        column = int(np.flatnonzero(J[row])[0])
        entry = J[row, column]
        smaller, larger = sorted((lower[row] / entry, upper[row] / entry))
        low[column] = max(low[column], smaller)
        up[column] = min(up[column], larger)
    return VelocityBox(lower=low, upper=up)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Region:
    """Trust region of y around v: ``-down <= y - v <= up``."""

    down: Array
    """(n,) distance from v to the lower ends of the region."""
    up: Array
    """(n,) distance from v to the upper ends of the region."""
    endless: Mask
    """(n,) entries that y may change beyond it."""


def certificate(levels: Sequence[Level], v: ArrayLike, radius: ArrayLike | None = None) -> float:
    """Return the largest entry [rate] of `level_excesses`: no level can be improved by more without
    worsening one above it.

    v (n,) [velocity]; radius () or (n,) [velocity]. Raises `InvalidInput` as that.
    """
    return float(level_excesses(levels, v, radius).max())


@np.errstate(over="ignore", invalid="ignore")  # what overflows has no certificate
def level_excesses(levels: Sequence[Level], v: ArrayLike, radius: ArrayLike | None = None) -> Array:
    """Bound by how much (levels,) [rate] each level's residual norm at v (n,) [velocity] is above
    its least.

    That least is over all y with ``|y - v| <= radius``, () or (n,) [velocity], entry by entry, that
    leave every row of the levels above at the residual it has at v or nearer to its bounds. Without
    a radius y is anywhere in the box that rows of the first level with one entry and two bounds
    span, the velocity limits; entries without such a row go anywhere: where one could improve a
    level, all of the level's residual counts. All entries of the first level itself, whose rows may
    contradict the box that they span, get about twice the velocity that the rows ask for; the
    levels below are held in it.

    inf where v is not finite or too large to tell. Raises `InvalidInput` for a v or radius of the
    wrong shape, or a radius that is not positive.
    """
    rows = stack(levels)
    low, up = widen_bounds(rows.jacobian, rows.lower, rows.upper, rows.gate)
    v = _checked_velocity(v, rows.jacobian.shape[1])
    normal = normal_rows(rows.jacobian, low, up, rows.sizes)
    # Rows that count as nothing for a solver count here.
    normal = replace(normal, J=rows.jacobian / np.repeat(normal.level, rows.sizes)[:, None])
    w = v / normal.velocity
    if radius is None:
        endless = np.isinf(normal.box.lower) | np.isinf(normal.box.upper)
        region = replace(_default_region(normal, w), endless=endless)
        excesses = _excesses(normal, w, region, first=_beyond_box(region))
    else:
        radii = np.asarray(radius, dtype=np.float64)
        if radii.shape not in ((), v.shape) or not ((radii > 0.0) & (radii < np.inf)).all():
            raise InvalidInput(
                f"radius = {radii}; give one finite velocity > 0 for all entries of v, or {len(v)}"
                " of them"
            )
        reach = np.broadcast_to(radii, v.shape) / normal.velocity
        region = _Region(down=reach, up=reach, endless=np.zeros(len(v), dtype=bool))
        excesses = _excesses(normal, w, region, first=region)
    return excesses * normal.level * normal.velocity


@np.errstate(over="ignore", invalid="ignore")
def normal_certificate(rows: NormalRows, w: Array) -> float:
    """Return the largest excess of any level at w (n,) over the larger of its residual and
    ``rows.unit``: what a status goes by.

    The region is the default one, but no farther from w than
    ``tolerances.REACH``. inf where rows that count as nothing are missed.
    """
    if rows.lost.are_missed(w * rows.velocity, rows.velocity):
        return np.inf
    region = _default_region(rows, w)
    reach = tolerances.REACH
    region = replace(region, down=np.minimum(region.down, reach), up=np.minimum(region.up, reach))
    excesses = _excesses(rows, w, region, first=_beyond_box(region))
    slack = interval_distance(rows.J @ w, rows.lower, rows.upper)
    sizes = np.array([_length(slack[level_rows]) for level_rows in row_slices(rows.sizes)])
    if np.isfinite(excesses).all():
        return float((excesses / np.maximum(sizes, rows.unit)).max(initial=0.0))
    return np.inf


def _checked_velocity(v: ArrayLike, n: int) -> Array:
    array = np.asarray(v, dtype=np.float64)
    if array.shape != (n,):
        raise InvalidInput(f"v has shape {array.shape}; the levels have {n} columns, give ({n},)")
    return array


def _length(w: Array) -> float:
    return float(np.sqrt(w @ w))


def _default_region(rows: NormalRows, w: Array) -> _Region:
    reach = tolerances.REACH
    boxed = (rows.box.lower > -np.inf) & (rows.box.upper < np.inf)
    down = np.maximum(w - rows.box.lower, 0.0)
    up = np.maximum(rows.box.upper - w, 0.0)
    return _Region(
        down=np.where(boxed, down, reach),
        up=np.where(boxed, up, reach),
        endless=np.zeros(len(w), dtype=bool),
    )


def _beyond_box(region: _Region) -> _Region:
    return replace(
        region,
        down=np.maximum(region.down, tolerances.REACH),
        up=np.maximum(region.up, tolerances.REACH),
    )


def _excesses(rows: NormalRows, w: Array, region: _Region, *, first: _Region) -> Array:
    """Return the excess of every level (levels,) at w; first: the trust region of the first
    level.
    """
    if not np.isfinite(w).all():
        return np.full(len(rows.sizes), np.inf)
    terms = _bound_terms(rows, w, region)
    excesses = np.full(len(rows.sizes), np.inf)
    for k, level_rows in enumerate(row_slices(rows.sizes)):
        level_region = first if level_rows.start == 0 else region
        excesses[k] = _level_excess(terms, level_rows, level_region)
    return np.where(np.isfinite(excesses), excesses, np.inf)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _BoundTerms:
    """Slack, gaps and rounding of all M rows at one velocity: terms of the bound on the excess."""

    J: Array
    """(M, n) Jacobian."""
    slack: Array
    """(M,) distance of the rows from their bounds."""
    up: Array
    """(M,) gap to the upper bound; 0 where rounding is as large."""
    down: Array
    """(M,) gap to the lower bound; 0 where rounding is as large."""
    noise: Array
    """(M,) amount that rounding leaves open of each row."""
    unit: float
    """`NormalRows.unit`."""


def _bound_terms(rows: NormalRows, w: Array, region: _Region) -> _BoundTerms:
    y = rows.J @ w
    far = _length(w) + _length(np.maximum(region.down, region.up))
    noise = np.asarray(tolerances.ROUNDING * len(w) * np.linalg.norm(rows.J, axis=1) * far)
    return _BoundTerms(
        J=rows.J,
        slack=interval_distance(y, rows.lower, rows.upper),
        up=np.where(rows.upper - y > noise, rows.upper - y, 0.0),
        down=np.where(y - rows.lower > noise, y - rows.lower, 0.0),
        noise=noise,
        unit=rows.unit,
    )


def _level_excess(terms: _BoundTerms, level_rows: slice, region: _Region) -> float:
    """Bound how much the residual norm of a level exceeds its optimum, by multipliers of the levels
    above.
    """
    size = _length(terms.slack[level_rows])
    if size == 0.0 or not np.isfinite(size):
        return size
    p = terms.slack[level_rows] / size
    gradient = p @ terms.J[level_rows]
    c, gap, noise = _rows_above(terms, level_rows.start)
    x = _multipliers(c, gap, gradient, np.maximum(region.down, region.up))
    r = gradient + x @ c
    rounding = float(x @ noise)
    if (np.abs(r[region.endless]) > tolerances.CERTIFIED).any():
        return size
    bound = float(x @ gap + np.abs(r) @ np.where(r > 0.0, region.down, region.up))
    if rounding > tolerances.RESOLVED * max(size, terms.unit):
        bound += rounding
    return min(size, bound)


def _rows_above(terms: _BoundTerms, n_above: int) -> tuple[Array, Array, Array]:
    """Return rows c (k, n) of the levels above, their gaps (k,) and noise (k,):
    ``c (y - v) <= gap``.
    """
    rows = terms.J[:n_above]
    noise = terms.noise[:n_above]
    c = np.concatenate([rows, -rows])
    gap = np.concatenate([terms.up[:n_above], terms.down[:n_above]])
    useful = np.isfinite(gap) & c.any(axis=1)
    return c[useful], gap[useful], np.concatenate([noise, noise])[useful]


def _multipliers(c: Array, gap: Array, gradient: Array, reach: Array) -> Array:
    """Return x >= 0 (k,) for which both the gradient that remains and the gaps are small, in the
    sense of least squares.
    """
    from scipy.optimize import nnls  # half a second, which few need

    if len(c) == 0:
        return np.zeros(0)
    columns = np.vstack([(c * reach).T, gap])
    lengths = np.linalg.norm(columns, axis=0)
    lengths[lengths == 0.0] = 1.0
    try:
        x = nnls(columns / lengths, -np.append(gradient * reach, 0.0), maxiter=30 * len(c))[0]
    except RuntimeError:  # too many iterations; without multipliers the bound is only larger
        x = np.zeros(len(c))
    return np.asarray(x / lengths)

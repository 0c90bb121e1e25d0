"""Convex QPs of stages as arrays written in place, and their solutions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from itertools import accumulate, pairwise

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, unchecked_constructor
from uvms_ocp.codegen.elementwise import interval_distance
from uvms_ocp.errors import AdvisedStatus, InvalidInput
from uvms_ocp.types import Array, Bound, Indices, Mask

_BEYOND = 4  # numbers that compiled code may read after the end

SIGNS = np.array([[1.0], [-1.0]])
"""Signs of the distances to the lower and the upper side."""


@checked_dataclass()
class StageShape:
    """N + 1 stages: N with states and controls, a last one with states only. Sizes may differ from
    stage to stage.

    Raises `InvalidInput` for lists of other lengths, negative sizes, and a horizon in which nothing
    varies.
    """

    n_x: tuple[int, ...]
    """(N + 1,) states."""
    n_u: tuple[int, ...]
    """(N,) controls."""
    n_r: tuple[int, ...]
    """(N + 1,) rows of the residual."""
    n_c: tuple[int, ...]
    """(N + 1,) rows of constraints."""

    def __post_init__(self) -> None:
        for name, length in (("n_x", self.N + 1), ("n_r", self.N + 1), ("n_c", self.N + 1)):
            if len(getattr(self, name)) != length:
                n_stages = len(getattr(self, name))
                raise InvalidInput(
                    f"{name} of {n_stages} stages and n_u of {self.N}; "
                    "give one stage more than in n_u"
                )
        if min((*self.n_x, *self.n_u, *self.n_r, *self.n_c)) < 0:
            raise InvalidInput("a stage has a negative size; give sizes >= 0")
        if sum(self.n_z) == 0:
            raise InvalidInput("no stage has a state or a control; give at least one")

    @property
    def N(self) -> int:
        """Steps."""
        return len(self.n_u)

    @property
    def n_z(self) -> tuple[int, ...]:
        """(N + 1,) Variables ``z = (x, u)``."""
        return _sums(self.n_x, (*self.n_u, 0))


@lru_cache(maxsize=256)
def _sums(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(first + second for first, second in zip(a, b, strict=True))


def offsets(sizes: Iterable[int]) -> list[int]:
    """Return the offsets of parts of such `sizes` in one array, and the end of the last one."""
    return [0, *accumulate(sizes)]


def leading(sizes: Iterable[int], counts: Iterable[int]) -> Indices:
    """Return where the first few numbers, as many as its count says, of each part of such `sizes`
    are in one array.
    """
    firsts = zip(offsets(sizes), counts, strict=False)
    return np.concatenate(
        [np.zeros(0, dtype=int), *(first + np.arange(count) for first, count in firsts)]
    )


@lru_cache(maxsize=256)
def slices(sizes: tuple[int, ...]) -> tuple[slice, ...]:
    """Return the slice of each part of a vector, for the sizes of its parts."""
    return tuple(slice(a, b) for a, b in pairwise(offsets(sizes)))


def parts(flat: Array, sizes: tuple[int, ...]) -> tuple[Array, ...]:
    """Return views (size,) of such parts of one array (n,) [any]."""
    return tuple(flat[part] for part in slices(sizes))


@checked
class StageQp:
    """Min sum_k 1/2 |J_k z_k + r_k|^2 + 1/2 z_k' H_k z_k + g_k' z_k + 1/2 z_k' diag(damping_k) z_k,
    z_k = (x_k, u_k), with x_{k+1} = A_k x_k + B_k u_k + b_k, lower_k <= C_k z_k <= upper_k,
    z_lower_k <= z_k <= z_upper_k.

    Every attribute below is a tuple with a view per stage; write with ``qp.A[k][:] = ...``. The
    views of one name lie one after the other in ``qp.flat[name]``, row-major; A and B are columns
    of ``dynamics`` (n_x[k+1], n_z[k]). A cost that is not convex is noticed while solving. Bounds
    may be infinite, and equal: an equality, or a fixed variable. A state x_0 that is given is one
    whose bounds are equal (`fix_initial_state`).

    A row of constraints or a bound is soft where its ``l1`` is finite: it may be missed by e >= 0
    on either side, which costs ``l1 e + l2 e^2 / 2``. All are hard at first: ``l1`` is infinite.
    """

    def __init__(self, shape: StageShape) -> None:
        self.shape = shape
        n_z = shape.n_z
        n_x = shape.n_x
        n_r = shape.n_r
        n_c = shape.n_c
        steps = list(zip(n_x[1:], n_z, strict=False))
        self.flat: dict[str, Array] = {}
        self.dynamics = self._matrices("dynamics", steps)
        """(n_x[k+1], n_z[k]) slopes of the next state."""
        self.A = tuple(F[:, :n] for F, n in zip(self.dynamics, n_x, strict=False))
        """(n_x[k+1], n_x[k]) slopes of the next state by the state."""
        self.B = tuple(F[:, n:] for F, n in zip(self.dynamics, n_x, strict=False))
        """(n_x[k+1], n_u[k]) slopes of the next state by the input."""
        self.b = self._vectors("b", n_x[1:])
        """(n_x[k+1],) offset of the next state."""
        self.J = self._matrices("J", list(zip(n_r, n_z, strict=True)))
        """(n_r, n_z) slopes of the residuals."""
        self.r = self._vectors("r", n_r)
        """(n_r,) residuals at z = 0."""
        self.H = self._matrices("H", list(zip(n_z, n_z, strict=True)))
        """(n_z, n_z) Hessian of the rest of the cost, symmetric."""
        self.g = self._vectors("g", n_z)
        """(n_z,) gradient of the rest of the cost."""
        self.damping = self._vectors("damping", n_z)
        """(n_z,) weights of the squares of z."""
        self.C = self._matrices("C", list(zip(n_c, n_z, strict=True)))
        """(n_c, n_z) rows."""
        self.lower = self._vectors("lower", n_c, -np.inf)
        """(n_c,) lower bounds of the rows."""
        self.upper = self._vectors("upper", n_c, np.inf)
        """(n_c,) upper bounds of the rows."""
        self.l1 = self._vectors("l1", n_c, np.inf)
        """(n_c,) linear penalty of a missed row; infinite for hard ones."""
        self.l2 = self._vectors("l2", n_c)
        """(n_c,) quadratic penalty of a missed row."""
        self.z_lower = self._vectors("z_lower", n_z, -np.inf)
        """(n_z,) lower bounds of z."""
        self.z_upper = self._vectors("z_upper", n_z, np.inf)
        """(n_z,) upper bounds of z."""
        self.z_l1 = self._vectors("z_l1", n_z, np.inf)
        """(n_z,) linear penalty of a missed bound; infinite for hard ones."""
        self.z_l2 = self._vectors("z_l2", n_z)
        """(n_z,) quadratic penalty of a missed bound."""

    def fix_initial_state(self, x: Array) -> None:
        """Begin the horizon at x (n,) [unit of x], n the states of the first stage. Raises
        `InvalidInput` for another shape.
        """
        if np.shape(x) != (self.shape.n_x[0],):
            raise InvalidInput(f"x of shape {np.shape(x)}; give ({self.shape.n_x[0]},)")
        self.z_lower[0][: self.shape.n_x[0]] = x
        self.z_upper[0][: self.shape.n_x[0]] = x

    def _vectors(self, name: str, sizes: tuple[int, ...], value: float = 0.0) -> tuple[Array, ...]:
        n = sum(sizes)
        flat = np.full(n + _BEYOND, value)[:n]
        self.flat[name] = flat
        return parts(flat, sizes)

    def _matrices(self, name: str, sizes: list[tuple[int, int]]) -> tuple[Array, ...]:
        flat = self._vectors(name, tuple(m * n for m, n in sizes))
        return tuple(part.reshape(size) for part, size in zip(flat, sizes, strict=True))


def is_valid(qp: StageQp) -> bool:
    """Check that entries are finite but for absent bounds, and that slack costs something."""
    flat = qp.flat
    for name, values in flat.items():
        if name in ("lower", "z_lower"):
            is_allowed = values < np.inf
        elif name in ("upper", "z_upper"):
            is_allowed = values > -np.inf
        elif name in ("l1", "z_l1"):
            is_allowed = values >= 0.0
        elif name in ("l2", "z_l2"):
            is_allowed = np.isfinite(values) & (values >= 0.0)
        else:
            is_allowed = np.isfinite(values)
        if not is_allowed.all():
            return False
    return True


def row_values(qp: StageQp, z: Array) -> Array:
    """Return the values (M,) [unit of the row] of rows and variables at z (n,) [unit of z]."""
    values = [C @ z_k for C, z_k in zip(qp.C, parts(z, qp.shape.n_z), strict=True)]
    return np.concatenate([*values, z])


class StageQpStatus(AdvisedStatus):
    """Outcome of one QP."""

    SOLVED = "solved", "nothing to do"
    INEXACT = (
        "inexact",
        "the KKT conditions hold to a thousand times the tolerance only; scale the rows",
    )
    INFEASIBLE = "infeasible", "no point keeps the constraints; loosen them, or make rows soft"
    UNBOUNDED = "unbounded", "the cost falls without end; add damping, or bounds"
    NOT_CONVEX = "not convex", "a Hessian is indefinite; use Gauss-Newton, or add damping"
    ITERATION_LIMIT = "iteration limit", "raise max_iterations, or scale the rows"
    NOT_A_NUMBER = (
        "not a number",
        (
            "an entry of the QP is not finite, a bound endless on the wrong side, or slack"
            " rewarded; look where it comes from"
        ),
    )

    @property
    def usable(self) -> bool:
        """True where the point can be used as the optimum."""
        return self in (StageQpStatus.SOLVED, StageQpStatus.INEXACT)


@checked_dataclass(eq=False)
class KktResidual:
    """Residuals of the optimality conditions, in units of the QP."""

    stationarity: Bound
    """[1/unit of z] largest entry of the gradient of the Lagrangian."""
    primal: Bound
    """[unit of the row] largest violation of dynamics, hard rows and hard bounds."""
    complementarity: Bound
    """Largest product of a multiplier and the distance to its bound."""


@checked_dataclass(eq=False)
class StageQpSolution:
    """Point and multipliers; tuples have an entry per stage, views of arrays of their own.

    Lagrangian: ``cost + costate_{k+1}' (A x + B u + b - x_{k+1}) + y' C z + y_z' z``: a multiplier
    is positive at an upper bound and negative at a lower one.
    """

    status: StageQpStatus
    """Reliability of the rest; where INFEASIBLE, the point misses the hard rows least, in sum."""
    z: tuple[Array, ...]
    """(n_z,) [unit of z] states and inputs."""
    x: tuple[Array, ...]
    """(n_x,) [unit of x] states."""
    u: tuple[Array, ...]
    """(n_u,) [unit of u], N of them."""
    costate: tuple[Array, ...]
    """(n_x,) [1/unit of x] multipliers of the step that leads to each state; 0 for x_0."""
    y: tuple[Array, ...]
    """(n_c,) [1/unit of the row] multipliers of rows."""
    y_z: tuple[Array, ...]
    """(n_z,) [1/unit of z] multipliers of bounds."""
    excess: tuple[Array, ...]
    """(n_c,) [unit of the row] by how much rows are missed: below 0 at the lower bound."""
    iterations: int
    """Factorisations."""
    kkt: KktResidual
    """KKT residual of the point."""
    cost: float
    """Without what soft rows cost."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WarmStart:
    """Point and multipliers of a QP nearby, in arrays with stage after stage."""

    z: Array
    """(n,) [unit of z] point."""
    costate: Array
    """(n_x,) [1/unit of x] multipliers of the steps."""
    y: Array
    """(M,) [1/unit of the row] multipliers of rows, then of bounds."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FlatSolution:
    """A `StageQpSolution` in arrays with stage after stage, for who solves one QP after the other.

    As one run ends its status is SOLVED, NOT_CONVEX, NOT_A_NUMBER, ITERATION_LIMIT, or UNBOUNDED
    where steps are, which proves nothing.
    """

    status: StageQpStatus
    """Reliability of the rest."""
    z: Array
    """(n,) [unit of z] point."""
    costate: Array
    """(n_x,) [1/unit of x] multipliers of the steps."""
    y: Array
    """(M,) [1/unit of the row] multipliers of rows, then of bounds, positive at an upper one."""
    kkt: KktResidual
    """KKT residual of the point."""
    iterations: int
    """Factorisations."""
    value: Array
    """(M,) [unit of the row] values of rows and variables."""
    worst: float
    """Largest residual of `kkt`, relative to the terms of its condition."""
    shape: StageShape
    """Shape of the QP."""
    products: ResidualProducts
    """Products of the residuals along z."""

    @np.errstate(invalid="ignore")  # of what is not a number there is no excess
    def excess(self, qp: StageQp) -> Array:
        """Return by how much rows (m,) [unit of the row] of the QP that was solved are missed."""
        lower = qp.flat["lower"]
        upper = qp.flat["upper"]
        return np.asarray(interval_distance(self.value[: len(lower)], lower, upper))

    def warm_start(self) -> WarmStart:
        """Return the start for a QP nearby that starts where this one ends."""
        return WarmStart(z=np.zeros_like(self.z), costate=self.costate, y=self.y)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualProducts:
    """Products of the residuals' rows along z."""

    slope: float
    """R' J z: derivative of the half square."""
    square: float
    """Square of J z."""
    change: float
    """[1/unit of z] largest entry of J' J z: of what the gradient of the half square changes by."""


kkt_residual = unchecked_constructor(KktResidual)
"""Constructor without argument checks."""
stage_qp_solution = unchecked_constructor(StageQpSolution)
"""Constructor without argument checks."""


class StartMode(IntEnum):
    """Treatment of the start point of a run."""

    EQUALITIES = 0
    """The optimum without inequalities is sought from z, and the run starts there."""
    WARM = 1
    """Z, costates and multipliers, those of all rows in y, are near the optimum."""
    COLD = 2
    """The run starts from z."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowTable:
    """M rows: those of constraints, stage after stage, then the variables. Arrays (2, M) hold lower
    and upper sides.
    """

    bound: Array
    """(2, M) [unit of the row] 0 where there is none."""
    side: Mask
    """(2, M) inequalities."""
    elastic: Mask
    """(2, M) inequalities that may be missed at a cost that is not smooth."""
    equal: Mask
    """(M,) equalities that are not elastic."""
    target: Array
    """(M,) [unit of the row] their right-hand sides; 0 elsewhere."""
    l1: Array
    """(M,) [1/unit of the row] 0 where the row is not elastic."""
    l2: Array
    """(M,) [1/unit of the row^2] 0 where the row is not elastic."""
    compliance: Array
    """(M,) [unit of the row^2] of rows that are missed in proportion to their multiplier; 0 of the
    others.
    """
    norm: Array
    """(M,) [unit of the row/unit of z] largest entry of a row, 1 where all are 0."""
    fixed: Mask
    """(n,) variables that do not move."""

    def rest(self, qp: StageQp) -> Array:
        """Return z (n,) [unit of z] with fixed variables where they are to be, all others at 0."""
        return np.where(self.fixed, qp.flat["z_lower"], 0.0)

    def violation(self, value: Array) -> float:
        """Return the largest violation [unit of z] of hard rows at the value (M,) [unit of the row]
        of all, relative to their norm.
        """
        hard = self.compliance == 0.0
        missed_sides = np.where(self.side & ~self.elastic & hard, SIGNS * (self.bound - value), 0.0)
        missed_side = missed_sides.max(axis=0, initial=0.0)
        missed_target = np.where(self.equal & hard, np.abs(value - self.target), 0.0)
        return float(np.max((missed_side + missed_target) / self.norm, initial=0.0))


def row_table(qp: StageQp, *, phase_one: bool = False) -> RowTable:
    """Build the row table of a QP; in phase one all hard rows are elastic, at a cost of 1 for the
    norm of the row, and soft ones are none.
    """
    flat = qp.flat
    lower = np.concatenate([flat["lower"], flat["z_lower"]])
    upper = np.concatenate([flat["upper"], flat["z_upper"]])
    l1 = np.concatenate([flat["l1"], flat["z_l1"]])
    l2 = np.concatenate([flat["l2"], flat["z_l2"]])
    n_rows = len(flat["lower"])
    norm = np.concatenate([*[norms(C) for C in qp.C], np.ones(sum(qp.shape.n_z))])
    has_hard_value = (flat["z_lower"] == flat["z_upper"]) & (flat["z_l1"] == np.inf)
    fixed = undetermined_variables(qp.shape) & has_hard_value
    counts = np.concatenate([np.ones(n_rows, dtype=bool), ~fixed])
    hard = l1 == np.inf
    if phase_one:
        counts &= hard
        l1 = 1.0 / norm
        l2 = np.zeros_like(l2)
        hard = np.zeros_like(hard)
    counts &= hard | (l1 > 0.0) | (l2 > 0.0)
    elastic = counts & ~hard & (l1 > 0.0)
    equal = counts & (lower == upper) & ~elastic
    side = np.isfinite([lower, upper]) & counts & ~equal
    is_compliant = counts & ~hard & ~elastic
    return RowTable(
        bound=np.where(side, [lower, upper], 0.0),
        side=side,
        elastic=side & elastic,
        equal=equal,
        target=np.where(equal, lower, 0.0),
        l1=np.where(elastic, l1, 0.0),
        l2=np.where(elastic, l2, 0.0),
        compliance=np.divide(1.0, l2, out=np.zeros_like(l2), where=is_compliant),
        norm=norm,
        fixed=fixed,
    )


def norms(rows: Array) -> Array:
    """Return the largest entry (m,) [any] of each of the rows (m, n) [any], 1 where all are 0."""
    norm = np.abs(rows).max(axis=1, initial=0.0)
    return np.where(norm > 0.0, norm, 1.0)


@lru_cache(maxsize=64)
def undetermined_variables(shape: StageShape) -> Mask:
    """Return the mask (n,) of what the dynamics of a shape do not determine: the first state and
    all controls.
    """
    undetermined = [np.ones(n, dtype=bool) for n in shape.n_z]
    for k, n_x in enumerate(shape.n_x[1:], start=1):
        undetermined[k][:n_x] = False
    return np.concatenate(undetermined)

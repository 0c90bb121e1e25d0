"""Lexicographic nonlinear programs as data: shared constraints, levels of least squares in order,
bounds, and outcomes.

Level k minimises ``1/2 |y_k - clip(y_k, lower_k, upper_k)|^2``, the squared distance of its rows to
their range, while the rows of the levels above stay where those levels left them. All rows of the
program are numbered once: first the constraints, then those that freeze level 0, level 1 and so on.
Bounds and multipliers use that numbering at every level, so that they carry over.

Variables and rows may have any units. Scale rows to the order of 1: those of a level add up as
squares, and one tolerance holds for all, so that costs, norms and violations have no unit.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Annotated, Any, TypeAlias

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.codegen.elementwise import interval_distance, interval_excess
from uvms_ocp.errors import AdvisedStatus, InvalidInput
from uvms_ocp.types import Bound, Positive, Range, Shape

_FROZEN_SLACK = 1e-6  # of inequality rows that are frozen exactly: they still need an inside
Expression: TypeAlias = ca.SX | ca.MX
Variables = Annotated[np.ndarray, Shape("self.program.n_x")]
"""Variables of the program that the owner holds."""
Parameters = Annotated[np.ndarray, Shape("self.program.n_p")]
_GRADIENTS = ["f", "g", "grad_gamma_x", "grad_gamma_p"]

_TABLE = (
    (files("uvms_ocp.solvers.nlp") / "return_statuses.csv").read_text(encoding="utf-8").splitlines()
)


class NlpStatus(AdvisedStatus):
    """Outcome of one level.

    INFEASIBLE: at a point from which no small step brings the constraints any nearer. Farther away
    others may keep them.
    """

    SOLVED = "solved", "nothing to do"
    INEXACT = (
        "inexact",
        (
            "the level is at a minimum to reduced accuracy only; scale its rows, or loosen the"
            " tolerance"
        ),
    )
    STALLED = (
        "stalled",
        (
            "no further progress before the constraints were kept; give another guess, or loosen"
            " the limits"
        ),
    )
    INFEASIBLE = (
        "infeasible",
        "no point keeps the constraints near the guess; loosen the limits, or give another guess",
    )
    ITERATION_LIMIT = (
        "iteration limit",
        "the level did not converge; raise max_iterations, or give a better guess",
    )
    TIME_LIMIT = (
        "time limit",
        "the time was over; raise time_limit, shorten the horizon, or start from the last solution",
    )
    NOT_A_NUMBER = (
        "not a number",
        "an expression is not finite at some point; look for divisions by zero, or move the guess",
    )
    INTERRUPTED = "interrupted", "stopped by hand at the best point so far; go on from there"
    SKIPPED = "skipped", "a level above it failed; see that level"

    @property
    def optimal(self) -> bool:
        """True where the level is at a minimum to working accuracy."""
        return self in (NlpStatus.SOLVED, NlpStatus.INEXACT)


_STATUSES = {row["return_status"]: NlpStatus[row["status"]] for row in csv.DictReader(_TABLE)}
"""Return statuses of IPOPT, and those that CasADi has for all solvers, with ours."""


def status_of(stats: Mapping[str, Any]) -> NlpStatus:
    """Return the status of the last call of a CasADi ``nlpsol``, from its ``stats()``."""
    named = _STATUSES.get(str(stats.get("return_status")))
    return named or _STATUSES.get(
        str(stats.get("unified_return_status")), NlpStatus.ITERATION_LIMIT
    )


@checked_dataclass(eq=False)
class NlpLevel:
    """One level of a small program, as expressions: rows `y` within ``[lower, upper]``."""

    y: Expression
    """(m,) [unit of the row] rows."""
    lower: Bound | Annotated[np.ndarray, Range()] = 0.0
    """(m,), or one for all rows [unit of the row]."""
    upper: Bound | Annotated[np.ndarray, Range()] = 0.0
    """(m,), or one for all rows [unit of the row]."""
    relax: Positive | None = None
    """None freezes the rows of the level; a share such as 0.01 freezes its cost at ``(1 + relax)``
    times the best, which leaves lower levels some freedom below costs that fix every variable, such
    as energy.
    """
    name: str = ""
    """Used in error messages; default its number."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelRows:
    """Rows of one level, and the rows of the program that freeze it.

    Raises `InvalidInput` for bounds that are NaN or in the wrong order, and for a share that is not
    positive.
    """

    name: str
    """Name of the level in errors and reports."""
    lower: np.ndarray
    """(m,) [unit of the row] lower bounds."""
    upper: np.ndarray
    """(m,) [unit of the row] upper bounds."""
    relax: float | None
    """Relaxation as in `NlpLevel`."""
    frozen: slice
    """Rows of the program that freeze the level."""

    def __post_init__(self) -> None:
        if (
            np.isnan(self.lower).any()
            or np.isnan(self.upper).any()
            or (self.lower > self.upper).any()
        ):
            raise InvalidInput(
                f"level {self.name!r}: bounds are NaN or lower > upper; give lower <= upper"
            )
        if self.relax is not None and not (np.isfinite(self.relax) and self.relax > 0):
            raise InvalidInput(
                f"level {self.name!r}: relax = {self.relax}; give None or a share > 0"
            )

    def distance(self, y: np.ndarray) -> np.ndarray:
        """Return the signed distance (m,) of the rows y (m,) [unit of the row] to their range."""
        return np.asarray(interval_distance(y, self.lower, self.upper))

    def kept(self, norm: float, tolerance: float) -> float:
        """Return the largest norm of the residual with which a level that has reached `norm` still
        keeps it; tolerance: allowed rise of the norm.
        """
        if self.relax is None:
            return norm + tolerance
        return float(((1 + self.relax) * norm**2 + 2 * tolerance) ** 0.5)

    def frozen_bounds(
        self, y: np.ndarray, cost: float, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of the rows that keep the level where it is, at y (m,) [unit of the
        row] and `cost`.

        `tolerance`: by which the norm of its residual may rise. The rows get half of it, the
        solver's own accuracy the rest.
        """
        if self.relax is None:
            if tolerance == 0:
                equal = self.lower == self.upper
            else:
                equal = np.zeros(len(y), dtype=bool)
            slack = np.where(equal, 0.0, tolerance / (2 * max(len(y), 1) ** 0.5) or _FROZEN_SLACK)
            low = np.where(equal, y, np.minimum(self.lower, y))
            up = np.where(equal, y, np.maximum(self.upper, y))
            return low - slack, up + slack
        return np.array([-np.inf]), np.array([(1 + self.relax) * cost + tolerance])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelNlp:
    """The NLP of one level."""

    nlp: Mapping[str, Expression]
    """X, p, f and g."""
    rows: np.ndarray
    """(n_g,) indices in the program of the rows of g."""
    functions: Mapping[str, ca.Function] = field(default_factory=dict)
    """Derivative functions by the names the NLP solver asks for (``nlp_jac_g``, ...), as far as
    there are any.
    """


def nlp_functions(
    variables: Sequence[ca.MX],
    values: Sequence[ca.MX],
    lam: Sequence[ca.MX],
    derivatives: tuple[ca.MX, ca.MX, ca.MX],
) -> dict[str, ca.Function]:
    """Build the functions of an NLP with variables x (n,) and p (n_p,) and values f () and g (m,),
    as IPOPT asks for them.

    lam: symbols for the multipliers of f and g. derivatives: gradient (n,) of f, Jacobian (m, n) of
    g, Hessian (n, n) of ``lam_f f + lam_g' g``, the upper triangle.
    """
    (f, g) = values
    (gradient, J, H) = derivatives
    primal = ["x", "p"]
    dual = ["x", "p", "lam_f", "lam_g"]
    primal_dual = [*variables, *lam]
    slope = lam[0] * gradient + J.T @ lam[1]
    functions = (
        ca.Function("nlp_f", variables, [f], primal, ["f"]),
        ca.Function("nlp_g", variables, [g], primal, ["g"]),
        ca.Function("nlp_grad_f", variables, [f, gradient], primal, ["f", "grad_f_x"]),
        ca.Function("nlp_jac_g", variables, [g, J], primal, ["g", "jac_g_x"]),
        ca.Function("nlp_hess_l", primal_dual, [H], dual, ["triu_hess_gamma_x_x"]),
        # Asked for at construction, never called: multipliers of parameters are off.
        ca.Function(
            "nlp_grad", primal_dual, [f, g, slope, ca.MX(*variables[1].shape)], dual, _GRADIENTS
        ),
    )
    return {function.name(): function for function in functions}


@checked_dataclass(eq=False)
class RowRanges:
    """Target ranges of the rows of a program; a program that is kept may be solved with others of
    the same `RowKinds`.
    """

    levels: tuple[LevelRows, ...]
    """Levels from the highest to the lowest."""
    lower: np.ndarray
    """(n_constraints,) [unit of the row] lower ends of the shared constraints."""
    upper: np.ndarray
    """(n_constraints,) [unit of the row] upper ends of the shared constraints."""

    @property
    def n_rows(self) -> int:
        """Constraints and the rows that freeze all levels but the last."""
        return max((level.frozen.stop for level in self.levels), default=len(self.lower))


@checked_dataclass(eq=False)
class LexicographicProgram:
    """Functions and rows of all levels, built once for many solves."""

    ranges: RowRanges
    """Ranges of the rows, for solves that are given none."""
    nlps: tuple[LevelNlp, ...]
    """Program of each level."""
    values: ca.Function
    """``x, p -> y`` of every level, one output each."""

    @property
    def n_x(self) -> int:
        """Variables."""
        return int(self.values.size1_in(0))

    @property
    def n_p(self) -> int:
        """Parameters."""
        return int(self.values.size1_in(1))

    def rows_at(
        self,
        x: Annotated[np.ndarray, Shape("self.n_x")],
        p: Annotated[np.ndarray, Shape("self.n_p")],
    ) -> tuple[np.ndarray, ...]:
        """Return rows y of every level at x (n,) [unit of x], with parameters p (n_p,) [unit of the
        parameter].
        """
        return tuple(np.array(y).ravel() for y in self.values.call([x, p]))

    def violation(
        self,
        x: Annotated[np.ndarray, Shape("self.n_x")],
        p: Annotated[np.ndarray, Shape("self.n_p")],
        bounds: RowBounds,
    ) -> float:
        """Return by how much x (n_x,) [unit of x] breaks bounds and constraints; p (n_p,) [unit of
        the parameter].
        """
        first = self.nlps[0]
        g = ca.Function("g", [first.nlp["x"], first.nlp["p"]], [first.nlp["g"]])(x, p)
        return bounds.violation(x, np.array(g).ravel(), first.rows)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowKinds:
    """Kinds of the bounds of rows, apart from their numbers."""

    equal: np.ndarray
    """(m,) True where lower = upper."""
    below: np.ndarray
    """(m,) True for ranges with a finite lower bound."""
    above: np.ndarray
    """(m,) True for ranges with a finite upper bound."""

    def __getitem__(self, rows: slice) -> RowKinds:
        """Return the kinds of some of the rows."""
        return RowKinds(equal=self.equal[rows], below=self.below[rows], above=self.above[rows])

    def same(self, other: RowKinds) -> bool:
        """Check that all rows are of the same kind."""
        return (
            np.array_equal(self.equal, other.equal)
            and np.array_equal(self.below, other.below)
            and np.array_equal(self.above, other.above)
        )


def row_kinds(lower: np.ndarray, upper: np.ndarray) -> RowKinds:
    """Return the kinds of rows with the bounds lower and upper (m,) [unit of the row]."""
    equal = lower == upper
    return RowKinds(
        equal=equal, below=np.isfinite(lower) & ~equal, above=np.isfinite(upper) & ~equal
    )


def signed_excess(
    y: Expression, lower: Expression, upper: Expression, kinds: RowKinds
) -> Expression:
    """Return the signed distance (m,) to the range; unlike `LevelRows.distance` without a kink where lower =
    upper.

    y, lower and upper (m,) [unit of the row]; a bound that `kinds` has not is not looked at.
    """
    distance = y - lower
    for i in np.flatnonzero(~kinds.equal).tolist():
        if kinds.above[i]:
            high = ca.fmax(y[i] - upper[i], 0)
        else:
            high = 0
        if kinds.below[i]:
            low = ca.fmax(lower[i] - y[i], 0)
        else:
            low = 0
        distance[i] = high - low
    return distance


def half_square(y: Expression, lower: Expression, upper: Expression, kinds: RowKinds) -> Expression:
    """``1/2 |distance to [lower, upper]|^2``; rows with lower = upper stay twice differentiable
    everywhere.

    y, lower and upper (m,) [unit of the row]; a bound that `kinds` has not is not looked at.
    """
    equal, above, below = (
        np.flatnonzero(kind).tolist() for kind in (kinds.equal, kinds.above, kinds.below)
    )
    total = ca.sumsqr(y[equal] - lower[equal])
    for i in above:
        total += ca.fmax(y[i] - upper[i], 0) ** 2
    for i in below:
        total += ca.fmax(lower[i] - y[i], 0) ** 2
    return total / 2


@checked
def lexicographic_program(
    x: Expression,
    levels: Sequence[NlpLevel],
    *,
    p: Expression | None = None,
    g: Expression | None = None,
    g_lower: Annotated[np.ndarray, Range()] | Bound = 0.0,
    g_upper: Annotated[np.ndarray, Range()] | Bound = 0.0,
) -> LexicographicProgram:
    """Build the program of a few expressions in x (n,): levels from the highest to the lowest,
    subject to g in its bounds.

    g_lower and g_upper (n_constraints,), or one for all constraints [unit of the row]. Raises
    `InvalidInput` without levels, and for bounds that do not fit.
    """
    if not levels:
        raise InvalidInput("a lexicographic program needs levels; give at least one")
    if p is None:
        parameters = type(x).sym("p", 0)
    else:
        parameters = p
    if g is None:
        constraints = type(x)(0, 1)
    else:
        constraints = g
    rows = []
    first = int(constraints.numel())
    for name, bound in (("g_lower", g_lower), ("g_upper", g_upper)):
        if np.shape(bound) not in ((), (first,)):
            raise InvalidInput(
                f"{name} has shape {np.shape(bound)}; give one number, or ({first},)"
            )
    for i, level in enumerate(levels):
        rows.append(_level_rows(level, i, first))
        first = rows[-1].frozen.stop
    costs = []
    freezing = []
    for level, row in zip(levels, rows, strict=True):
        kinds = row_kinds(row.lower, row.upper)
        cost = half_square(level.y, ca.DM(row.lower), ca.DM(row.upper), kinds)
        costs.append(cost)
        freezing.append(level.y if level.relax is None else cost)
    nlps = []
    for i, cost in enumerate(costs):
        stacked = ca.vertcat(constraints, *freezing[:i])
        nlps.append(
            LevelNlp(
                nlp={"x": x, "p": parameters, "f": cost, "g": stacked},
                rows=np.arange(stacked.numel()),
            )
        )
    lower = np.broadcast_to(np.asarray(g_lower, dtype=float), constraints.numel())
    upper = np.broadcast_to(np.asarray(g_upper, dtype=float), constraints.numel())
    values = [ca.densify(level.y) for level in levels]
    return LexicographicProgram(
        ranges=RowRanges(levels=tuple(rows), lower=lower, upper=upper),
        nlps=tuple(nlps),
        values=ca.Function("values", [x, parameters], values),
    )


def _level_rows(level: NlpLevel, index: int, first: int) -> LevelRows:
    m = int(level.y.numel())
    n_frozen = m if level.relax is None else 1
    return LevelRows(
        name=level.name or f"level {index}",
        lower=np.broadcast_to(np.asarray(level.lower, dtype=float), (m,)),
        upper=np.broadcast_to(np.asarray(level.upper, dtype=float), (m,)),
        relax=level.relax,
        frozen=slice(first, first + n_frozen),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowBounds:
    """Bounds of the variables and of all rows of the program; rows of levels that are not frozen
    yet are infinite.
    """

    x_lower: np.ndarray
    """(n_x,) [unit of x] lower bounds of the variables."""
    x_upper: np.ndarray
    """(n_x,) [unit of x] upper bounds of the variables."""
    lower: np.ndarray
    """(n_rows,) [unit of the row] lower bounds of the rows."""
    upper: np.ndarray
    """(n_rows,) [unit of the row] upper bounds of the rows."""

    def with_rows(self, rows: slice, bounds: tuple[np.ndarray, np.ndarray]) -> RowBounds:
        """Replace the bounds of the given rows by others, lower and upper (m,) [unit of the
        row].
        """
        lower = self.lower.copy()
        upper = self.upper.copy()
        lower[rows], upper[rows] = bounds
        return replace(self, lower=lower, upper=upper)

    def widened(self, slack: float) -> RowBounds:
        """Let the rows of equations give way by `slack` [unit of the row] to both sides."""
        slacks = np.where(self.lower == self.upper, slack, 0.0)
        return replace(self, lower=self.lower - slacks, upper=self.upper + slacks)

    def violation(self, x: np.ndarray, g: np.ndarray, rows: np.ndarray | slice) -> float:
        """Return the largest violation at x (n_x,) [unit of x], where the rows numbered `rows` (m,)
        are g (m,) [unit of the row].
        """
        broken = interval_excess(g, self.lower[rows], self.upper[rows]).max(initial=0.0)
        return float(max(broken, interval_excess(x, self.x_lower, self.x_upper).max(initial=0.0)))


def row_bounds(
    ranges: RowRanges, x_lower: np.ndarray | float, x_upper: np.ndarray | float, n_x: int
) -> RowBounds:
    """Return bounds with no level frozen; x_lower and x_upper (n_x,), or one for all variables
    [unit of x].

    Raises `InvalidInput` for bounds that are NaN or that no x keeps.
    """
    for name, bound in (("x_lower", x_lower), ("x_upper", x_upper)):
        if np.isnan(np.asarray(bound, dtype=float)).any():
            raise InvalidInput(
                f"{name} has NaN; give numbers, or an infinity where there is no bound"
            )
    if (
        np.less_equal(x_upper, -np.inf)
        | np.greater_equal(x_lower, np.inf)
        | np.greater(x_lower, x_upper)
    ).any():
        raise InvalidInput(
            "x_lower and x_upper exclude every x; give x_lower <= x_upper, and infinity only"
            " outwards"
        )
    lower = np.full(ranges.n_rows, -np.inf)
    upper = np.full(ranges.n_rows, np.inf)
    m = len(ranges.lower)
    lower[:m] = ranges.lower
    upper[:m] = ranges.upper
    return RowBounds(
        x_lower=np.broadcast_to(np.asarray(x_lower, dtype=float), (n_x,)),
        x_upper=np.broadcast_to(np.asarray(x_upper, dtype=float), (n_x,)),
        lower=lower,
        upper=upper,
    )

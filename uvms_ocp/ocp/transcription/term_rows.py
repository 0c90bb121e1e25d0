"""Rows, costs and parameters of all terms that count at one kind of node.

Their functions have the parameters ``[active, rate, roots of weights, lower, upper, goals of all
terms]``. `active` is 0 where the state is given, at the very first node, and 1 elsewhere; `rate` is
1 / time [1/s] with the nominal time of the horizon for steps, and the share of half the last step
in that time for ends of phases; bounds that there are not stand as 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, cached_property, partial
from itertools import pairwise

import casadi as ca
import numpy as np

from uvms_ocp.checks import unchecked_method
from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.ocp.node_margins import NodeMargins
from uvms_ocp.ocp.problem import HessianKind, OcpLevel, OcpPhase, OcpProblem, counts
from uvms_ocp.ocp.terms import At, Term
from uvms_ocp.ocp.transcription.stage import Derivatives, StageModel, derivatives
from uvms_ocp.solvers.nlp.program import RowKinds, half_square, row_kinds, signed_excess
from uvms_ocp.tasks.task import Residual

CONSTRAINT = -1
"""Stands for the level of a constraint."""
_N_COMMON = 2  # active, rate

_VARYING = {
    OcpProblem: ("start", "current", "phases", "levels", "constraints", "longest"),
    OcpPhase: ("duration",),
    OcpLevel: ("terms", "relax"),
}
"""Fields that may differ, or whose parts are looked at one by one."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermEntry:
    """A term with rows at a kind of node, as it was built in."""

    place: int
    """Among the terms of the problem."""
    level: int
    """Or CONSTRAINT"""
    term: Term
    residual: Residual
    """Without the weight."""
    goals: ca.SX
    """(n,) its parameters."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermNodes:
    """Purpose of the parameters of terms."""

    times: Sequence[float]
    """(n,) [s]"""
    active: Sequence[bool]
    """(n,) False where the state is given."""
    q: np.ndarray
    """(n, n_q) [m, rad] configurations about which terms that follow the guess are written."""
    tightened: Mapping[Term, NodeMargins]
    """Margins of the nodes beyond the ranges of terms; see `Term.references`."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermNumbers:
    """Numbers that may differ between problems of one shape."""

    terms: tuple[Term, ...]
    """Terms whose references are the goals."""
    roots: np.ndarray
    """(n_terms,) of the weights."""
    lower: np.ndarray
    """(m,) weighted."""
    upper: np.ndarray
    """(m,) weighted."""

    def parameters(self, nodes: TermNodes, rate: float) -> np.ndarray:
        """Parameters of nodes, one node after the other; rate [1/s or -]: see the module."""
        bounds = [np.where(np.isfinite(bound), bound, 0.0) for bound in (self.lower, self.upper)]
        n = len(nodes.active)
        fixed = np.concatenate([[rate], self.roots, *bounds])
        goals = [_goals(term, nodes) for term in self.terms]
        parts = [
            np.reshape(nodes.active, (n, 1)),
            np.tile(fixed, (n, 1)),
            *(np.reshape(goal, (n, -1)) for goal in goals),
        ]
        return np.asarray(np.hstack(parts, dtype=float).ravel())


def _goals(term: Term, nodes: TermNodes) -> np.ndarray:
    """References of a term, node by node where it does not look at the motion: that leaves out the
    check of all times.
    """
    if type(term).references is Term.references:
        return np.array([*map(unchecked_method(term.reference), nodes.times)])
    return term.references(nodes.times, nodes.q, nodes.tightened.get(term))


def term_numbers(terms: Sequence[Term], residuals: Sequence[Residual]) -> TermNumbers:
    """Return the numbers of terms with these residuals, without their weights."""
    roots = np.sqrt([term.weight for term in terms])
    pairs = list(zip(roots, residuals, strict=True))
    return TermNumbers(
        terms=tuple(terms),
        roots=roots,
        lower=np.concatenate([np.zeros(0), *(root * residual.lower for root, residual in pairs)]),
        upper=np.concatenate([np.zeros(0), *(root * residual.upper for root, residual in pairs)]),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class TermRows:
    """Rows of all terms at one kind of node: the steps of a phase, or its end.

    Rows of constraints come first, then those of level after level.
    """

    name: str
    model: StageModel
    parameters: ca.SX
    """(n_parameters,)"""
    rows: ca.SX
    """(m,) weighted."""
    costs: ca.SX
    """(n_levels,) """
    errors: tuple[ca.SX, ...]
    """Residuals of every level, the vectors whose half squares are the costs."""
    members: tuple[TermEntry, ...]
    own: TermNumbers
    """Numbers of the problem that was built in."""
    kinds: RowKinds
    level: np.ndarray
    """(m,) level of each row, or CONSTRAINT."""
    state_only: np.ndarray
    """(m,) True for rows without inputs."""
    names: tuple[str, ...]
    """(m,) term of each row."""

    @cached_property
    def functions(self) -> Derivatives:
        """Rows and costs with their derivatives in z."""
        residuals = None if self.model.problem.hessian is HessianKind.EXACT else self.errors
        # Terms of forces hold the equations of motion where forces are no variables.
        make = derivatives if self.model.has_force_variables else self.model.derivatives
        return make(
            self.name,
            self.model.z,
            self.parameters,
            self.rows,
            costs=self.costs,
            residuals=residuals,
        )

    @cached_property
    def value(self) -> ca.Function:
        """``z, parameters, water -> rows``, without derivatives and not compiled."""
        return ca.Function(
            f"{self.name}_rows",
            [self.model.z, self.parameters, self.model.water],
            [ca.densify(self.rows)],
        )

    @property
    def n_rows(self) -> int:
        return len(self.names)

    @property
    def n_parameters(self) -> int:
        return (
            _N_COMMON
            + len(self.members)
            + 2 * self.n_rows
            + sum(member.goals.numel() for member in self.members)
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermBlock:
    """`TermRows` at the nodes where they count, which follow each other."""

    rows: TermRows
    nodes: np.ndarray
    """(n,) """


def term_blocks(model: StageModel) -> tuple[TermBlock, ...]:
    """All terms of a problem: the steps of every phase, then the end of every phase."""
    nodes = model.problem.starts_of_phases()
    phases = model.problem.phases
    spans = [np.arange(first, end) for first, end in pairwise(nodes)]
    entry = cache(partial(_entry, model))  # a term is asked for its rows once, wherever it counts
    paths = []
    ends = []
    for i, phase in enumerate(phases):
        on_path, at_end = (
            [entry(place) for place in _places(model.problem, phase, at_end=end)]
            for end in (False, True)
        )
        paths.append(
            TermBlock(rows=_term_rows(model, on_path, f"path_{i}", on_path=True), nodes=spans[i])
        )
        ends.append(
            TermBlock(
                rows=_term_rows(model, at_end, f"end_{i}", on_path=False),
                nodes=nodes[i + 1 : i + 2],
            )
        )
    return (*paths, *ends)


def eliminated_blocks(blocks: Sequence[TermBlock], model: StageModel) -> tuple[TermBlock, ...]:
    """Write blocks in the symbols of a model with forces `eliminated`: terms are asked for their
    rows once.
    """
    if not blocks[0].rows.model.has_force_variables:  # rows hold the equations of motion instead
        return term_blocks(model)
    z = ca.vertcat(model.z[: model.n_motion], *model.inputs)
    return tuple(replace(block, rows=_rows_at(block.rows, z, model)) for block in blocks)


def _rows_at(block: TermRows, z: ca.SX, model: StageModel) -> TermRows:
    rows, costs, *errors = ca.substitute(
        [block.rows, block.costs, *block.errors], [block.model.z], [z]
    )
    return replace(block, model=model, rows=rows, costs=costs, errors=tuple(errors))


def _places(problem: OcpProblem, phase: OcpPhase, *, at_end: bool) -> list[int]:
    """Return the places, among all terms of a problem, of those that count on the path of a phase,
    or at its end.
    """
    return [
        place
        for place, term in enumerate(problem.terms)
        if counts(problem, term, phase, at_end=at_end)
    ]


def _entry(model: StageModel, place: int) -> TermEntry:
    problem = model.problem
    term = model.problem.terms[place]
    levels = [CONSTRAINT] * len(problem.constraints) + [
        i for i, level in enumerate(problem.levels) for _ in level.terms
    ]
    goals = ca.SX.sym("goals", term.n_parameters(model.robot))
    return TermEntry(
        place=place,
        level=levels[place],
        term=term,
        residual=residual_of(model, term, goals),
        goals=goals,
    )


def residual_of(model: StageModel, term: Term, goals: ca.SX) -> Residual:
    """Build the residual of a term with parameters `goals` (n,). Raises `InvalidInput` for whatever
    its own code raises, by its name.
    """
    try:
        return term.residual(model.symbols, goals)
    except UvmsError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:200]
        problem = f"term {term.name!r}: its residual raised {type(error).__name__}: {text}"
        raise InvalidInput(f"{problem}; mend it, its cause is chained") from error


def _term_rows(
    model: StageModel, members: Sequence[TermEntry], name: str, *, on_path: bool
) -> TermRows:
    """Costs on the path are integrals, as shares of the nominal time of the horizon; the last node,
    which has no step of its own, counts as half of the last one.
    """
    numbers = term_numbers(
        [member.term for member in members], [member.residual for member in members]
    )
    kinds = row_kinds(numbers.lower, numbers.upper)
    m = len(numbers.lower)
    common = ca.SX.sym("common", _N_COMMON)
    roots = ca.SX.sym("root", len(members))
    lower = ca.SX.sym("lower", m)
    upper = ca.SX.sym("upper", m)
    s = ca.vertcat(common, roots, lower, upper, *(member.goals for member in members))
    rows = ca.vertcat(
        ca.SX(0, 1), *[roots[i] * member.residual.value for i, member in enumerate(members)]
    )
    if on_path:
        step = model.z[model.layout.h]
    else:
        step = ca.SX(1)
    shares = [step * common[1] if member.term.at is At.PATH else ca.SX(1) for member in members]
    costs, errors = _costs(
        len(model.problem.levels), members, (rows, lower, upper, kinds), shares, common[0]
    )
    each_row = [member for member in members for _ in range(member.residual.n_rows)]
    return TermRows(
        name=name,
        model=model,
        parameters=s,
        rows=rows,
        costs=costs,
        errors=tuple(errors),
        members=tuple(members),
        own=numbers,
        kinds=kinds,
        level=np.array([member.level for member in each_row], dtype=int),
        state_only=np.array([member.term.state_only for member in each_row], dtype=bool),
        names=tuple(member.term.name for member in each_row),
    )


def _costs(
    n_levels: int,
    members: Sequence[TermEntry],
    parts: tuple[ca.SX, ca.SX, ca.SX, RowKinds],
    shares: Sequence[ca.SX],
    active: ca.SX,
) -> tuple[ca.SX, list[ca.SX]]:
    """Cost of every level (n_levels,), and the vectors whose half squares they are. parts: rows,
    lower, upper, kinds.
    """
    costs = [ca.SX(0) for _ in range(n_levels)]
    errors = [ca.SX(0, 1) for _ in range(n_levels)]
    ends = np.cumsum([0, *(member.residual.n_rows for member in members)]).tolist()
    for member, share, first, stop in zip(members, shares, ends[:-1], ends[1:], strict=True):
        if member.level != CONSTRAINT:
            scale = share * (active if member.term.state_only else 1)
            rows, lower, upper, kinds = (part[first:stop] for part in parts)
            costs[member.level] += scale * half_square(rows, lower, upper, kinds)
            errors[member.level] = ca.vertcat(
                errors[member.level], ca.sqrt(scale) * signed_excess(rows, lower, upper, kinds)
            )
    return ca.vertcat(*costs), errors


# Decide whether a program that was built for one problem solves another one with other parameters.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReusedProblem:
    """A problem, and what a kept program takes from its terms."""

    problem: OcpProblem
    numbers: tuple[TermNumbers, ...]
    """Numbers of each block."""


def fit_problem(
    model: StageModel, blocks: Sequence[TermBlock], problem: OcpProblem
) -> ReusedProblem:
    """The numbers of a problem for the program of `blocks`; raises `InvalidInput` for a problem of
    another shape.
    """
    built = model.problem
    if problem is built:
        return ReusedProblem(problem=built, numbers=tuple(block.rows.own for block in blocks))
    _require_same_fields("the problem", built, problem)
    _require_same_parts(built, problem)
    return ReusedProblem(
        problem=problem, numbers=tuple(_numbers(model, block.rows, problem) for block in blocks)
    )


def _require_same_parts(built: OcpProblem, problem: OcpProblem) -> None:
    _require_as_many("the problem", "phases", built.phases, problem.phases)
    for phase, other in zip(built.phases, problem.phases, strict=True):
        _require_same_fields(f"phase {other.name!r}", phase, other)
    _require_equal("the problem", "free durations", built.free_time, problem.free_time)
    _require_equal("the problem", "a limited total", built.limits_total, problem.limits_total)
    _require_as_many("the problem", "constraints", built.constraints, problem.constraints)
    _require_as_many("the problem", "levels", built.levels, problem.levels)
    for level, another in zip(built.levels, problem.levels, strict=True):
        place = f"level {another.name!r}"
        _require_same_fields(place, level, another)
        _require_as_many(place, "terms", level.terms, another.terms)
        if (level.relax is None) != (another.relax is None):
            _require_equal(place, "relax", level.relax, another.relax)


def _require_same_fields(place: str, built: object, given: object) -> None:
    for field in fields(built):  # type: ignore[arg-type]
        if field.name not in _VARYING[type(built)]:
            _require_equal(
                place, field.name, getattr(built, field.name), getattr(given, field.name)
            )


def _require_equal(place: str, name: str, built: object, given: object) -> None:
    if is_dataclass(built) and not _same(built, given):
        found = ", ".join(_differences(built, given, name))
        raise InvalidInput(f"{place} differs in {found} from the planner's: build a new Planner")
    if not _same(built, given):
        raise InvalidInput(
            f"{place} has {name} = {given}, the planner was built for {built}: build a new Planner"
        )


def _require_as_many(
    place: str, name: str, built: Sequence[object], given: Sequence[object]
) -> None:
    if len(built) != len(given):
        raise InvalidInput(
            f"{place} has {len(given)} {name}, the planner was built for {len(built)}: build a new"
            " Planner"
        )


def _numbers(model: StageModel, rows: TermRows, given: OcpProblem) -> TermNumbers:
    terms = [given.terms[member.place] for member in rows.members]
    if all(term is member.term for member, term in zip(rows.members, terms, strict=True)):
        return rows.own
    return term_numbers(
        terms,
        [_residual(model, member, term) for member, term in zip(rows.members, terms, strict=True)],
    )


def _residual(model: StageModel, member: TermEntry, term: Term) -> Residual:
    """Return the residual of a term in the place of another one."""
    built = member.residual
    if term is member.term or not any(_differences(member.term, term)):
        return built
    if _role(model, member.term) != _role(model, term):
        raise _other(model, member, term)
    given = residual_of(model, term, member.goals)
    same_kinds = row_kinds(built.lower, built.upper).same(row_kinds(given.lower, given.upper))
    if not (
        same_kinds
        and _same_expression(built.value, given.value, model.z, model.water, member.goals)
    ):
        raise _other(model, member, term)
    return given


def _role(model: StageModel, term: Term) -> tuple[object, ...]:
    """Return the key that decides where the rows of a term are, and their names."""
    return (
        term.name,
        term.at,
        term.phase,
        term.state_only,
        term.is_goal,
        term.n_parameters(model.robot),
    )


def _same_expression(one: ca.SX, other: ca.SX, *symbols: ca.SX) -> bool:
    if one.shape != other.shape:
        return False
    texts = [ca.Function("rows", list(symbols), [value]).serialize() for value in (one, other)]
    return bool(texts[0] == texts[1])


def _other(model: StageModel, member: TermEntry, given: Term) -> InvalidInput:
    if member.level == CONSTRAINT:
        place = "constraints"
    else:
        place = f"level {model.problem.levels[member.level].name!r}"
    found = ", ".join(_differences(member.term, given))
    return InvalidInput(
        f"{place}: term {given.name!r} differs in {found} from the planner's: build a new Planner"
    )


def _differences(built: object, given: object, path: str = "") -> Iterator[str]:
    """Names of what differs: fields, those of fields in their fields too, and whatever else an
    instance carries.
    """
    if type(built) is not type(given):
        yield f"{path or 'kind'} ({type(given).__name__}, not {type(built).__name__})"
        return
    for attribute in {**_attributes(built), **_attributes(given)}:
        one = getattr(built, attribute, None)
        other = getattr(given, attribute, None)
        if path:
            name = f"{path}.{attribute}"
        else:
            name = attribute
        if is_dataclass(one) and one is not other:
            yield from _differences(one, other, name)
        elif not _same(one, other):
            yield name


def _attributes(value: object) -> dict[str, None]:
    """Names of all that an instance carries: a user's class need not be a dataclass all the way
    down.
    """
    slots = (name for kind in type(value).__mro__ for name in _slots(kind))
    own = [*(field.name for field in fields(value)), *slots, *getattr(value, "__dict__", ())]  # type: ignore[arg-type]
    return dict.fromkeys(name for name in own if hasattr(value, name))


def _slots(kind: type) -> tuple[str, ...]:
    slots = kind.__dict__.get("__slots__", ())
    return tuple(
        name
        for name in ((slots,) if isinstance(slots, str) else slots)
        if not name.startswith("__")
    )


def _same(one: object, other: object) -> bool:
    if one is other:
        return True
    if isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(one) == len(other) and all(_same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return bool(np.array_equal(one, other))  # type: ignore[arg-type]
    if is_dataclass(one):
        same = type(one) is type(other) and not any(_differences(one, other))
    else:
        same = one == other
    return bool(same)

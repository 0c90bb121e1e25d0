"""Rows and costs of all terms that count at one kind of node, and their parameters.

Parameters stand in this order: active, rate, roots of the weights, lower bounds, upper bounds, goals
of all terms. `active` is 0 at the very first node where the state is fixed, and 1 elsewhere. `rate`
turns costs into shares of the nominal time of the horizon: for steps 1 / that time [1/s], for ends of
phases half of the last step / that time. Bounds that are infinite stand as 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import casadi as ca
import numpy as np

from uvms_ocp.checks import unchecked_method
from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.ocp.node_margins import NodeMargins
from uvms_ocp.ocp.problem import HessianKind, OcpPhase, OcpProblem, counts
from uvms_ocp.ocp.terms import At, Term
from uvms_ocp.ocp.transcription.derivatives import Derivatives, derivatives
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.solvers.nlp.program import RowKinds, half_square, row_kinds, signed_excess
from uvms_ocp.tasks.task import Residual

CONSTRAINT = -1
"""Stands for the level of a constraint."""
_N_COMMON = 2  # number of parameters that all terms share: active, rate


@dataclass(frozen=True, kw_only=True, eq=False)
class TermRows:
    """Rows of all terms at one kind of node: the steps of a phase, or its end.

    Rows of constraints come first, then those of level after level.
    """

    name: str
    model: StageModel
    parameters: ca.SX
    """(n_parameters,) parameters."""
    rows: ca.SX
    """(m,) weighted rows."""
    costs: ca.SX
    """(n_levels,) cost of each level."""
    errors: tuple[ca.SX, ...]
    """Residuals of every level, the vectors whose half squares are the costs."""
    members: tuple[TermEntry, ...]
    """Terms with rows there."""
    numbers: TermNumbers
    """Weights, bounds and goals of the problem that the rows were written for."""
    kinds: RowKinds
    """Kinds of the rows: equalities, and which bounds the others have."""
    level: np.ndarray
    """(m,) level of each row, or CONSTRAINT."""
    state_only: np.ndarray
    """(m,) True for rows without inputs."""
    names: tuple[str, ...]
    """(m,) name of the term of each row."""

    @cached_property
    def functions(self) -> Derivatives:
        """Rows and costs with their derivatives in z."""
        residuals = None if self.model.problem.hessian is HessianKind.EXACT else self.errors
        # Terms of forces hold the equations of motion where forces are no variables: only then is
        # compiling worth it.
        build = derivatives if self.model.has_force_variables else self.model.derivatives
        return build(
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
        """Number of rows."""
        return len(self.names)

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        n_roots = len(self.members)
        n_bounds = 2 * self.n_rows
        n_goals = sum(member.goals.numel() for member in self.members)
        return _N_COMMON + n_roots + n_bounds + n_goals


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermBlock:
    """Rows of terms, and the consecutive nodes at which they count."""

    rows: TermRows
    nodes: np.ndarray
    """(n,) numbers of the nodes."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermEntry:
    """A term that counts at a kind of node, with its symbolic residual."""

    place: int
    """Index among the terms of the problem."""
    level: int
    """Index of its level, or CONSTRAINT."""
    term: Term
    residual: Residual
    """Residual without the weight."""
    goals: ca.SX
    """(n,) parameters of the term."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermNumbers:
    """Weights, bounds and goals: they may differ between problems that share the same rows."""

    terms: tuple[Term, ...]
    """Terms, whose references are the goals among the parameters."""
    roots: np.ndarray
    """(n_terms,) roots of the weights."""
    lower: np.ndarray
    """(m,) weighted lower bounds of the rows."""
    upper: np.ndarray
    """(m,) weighted upper bounds of the rows."""

    def parameters(self, nodes: TermNodes, rate: float) -> np.ndarray:
        """Return the parameters of the rows (n * n_parameters,), node after node, in the order that
        the module gives; rate [1/s or -]: that of the module.
        """
        n = len(nodes.active)
        lower = np.where(np.isfinite(self.lower), self.lower, 0.0)
        upper = np.where(np.isfinite(self.upper), self.upper, 0.0)
        same_at_all_nodes = np.concatenate([[rate], self.roots, lower, upper])
        parts = [np.reshape(nodes.active, (n, 1)), np.tile(same_at_all_nodes, (n, 1))]
        for term in self.terms:
            parts.append(np.reshape(_goals(term, nodes), (n, -1)))
        return np.asarray(np.hstack(parts, dtype=float).ravel())


def _goals(term: Term, nodes: TermNodes) -> np.ndarray:
    """Return the references of a term (n, n_goals) at the nodes."""
    depends_on_time_alone = type(term).references is Term.references
    if depends_on_time_alone:
        # Asked node by node, as `references` would check all times at every call.
        reference = unchecked_method(term.reference)
        return np.array([reference(t) for t in nodes.times])
    return term.references(nodes.times, nodes.q, nodes.tightened.get(term))


def term_numbers(terms: Sequence[Term], residuals: Sequence[Residual]) -> TermNumbers:
    """Return weights, weighted bounds and goals of terms whose residuals are not weighted yet."""
    roots = np.sqrt([term.weight for term in terms])
    lower = [np.zeros(0)]
    upper = [np.zeros(0)]
    for root, residual in zip(roots, residuals, strict=True):
        lower.append(root * residual.lower)
        upper.append(root * residual.upper)
    return TermNumbers(
        terms=tuple(terms),
        roots=roots,
        lower=np.concatenate(lower),
        upper=np.concatenate(upper),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermNodes:
    """Nodes for which parameters of terms are made."""

    times: Sequence[float]
    """(n,) [s] times of the nodes."""
    active: Sequence[bool]
    """(n,) False where the state is given."""
    q: np.ndarray
    """(n, n_q) [m, rad] configurations of the guess, for terms whose references depend on it."""
    tightened: Mapping[Term, NodeMargins]
    """Margins of the nodes beyond the ranges of terms; see `Term.references`."""


def term_blocks(model: StageModel) -> tuple[TermBlock, ...]:
    """Write all terms of a problem: the steps of every phase, then the end of every phase."""
    problem = model.problem
    starts = problem.starts_of_phases()
    entry = cache(partial(_entry, model))  # a term is asked for its rows once, wherever it counts
    paths = []
    ends = []
    for i, phase in enumerate(problem.phases):
        on_path = [entry(place) for place in _places(problem, phase, at_end=False)]
        path_rows = _term_rows(model, on_path, f"path_{i}", on_path=True)
        paths.append(TermBlock(rows=path_rows, nodes=np.arange(starts[i], starts[i + 1])))
        at_end = [entry(place) for place in _places(problem, phase, at_end=True)]
        end_rows = _term_rows(model, at_end, f"end_{i}", on_path=False)
        ends.append(TermBlock(rows=end_rows, nodes=starts[i + 1 : i + 2]))
    return (*paths, *ends)


def eliminated_blocks(blocks: Sequence[TermBlock], model: StageModel) -> tuple[TermBlock, ...]:
    """Write blocks in the symbols of a model that eliminates forces, by substitution: terms are not
    asked for their rows again.

    Where forces are no variables of the blocks, their rows hold the equations of motion and have to
    be written anew.
    """
    if not blocks[0].rows.model.has_force_variables:
        return term_blocks(model)
    z = ca.vertcat(model.z[: model.n_motion], *model.inputs)
    return tuple(replace(block, rows=_rows_at(block.rows, z, model)) for block in blocks)


def _rows_at(term_rows: TermRows, z: ca.SX, model: StageModel) -> TermRows:
    """Substitute expressions z (n_z,) in the symbols of a model for the variables of rows."""
    expressions = [term_rows.rows, term_rows.costs, *term_rows.errors]
    rows, costs, *errors = ca.substitute(expressions, [term_rows.model.z], [z])
    return replace(term_rows, model=model, rows=rows, costs=costs, errors=tuple(errors))


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
    """Build the rows of one term of the model's problem."""
    problem = model.problem
    term = problem.terms[place]
    levels = [CONSTRAINT] * len(problem.constraints)
    for i, level in enumerate(problem.levels):
        levels += [i] * len(level.terms)
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
    """Write the rows of terms at one kind of node.

    Costs on the path are integrals over time, divided by the nominal time of the horizon. The end of
    a phase has no step of its own: terms of the path are integrated there over half of the last one.
    """
    terms = [member.term for member in members]
    numbers = term_numbers(terms, [member.residual for member in members])
    kinds = row_kinds(numbers.lower, numbers.upper)
    m = len(numbers.lower)
    common = ca.SX.sym("common", _N_COMMON)
    roots = ca.SX.sym("root", len(members))
    lower = ca.SX.sym("lower", m)
    upper = ca.SX.sym("upper", m)
    parameters = ca.vertcat(common, roots, lower, upper, *(member.goals for member in members))
    weighted = [roots[i] * member.residual.value for i, member in enumerate(members)]
    rows = ca.vertcat(ca.SX(0, 1), *weighted)
    active = common[0]
    rate = common[1]
    duration = model.z[model.layout.h] if on_path else ca.SX(1)
    time_shares = []
    for term in terms:
        time_shares.append(duration * rate if term.at is At.PATH else ca.SX(1))
    n_levels = len(model.problem.levels)
    costs, errors = _costs(n_levels, members, (rows, lower, upper, kinds), time_shares, active)
    row_members = []
    for member in members:
        row_members += [member] * member.residual.n_rows
    return TermRows(
        name=name,
        model=model,
        parameters=parameters,
        rows=rows,
        costs=costs,
        errors=tuple(errors),
        members=tuple(members),
        numbers=numbers,
        kinds=kinds,
        level=np.array([member.level for member in row_members], dtype=int),
        state_only=np.array([member.term.state_only for member in row_members], dtype=bool),
        names=tuple(member.term.name for member in row_members),
    )


def _costs(
    n_levels: int,
    members: Sequence[TermEntry],
    parts: tuple[ca.SX, ca.SX, ca.SX, RowKinds],
    time_shares: Sequence[ca.SX],
    active: ca.SX,
) -> tuple[ca.SX, list[ca.SX]]:
    """Return the cost of every level (n_levels,), and the vectors whose half squares they are.

    parts: rows, lower, upper and kinds of all members, each (m,). time_shares: factor of each member.
    """
    costs = [ca.SX(0) for _ in range(n_levels)]
    errors = [ca.SX(0, 1) for _ in range(n_levels)]
    first = 0
    for member, time_share in zip(members, time_shares, strict=True):
        stop = first + member.residual.n_rows
        if member.level != CONSTRAINT:
            scale = time_share * (active if member.term.state_only else 1)
            rows, lower, upper, kinds = [part[first:stop] for part in parts]
            costs[member.level] += scale * half_square(rows, lower, upper, kinds)
            error = ca.sqrt(scale) * signed_excess(rows, lower, upper, kinds)
            errors[member.level] = ca.vertcat(errors[member.level], error)
        first = stop
    return ca.vertcat(*costs), errors

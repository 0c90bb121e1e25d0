"""Rows, costs and parameters of all terms that count at one kind of node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from uvms_ocp.ocp.problem import HessianKind, OcpPhase, OcpProblem, counts_at_end, counts_on_path
from uvms_ocp.ocp.terms import StageSymbols, Term
from uvms_ocp.ocp.transcription.stage import Derivatives, StageModel, compiled, derivatives
from uvms_ocp.solvers.nlp.program import half_square
from uvms_ocp.tasks.task import Residual

CONSTRAINT = -1
"""Stands for the level of a constraint."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermRows:
    """What all terms together add at one kind of node: the steps of a phase, or its end.

    `functions` have the parameters ``[active, goals of all terms]``; rows of constraints come first, then those of
    level after level. `active` is 0 where the state is given, at the very first node, and 1 elsewhere.
    """

    functions: Derivatives
    terms: tuple[Term, ...]
    sizes: tuple[int, ...]
    """Parameters of each term."""
    level: np.ndarray
    """(m,) [-] level of each row, or CONSTRAINT."""
    lower: np.ndarray
    """(m,) [-] weighted."""
    upper: np.ndarray
    """(m,) [-] weighted."""
    state_only: np.ndarray
    """(m,) [-] True for rows without inputs."""
    names: tuple[str, ...]
    """(m,) term of each row."""

    def parameters(self, t: float, *, active: bool) -> np.ndarray:
        """Parameters at time t [s]."""
        return np.concatenate([[float(active)], *(term.reference(t) for term in self.terms)])

    @property
    def n_rows(self) -> int:
        return len(self.names)

    @property
    def n_parameters(self) -> int:
        return 1 + sum(self.sizes)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TermBlock:
    """`TermRows` at the nodes where they count, which follow each other."""

    rows: TermRows
    nodes: np.ndarray
    """(n,) [-]"""


def term_blocks(model: StageModel) -> tuple[TermBlock, ...]:
    """All terms of a problem: the steps of every phase, then the end of every phase."""
    nodes, phases = model.problem.starts_of_phases(), model.problem.phases
    spans = [np.arange(first, end) for first, end in pairwise(nodes)]
    paths = [TermBlock(rows=_path_rows(model, phase), nodes=span) for phase, span in zip(phases, spans, strict=True)]
    ends = [TermBlock(rows=_end_rows(model, phase), nodes=nodes[i : i + 1]) for i, phase in enumerate(phases, 1)]
    return (*paths, *ends)


def _path_rows(model: StageModel, phase: OcpPhase) -> TermRows:
    """Rows at the steps of a phase; costs are integrals, as shares of the nominal time of the horizon."""
    h = model.z[model.layout.h]
    return _term_rows(model, phase, counts_on_path, h / model.problem.nominal_times()[-1], f"path_{phase.name}")


def _end_rows(model: StageModel, phase: OcpPhase) -> TermRows:
    """Rows at the node that ends a phase."""
    return _term_rows(model, phase, counts_at_end, ca.SX(1), f"end_{phase.name}")


Counts = Callable[[OcpProblem, Term, OcpPhase], bool]


def _term_rows(model: StageModel, phase: OcpPhase, counts: Counts, share: ca.SX, name: str) -> TermRows:
    problem, symbols = model.problem, model.symbols()
    groups = [(CONSTRAINT, problem.constraints), *((i, level.terms) for i, level in enumerate(problem.levels))]
    members = [(i, term) for i, terms in groups for term in terms if counts(problem, term, phase)]
    sizes = tuple(term.n_parameters(problem.robot) for _, term in members)
    s = ca.SX.sym("s", 1 + sum(sizes))
    residuals = _residuals([term for _, term in members], sizes, symbols, s[1:])
    rows = ca.vertcat(ca.SX(0, 1), *(residual.value for residual in residuals))
    errors: list[ca.SX] = [ca.SX(0, 1) for _ in problem.levels]
    costs = [ca.SX(0) for _ in problem.levels]
    for (i, term), residual in zip(members, residuals, strict=True):
        if i != CONSTRAINT:
            scale = share * (s[0] if term.state_only else 1)
            costs[i] += scale * half_square(residual.value, residual.lower, residual.upper)
            errors[i] = ca.vertcat(errors[i], ca.sqrt(scale) * _beyond(residual))
    exact = problem.hessian is HessianKind.EXACT
    counted = [(i, term, residual.n_rows) for (i, term), residual in zip(members, residuals, strict=True)]
    functions = derivatives(
        _identifier(name), model.z, s, rows, costs=ca.vertcat(*costs), residuals=None if exact else errors
    )
    return TermRows(
        # Terms of forces hold the equations of motion where forces are no variables.
        functions=functions if model.decides_forces else compiled(functions),
        terms=tuple(term for _, term in members),
        sizes=sizes,
        level=np.array([i for i, _, m in counted for _ in range(m)], dtype=int),
        lower=np.concatenate([np.zeros(0), *(residual.lower for residual in residuals)]),
        upper=np.concatenate([np.zeros(0), *(residual.upper for residual in residuals)]),
        state_only=np.array([term.state_only for _, term, m in counted for _ in range(m)], dtype=bool),
        names=tuple(term.name for _, term, m in counted for _ in range(m)),
    )


def _residuals(terms: Sequence[Term], sizes: Sequence[int], symbols: StageSymbols, goals: ca.SX) -> list[Residual]:
    ends = np.cumsum([0, *sizes])
    parts = [goals[int(first) : int(last)] for first, last in pairwise(ends)]
    return [_weighted(term, term.residual(symbols, part)) for term, part in zip(terms, parts, strict=True)]


def _weighted(term: Term, residual: Residual) -> Residual:
    w = term.weight
    return Residual(value=w * residual.value, lower=w * residual.lower, upper=w * residual.upper)


def _beyond(residual: Residual) -> ca.SX:
    """Signed distance to the range; unlike `intervals.distance` without a kink where lower = upper."""
    y = residual.value
    high = ca.vertcat(*(ca.fmax(y[i] - u, 0) if np.isfinite(u) else ca.SX(0) for i, u in enumerate(residual.upper)))
    low = ca.vertcat(*(ca.fmax(lo - y[i], 0) if np.isfinite(lo) else ca.SX(0) for i, lo in enumerate(residual.lower)))
    equal = ca.DM((residual.lower == residual.upper).astype(float))
    target = ca.DM(np.where(residual.lower == residual.upper, residual.lower, 0.0))
    return equal * (y - target) + (1 - equal) * (high - low)


def _identifier(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)

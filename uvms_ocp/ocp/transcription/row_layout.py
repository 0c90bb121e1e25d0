"""The raw rows of a horizon, all numbered here: where each group of them is, and what every single row is.

    dynamics      step by step: the next state, then the forces where they are variables
    start         the first state, and the last one where the motion is periodic
    equal_steps   where durations are free: every step is as long as the one before
    total         where it is limited: all steps together
    terms         block by block, node by node
    costs         one row for each level

`uvms_ocp.ocp.transcription.horizon` gives their values in this order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.boundary import PERIODIC, START, Boundary
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermBlock, TermNumbers

FIXED = ("motion", "forces", START, "equal steps")
"""Names of rows that are laws, not wishes."""
TOTAL = "total duration"
_DROPPED = -2  # level of rows that say nothing
_START = 0.75  # stage of the first state: after the dynamics and the terms of the first node


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowLayout:
    """Numbers of the raw rows of each group, and what every row is."""

    dynamics: np.ndarray
    """(N, n_dynamics) [-]"""
    start: np.ndarray
    """(n_boundary,) [-]"""
    equal_steps: np.ndarray
    """(N - 1,) [-], or none where durations are fixed."""
    total: np.ndarray
    """(1,) [-], or none where the steps together may take any time."""
    terms: tuple[np.ndarray, ...]
    """(n_nodes, n_rows) [-] of each block."""
    costs: np.ndarray
    """(n_levels,) [-]"""
    n_state: int
    """[-] Rows of the next state in the dynamics of a step."""
    stage: np.ndarray
    """(n_rows,) [-] node or step of each row, by which they are sorted."""
    lower: np.ndarray
    """(n_rows,) [unit of the row]"""
    upper: np.ndarray
    """(n_rows,) [unit of the row]"""
    names: tuple[str, ...]
    """(n_rows,) of what each row stands for, in reports."""
    constraints: np.ndarray
    """(n_constraints,) [-] rows that are constraints, in ascending order."""
    levels: tuple[np.ndarray, ...]
    """(m,) [-] rows of each level, in ascending order."""
    held: tuple[np.ndarray, ...]
    """(m,) [-] rows that keep what each level has reached: its own, or its cost where the level may be relaxed."""

    @property
    def n_rows(self) -> int:
        return len(self.names)

    def bounds(self, numbers: Sequence[TermNumbers], longest: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_rows,) [unit of the row] with those of another problem of the same shape, block by block.

        longest [s]: of all steps together.
        """
        lower, upper = self.lower.copy(), self.upper.copy()
        upper[self.total] = longest
        for rows, own in zip(self.terms, numbers, strict=True):
            lower[rows], upper[rows] = own.lower, own.upper
        return lower, upper


def row_layout(problem: OcpProblem, blocks: Sequence[TermBlock], ends: Boundary, *, n_forces: int) -> RowLayout:
    """Number the rows of a problem whose terms are `blocks`; n_forces: rows of forces in the dynamics of each step."""
    N, n_state = problem.n_steps, problem.robot.n_q + problem.robot.n_v
    groups = [
        _dynamics(N, n_state, n_forces),
        _ends(problem, ends),
        _equal_steps(problem),
        _total(problem),
        *(_terms(block, fixed_start=problem.fixed_start) for block in blocks),
        _costs(problem),
    ]
    stops = np.cumsum([0, *(len(group.names) for group in groups)])
    dynamics, start, equal_steps, total, *terms, costs = (np.arange(first, stop) for first, stop in pairwise(stops))
    level = np.concatenate([group.level for group in groups])
    of_levels = tuple(np.flatnonzero(level == i) for i in range(len(problem.levels)))
    held = [costs[i : i + 1] if item.relax is not None else of_levels[i] for i, item in enumerate(problem.levels)]
    return RowLayout(
        dynamics=dynamics.reshape(N, -1),
        start=start,
        equal_steps=equal_steps,
        total=total,
        terms=tuple(rows.reshape(len(block.nodes), -1) for rows, block in zip(terms, blocks, strict=True)),
        costs=costs,
        n_state=n_state,
        stage=np.concatenate([group.stage for group in groups]),
        lower=np.concatenate([group.lower for group in groups]),
        upper=np.concatenate([group.upper for group in groups]),
        names=tuple(name for group in groups for name in group.names),
        constraints=np.flatnonzero(level == CONSTRAINT),
        levels=of_levels,
        held=tuple(held),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Group:
    """What the rows of one group are; each field has one entry for every row."""

    level: np.ndarray
    """level, `CONSTRAINT` or `_DROPPED`"""
    stage: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    names: tuple[str, ...]


def _equalities(level: np.ndarray, stage: np.ndarray, names: tuple[str, ...]) -> _Group:
    zero = np.zeros(len(names))
    return _Group(level=level, stage=stage, lower=zero, upper=zero, names=names)


def _dynamics(N: int, n_state: int, n_forces: int) -> _Group:
    names = N * (*FIXED[:1] * n_state, *FIXED[1:2] * n_forces)
    return _equalities(np.full(len(names), CONSTRAINT), np.repeat(np.arange(N), n_state + n_forces), names)


def _ends(problem: OcpProblem, ends: Boundary) -> _Group:
    """Rows that tie both ends come last."""
    closed = np.array([name == PERIODIC for name in ends.names], dtype=bool)
    return _Group(
        level=np.full(len(closed), CONSTRAINT),
        stage=np.where(closed, problem.n_steps + _START, _START),
        lower=ends.lower,
        upper=ends.upper,
        names=ends.names,
    )


def _equal_steps(problem: OcpProblem) -> _Group:
    """The first step of a phase may be longer or shorter than the last one of the phase before."""
    n = problem.n_steps - 1 if problem.free_time else 0
    first = np.isin(np.arange(1, n + 1), problem.starts_of_phases())
    return _equalities(np.where(first, _DROPPED, CONSTRAINT), np.arange(n), FIXED[3:] * n)


def _total(problem: OcpProblem) -> _Group:
    n = int(problem.limits_total)
    level, stage = np.full(n, CONSTRAINT), np.full(n, problem.n_steps + _START)
    return _Group(
        level=level, stage=stage, lower=np.full(n, -np.inf), upper=np.full(n, problem.longest), names=(TOTAL,) * n
    )


def _terms(block: TermBlock, *, fixed_start: bool) -> _Group:
    """A state that is given is not asked for anything."""
    rows, n = block.rows, len(block.nodes)
    level = np.tile(rows.level, (n, 1))
    if fixed_start:
        level[(block.nodes == 0)[:, None] & rows.state_only] = _DROPPED
    return _Group(
        level=level.ravel(),
        stage=np.repeat(block.nodes + 0.5, rows.n_rows),
        lower=np.tile(rows.own.lower, n),
        upper=np.tile(rows.own.upper, n),
        names=n * rows.names,
    )


def _costs(problem: OcpProblem) -> _Group:
    names = tuple(f"cost of {level.name}" for level in problem.levels)
    return _equalities(np.full(len(names), _DROPPED), np.full(len(names), problem.n_steps + 1), names)

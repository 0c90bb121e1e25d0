"""Number the raw rows of the NLP, among them those that tie the ends of the horizon.

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

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.ocp.node_margins import NodeMargins
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.ocp.transcription.derivatives import Derivatives, derivatives
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermBlock, TermNumbers
from uvms_ocp.robot import SymbolicModel

# Names of rows, in reports.
MOTION = "motion"
FORCES = "forces"
START = "start"
EQUAL_STEPS = "equal steps"
PERIODIC = "periodic"
TOTAL = "total duration"

_DROPPED = -2  # level of rows that bind nothing
_START_STAGE = 0.75  # of the first state: after the dynamics and the terms of the first node


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowLayout:
    """Numbers of the raw rows of each group, and what every row is."""

    dynamics: np.ndarray
    """(N, n_dynamics) rows of each step."""
    start: np.ndarray
    """(n_boundary,) rows of the first and the last state."""
    equal_steps: np.ndarray
    """(N - 1,) rows that keep steps equally long; none where durations are fixed."""
    total: np.ndarray
    """(1,) row of all steps' duration together; none where it is not limited."""
    terms: tuple[np.ndarray, ...]
    """Indices (n_nodes, n_rows) of the rows of each block."""
    costs: np.ndarray
    """(n_levels,) row of each level's cost."""
    n_state: int
    """Rows of the next state in the dynamics of a step."""
    stage: np.ndarray
    """(n_rows,) node or step of each row, by which they are sorted."""
    lower: np.ndarray
    """(n_rows,) [unit of the row] lower bounds."""
    upper: np.ndarray
    """(n_rows,) [unit of the row] upper bounds."""
    names: tuple[str, ...]
    """(n_rows,) names of what each row stands for, in reports."""
    constraints: np.ndarray
    """(n_constraints,) rows that are constraints, in ascending order."""
    levels: tuple[np.ndarray, ...]
    """(m,) rows of each level, in ascending order."""
    held: tuple[np.ndarray, ...]
    """(m,) rows by which lower levels keep what each level has reached: those of the level, or the
    row of its cost where the level may be relaxed.
    """

    @property
    def n_rows(self) -> int:
        """Number of raw rows."""
        return len(self.names)

    def bounds(
        self,
        numbers: Sequence[TermNumbers],
        longest: float,
        margins: Sequence[BlockMargins] = (),
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds (n_rows,) [unit of the row] with those of another problem of the same
        shape, block by block.

        longest [s]: of all steps together. margins: what is asked of some of the rows beyond them.
        """
        lower = self.lower.copy()
        upper = self.upper.copy()
        upper[self.total] = longest
        for rows, block_numbers in zip(self.terms, numbers, strict=True):
            lower[rows] = block_numbers.lower
            upper[rows] = block_numbers.upper
        for row_margins in margins:
            rows = self.terms[row_margins.block][:, row_margins.columns]
            node_margins = row_margins.margins
            lower[rows], upper[rows] = node_margins.narrowed(
                lower[rows], upper[rows], row_margins.unit
            )
        return lower, upper


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BlockMargins:
    """Margins of the rows of one constraint beyond their ranges, in one block of terms."""

    block: int
    """Index of the block."""
    columns: np.ndarray
    """(m,) indices of its rows among those of the block."""
    unit: np.ndarray
    """(m,) root of its weight, by which they are scaled."""
    margins: NodeMargins
    """Margins at the nodes of the block."""


def row_layout(
    problem: OcpProblem, blocks: Sequence[TermBlock], ends: BoundaryRows, *, n_forces: int
) -> RowLayout:
    """Number the rows of a problem whose terms are `blocks`; n_forces: rows of forces in the
    dynamics of each step.
    """
    N = problem.n_steps
    n_state = problem.robot.n_q + problem.robot.n_v
    groups = [
        _dynamics_group(N, n_state, n_forces),
        _boundary_group(problem, ends),
        _equal_steps_group(problem),
        _total_group(problem),
        *(_terms_group(block, fixed_start=problem.fixed_start) for block in blocks),
        _costs_group(problem),
    ]
    stops = np.cumsum([0, *(len(group.names) for group in groups)])
    numbers = [np.arange(first, stop) for first, stop in pairwise(stops)]
    dynamics, start, equal_steps, total, *terms, costs = numbers
    row_level = np.concatenate([group.level for group in groups])
    levels = []
    held = []
    for i, level in enumerate(problem.levels):
        rows = np.flatnonzero(row_level == i)
        levels.append(rows)
        held.append(rows if level.relax is None else costs[i : i + 1])
    names = list[str]()
    for group in groups:
        names += group.names
    return RowLayout(
        dynamics=dynamics.reshape(N, -1),
        start=start,
        equal_steps=equal_steps,
        total=total,
        terms=tuple(
            rows.reshape(len(block.nodes), -1) for rows, block in zip(terms, blocks, strict=True)
        ),
        costs=costs,
        n_state=n_state,
        stage=np.concatenate([group.stage for group in groups]),
        lower=np.concatenate([group.lower for group in groups]),
        upper=np.concatenate([group.upper for group in groups]),
        names=tuple(names),
        constraints=np.flatnonzero(row_level == CONSTRAINT),
        levels=tuple(levels),
        held=tuple(held),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Group:
    """Rows of one group; each field has one entry for every row."""

    level: np.ndarray
    """Level, `CONSTRAINT` or `_DROPPED`."""
    stage: np.ndarray
    """Node or step of the row, by which rows are sorted."""
    lower: np.ndarray
    """[unit of the row] lower bound."""
    upper: np.ndarray
    """[unit of the row] upper bound."""
    names: tuple[str, ...]
    """Name of what the row stands for, in reports."""


def _group(
    names: tuple[str, ...],
    stage: ArrayLike,
    level: ArrayLike = CONSTRAINT,
    lower: ArrayLike = 0.0,
    upper: ArrayLike = 0.0,
) -> _Group:
    """Make a group; a single number holds for all of its rows."""
    n = len(names)
    return _Group(
        names=names,
        level=np.broadcast_to(level, n),
        stage=np.broadcast_to(stage, n),
        lower=np.broadcast_to(lower, n),
        upper=np.broadcast_to(upper, n),
    )


def _dynamics_group(n_steps: int, n_state: int, n_forces: int) -> _Group:
    """Make the rows of the dynamics, step by step: the next state, then the forces."""
    names_of_step = (MOTION,) * n_state + (FORCES,) * n_forces
    return _group(n_steps * names_of_step, np.repeat(np.arange(n_steps), n_state + n_forces))


def _boundary_group(problem: OcpProblem, ends: BoundaryRows) -> _Group:
    """Make the rows of both ends of the horizon; those that tie them together come last."""
    ties_ends = np.array([name == PERIODIC for name in ends.names], dtype=bool)
    stage = np.where(ties_ends, problem.n_steps + _START_STAGE, _START_STAGE)
    return _group(ends.names, stage, lower=ends.lower, upper=ends.upper)


def _equal_steps_group(problem: OcpProblem) -> _Group:
    """Make the rows that keep each step as long as the one before it. The first step of a phase may
    have another length.
    """
    n = problem.n_steps - 1 if problem.free_time else 0
    starts_phase = np.isin(np.arange(1, n + 1), problem.starts_of_phases())
    level = np.where(starts_phase, _DROPPED, CONSTRAINT)
    return _group((EQUAL_STEPS,) * n, np.arange(n), level)


def _total_group(problem: OcpProblem) -> _Group:
    """Make the row of the duration of all steps, where it is limited."""
    names = (TOTAL,) if problem.limits_total else ()
    stage = problem.n_steps + _START_STAGE
    return _group(names, stage, lower=-np.inf, upper=problem.longest)


def _terms_group(block: TermBlock, *, fixed_start: bool) -> _Group:
    """Make the rows of a block of terms at its nodes. Rows of the state alone are dropped at a given
    start, which no plan can change.
    """
    rows = block.rows
    n = len(block.nodes)
    level = np.tile(rows.level, (n, 1))
    if fixed_start:
        level[(block.nodes == 0)[:, None] & rows.state_only] = _DROPPED
    stage = np.repeat(block.nodes + 0.5, rows.n_rows)
    lower = np.tile(rows.numbers.lower, n)
    upper = np.tile(rows.numbers.upper, n)
    return _group(n * rows.names, stage, level.ravel(), lower, upper)


def _costs_group(problem: OcpProblem) -> _Group:
    """Make a row for the cost of each level."""
    names = tuple(f"cost of {level.name}" for level in problem.levels)
    return _group(names, problem.n_steps + 1, _DROPPED)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BoundaryRows:
    """Rows of the first and the last state ``[q_0, v_0, q_N, v_N]``.

    The first state is the given one or near it; where the motion is periodic, the last state is the
    first again. The given state ``[q, v]`` is the parameter of the rows.
    """

    functions: Derivatives
    """Values of the rows and their derivatives."""
    lower: np.ndarray
    """(m,) [m, rad, m/s, rad/s, -] lower bounds."""
    upper: np.ndarray
    """(m,) [m, rad, m/s, rad/s, -] upper bounds."""
    names: tuple[str, ...]
    """(m,) START or PERIODIC."""
    coupled: bool
    """True where rows tie the last state to the first."""


def boundary(model: StageModel) -> BoundaryRows:
    """Build the boundary rows of the model's problem: `OcpProblem.start_freedom` and
    `OcpProblem.periodic`.
    """
    problem = model.problem
    n = model.layout.h
    first = ca.SX.sym("first", n)
    last = ca.SX.sym("last", n)
    start = ca.SX.sym("given", n)
    rows, freedom = _start_rows(model, first, start)
    names = (START,) * rows.numel()
    if problem.periodic:
        # By axes: the integration keeps the norm of a quaternion, which needs no row.
        closing = _difference(model, first, last)
        rows = ca.vertcat(rows, closing)
        freedom = np.concatenate([freedom, np.zeros(closing.numel())])
        names += (PERIODIC,) * closing.numel()
    residuals = None if problem.hessian is HessianKind.EXACT else ()
    z = ca.vertcat(first, last)
    return BoundaryRows(
        functions=derivatives("boundary", z, start, rows, residuals=residuals),
        lower=-freedom,
        upper=freedom,
        names=names,
        coupled=problem.periodic,
    )


def _start_rows(model: StageModel, first: ca.SX, start: ca.SX) -> tuple[ca.SX, np.ndarray]:
    """Return the rows (m,) of the first state, and by how much (m,) each may differ from 0."""
    freedom = model.problem.start_freedom
    if freedom is None:
        rows = first - start
        return rows, np.zeros(rows.numel())
    unit_vectors = []
    if model.robot.n_vehicle:
        unit_vectors.append(slice(3, 7))  # the quaternion
    for joint in model.robot.joints:
        if joint.n_q > joint.n_v:  # cosine and sine of an angle
            unit_vectors.append(slice(joint.q.stop - 2, joint.q.stop))
    norms = ca.vertcat(ca.SX(0, 1), *(ca.sumsqr(first[part]) - 1 for part in unit_vectors))
    rows = ca.vertcat(_difference(model, start, first), norms)
    return rows, np.concatenate([freedom, np.zeros(norms.numel())])


def _difference(model: StageModel, first: ca.SX, second: ca.SX) -> ca.SX:
    """Return the difference (2 n_v,) of two states, along the axes and in velocity."""
    n = model.robot.n_q
    tree = SymbolicModel(model.robot.model)
    return ca.vertcat(tree.difference(first[:n], second[:n]), second[n:] - first[n:])

"""Number the variables, parameters and rows of the NLP, among them those that tie the ends of the
horizon.

dynamics      step by step: the next state, then the forces where they are variables
    start         the first state, and the last one where the motion is periodic
    equal_steps   where durations are free: every step is as long as the one before
    total         where it is limited: all steps together
    terms         block by block, node by node
    costs         one row for each level

`uvms_ocp.ocp.transcription.transcription` gives their values in this order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, NodeMargins, Tightening
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, has_thrusters, unchecked_trajectory
from uvms_ocp.ocp.transcription.stage import Derivatives, StageModel, derivatives
from uvms_ocp.ocp.transcription.term_rows import (
    CONSTRAINT,
    ReusedProblem,
    TermBlock,
    TermNodes,
    TermNumbers,
)
from uvms_ocp.robot import State, SymbolicModel

START = "start"
PERIODIC = "periodic"
"""Names of the rows, in reports."""

FIXED = ("motion", "forces", START, "equal steps")
"""Names of rows that are laws, not wishes."""
TOTAL = "total duration"
_DROPPED = -2  # level of rows that say nothing
_START = 0.75  # stage of the first state: after the dynamics and the terms of the first node


# The variables of the NLP: those of step after step, then the state of the last node; units are
# those of z.


class NodeVariables(NamedTuple):
    """The variables as columns, node by node."""

    steps: ca.MX
    """(n_z, N) z of all steps"""
    last: ca.MX
    """(n_z,) z of the last node, zero but for its state"""
    following: ca.MX
    """(n_state, N) state at the end of each step"""


@dataclass(frozen=True, kw_only=True, eq=False)
class VariableLayout:
    """Layout of the entries of z of every node in the variables x (n_x,); converts trajectories to
    variables.
    """

    model: StageModel

    @property
    def N(self) -> int:
        return self.model.problem.n_steps

    @property
    def free(self) -> bool:
        """Durations are variables."""
        return self.model.problem.free_time

    @cached_property
    def _column(self) -> np.ndarray:
        """(n_z,) place of every entry of z among the variables of its step; -1 where it is none."""
        is_variable = np.ones(self.model.layout.n_z, dtype=bool)
        is_variable[self.model.layout.h] = self.free
        return np.where(is_variable, np.cumsum(is_variable) - 1, -1)

    @cached_property
    def n_step(self) -> int:
        """Variables of a step."""
        return self.model.layout.n_z - (not self.free)

    @cached_property
    def n_state(self) -> int:
        """Variables of the last node."""
        return self.model.layout.h + self.free

    @cached_property
    def n_x(self) -> int:
        return self.N * self.n_step + self.n_state

    def columns(self, node: int) -> np.ndarray:
        """Index in x of every entry of z at a node (n_z,); -1 where it is no variable."""
        columns = np.where(self._column >= 0, self._column + node * self.n_step, -1)
        if node == self.N:
            columns[self.model.layout.h + 1 :] = -1
        return columns

    @cached_property
    def all_columns(self) -> np.ndarray:
        """(N + 1, n_z) of all nodes."""
        return np.array([self.columns(k) for k in range(self.N + 1)])

    @cached_property
    def _inputs(self) -> BufferedFunction:
        """``z (n_z, N), water (3, N) -> thrust, torque`` in shares of their limits."""
        return BufferedFunction(self.model.inputs_function.map(self.N))

    def nodes(self, x: ca.MX, h: ca.MX) -> NodeVariables:
        """Columns of the variables x (n_x,); h (N,) [s]: lengths of the steps where they are no
        variables.
        """
        layout = self.model.layout
        n = self.N * self.n_step
        W = ca.reshape(x[:n], self.n_step, self.N)
        end = x[n:]
        return NodeVariables(
            steps=W if self.free else ca.vertcat(W[: layout.h, :], h.T, W[layout.h :, :]),
            last=ca.vertcat(end, ca.MX.zeros(layout.n_z - self.n_state)),
            following=ca.horzcat(W[: self.n_state, 1:], end),
        )

    def bounds(
        self, problem: OcpProblem, tightened: Tightening = NO_TIGHTENING
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_x,) of the variables: limits of the robot, durations of a problem of the same
        shape; narrower where nodes are asked for more.
        """
        low = np.empty(self.n_x)
        up = np.empty(self.n_x)
        used = self.all_columns >= 0
        for values, bound in zip((low, up), self._step_bounds(), strict=True):
            values[self.all_columns[used]] = np.broadcast_to(bound, used.shape)[used]
        self._narrow(tightened, low, up)
        if self.free:
            self._bound_durations(problem, low, up)
        if problem.fixed_start:
            # It is given by rows; bounds on it could only contradict them.
            first = self.columns(0)[: self.model.layout.h]
            low[first] = -np.inf
            up[first] = np.inf
        return low, up

    def bounds_around(
        self, q: np.ndarray, radius: float, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_x,) narrower by joints that go no farther than radius [m, rad] from
        configurations q (N + 1, n_q) [m, rad], the start excepted, which is given.
        """
        places = self.model.robot.limited_positions
        columns = self.all_columns[1:, places]
        inside = np.clip(q[1:, places], lower[columns], upper[columns])
        narrow_lower = lower.copy()
        narrow_upper = upper.copy()
        narrow_lower[columns] = np.maximum(lower[columns], inside - radius)
        narrow_upper[columns] = np.minimum(upper[columns], inside + radius)
        return narrow_lower, narrow_upper

    def _narrow(self, tightened: Tightening, low: np.ndarray, up: np.ndarray) -> None:
        """Narrow bounds (n_x,) of what has them."""
        layout = self.model.layout
        actuators = self.model.actuators
        positions = self.model.robot.limited_positions
        parts = (
            (tightened.positions, positions, np.ones(len(positions))),
            (tightened.thrust, _places(layout.thrust), 1.0 / actuators.thrust_unit),
            (tightened.torque, _places(layout.torque), 1.0 / actuators.torque_unit),
        )
        for more, places, unit in parts:
            if more is None or not len(places):
                continue
            columns = self.all_columns[:, places]
            used = columns >= 0
            lower, upper = more.narrowed(low[columns], up[columns], unit)
            low[columns[used]] = lower[used]
            up[columns[used]] = upper[used]

    def _bound_durations(self, problem: OcpProblem, low: np.ndarray, up: np.ndarray) -> None:
        phases = [phase for phase in problem.phases for _ in range(phase.n_steps)]
        for k, phase in enumerate([*phases, phases[-1]]):
            shortest, longest = phase.range
            # A range of no width would leave interior points no inside.
            slack = 0.0 if phase.free else 1e-6
            h = self.columns(k)[self.model.layout.h]
            low[h] = (shortest - slack) / phase.n_steps
            up[h] = (longest + slack) / phase.n_steps

    def _step_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        robot = self.model.robot
        layout = self.model.layout
        actuators = self.model.actuators
        lower = np.full(layout.n_z, -np.inf)
        upper = np.full(layout.n_z, np.inf)
        if not self.model.problem.limited:
            return lower, upper
        lower[layout.q], upper[layout.q] = robot.configuration_bounds
        for part, limit in (
            (layout.v, robot.limits.velocity),
            (layout.a, robot.limits.acceleration),
        ):
            lower[part] = -limit
            upper[part] = limit
        lower[layout.thrust] = actuators.thrust_lower
        upper[layout.thrust] = actuators.thrust_upper
        lower[layout.torque] = -actuators.torque_limit
        upper[layout.torque] = actuators.torque_limit
        return lower, upper

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Variables (n_x,) of a trajectory; times are taken as they are where durations are free.

        Raises `InvalidInput` for a trajectory of another number of steps.
        """
        if len(trajectory.a) != self.N:
            raise InvalidInput(
                f"the guess has {len(trajectory.a)} steps; give one of {self.N}, such as `through`"
                " makes"
            )
        actuators = self.model.actuators
        shares = (
            trajectory.thrust / actuators.thrust_unit,
            trajectory.torque / actuators.torque_unit,
        )
        steps = np.hstack(
            [
                np.diff(trajectory.t)[:, None],
                trajectory.a,
                *(shares if self.model.has_force_variables else ()),
            ]
        )
        Z = np.hstack([trajectory.q, trajectory.v, np.vstack([steps, steps[-1:]])])
        x = np.zeros(self.n_x)
        used = self.all_columns >= 0
        x[self.all_columns[used]] = Z[used]
        return x

    def unpack(self, x: np.ndarray, problem: OcpProblem) -> Trajectory:
        """The trajectory of variables x (n_x,) [unit of x]; where durations are fixed, with those
        of the problem.

        Numbers that are not finite stay so: the status of a result says whether they are, and
        receding horizon goes by it.
        """
        layout, actuators = self.model.layout, self.model.actuators
        Z = np.zeros((self.N + 1, layout.n_z))
        used = self.all_columns >= 0
        Z[used] = x[self.all_columns[used]]
        if self.free:
            steps = Z[:-1, layout.h]
        else:
            steps = np.diff(problem.nominal_times())
        Z[:-1, layout.h] = steps
        thrust, torque = (
            part.reshape(-1, self.N).T for part in self._inputs(Z[:-1].T, problem.currents.T)
        )
        parts = {
            "t": np.concatenate([[0.0], np.cumsum(steps)]),
            "q": Z[:, layout.q].copy(),
            "v": Z[:, layout.v].copy(),
            "a": Z[:-1, layout.a].copy(),
            "thrust": thrust * actuators.thrust_unit,
            "torque": torque * actuators.torque_unit,
        }
        for part in parts.values():
            part.flags.writeable = False
        return unchecked_trajectory(**parts, of_wrench=not has_thrusters(self.model.problem))


def _places(part: slice) -> np.ndarray:
    return np.arange(part.start, part.stop)


# The parameters of the NLP, in this order: start, currents, lengths of the steps, and those of all
# terms in their units.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ParameterLayout:
    """Layout of the parameters p."""

    blocks: tuple[TermBlock, ...]
    start: slice
    """Q [m, rad] and v [m/s, rad/s] of the first node."""
    water: slice
    """[m/s] Velocities of the water, step after step."""
    steps: slice
    """[s] Lengths of the steps."""
    terms: tuple[slice, ...]
    """Ranges of each block, node after node."""

    @property
    def n(self) -> int:
        return self.terms[-1].stop

    def values(
        self,
        reused: ReusedProblem,
        *,
        t0: float,
        start: State | None,
        near: np.ndarray | None = None,
        tightened: Tightening = NO_TIGHTENING,
    ) -> np.ndarray:
        """Parameters (n,) with the first node at t0 [s]; see `Transcription.parameters`.

        near (n_nodes, n_q) [m, rad].
        """
        nominal = reused.problem.nominal_times()
        state = start or reused.problem.start
        times = t0 + nominal
        rate = 1.0 / nominal[-1]
        last_share = 0.5 * (nominal[-1] - nominal[-2]) * rate
        n_phases = len(reused.problem.phases)
        if near is None:
            about = np.tile(state.q, (len(times), 1))
        else:
            about = near
        parts = [state.q, state.v, reused.problem.currents.ravel(), np.diff(nominal)]
        for i, (block, numbers) in enumerate(zip(self.blocks, reused.numbers, strict=True)):
            nodes_of_block = block.nodes
            extra = {term: more.at(nodes_of_block) for term, more in tightened.terms.items()}
            active = ((nodes_of_block > 0) | (not reused.problem.fixed_start)).tolist()
            nodes = TermNodes(
                times=times[nodes_of_block].tolist(),
                active=active,
                q=about[nodes_of_block],
                tightened=extra,
            )
            parts.append(numbers.parameters(nodes, rate if i < n_phases else last_share))
        return np.concatenate(parts)


def parameter_layout(problem: OcpProblem, blocks: tuple[TermBlock, ...]) -> ParameterLayout:
    """Place the parameters of a problem whose terms are `blocks`."""
    sizes = [block.rows.n_parameters * len(block.nodes) for block in blocks]
    ends = np.cumsum(
        [0, problem.robot.n_q + problem.robot.n_v, 3 * problem.n_steps, problem.n_steps, *sizes]
    ).tolist()
    start, water, steps, *places = (slice(first, stop) for first, stop in pairwise(ends))
    return ParameterLayout(
        blocks=blocks, start=start, water=water, steps=steps, terms=tuple(places)
    )


# Rows that tie the ends of the horizon: the first state is given, or near the given one, and may be
# the last one too.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BoundaryRows:
    """Rows of the first and the last state ``[q_0, v_0, q_N, v_N]``; the given state ``[q, v]`` is
    their parameter.
    """

    functions: Derivatives
    lower: np.ndarray
    """(m,) [m, rad, m/s, rad/s, -]"""
    upper: np.ndarray
    """(m,) [m, rad, m/s, rad/s, -]"""
    names: tuple[str, ...]
    """(m,)"""
    coupled: bool
    """The rows tie the last state to the first."""


def boundary(model: StageModel) -> BoundaryRows:
    """Build the boundary rows of the model's problem: `OcpProblem.start_freedom` and
    `OcpProblem.periodic`.
    """
    problem = model.problem
    n = model.layout.h
    first, last, start = (ca.SX.sym(name, n) for name in ("first", "last", "given"))
    parts = [(START, *_given(model, first, start))]
    if (
        problem.periodic
    ):  # by axes: the integration keeps the norm of a quaternion, which needs no row
        closed = _difference(model, first, last)
        parts.append((PERIODIC, closed, np.zeros(closed.numel())))
    rows = ca.vertcat(*(rows for _, rows, _ in parts))
    width = np.concatenate([width for _, _, width in parts])
    residuals = None if problem.hessian is HessianKind.EXACT else ()
    return BoundaryRows(
        functions=derivatives(
            "boundary", ca.vertcat(first, last), start, rows, residuals=residuals
        ),
        lower=-width,
        upper=width,
        names=tuple(name for name, part, _ in parts for _ in range(part.numel())),
        coupled=problem.periodic,
    )


def _given(model: StageModel, first: ca.SX, start: ca.SX) -> tuple[ca.SX, np.ndarray]:
    """Rows of the first state, and by how much each may differ from 0."""
    freedom = model.problem.start_freedom
    if freedom is None:
        rows = first - start
        return rows, np.zeros(rows.numel())
    if model.robot.n_vehicle:
        parts = [slice(3, 7)]
    else:
        parts = []
    parts += [
        slice(joint.q.stop - 2, joint.q.stop)
        for joint in model.robot.joints
        if joint.n_q > joint.n_v
    ]
    norms = ca.vertcat(ca.SX(0, 1), *(ca.sumsqr(first[part]) - 1 for part in parts))
    rows = ca.vertcat(_difference(model, start, first), norms)
    return rows, np.concatenate([freedom, np.zeros(norms.numel())])


def _difference(model: StageModel, first: ca.SX, second: ca.SX) -> ca.SX:
    """(2 n_v,) from one state to another."""
    n = model.robot.n_q
    tree = SymbolicModel(model.robot.model)
    return ca.vertcat(tree.difference(first[:n], second[:n]), second[n:] - first[n:])


# The raw rows of a horizon, all numbered here: where each group of them is, and what every single
# row is.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BlockMargins:
    """Margins of the rows of one constraint beyond their ranges, in one block of terms."""

    block: int
    columns: np.ndarray
    """(m,) its rows among those of the block."""
    unit: np.ndarray
    """(m,) root of its weight, by which they are scaled."""
    margins: NodeMargins
    """At the nodes of the block."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowLayout:
    """Numbers of the raw rows of each group, and what every row is."""

    dynamics: np.ndarray
    """(N, n_dynamics) """
    start: np.ndarray
    """(n_boundary,) """
    equal_steps: np.ndarray
    """(N - 1,), or none where durations are fixed."""
    total: np.ndarray
    """(1,), or none where the steps together may take any time."""
    terms: tuple[np.ndarray, ...]
    """(n_nodes, n_rows) of each block."""
    costs: np.ndarray
    """(n_levels,) """
    n_state: int
    """Rows of the next state in the dynamics of a step."""
    stage: np.ndarray
    """(n_rows,) node or step of each row, by which they are sorted."""
    lower: np.ndarray
    """(n_rows,) [unit of the row]"""
    upper: np.ndarray
    """(n_rows,) [unit of the row]"""
    names: tuple[str, ...]
    """(n_rows,) of what each row stands for, in reports."""
    constraints: np.ndarray
    """(n_constraints,) rows that are constraints, in ascending order."""
    levels: tuple[np.ndarray, ...]
    """(m,) rows of each level, in ascending order."""
    held: tuple[np.ndarray, ...]
    """(m,) rows that keep what each level has reached: its own, or its cost where the level may be
    relaxed.
    """

    @property
    def n_rows(self) -> int:
        return len(self.names)

    def bounds(
        self,
        numbers: Sequence[TermNumbers],
        longest: float,
        margins: Sequence[BlockMargins] = (),
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_rows,) [unit of the row] with those of another problem of the same shape, block
        by block.

        longest [s]: of all steps together. margins: what is asked of some of the rows beyond them.
        """
        lower = self.lower.copy()
        upper = self.upper.copy()
        upper[self.total] = longest
        for rows, block_numbers in zip(self.terms, numbers, strict=True):
            lower[rows] = block_numbers.lower
            upper[rows] = block_numbers.upper
        for more in margins:
            rows = self.terms[more.block][:, more.columns]
            lower[rows], upper[rows] = more.margins.narrowed(lower[rows], upper[rows], more.unit)
        return lower, upper


def row_layout(
    problem: OcpProblem, blocks: Sequence[TermBlock], ends: BoundaryRows, *, n_forces: int
) -> RowLayout:
    """Number the rows of a problem whose terms are `blocks`; n_forces: rows of forces in the
    dynamics of each step.
    """
    N = problem.n_steps
    n_state = problem.robot.n_q + problem.robot.n_v
    names = N * (*FIXED[:1] * n_state, *FIXED[1:2] * n_forces)
    groups = [
        _group(names, np.repeat(np.arange(N), n_state + n_forces)),
        _ends(problem, ends),
        _equal_steps(problem),
        _total(problem),
        *(_terms(block, fixed_start=problem.fixed_start) for block in blocks),
        _costs(problem),
    ]
    stops = np.cumsum([0, *(len(group.names) for group in groups)])
    dynamics, start, equal_steps, total, *terms, costs = (
        np.arange(first, stop) for first, stop in pairwise(stops)
    )
    level = np.concatenate([group.level for group in groups])
    of_levels = tuple(np.flatnonzero(level == i) for i in range(len(problem.levels)))
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
        **{
            name: np.concatenate([getattr(group, name) for group in groups])
            for name in ("stage", "lower", "upper")
        },
        names=tuple(name for group in groups for name in group.names),
        constraints=np.flatnonzero(level == CONSTRAINT),
        levels=of_levels,
        held=tuple(
            costs[i : i + 1] if item.relax is not None else of_levels[i]
            for i, item in enumerate(problem.levels)
        ),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Group:
    """Rows of one group; each field has one entry for every row."""

    level: np.ndarray
    """Level, `CONSTRAINT` or `_DROPPED`"""
    stage: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    names: tuple[str, ...]


def _group(
    names: tuple[str, ...],
    stage: ArrayLike,
    level: ArrayLike = CONSTRAINT,
    lower: ArrayLike = 0.0,
    upper: ArrayLike = 0.0,
) -> _Group:
    """Make a group; a single number holds for all of its rows."""
    fields = {"level": level, "stage": stage, "lower": lower, "upper": upper}
    return _Group(
        names=names, **{name: np.broadcast_to(value, len(names)) for name, value in fields.items()}
    )


def _ends(problem: OcpProblem, ends: BoundaryRows) -> _Group:
    """Rows that tie both ends come last."""
    closed = np.array([name == PERIODIC for name in ends.names], dtype=bool)
    return _group(
        ends.names,
        np.where(closed, problem.n_steps + _START, _START),
        lower=ends.lower,
        upper=ends.upper,
    )


def _equal_steps(problem: OcpProblem) -> _Group:
    """The first step of a phase may be longer or shorter than the last one of the phase before."""
    n = problem.n_steps - 1 if problem.free_time else 0
    first = np.isin(np.arange(1, n + 1), problem.starts_of_phases())
    return _group(FIXED[3:] * n, np.arange(n), np.where(first, _DROPPED, CONSTRAINT))


def _total(problem: OcpProblem) -> _Group:
    return _group(
        (TOTAL,) * int(problem.limits_total),
        problem.n_steps + _START,
        lower=-np.inf,
        upper=problem.longest,
    )


def _costs(problem: OcpProblem) -> _Group:
    return _group(
        tuple(f"cost of {level.name}" for level in problem.levels), problem.n_steps + 1, _DROPPED
    )


def _terms(block: TermBlock, *, fixed_start: bool) -> _Group:
    """A state that is given is not asked for anything."""
    rows = block.rows
    n = len(block.nodes)
    level = np.tile(rows.level, (n, 1))
    if fixed_start:
        level[(block.nodes == 0)[:, None] & rows.state_only] = _DROPPED
    lower, upper = np.tile([rows.own.lower, rows.own.upper], n)
    return _group(
        n * rows.names, np.repeat(block.nodes + 0.5, rows.n_rows), level.ravel(), lower, upper
    )

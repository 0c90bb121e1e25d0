"""From an optimal control problem to a sparse lexicographic NLP: multiple shooting on the manifold.

Step functions are mapped over the horizon and their nonzeros are placed into the large matrices, so that the
derivatives of a horizon cost as much as those of its steps, and nothing is differentiated twice. Variables and rows are
ordered step by step, as structure-exploiting solvers want them.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.horizon import Block, Horizon
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermRows, end_rows, path_rows
from uvms_ocp.solvers.intervals import excess
from uvms_ocp.solvers.nlp.program import LevelNlp, LevelRows, LexicographicProgram

_DROPPED = -2  # level of rows that say nothing


class Transcription:
    """The NLP of a problem. Start, current, goals and fixed durations are parameters; the rest is built in."""

    def __init__(self, problem: OcpProblem, *, plugin: str = "ipopt") -> None:
        self.problem, self._plugin = problem, plugin
        self.model = StageModel(problem)
        self.N = problem.n_steps
        layout = self.model.layout
        self._free = problem.free_time
        self._kept = np.array([i for i in range(layout.n_z) if self._free or i != layout.h])
        self._column = np.full(layout.n_z, -1)
        self._column[self._kept] = np.arange(len(self._kept))
        self.n_state = layout.n_q + layout.n_v + int(self._free)
        self.n_x = self.N * len(self._kept) + self.n_state
        self._nodes = problem.starts_of_phases()
        self._phase_of_step = np.repeat(np.arange(len(problem.phases)), np.diff(self._nodes))
        self._paths = [path_rows(self.model, phase) for phase in problem.phases]
        self._ends = [end_rows(self.model, phase) for phase in problem.phases]
        self._x = ca.MX.sym("x", self.n_x)
        self._p = ca.MX.sym("p", self._n_parameters())
        self._build_blocks()
        self._number_rows()

    # --- variables and parameters -----------------------------------------------------------------

    def columns(self, node: int) -> np.ndarray:
        """Index in x of every entry of z at a node; -1 where it is no variable."""
        columns = np.where(self._column >= 0, self._column + node * len(self._kept), -1)
        if node == self.N:
            columns[self.model.layout.h + 1 :] = -1
        return columns

    def _n_parameters(self) -> int:
        pairs = zip(self._paths, self.problem.phases, strict=True)
        goals = sum(rows.n_parameters * phase.n_steps for rows, phase in pairs)
        return self._n_given + goals + sum(rows.n_parameters for rows in self._ends)

    @property
    def _n_given(self) -> int:
        """Start (q, v), current, and the length of every step."""
        return self.problem.robot.n_q + self.problem.robot.n_v + 3 + self.N

    def parameters(
        self, problem: OcpProblem | None = None, *, t0: float = 0.0, start: State | None = None
    ) -> np.ndarray:
        """Parameters (n_p,) of this problem, or of one of the same shape with another start, current or goals.

        t0 [s]: time of the first node, for goals that move. start: instead of the problem's, such as a measured one,
        which may be slightly outside the joint limits.
        """
        given = problem or self.problem
        times = t0 + given.nominal_times()
        state = start or given.start
        parts = [state.q, state.v, given.current, np.diff(times)]
        for i, rows in enumerate(self._paths):
            terms = _terms_like(rows, given, self.problem)
            for k in range(self._nodes[i], self._nodes[i + 1]):
                parts += [np.array([float(k > 0)]), *(term.reference(times[k]) for term in terms)]
        for i, rows in enumerate(self._ends):
            terms = _terms_like(rows, given, self.problem)
            parts += [np.ones(1), *(term.reference(times[self._nodes[i + 1]]) for term in terms)]
        return np.concatenate(parts)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_x,) of the variables: limits of the robot, durations."""
        lower, upper = self._step_bounds()
        low, up = np.full(self.n_x, -np.inf), np.full(self.n_x, np.inf)
        for k in range(self.N + 1):
            columns = self.columns(k)
            used = columns >= 0
            low[columns[used]], up[columns[used]] = lower[used], upper[used]
            if self._free:
                phase = self.problem.phases[self._phase_of_step[min(k, self.N - 1)]]
                shortest, longest = phase.range
                # A range of no width would leave interior points no inside.
                slack = 0.0 if phase.free else 1e-6
                low[columns[self.model.layout.h]] = (shortest - slack) / phase.n_steps
                up[columns[self.model.layout.h]] = (longest + slack) / phase.n_steps
        # The first state is given by rows; bounds on it could only contradict them.
        first = self.columns(0)[: self.problem.robot.n_q + self.problem.robot.n_v]
        low[first], up[first] = -np.inf, np.inf
        return low, up

    def _step_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        robot, layout, actuators = self.problem.robot, self.model.layout, self.model.actuators
        lower, upper = np.full(layout.n_z, -np.inf), np.full(layout.n_z, np.inf)
        if not self.problem.limited:
            return lower, upper
        first = robot.n_vehicle
        for joint in robot.joints:
            if joint.n_q == joint.n_v:
                own = slice(joint.idx_v - first, joint.idx_v - first + joint.n_v)
                lower[joint.q], upper[joint.q] = robot.limits.position_lower[own], robot.limits.position_upper[own]
        for part, limit in ((layout.v, robot.limits.velocity), (layout.a, robot.limits.acceleration)):
            lower[part], upper[part] = -limit, limit
        lower[layout.thrust], upper[layout.thrust] = actuators.thrust_lower, actuators.thrust_upper
        lower[layout.torque], upper[layout.torque] = -actuators.torque_limit, actuators.torque_limit
        return lower, upper

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Variables (n_x,) of a trajectory; times are taken as they are where durations are free."""
        actuators = self.model.actuators
        x = np.zeros(self.n_x)
        h = np.diff(trajectory.t)
        for k in range(self.N + 1):
            j = min(k, self.N - 1)
            shares = (trajectory.thrust[j] / actuators.thrust_unit, trajectory.torque[j] / actuators.torque_unit)
            inputs = shares if self.model.decides_forces else ()
            z = np.concatenate([trajectory.q[k], trajectory.v[k], [h[j]], trajectory.a[j], *inputs])
            columns = self.columns(k)
            x[columns[columns >= 0]] = z[columns >= 0]
        return x

    def unpack(self, x: np.ndarray) -> Trajectory:
        """The trajectory of variables (n_x,)."""
        layout, actuators = self.model.layout, self.model.actuators
        Z = np.zeros((self.N + 1, layout.n_z))
        for k in range(self.N + 1):
            columns = self.columns(k)
            Z[k, columns >= 0] = x[columns[columns >= 0]]
        steps = Z[:-1, layout.h] if self._free else np.diff(self.problem.nominal_times())
        Z[:-1, layout.h] = steps
        thrust, torque = (np.array(part).T for part in self.model.inputs_function.map(self.N)(Z[:-1].T))
        return Trajectory(
            t=np.concatenate([[0.0], np.cumsum(steps)]),
            q=Z[:, layout.q],
            v=Z[:, layout.v],
            a=Z[:-1, layout.a],
            thrust=thrust * actuators.thrust_unit,
            torque=torque * actuators.torque_unit,
        )

    # --- blocks and rows --------------------------------------------------------------------------

    def _build_blocks(self) -> None:
        layout, n_q_v = self.model.layout, self.problem.robot.n_q + self.problem.robot.n_v
        W = ca.reshape(self._x[: self.N * len(self._kept)], len(self._kept), self.N)
        last = self._x[self.N * len(self._kept) :]
        h = self._p[n_q_v + 3 : n_q_v + 3 + self.N]
        self._Z = W if self._free else ca.vertcat(W[: layout.h, :], h.T, W[layout.h :, :])
        tail = ca.MX.zeros(layout.n_z - n_q_v - int(self._free))
        self._Z_last = ca.vertcat(last, tail)
        self._next = ca.horzcat(W[: self.n_state, 1:], last)
        self._water = self._p[n_q_v : n_q_v + 3]
        self._n_dynamics = n_q_v + layout.n_v * self.model.decides_forces
        self._first_init = self.N * self._n_dynamics
        self._first_steps = self._first_init + n_q_v
        self._blocks: list[Block] = []
        first, offset = self._first_steps + (self.N - 1 if self._free else 0), self._n_given
        for i, rows in enumerate(self._paths):
            nodes = np.arange(self._nodes[i], self._nodes[i + 1])
            offset = self._add_block(rows, nodes, self._Z[:, nodes[0] : nodes[-1] + 1], first, offset)
            first = self._blocks[-1].stop
        for i, rows in enumerate(self._ends):
            node = int(self._nodes[i + 1])
            Z = self._Z_last if node == self.N else self._Z[:, node]
            offset = self._add_block(rows, np.array([node]), Z, first, offset)
            first = self._blocks[-1].stop
        self._first_cost = first
        self._horizon = Horizon(
            model=self.model,
            x=self._x,
            p=self._p,
            Z=self._Z,
            following=self._next,
            water=self._water,
            blocks=tuple(self._blocks),
            columns=self.columns,
            n_dynamics=self._n_dynamics,
            free=self._free,
            n_levels=len(self.problem.levels),
        )

    def _add_block(self, rows: TermRows, nodes: np.ndarray, Z: ca.MX, first: int, offset: int) -> int:
        stop = offset + rows.n_parameters * len(nodes)
        S = ca.reshape(self._p[offset:stop], rows.n_parameters, len(nodes))
        self._blocks.append(Block(rows=rows, nodes=nodes, Z=Z, S=S, first=first, last_node=nodes[0] == self.N))
        return stop

    def _number_rows(self) -> None:
        """Level, stage and bounds of every raw row; cost rows of the levels come last."""
        n_levels, n_raw = len(self.problem.levels), self._first_cost + len(self.problem.levels)
        self._level = np.full(n_raw, CONSTRAINT)
        self._stage = np.zeros(n_raw)
        self._low, self._up = np.zeros(n_raw), np.zeros(n_raw)
        self._stage[: self._first_init] = np.repeat(np.arange(self.N), self._n_dynamics)
        self._stage[self._first_init : self._first_steps] = 0.75
        if self._free:
            inside = np.diff(self._phase_of_step) == 0
            steps = slice(self._first_steps, self._first_steps + self.N - 1)
            self._stage[steps] = np.arange(self.N - 1)
            self._level[steps] = np.where(inside, CONSTRAINT, _DROPPED)
        for block in self._blocks:
            own, n = slice(block.first, block.stop), len(block.nodes)
            level = np.tile(block.rows.level, (n, 1))
            level[(block.nodes == 0)[:, None] & block.rows.state_only] = _DROPPED
            self._level[own] = level.ravel()
            self._stage[own] = np.repeat(block.nodes + 0.5, block.n_rows)
            self._low[own], self._up[own] = np.tile(block.rows.lower, n), np.tile(block.rows.upper, n)
        self._level[self._first_cost :] = _DROPPED
        self._stage[self._first_cost :] = self.N + 1
        self._of_level = [np.flatnonzero(self._level[: self._first_cost] == i) for i in range(n_levels)]
        self._constraints = np.flatnonzero(self._level == CONSTRAINT)

    @cached_property
    def _constraint_values(self) -> ca.Function:
        return ca.Function("constraints", [self._x, self._p], [self._horizon.rows[self._constraints.tolist()]])

    def violations(self, x: np.ndarray, p: np.ndarray) -> dict[str, float]:
        """Largest violation of every group of constraints at x, in the units of its rows."""
        g = np.array(self._constraint_values(x, p)).ravel()
        low, up = self._low[self._constraints], self._up[self._constraints]
        worst: dict[str, float] = {}
        for row, value in zip(self._constraints, excess(g, low, up).tolist(), strict=True):
            name = self._name(int(row))
            worst[name] = max(worst.get(name, 0.0), value)
        return worst

    def obstruction(self, problem: OcpProblem) -> tuple[str, float] | None:
        """Constraint along the path that the start itself breaks, and by how much."""
        z = np.zeros(self.model.layout.n_z)
        z[self.model.layout.q], z[self.model.layout.v] = problem.start.q, problem.start.v
        rows = self._paths[0]
        s = rows.parameters(0.0, active=False)
        y = np.array(rows.functions.value(z, s)).ravel()
        broken = excess(y, rows.lower, rows.upper)
        broken[(rows.level != CONSTRAINT) | ~rows.state_only] = 0.0
        if not broken.any() or broken.max() < 1e-9:
            return None
        return rows.names[int(broken.argmax())], float(broken.max())

    def _name(self, raw: int) -> str:
        if raw < self._first_init:
            inside = raw % self._n_dynamics
            return "motion" if inside < self.problem.robot.n_q + self.problem.robot.n_v else "forces"
        if raw < self._first_steps:
            return "start"
        block = next((block for block in self._blocks if block.first <= raw < block.stop), None)
        return "equal steps" if block is None else block.rows.names[(raw - block.first) % block.n_rows]

    # --- the program ------------------------------------------------------------------------------

    @cached_property
    def program(self) -> LexicographicProgram:
        """The lexicographic program, with derivatives."""
        levels, frozen, first = [], [self._constraints], len(self._constraints)
        for i, level in enumerate(self.problem.levels):
            rows = self._of_level[i]
            held = rows if level.relax is None else np.array([self._first_cost + i])
            levels.append(
                LevelRows(
                    name=level.name,
                    lower=self._low[rows],
                    upper=self._up[rows],
                    relax=level.relax,
                    frozen=slice(first, first + len(held)),
                )
            )
            frozen.append(held)
            first += len(held)
        numbered = np.concatenate(frozen)
        y = [self._horizon.rows[rows.tolist()] if len(rows) else ca.MX(0, 1) for rows in self._of_level]
        return LexicographicProgram(
            levels=tuple(levels),
            nlps=tuple(self._level_nlp(i, numbered[: levels[i].frozen.start]) for i in range(len(levels))),
            values=ca.Function("values", [self._x, self._p], y),
            lower=self._low[self._constraints],
            upper=self._up[self._constraints],
        )

    def _level_nlp(self, index: int, numbered: np.ndarray) -> LevelNlp:
        order = np.argsort(self._stage[numbered], kind="stable")
        raw_rows = numbered[order]
        horizon = self._horizon
        nlp = {"x": self._x, "p": self._p, "f": horizon.costs[index], "g": horizon.rows[raw_rows.tolist()]}
        functions = horizon.derivative_functions(index, raw_rows, plugin=self._plugin)
        return LevelNlp(nlp=nlp, rows=order, functions=functions)


def _terms_like(rows: TermRows, given: OcpProblem, built: OcpProblem) -> list[Term]:
    """The terms of another problem in the places of those that rows were built from."""
    if given is built:
        return list(rows.terms)
    places = {id(term): i for i, term in enumerate(built.terms)}
    return [given.terms[places[id(term)]] for term in rows.terms]

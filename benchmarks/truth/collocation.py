"""Solve a statement with IPOPT by a transcription of its own.

Constant accelerations over the steps, forces at their middle, whose state is a variable too:

    q_next = q (+) (h v + h^2/2 a),   q_mid = q (+) (h/2 v + h^2/8 a)
    v_next = v + h a,                 ID(q_mid, v + h/2 a, a, water) = forces

Every node has the variables ``z = [q, v, h, a, thrust, torque, q_mid]``; those of the last node
below v are 0. Only inverse dynamics and the poses of frames are expressions of the package.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from time import process_time

import casadi as ca
import numpy as np
import pinocchio as pin

from truth.planes import PlaneRows, plane_rows
from truth.statement import Node, Statement, node_symbols, units_of, units_of_problem
from uvms_ocp.codegen.compile import compile_function
from uvms_ocp.ocp import OcpProblem, Trajectory
from uvms_ocp.robot import Robot
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.solvers.nlp.program import nlp_functions

_ITERATIONS = 250  # of IPOPT for one solve
# [s] of a processor for one solve of IPOPT; no further round begins after twice that
_SECONDS = 8.0
_TOLERANCE = 1e-7  # error of the optimality conditions
_FREE = {"mu_strategy": "adaptive"}  # options of IPOPT for a start from anywhere
_NEAR = {
    "mu_strategy": "monotone",
    "mu_init": 1e-6,
    "bound_push": 1e-8,
    "bound_frac": 1e-8,
    "slack_bound_push": 1e-8,
    "slack_bound_frac": 1e-8,
}
"""Options of IPOPT for a start that may be an optimum."""
FEASIBLE = 1e-5
"""[unit of the row] violation up to which a point keeps its rows."""
_SERIES = 11  # terms: exact to rounding for steps that turn by up to 3 rad
_WIDE = 1e-9  # [s] by which a fixed step is wider than nothing


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Layout:
    """Places of the parts of z."""

    q: slice
    v: slice
    h: int
    a: slice
    thrust: slice
    torque: slice
    middle: slice
    n: int


def layout_of(robot: Robot, n_thrust: int) -> Layout:
    """Place the variables of a node."""
    sizes = (robot.n_q, robot.n_v, 1, robot.n_v, n_thrust, robot.n_joints, robot.n_q)
    ends = np.cumsum([0, *sizes]).tolist()
    q, v, h, a, thrust, torque, middle = map(slice, ends[:-1], ends[1:])
    return Layout(q=q, v=v, h=h.start, a=a, thrust=thrust, torque=torque, middle=middle, n=ends[-1])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Block:
    """Rows and a cost of z (n_z,) with parameters s, and their derivatives."""

    value: ca.Function
    """``z, s -> rows``"""
    jacobian: ca.Function
    """``z, s -> nonzeros``"""
    hessian: ca.Function
    """``z, s, multipliers -> nonzeros`` of both triangles."""
    jacobian_pattern: ca.Sparsity
    hessian_pattern: ca.Sparsity

    @property
    def n_rows(self) -> int:
        return int(self.value.numel_out(0))


def block_of(name: str, z: ca.SX, s: ca.SX, rows: ca.SX) -> Block:
    """Differentiate rows (m,) twice."""
    lam = ca.SX.sym("lam", rows.numel())
    J = ca.jacobian(rows, z)
    H = ca.hessian(ca.dot(lam, rows), z)[0]
    options = {"cse": True}
    return Block(
        value=ca.Function(f"{name}_value", [z, s], [ca.densify(rows)], options),
        jacobian=ca.Function(f"{name}_jacobian", [z, s], [_nonzeros(J)], options),
        hessian=ca.Function(f"{name}_hessian", [z, s, lam], [_nonzeros(H)], options),
        jacobian_pattern=J.sparsity(),
        hessian_pattern=H.sparsity(),
    )


def _nonzeros(matrix: ca.SX) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *matrix.nonzeros())


# The motion over a step, written anew: series instead of quotients that vanish at 0.


def moved(robot: Robot, q: ca.SX, step: ca.SX) -> ca.SX:
    """Configuration (n_q,) after a step (n_v,) from q."""
    parts = []
    if robot.n_vehicle:
        turn = step[3:6]
        s = ca.sumsqr(turn)
        cross = ca.skew(turn)
        # V = 1 + (1 - cos)/angle^2 [w] + (angle - sin)/angle^3 [w]^2
        V = ca.SX.eye(3) + _series(s, 2) * cross + _series(s, 3) * (cross @ cross)
        parts.append(q[:3] + rotation(q[3:7]) @ V @ step[:3])
        half = s / 4
        spin = ca.vertcat(_series(half, 1) * turn / 2, _series(half, 0))
        parts.append(quaternion_product(q[3:7], spin))
    for joint in robot.joints:
        way = step[joint.idx_v]
        if joint.endless:
            c, s = q[joint.q][0], q[joint.q][1]
            cosine = c * ca.cos(way) - s * ca.sin(way)
            sine = s * ca.cos(way) + c * ca.sin(way)
            parts.append(ca.vertcat(cosine, sine))
        else:
            parts.append(q[joint.q] + way)
    return ca.vertcat(*parts)


def _series(s: ca.SX, first: int) -> ca.SX:
    """``sum_k (-s)^k / (2 k + first)!`` of the square s of an angle, by Horner's rule."""
    result = ca.SX(1)
    for k in range(_SERIES, 0, -1):
        result = 1 - s * result / ((2 * k + first - 1) * (2 * k + first))
    return result / float(np.prod(np.arange(1, first + 1)))


def rotation(x: ca.SX) -> ca.SX:
    """R (3, 3) of a unit quaternion xyzw."""
    u = x[:3]
    w = x[3]
    return ca.SX.eye(3) + 2 * w * ca.skew(u) + 2 * ca.skew(u) @ ca.skew(u)


def quaternion_product(x: ca.SX, y: ca.SX) -> ca.SX:
    """Hamilton product of two quaternions xyzw."""
    vector = x[3] * y[:3] + y[3] * x[:3] + ca.cross(x[:3], y[:3])
    return ca.vertcat(vector, x[3] * y[3] - ca.dot(x[:3], y[:3]))


@lru_cache(maxsize=4)
def _dynamics_blocks(robot: Robot, wrench: bool, n_thrust: int) -> tuple[Block, Block]:
    """Motion over a step, and balance of forces at its middle (parameters: water (3,))."""
    layout = layout_of(robot, n_thrust)
    z = ca.SX.sym("z", layout.n)
    q = z[layout.q]
    v = z[layout.v]
    h = z[layout.h]
    a = z[layout.a]
    water = ca.SX.sym("water", 3)
    motion = ca.vertcat(
        moved(robot, q, h * v + h**2 / 2 * a),
        v + h * a,
        moved(robot, q, h / 2 * v + h**2 / 8 * a) - z[layout.middle],
    )
    dynamics = cached_dynamics(robot).symbolic
    waters = ca.repmat(water, 1, len(dynamics.links))
    middle = ca.SX.sym("middle", robot.n_q)
    rate = ca.SX.sym("rate", robot.n_v)
    required = dynamics.inverse_dynamics(middle, rate, a, waters, ca.SX(*waters.shape))
    required = ca.substitute(
        required, ca.vertcat(middle, rate), ca.vertcat(z[layout.middle], v + h / 2 * a)
    )
    units = units_of(robot, wrench=wrench)
    thrust = z[layout.thrust] * ca.DM(units.thrust)
    torque = z[layout.torque] * ca.DM(units.torque)
    actuation = ca.vertcat(ca.sparsify(ca.DM(units.matrix)) @ thrust, torque)
    scale = np.concatenate([np.abs(units.matrix) @ units.thrust / 4, units.torque])
    scale = np.maximum(scale, 1e-3 * scale.max(initial=1.0))
    balance = (required - actuation) / ca.DM(scale)
    motion_block = block_of("motion", z, ca.SX(0, 1), motion)
    balance_block = block_of("balance", z, water, balance)
    return motion_block, _compiled(balance_block)


def _compiled(block: Block) -> Block:
    """Compile the derivatives of a block to machine code, where there is a compiler."""
    return replace(
        block,
        jacobian=compile_function(block.jacobian),
        hessian=compile_function(block.hessian),
    )


# The whole program, assembled from blocks.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Placed:
    """A block at some nodes, whose rows are numbered in the whole."""

    name: str
    block: Block
    nodes: np.ndarray
    """(n,)"""
    s: np.ndarray | ca.MX
    """(n_s, n) parameters."""
    numbers: np.ndarray
    """(n, n_rows)"""
    lower: float = 0.0
    upper: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Way:
    """A motion that IPOPT came to from one start."""

    trajectory: Trajectory
    costs: np.ndarray
    """(n_levels,) of the levels of costs."""
    status: str
    """Return status of IPOPT."""
    violations: dict[str, float]
    """[unit of the row] of every group of rows."""

    @property
    def kept(self) -> bool:
        """All rows are kept at the nodes."""
        return max(self.violations.values()) <= FEASIBLE


class Collocation:
    """One statement, transcribed for IPOPT."""

    def __init__(
        self, problem: OcpProblem, statement: Statement, motions: Sequence[Trajectory]
    ) -> None:
        """motions: where pairs of shapes may come near."""
        self.problem = problem
        self.statement = statement
        robot = problem.robot
        self.units = units_of_problem(problem)
        self.N = problem.n_steps
        self.layout = layout_of(robot, self.units.matrix.shape[1])
        self.times = problem.nominal_times()
        self.planes: PlaneRows | None = None
        if statement.shapes is not None:
            places = [(motion.q, self.times.tolist()) for motion in motions]
            self.planes = plane_rows(robot, statement.shapes, places)
        self.n_levels = max(cost.level for cost in statement.costs) + 1
        self._x = ca.MX.sym("x", self.layout.n * (self.N + 1))
        size = self.planes.n_parameters if self.planes else 0
        self._p = ca.MX.sym("p", size * self.N)
        self._groups = self._placed_groups()
        self.n_rows = sum(group.numbers.size for group in self._groups) + len(self._equal_steps)

    # --- groups of rows ---------------------------------------------------------------------------

    def _node(self) -> tuple[Node, ca.SX]:
        """Symbols of a node, and its z made of them."""
        robot = self.problem.robot
        layout = self.layout
        node = node_symbols(robot, self.units.matrix.shape[1])
        h = ca.SX.sym("h")
        middle = ca.SX.sym("middle", robot.n_q)
        z = ca.vertcat(node.q, node.v, h, node.a, node.thrust, node.torque, middle)
        assert z.numel() == layout.n
        return node, z

    def _placed_groups(self) -> list[Placed]:
        problem = self.problem
        wrench = problem.actuation.value == "wrench"
        motion, balance = _dynamics_blocks(problem.robot, wrench, self.units.matrix.shape[1])
        steps = np.arange(self.N)
        after = np.arange(1, self.N + 1)
        every = np.arange(self.N + 1)
        ends = problem.starts_of_phases()[1:]
        node, z = self._node()
        chosen: list[tuple[str, Block, np.ndarray, np.ndarray | ca.MX, float, float]] = [
            ("motion", motion, steps, np.zeros((0, self.N)), 0.0, 0.0),
            ("forces", balance, steps, problem.currents.T, 0.0, 0.0),
        ]
        for rows in self.statement.path:
            block = block_of("path", z, node.t, rows.rows(node))
            if rows.of_inputs:
                nodes = steps
            elif problem.fixed_start:
                nodes = after
            else:
                nodes = every
            chosen.append(
                (rows.name, block, nodes, self.times[None, nodes], rows.lower, rows.upper)
            )
        for end in self.statement.ends:
            block = block_of("end", z, node.t, end.rows(node))
            nodes = ends[[end.phase]]
            chosen.append((end.name, block, nodes, self.times[None, nodes], 0.0, 0.0))
        if self.planes is not None and self.planes.pairs:
            s = ca.SX.sym("s", self.planes.n_parameters)
            block = block_of("planes", z, s, self.planes.rows(node, s))
            parameters = ca.reshape(self._p, self.planes.n_parameters, self.N)
            chosen.append(("planes", block, after, parameters, 0.0, np.inf))
        groups = []
        n = 0
        for name, block, nodes, s_of, lower, upper in chosen:
            numbers = n + np.arange(len(nodes) * block.n_rows).reshape(len(nodes), block.n_rows)
            n += numbers.size
            groups.append(
                Placed(
                    name=name,
                    block=block,
                    nodes=nodes,
                    s=s_of,
                    numbers=numbers,
                    lower=lower,
                    upper=upper,
                )
            )
        return groups

    @cached_property
    def _cost_block(self) -> Block:
        """Costs of a step of all levels, with the rate 1 / nominal time in them."""
        node, z = self._node()
        levels = [ca.SX(0) for _ in range(self.n_levels)]
        share = z[self.layout.h] / self.times[-1]
        for cost in self.statement.costs:
            levels[cost.level] += share * cost.weight / 2 * cost.density(node)
        return block_of("cost", z, ca.SX(0, 1), ca.vertcat(*levels))

    @cached_property
    def _equal_steps(self) -> list[int]:
        """Steps that are as long as the next one."""
        starts = set(self.problem.starts_of_phases().tolist())
        return [k for k in range(self.N - 1) if k + 1 not in starts]

    # --- the program ------------------------------------------------------------------------------

    @cached_property
    def _Z(self) -> ca.MX:
        return ca.reshape(self._x, self.layout.n, self.N + 1)

    def _values(self, group: Placed) -> ca.MX:
        """(n_rows, n)"""
        Z = self._Z[:, group.nodes.tolist()]
        values = group.block.value.map(len(group.nodes))(Z, group.s)
        if group.name == "motion":
            n_state = self.layout.h
            following = self._Z[:n_state, 1:]
            values -= ca.vertcat(following, ca.MX.zeros(values.shape[0] - n_state, self.N))
        return values

    @cached_property
    def _g(self) -> ca.MX:
        parts = [ca.vec(self._values(group)) for group in self._groups]
        h = self._Z[self.layout.h, :].T
        equal = h[self._equal_steps] - h[[k + 1 for k in self._equal_steps]]
        return ca.vertcat(*parts, equal)

    @cached_property
    def _costs(self) -> ca.MX:
        values = self._cost_block.value.map(self.N)(self._Z[:, : self.N], ca.MX(0, self.N))
        return ca.sum2(values)

    def _jacobian(self) -> ca.MX:
        total = ca.MX(self.n_rows, self._x.numel())
        for group in self._groups:
            block = group.block
            nonzeros = block.jacobian.map(len(group.nodes))(
                self._Z[:, group.nodes.tolist()], group.s
            )
            rows, columns = map(np.array, block.jacobian_pattern.get_triplet())
            total += self._spread(
                ca.vec(nonzeros),
                group.numbers[:, rows.astype(int)].ravel(),
                (self.layout.n * group.nodes[:, None] + columns.astype(int)).ravel(),
            )
            if group.name == "motion":
                n_state = self.layout.h
                following = self.layout.n * (group.nodes[:, None] + 1) + np.arange(n_state)
                rows = group.numbers[:, :n_state].ravel()
                total += self._spread(-ca.MX.ones(rows.size), rows, following.ravel())
        if self._equal_steps:
            rows = self.n_rows - len(self._equal_steps) + np.arange(len(self._equal_steps))
            places = self.layout.n * np.array(self._equal_steps) + self.layout.h
            unit_slopes = ca.MX.ones(rows.size)
            total += self._spread(unit_slopes, rows, places)
            total += self._spread(-unit_slopes, rows, places + self.layout.n)
        return total

    def _spread(self, values: ca.MX, rows: np.ndarray, columns: np.ndarray) -> ca.MX:
        """(n_rows, n_x) with values at places that are all different."""
        return _matrix(values, rows, columns, (self.n_rows, self._x.numel()))

    def _hessian(self, lam: ca.MX, sigma: ca.MX) -> ca.MX:
        n_x = self._x.numel()
        total = ca.MX(n_x, n_x)
        placed = []
        for group in self._groups:
            multipliers = lam[group.numbers.ravel().tolist()]
            of_nodes = ca.reshape(multipliers, *group.numbers.T.shape)
            placed.append((group.block, group.nodes, group.s, of_nodes))
        of_costs = ca.repmat(sigma, 1, self.N)
        placed.append((self._cost_block, np.arange(self.N), np.zeros((0, self.N)), of_costs))
        for block, nodes, s, multipliers in placed:
            if not block.hessian_pattern.nnz():
                continue
            nonzeros = block.hessian.map(len(nodes))(self._Z[:, nodes.tolist()], s, multipliers)
            rows_of_z, columns_of_z = block.hessian_pattern.get_triplet()
            first = self.layout.n * nodes[:, None]
            rows = first + np.array(rows_of_z, dtype=int)
            columns = first + np.array(columns_of_z, dtype=int)
            total += _matrix(ca.vec(nonzeros), rows.ravel(), columns.ravel(), (n_x, n_x))
        return total

    def _cost_gradients(self) -> ca.MX:
        """(n_levels, n_x)"""
        nonzeros = self._cost_block.jacobian.map(self.N)(self._Z[:, : self.N], ca.MX(0, self.N))
        rows, columns = map(np.array, self._cost_block.jacobian_pattern.get_triplet())
        nodes = np.arange(self.N)
        total = ca.MX(self.n_levels, self._x.numel())
        values = ca.reshape(nonzeros, len(rows), self.N)
        for k in nodes.tolist():
            places = self.layout.n * k + columns.astype(int)
            total += _matrix(values[:, k], rows.astype(int), places, total.shape)
        return total

    def _solver(self, level: int, *, from_optimum: bool) -> ca.Function:
        """Build the solver for the cost of a level, below those of the levels above it;
        from_optimum: what stays by its start, instead of going to the middle of all bounds first.
        """
        above = list(range(level))
        g = self._g
        J = self._jacobian()
        gradients = self._cost_gradients()
        if above:
            g = ca.vertcat(g, self._costs[above])
            J = ca.vertcat(J, gradients[above, :])
        lam_f = ca.MX.sym("lam_f")
        lam = ca.MX.sym("lam_g", g.numel())
        below = self.n_levels - level - 1
        sigma = ca.vertcat(lam[self.n_rows :], lam_f, ca.MX.zeros(below))
        H = ca.triu(self._hessian(lam[: self.n_rows], sigma))
        gradient = ca.densify(gradients[level, :]).T
        variables = [self._x, self._p]
        values = [self._costs[level], g]
        functions = nlp_functions(variables, values, [lam_f, lam], (gradient, J, H))
        options = {
            "cache": functions,
            "error_on_fail": False,
            "print_time": False,
            "calc_lam_p": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": _ITERATIONS,
                "tol": _TOLERANCE,
                "max_cpu_time": _SECONDS,
                **(_NEAR if from_optimum else _FREE),
            },
        }
        nlp = {"x": self._x, "p": self._p, "f": values[0], "g": g}
        return ca.nlpsol("own", "ipopt", nlp, options)

    @cached_property
    def _free_solvers(self) -> list[ca.Function]:
        return [self._solver(level, from_optimum=False) for level in range(self.n_levels)]

    @cached_property
    def _near_solvers(self) -> list[ca.Function]:
        return [self._solver(level, from_optimum=True) for level in range(self.n_levels)]

    @cached_property
    def _evaluate(self) -> ca.Function:
        return ca.Function("evaluate", [self._x, self._p], [self._g, self._costs])

    # --- bounds -----------------------------------------------------------------------------------

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_x,) of the variables."""
        problem = self.problem
        layout = self.layout
        robot = problem.robot
        lower = np.full((self.N + 1, layout.n), -np.inf)
        upper = np.full((self.N + 1, layout.n), np.inf)
        if problem.limited:
            lower[:, layout.q], upper[:, layout.q] = robot.configuration_bounds
            for part, limit in (
                (layout.v, robot.limits.velocity),
                (layout.a, robot.limits.acceleration),
                (layout.torque, self.units.torque_limit),
            ):
                lower[:, part] = -limit
                upper[:, part] = limit
            lower[:, layout.thrust] = self.units.thrust_lower
            upper[:, layout.thrust] = self.units.thrust_upper
        k = 0
        for phase in problem.phases:
            steps = slice(k, k + phase.n_steps)
            shortest, longest = phase.range
            lower[steps, layout.h] = shortest / phase.n_steps
            upper[steps, layout.h] = longest / phase.n_steps
            k += phase.n_steps
        lower[-1, layout.h :] = upper[-1, layout.h :] = 0.0
        if problem.fixed_start:
            start = np.concatenate([problem.start.q, problem.start.v])
            lower[0, : layout.h] = upper[0, : layout.h] = start
        return lower.ravel(), upper.ravel()

    @cached_property
    def row_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_rows,)."""
        lower = np.zeros(self.n_rows)
        upper = np.zeros(self.n_rows)
        for group in self._groups:
            numbers = group.numbers.ravel()
            lower[numbers] = group.lower
            upper[numbers] = group.upper
        return lower, upper

    # --- motions ----------------------------------------------------------------------------------

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Variables (n_x,) of a trajectory."""
        model = self.problem.robot.model
        layout = self.layout
        h = np.diff(trajectory.t)
        Z = np.zeros((self.N + 1, layout.n))
        q = trajectory.q.copy()
        if self.problem.robot.n_vehicle:
            turns = h[:, None] * trajectory.v[:-1, 3:6] + h[:, None] ** 2 / 2 * trajectory.a[:, 3:6]
            for (before, after), turn in zip(pairwise(q), turns, strict=True):
                # Of two quaternions of an attitude the one that the step comes to: not the nearer
                # one where the vehicle turns by more than half a revolution.
                side = np.cos(np.linalg.norm(turn) / 2)
                if side * (before[3:7] @ after[3:7]) < 0.0:
                    after[3:7] *= -1.0
        Z[:, layout.q] = q
        Z[:, layout.v] = trajectory.v
        Z[:-1, layout.h] = h
        Z[:-1, layout.a] = trajectory.a
        Z[:-1, layout.thrust] = trajectory.thrust / self.units.thrust
        Z[:-1, layout.torque] = trajectory.torque / self.units.torque
        for k in range(self.N):
            way = h[k] / 2 * trajectory.v[k] + h[k] ** 2 / 8 * trajectory.a[k]
            Z[k, layout.middle] = pin.integrate(model, q[k], way)
        return Z.ravel()

    def unpack(self, x: np.ndarray) -> Trajectory:
        """The trajectory of variables x (n_x,)."""
        layout = self.layout
        Z = x.reshape(self.N + 1, layout.n)
        return Trajectory(
            t=np.concatenate([[0.0], np.cumsum(Z[:-1, layout.h])]),
            q=np.array([pin.normalize(self.problem.robot.model, row) for row in Z[:, layout.q]]),
            v=Z[:, layout.v].copy(),
            a=Z[:-1, layout.a].copy(),
            thrust=Z[:-1, layout.thrust] * self.units.thrust,
            torque=Z[:-1, layout.torque] * self.units.torque,
            of_wrench=self.problem.actuation.value == "wrench",
        )

    def _plane_parameters(self, x: np.ndarray) -> np.ndarray:
        if self.planes is None or not self.planes.pairs:
            return np.zeros(self._p.numel())
        q = x.reshape(self.N + 1, self.layout.n)[1:, self.layout.q]
        q = np.array([pin.normalize(self.problem.robot.model, row) for row in q])
        return self.planes.parameters(q, self.times[1:].tolist()).ravel()

    def judge(self, trajectory: Trajectory) -> tuple[np.ndarray, dict[str, float]]:
        """Costs (n_levels,) of a motion, and by how much it breaks every group of rows at its
        nodes; those of shapes are left to `dense_check`.
        """
        x = self.pack(trajectory)
        parts = self._evaluate(x, np.zeros(self._p.numel()))
        g, costs = (np.array(part).ravel() for part in parts)
        excess = np.maximum(self.row_bounds[0] - g, g - self.row_bounds[1])
        violations = {}
        for group in self._groups:
            if group.name != "planes":
                violations[group.name] = float(excess[group.numbers].max(initial=0.0))
        lower, upper = self.bounds
        beyond = np.maximum(lower - x, x - upper).reshape(self.N + 1, self.layout.n)
        names = ("q", "v", "h", "a", "thrust", "torque")
        for name in names:
            part = beyond[:, getattr(self.layout, name)]
            violations[f"limits of {name}"] = float(part.max(initial=0.0))
        return costs, violations

    def solve(self, start: Trajectory, *, from_optimum: bool = False, rounds: int = 5) -> Way:
        """Solve from a start, level of costs after level; from_optimum: stay by it. rounds: in which
        planes between shapes are written anew where the last motion is.
        """
        solvers = self._near_solvers if from_optimum else self._free_solvers
        if self.planes is None or not self.planes.pairs:
            rounds = 1
        x = self.pack(start)
        lower, upper = self.bounds
        row_lower, row_upper = self.row_bounds
        status = ""
        begin = process_time()
        for _ in range(rounds):
            if process_time() - begin > 2 * _SECONDS:
                break
            before = x
            p = self._plane_parameters(x)
            cost_limits: list[float] = []
            for level, solver in enumerate(solvers):
                result = solver(
                    x0=x,
                    p=p,
                    lbx=lower,
                    ubx=upper,
                    lbg=np.concatenate([row_lower, np.full(level, -np.inf)]),
                    ubg=np.concatenate([row_upper, np.array(cost_limits)]),
                )
                x = np.array(result["x"]).ravel()
                status = str(solver.stats()["return_status"])
                if level + 1 < self.n_levels:
                    relax = self.problem.levels[-self.n_levels + level].relax or 0.0
                    cost_limits.append((1.0 + relax) * float(result["f"]) + 1e-8)
            if np.abs(x - before).max() < 1e-3 or not np.isfinite(x).all():
                break
        trajectory = self.unpack(x)
        costs, violations = self.judge(trajectory)
        return Way(trajectory=trajectory, costs=costs, status=status, violations=violations)


def _matrix(values: ca.MX, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> ca.MX:
    order = np.lexsort((rows, columns))
    pattern = ca.Sparsity.triplet(*shape, rows[order].tolist(), columns[order].tolist())
    return ca.MX(pattern, values[order.tolist()])

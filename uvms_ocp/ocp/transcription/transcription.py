"""Multiple shooting on the manifold: an optimal control problem becomes a sparse lexicographic NLP.

Step functions are mapped over the horizon and their nonzeros are placed into the large matrices, so
that the derivatives of a horizon cost as much as those of its steps, and nothing is differentiated
twice. Variables and rows are ordered step by step, as structure-exploiting solvers want them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from threading import RLock

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import interval_excess
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription import layout as layouts, term_rows
from uvms_ocp.ocp.transcription.stage import Derivatives, StageModel
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.level_solver import STAGEWISE
from uvms_ocp.solvers.nlp.program import (
    LevelNlp,
    LevelRows,
    LexicographicProgram,
    RowRanges,
    nlp_functions,
)

_ROUNDING = 1e-9  # violation of a constraint at the start that is none


# Placing nonzeros into large sparse matrices, as CasADi MX.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Entries:
    """Nonzeros with their places. Entries in a negative row or column count for nothing."""

    values: ca.MX
    """(n,)"""
    rows: np.ndarray
    """(n,) """
    columns: np.ndarray
    """(n,) """

    def selected(self, position: np.ndarray, none: int) -> Entries:
        """Move row i to entry i of position (n_rows,); rows that are moved to `none` count for
        nothing.
        """
        rows = position[self.rows]
        return Entries(
            values=self.values, rows=rows, columns=np.where(rows == none, -1, self.columns)
        )


def assemble(entries: Sequence[Entries], shape: tuple[int, int]) -> ca.MX:
    """The matrix of all entries; no two may share a place."""
    rows = np.concatenate([item.rows for item in entries])
    columns = np.concatenate([item.columns for item in entries])
    kept = np.flatnonzero((rows >= 0) & (columns >= 0))
    order = kept[np.lexsort((rows[kept], columns[kept]))]
    starts = np.concatenate([[0], np.cumsum(np.bincount(columns[kept], minlength=shape[1]))])
    sparsity = ca.Sparsity(*shape, starts.tolist(), rows[order].tolist())
    return ca.MX(sparsity, ca.vertcat(*(item.values for item in entries))[order.tolist()])


def upper_triangle(entries: Sequence[Entries], n: int) -> ca.MX:
    """The upper triangle of the square matrix (n, n) of all entries, which add up where they share
    a place.
    """
    rows, columns = (
        np.concatenate([getattr(item, name) for item in entries]) for name in ("rows", "columns")
    )
    kept = np.flatnonzero((rows >= 0) & (columns >= 0) & (rows <= columns))
    places, target = np.unique(columns[kept].astype(np.int64) * n + rows[kept], return_inverse=True)
    # One product instead of sums of large matrices, each of which would be gone through anew.
    sums = ca.DM.triplet(
        target.tolist(), kept.tolist(), ca.DM.ones(len(kept)), len(places), len(rows)
    )
    sparsity = ca.Sparsity.triplet(n, n, (places % n).tolist(), (places // n).tolist())
    return ca.MX(
        sparsity, ca.densify(sums @ ca.vertcat(*(ca.densify(item.values) for item in entries)))
    )


# Rows and costs of a whole horizon with their derivatives, made of the functions of its steps.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Block:
    """Rows of one kind: functions of one node, what they are called with at all of them, and where
    their rows are.
    """

    functions: Derivatives
    Z: ca.MX
    """(n_z, n)"""
    S: ca.MX
    """(n_parameters, n)"""
    columns: np.ndarray
    """(n, n_z) see `VariableLayout.columns`"""
    numbers: np.ndarray
    """(n, m) raw rows of each node."""

    def mapped(self, function: ca.Function, *more: ca.MX) -> ca.MX:
        """Outputs (m, n) of a function at all nodes."""
        n = len(self.columns)
        return function.map(n)(
            self.Z,
            self.S,
            *[item if item.shape[1] == n else ca.repmat(item, 1, n) for item in more],
        )

    def hessian(self, sigma: ca.MX, lam: ca.MX) -> Entries:
        """Entries of the second derivative of ``sigma' costs + lam' rows``, as far as it has costs;
        lam (m, n).
        """
        values = self.mapped(
            self.functions.hessian, sigma[: self.functions.costs.numel_out(0)], lam
        )
        return _placed(values, self.functions.hessian_sparsity, self.columns, self.columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon:
    """Values and derivatives of all raw rows; see `uvms_ocp.ocp.transcription.layout`."""

    model: StageModel
    layout: layouts.RowLayout
    x: ca.MX
    """(n_x,)"""
    p: ca.MX
    """(n_p,)"""
    nodes: layouts.NodeVariables
    columns: np.ndarray
    """(N + 1, n_z) see `VariableLayout.columns`"""
    dynamics: Block
    """Motion over the steps: rows of which are the next state less what they give, then forces."""
    ends: Block
    """The first and the last state together, as one node."""
    blocks: tuple[Block, ...]
    """Terms."""

    @property
    def n_x(self) -> int:
        return int(self.x.numel())

    @property
    def n_levels(self) -> int:
        return len(self.layout.costs)

    @cached_property
    def rows(self) -> ca.MX:
        """All raw rows."""
        n = self.layout.n_state
        values = self.dynamics.mapped(self.dynamics.functions.value)
        parts = [
            ca.vec(ca.vertcat(self.nodes.following[:n, :] - values[:n, :], values[n:, :])),
            self.ends.mapped(self.ends.functions.value),
        ]
        if len(self.layout.equal_steps):
            h = self.nodes.steps[self.model.layout.h, :]
            parts.append((h[1:] - h[:-1]).T)
        if len(self.layout.total):
            parts.append(ca.sum2(self.nodes.steps[self.model.layout.h, :]))
        parts += [ca.vec(block.mapped(block.functions.value)) for block in self.blocks]
        return ca.vertcat(*parts, self.costs)

    @cached_property
    def costs(self) -> ca.MX:
        """(n_levels,)"""
        return sum(
            (ca.sum2(block.mapped(block.functions.costs)) for block in self.blocks),
            ca.MX.zeros(self.n_levels),
        )

    def _gradient(self, sigma: ca.MX) -> ca.MX:
        """Gradient (n_x,) of ``sigma' costs``."""
        total = ca.MX.zeros(self.n_x)
        for block in self.blocks:
            values = ca.vec(block.mapped(block.functions.gradient, sigma))
            entries = Entries(
                values=values,
                rows=block.columns.ravel(),
                columns=np.where(block.columns.ravel() >= 0, 0, -1),
            )
            total += ca.densify(assemble([entries], (self.n_x, 1)))
        return total

    @cached_property
    def _jacobian_entries(self) -> list[Entries]:
        """Nonzeros of the raw rows, apart from those of the cost rows."""
        entries = [self._linear_entries()]
        for block in (self.dynamics, self.ends, *self.blocks):
            sparsity = block.functions.jacobian_sparsity
            if sparsity.nnz():
                nonzeros = block.mapped(block.functions.jacobian)
                if block is self.dynamics:
                    sign = np.where(
                        np.array(sparsity.get_triplet()[0]) < self.layout.n_state, -1.0, 1.0
                    )
                    nonzeros *= ca.repmat(ca.DM(sign), 1, len(block.columns))
                entries.append(_placed(nonzeros, sparsity, block.numbers, block.columns))
        return entries

    def _linear_entries(self) -> Entries:
        """Ones and minus ones: the next state, equal steps, all steps."""
        n = self.layout.n_state
        layout = self.layout
        h = self.columns[:-1, self.model.layout.h]
        groups = [(layout.dynamics[:, :n].ravel(), self.columns[1:, :n].ravel(), 1.0)]
        if len(layout.equal_steps):
            groups += [(layout.equal_steps, h[1:], 1.0), (layout.equal_steps, h[:-1], -1.0)]
        if len(layout.total):
            groups.append((np.repeat(layout.total, len(h)), h, 1.0))
        rows, columns, _ = zip(*groups, strict=True)
        values = np.concatenate([np.full(len(numbers), value) for numbers, _, value in groups])
        return Entries(
            values=ca.MX(ca.DM(values)), rows=np.concatenate(rows), columns=np.concatenate(columns)
        )

    def _hessian(self, sigma: ca.MX, lam: ca.MX) -> list[Entries]:
        """Entries of the second derivative of ``sigma' costs + lam' raw``, which add up."""
        n = self.layout.n_state
        entries = []
        for block in (self.dynamics, self.ends, *self.blocks):
            if block.functions.hessian_sparsity.nnz():
                own = ca.reshape(lam[block.numbers.ravel().tolist()], *block.numbers.T.shape)
                entries.append(
                    block.hessian(
                        sigma,
                        ca.vertcat(-own[:n, :], own[n:, :]) if block is self.dynamics else own,
                    )
                )
        return entries

    def derivative_functions(self, index: int, raw_rows: np.ndarray) -> dict[str, ca.Function]:
        """Build the functions that IPOPT needs, of the cost of one level and of the rows numbered
        raw_rows (m,).
        """
        only = ca.DM(np.eye(self.n_levels)[index])
        values = [self.costs[index], self.rows[raw_rows.tolist()]]
        lam_f = ca.MX.sym("lam_f")
        lam_g = ca.MX.sym("lam_g", len(raw_rows))
        position = np.full(self.layout.n_rows, len(raw_rows))
        position[raw_rows] = np.arange(len(raw_rows))
        lam = ca.vertcat(lam_g, 0)[position.tolist()]
        sigma = lam[self.layout.costs.tolist()] + lam_f * only
        J = assemble(self._rows_of(raw_rows, position), (len(raw_rows), self.n_x))
        H = upper_triangle(self._hessian(sigma, lam), self.n_x)
        return nlp_functions(
            [self.x, self.p], values, [lam_f, lam_g], (self._gradient(ca.MX(only)), J, H)
        )

    def _rows_of(self, raw_rows: np.ndarray, position: np.ndarray) -> list[Entries]:
        """Entries of the chosen rows, renumbered; frozen costs add one dense row each."""
        chosen = [entries.selected(position, len(raw_rows)) for entries in self._jacobian_entries]
        for level, raw in enumerate(self.layout.costs):
            if position[raw] < len(raw_rows):
                one = ca.MX(ca.DM(np.eye(self.n_levels)[level]))
                row = np.full(self.n_x, position[raw])
                chosen.append(
                    Entries(values=self._gradient(one), rows=row, columns=np.arange(self.n_x))
                )
        return chosen


def horizon(
    variables: layouts.VariableLayout,
    parameters: layouts.ParameterLayout,
    layout: layouts.RowLayout,
    ends: layouts.BoundaryRows,
) -> Horizon:
    """Symbols of the variables and parameters of a problem, and its rows in them."""
    x = ca.MX.sym("x", variables.n_x)
    p = ca.MX.sym("p", parameters.n)
    nodes = variables.nodes(x, p[parameters.steps])
    n = layout.n_state
    columns = variables.all_columns
    every = ca.horzcat(nodes.steps, nodes.last)
    blocks = tuple(
        Block(
            functions=block.rows.functions,
            Z=every[:, int(block.nodes[0]) : int(block.nodes[-1]) + 1],
            S=ca.reshape(p[own], block.rows.n_parameters, len(block.nodes)),
            columns=columns[block.nodes],
            numbers=numbers,
        )
        for block, own, numbers in zip(
            parameters.blocks, parameters.terms, layout.terms, strict=True
        )
    )
    return Horizon(
        model=variables.model,
        layout=layout,
        x=x,
        p=p,
        nodes=nodes,
        columns=columns,
        dynamics=Block(
            functions=variables.model.dynamics,
            Z=nodes.steps,
            S=ca.reshape(p[parameters.water], 3, variables.N),
            columns=columns[:-1],
            numbers=layout.dynamics,
        ),
        ends=Block(
            functions=ends.functions,
            Z=ca.vertcat(nodes.steps[:n, 0], nodes.last[:n]),
            S=p[parameters.start],
            columns=np.concatenate([columns[0, :n], columns[-1, :n]])[None],
            numbers=layout.start[None],
        ),
        blocks=blocks,
    )


def _placed(
    nonzeros: ca.MX, sparsity: ca.Sparsity, numbers: np.ndarray, columns: np.ndarray
) -> Entries:
    """Nonzeros (nnz, n) of the same small matrix at n nodes, whose rows and columns are numbered
    (n, ...) in the whole.
    """
    rows, places = (np.array(i, dtype=int) for i in sparsity.get_triplet())
    return Entries(
        values=ca.vec(nonzeros), rows=numbers[:, rows].ravel(), columns=columns[:, places].ravel()
    )


# Multiple shooting on the manifold: an optimal control problem becomes a sparse lexicographic NLP.


class Transcription:
    """The NLP of a problem, kept for all problems of its shape; see
    `uvms_ocp.ocp.transcription.term_rows`.

    It keeps memory from call to call: whoever shares it between threads holds `turn` meanwhile, as
    planners do. Methods that take a problem raise `InvalidInput` for one of another shape; by
    default it is the one that was built in.
    """

    def __init__(
        self, problem: OcpProblem, *, plugin: str = "ipopt", like: Transcription | None = None
    ) -> None:
        """like: of another problem, whose dynamics serve here too where they are the same."""
        self.problem = problem
        self.plugin = plugin
        self.model: StageModel = StageModel(
            problem, like=None if like is None else like.model, compiled=plugin != STAGEWISE
        )
        self.blocks = term_rows.term_blocks(self.model)
        self.variables = layouts.VariableLayout(model=self.model)
        self._own_bounds = self.variables.bounds(problem)
        self.parameter_layout = layouts.parameter_layout(problem, self.blocks)
        self._ends = ends = layouts.boundary(self.model)
        if plugin == STAGEWISE and (ends.coupled or problem.limits_total):
            what = "a periodic motion ties its ends" if ends.coupled else "`longest` ties all steps"
            raise InvalidInput(f"{plugin} goes from step to step, {what}: use plugin='ipopt'")
        self.row_layout = layouts.row_layout(
            problem, self.blocks, ends, n_forces=self.model.n_forces
        )
        self._own = self._last = term_rows.fit_problem(self.model, self.blocks, problem)
        self.turn = RLock()
        """Lock of the thread that plans."""
        _ = self.model.inputs_function  # is compiled before any clock runs

    @property
    def n_x(self) -> int:
        """Number of variables."""
        return self.variables.n_x

    @cached_property
    def _horizon(self) -> Horizon:
        """Made where it is asked for: a solver that goes from step to step has functions of its
        own, and only a diagnosis asks for these, uncompiled as its clock runs.
        """
        return horizon(self.variables, self.parameter_layout, self.row_layout, self._ends)

    def _fitted(self, problem: OcpProblem | None) -> term_rows.ReusedProblem:
        """Every method of a plan asks for that of the same problem, and for that of the one that
        was built in.
        """
        if problem is None or problem is self.problem:
            return self._own
        if problem is not self._last.problem:
            self._last = term_rows.fit_problem(self.model, self.blocks, problem)
        return self._last

    def parameters(
        self,
        problem: OcpProblem | None = None,
        *,
        t0: float = 0.0,
        start: State | None = None,
        near: np.ndarray | None = None,
        tightened: Tightening = NO_TIGHTENING,
    ) -> np.ndarray:
        """Parameters (n_p,).

        t0 [s]: time of the first node, for goals that move. start: instead of the problem's, such
        as a measured one, which may be slightly outside the joint limits. near (n_nodes, n_q) [m,
        rad]: configurations of the nodes where terms that follow the guess are written, the start
        by default. tightened: what is asked of these nodes beyond the ranges.
        """
        return self.parameter_layout.values(
            self._fitted(problem), t0=t0, start=start, near=near, tightened=tightened
        )

    def bounds(
        self,
        problem: OcpProblem | None = None,
        tightened: Tightening = NO_TIGHTENING,
        around: tuple[np.ndarray, float] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_x,) of the variables: limits of the robot, durations; narrower where nodes are
        asked for more, or joints go no farther than so much [m, rad] from configurations around
        (N + 1, n_q) [m, rad].
        """
        lower, upper = self._given_bounds(problem, tightened)
        if around is None or not np.isfinite(around[1]):
            return lower, upper
        q, radius = around
        return self.variables.bounds_around(q, radius, lower, upper)

    def _given_bounds(
        self, problem: OcpProblem | None, tightened: Tightening
    ) -> tuple[np.ndarray, np.ndarray]:
        if tightened.limits:
            return self.variables.bounds(problem or self.problem, tightened)
        if problem is None or not problem.free_time:
            return self._own_bounds
        return self.variables.bounds(problem)

    def ranges(
        self, problem: OcpProblem | None = None, tightened: Tightening = NO_TIGHTENING
    ) -> RowRanges:
        """Return the target ranges of the rows; narrower where nodes are asked for more."""
        given = self._fitted(problem)
        if tightened.terms:
            return self._ranges(given, self._margins_of_rows(given, tightened))
        if given is self._own:
            return self._own_ranges
        return self._ranges(given)

    def _margins_of_rows(
        self, given: term_rows.ReusedProblem, tightened: Tightening
    ) -> list[layouts.BlockMargins]:
        """Return the margins of the rows of constraints that are their quantities."""
        result = []
        for i, (block, numbers) in enumerate(zip(self.blocks, given.numbers, strict=True)):
            column = 0
            for k, member in enumerate(block.rows.members):
                columns = column + np.arange(member.residual.n_rows)
                column += member.residual.n_rows
                more = tightened.terms.get(given.problem.terms[member.place])
                if more is None or member.level != term_rows.CONSTRAINT:
                    continue
                if member.term.rows_are_quantities:
                    unit = np.full(len(columns), numbers.roots[k])
                    result.append(
                        layouts.BlockMargins(
                            block=i, columns=columns, unit=unit, margins=more.at(block.nodes)
                        )
                    )
        return result

    @cached_property
    def _own_ranges(self) -> RowRanges:
        return self._ranges(self._own)

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Variables (n_x,) of a trajectory; times are taken as they are where durations are
        free.
        """
        return self.variables.pack(trajectory)

    def unpack(self, x: np.ndarray, problem: OcpProblem | None = None) -> Trajectory:
        """The trajectory of variables x (n_x,) [unit of x]."""
        return self.variables.unpack(x, problem or self.problem)

    @cached_property
    def _constraint_values(self) -> ca.Function:
        rows = self._horizon.rows[self.row_layout.constraints.tolist()]
        return ca.Function("constraints", [self._horizon.x, self._horizon.p], [rows])

    @cached_property
    def _rows_and_slopes(self) -> ca.Function:
        raw = np.arange(self.row_layout.n_rows - len(self.row_layout.costs))
        return self._horizon.derivative_functions(0, raw)["nlp_jac_g"]

    def rows_and_slopes(self, x: np.ndarray, p: np.ndarray) -> tuple[ca.DM, ca.DM]:
        """Values (m,) and Jacobian (m, n_x) of all raw rows but those of costs, which are the last,
        at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the parameter].
        """
        values, slopes = self._rows_and_slopes(x, p)
        return values, slopes

    def row_functions(self, raw_rows: np.ndarray) -> dict[str, ca.Function]:
        """``nlp_g``, ``nlp_jac_g`` and ``nlp_hess_l`` of the rows numbered raw_rows (m,), as IPOPT
        asks for them.
        """
        return self._horizon.derivative_functions(0, raw_rows)

    @cached_property
    def _costs(self) -> ca.Function:
        return ca.Function("costs", [self._horizon.x, self._horizon.p], [self._horizon.costs])

    def costs(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Cost (n_levels,) of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit
        of the parameter].
        """
        return np.array(self._costs(x, p)).ravel()

    def violations(
        self, x: np.ndarray, p: np.ndarray, problem: OcpProblem | None = None
    ) -> dict[str, float]:
        """Largest violation [unit of the row] of every group of constraints at x (n_x,) [unit of
        x].

        p (n_p,) [unit of the parameter]: see `parameters`.
        """
        g = np.array(self._constraint_values(x, p)).ravel()
        rows = self.row_layout.constraints
        ranges = self.ranges(problem)
        broken = interval_excess(g, ranges.lower, ranges.upper)
        worst: dict[str, float] = {}
        for row, value in zip(rows, broken.tolist(), strict=True):
            name = self.row_layout.names[row]
            worst[name] = max(worst.get(name, 0.0), value)
        return worst

    def obstruction(self, problem: OcpProblem) -> tuple[str, float] | None:
        """Constraint along the path that the start itself breaks, and by how much."""
        of_state = (self.blocks[0].rows.level == term_rows.CONSTRAINT) & self.blocks[
            0
        ].rows.state_only
        if not (problem.fixed_start and of_state.any()):
            return None
        # the steps of the first phase
        rows = self.blocks[0].rows
        numbers = self._fitted(problem).numbers[0]
        z, s = self._at_start(problem, numbers)
        broken = interval_excess(
            np.array(rows.value(z, s, problem.currents[0])).ravel(), numbers.lower, numbers.upper
        )
        # What is no number is nothing that another start would mend: solvers meet it, and their
        # verdict names it.
        broken[~of_state | np.isnan(broken)] = 0.0
        if not broken.any() or broken.max() < _ROUNDING:
            return None
        return rows.names[int(broken.argmax())], float(broken.max())

    def undefined(self, problem: OcpProblem) -> list[str]:
        """Terms whose rows, or their slopes, are no numbers at the start."""
        names: dict[str, None] = {}
        for block, numbers in zip(self.blocks, self._fitted(problem).numbers, strict=True):
            functions = block.rows.functions
            at = self._at_start(problem, numbers)
            slopes = np.array(functions.jacobian(*at)).ravel()
            wrong = set(np.flatnonzero(np.isnan(np.array(functions.value(*at)).ravel())).tolist())
            wrong |= set(
                np.array(functions.jacobian_sparsity.row(), dtype=int)[
                    ~np.isfinite(slopes)
                ].tolist()
            )
            names |= dict.fromkeys(block.rows.names[row] for row in sorted(wrong))
        return list(names)

    def _at_start(
        self, problem: OcpProblem, numbers: term_rows.TermNumbers
    ) -> tuple[np.ndarray, np.ndarray]:
        """Z (n_z,) of the start without inputs, and the parameters of terms with these numbers."""
        z = np.zeros(self.model.layout.n_z)
        z[self.model.layout.q] = problem.start.q
        z[self.model.layout.v] = problem.start.v
        here = term_rows.TermNodes(
            times=[0.0], active=[False], q=problem.start.q[None], tightened={}
        )
        return z, numbers.parameters(here, 1.0)

    @cached_property
    def program(self) -> LexicographicProgram:
        """The lexicographic program, with derivatives."""
        layout = self.row_layout
        x = self._horizon.x
        p = self._horizon.p
        numbered = np.concatenate([layout.constraints, *layout.held])
        ranges = self._own_ranges
        y = [
            self._horizon.rows[rows.tolist()] if len(rows) else ca.MX(0, 1)
            for rows in layout.levels
        ]
        return LexicographicProgram(
            ranges=ranges,
            nlps=tuple(
                self._level_nlp(i, numbered[: level.frozen.start])
                for i, level in enumerate(ranges.levels)
            ),
            values=ca.Function("values", [x, p], y),
        )

    def _ranges(
        self, given: term_rows.ReusedProblem, margins: Sequence[layouts.BlockMargins] = ()
    ) -> RowRanges:
        layout = self.row_layout
        lower, upper = layout.bounds(given.numbers, given.problem.longest, margins)
        ends = np.cumsum([len(layout.constraints), *(len(rows) for rows in layout.held)]).tolist()
        return RowRanges(
            levels=tuple(
                LevelRows(
                    name=level.name,
                    lower=lower[rows],
                    upper=upper[rows],
                    relax=level.relax,
                    frozen=slice(first, stop),
                )
                for level, rows, first, stop in zip(
                    given.problem.levels, layout.levels, ends[:-1], ends[1:], strict=True
                )
            ),
            lower=lower[layout.constraints],
            upper=upper[layout.constraints],
        )

    def _level_nlp(self, index: int, numbered: np.ndarray) -> LevelNlp:
        order = np.argsort(self.row_layout.stage[numbered], kind="stable")
        raw_rows = numbered[order]
        whole = self._horizon
        nlp = {
            "x": whole.x,
            "p": whole.p,
            "f": whole.costs[index],
            "g": whole.rows[raw_rows.tolist()],
        }
        return LevelNlp(nlp=nlp, rows=order, functions=whole.derivative_functions(index, raw_rows))

"""Multiple shooting on the manifold: an optimal control problem becomes a sparse lexicographic NLP.

Variables and rows are ordered step by step, as structure-exploiting solvers want them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from threading import RLock

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import interval_excess
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.horizon import Horizon, horizon
from uvms_ocp.ocp.transcription.layout import BlockMargins, boundary, row_layout
from uvms_ocp.ocp.transcription.parameters import parameter_layout
from uvms_ocp.ocp.transcription.problem_reuse import ReusedProblem, fit_problem
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermNodes, TermNumbers, term_blocks
from uvms_ocp.ocp.transcription.variables import VariableLayout
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import STAGEWISE
from uvms_ocp.solvers.nlp.program import LevelNlp, LevelRows, LexicographicProgram, RowRanges

_ROUNDING = 1e-9  # violation of a constraint at the start that is none


class Transcription:
    """The NLP of a problem, kept for all problems of its shape; see
    `uvms_ocp.ocp.transcription.problem_reuse`.

    It keeps memory from call to call: whoever shares it between threads holds `turn` meanwhile, as
    planners do. Methods that take a problem raise `InvalidInput` for one of another shape; by
    default it is the one that was built in.
    """

    def __init__(
        self, problem: OcpProblem, *, plugin: str = "ipopt", like: Transcription | None = None
    ) -> None:
        """Build the NLP of a problem for a solver of NLPs.

        like: of another problem, whose dynamics serve this one too where they are the same.
        """
        self.problem = problem
        self.plugin = plugin
        self.model: StageModel = StageModel(
            problem, like=None if like is None else like.model, compiled=plugin != STAGEWISE
        )
        self.blocks = term_blocks(self.model)
        self.variables = VariableLayout(model=self.model)
        self._built_bounds = self.variables.bounds(problem)
        self.parameter_layout = parameter_layout(problem, self.blocks)
        self._boundary = boundary(self.model)
        if plugin == STAGEWISE:
            self._refuse_coupled_stages()
        self.row_layout = row_layout(
            problem, self.blocks, self._boundary, n_forces=self.model.n_forces
        )
        self._built = fit_problem(self.model, self.blocks, problem)
        """Numbers of the problem that was built in."""
        self._last = self._built
        """Numbers of the problem that was asked for last."""
        self.turn = RLock()
        """Lock of the thread that plans."""
        _ = self.model.inputs_function  # is compiled before any clock runs

    def _refuse_coupled_stages(self) -> None:
        """Raise `InvalidInput` for what ties stages that are no neighbours."""
        if self._boundary.coupled:
            coupling = "a periodic motion ties its ends"
        elif self.problem.limits_total:
            coupling = "`longest` ties all steps"
        else:
            return
        raise InvalidInput(f"{self.plugin} goes from step to step, {coupling}: use plugin='ipopt'")

    @property
    def n_x(self) -> int:
        """Number of variables."""
        return self.variables.n_x

    @cached_property
    def _horizon(self) -> Horizon:
        """Rows of the whole horizon, made where they are asked for: a solver that goes from step to
        step has functions of its own, and only a diagnosis asks for these, uncompiled as its clock
        runs.
        """
        return horizon(self.variables, self.parameter_layout, self.row_layout, self._boundary)

    def _fitted(self, problem: OcpProblem | None) -> ReusedProblem:
        """Return the numbers of a problem.

        Every method of a plan asks for those of the same problem, and for those of the one that was
        built in.
        """
        if problem is None or problem is self.problem:
            return self._built
        if problem is not self._last.problem:
            self._last = fit_problem(self.model, self.blocks, problem)
        return self._last

    def parameters(
        self,
        problem: OcpProblem | None = None,
        *,
        t0: float = 0.0,
        start: State | None = None,
        written_at: np.ndarray | None = None,
        tightened: Tightening = NO_TIGHTENING,
    ) -> np.ndarray:
        """Return parameters (n_p,).

        t0 [s]: time of the first node, for goals that move. start: instead of the problem's, such
        as a measured one, which may be slightly outside the joint limits. written_at (n_nodes, n_q)
        [m, rad]: configurations of the nodes at which terms that follow the guess are written, the
        start by default. tightened: what is asked of these nodes beyond the ranges.
        """
        return self.parameter_layout.values(
            self._fitted(problem), t0=t0, start=start, written_at=written_at, tightened=tightened
        )

    def bounds(
        self,
        problem: OcpProblem | None = None,
        tightened: Tightening = NO_TIGHTENING,
        around: tuple[np.ndarray, float] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds (n_x,) of the variables: limits of the robot, durations; narrower where
        nodes are asked for more, or joints go no farther than a radius [m, rad] from configurations
        (N + 1, n_q) [m, rad], which are `around`.
        """
        lower, upper = self._bounds_of_nodes(problem, tightened)
        if around is None:
            return lower, upper
        q, radius = around
        if not np.isfinite(radius):
            return lower, upper
        return self.variables.bounds_around(q, radius, lower, upper)

    def _bounds_of_nodes(
        self, problem: OcpProblem | None, tightened: Tightening
    ) -> tuple[np.ndarray, np.ndarray]:
        if tightened.limits:
            return self.variables.bounds(problem or self.problem, tightened)
        if problem is None or not problem.free_time:
            return self._built_bounds
        return self.variables.bounds(problem)

    def ranges(
        self, problem: OcpProblem | None = None, tightened: Tightening = NO_TIGHTENING
    ) -> RowRanges:
        """Return the target ranges of the rows; narrower where nodes are asked for more."""
        reused = self._fitted(problem)
        if tightened.terms:
            return self._ranges(reused, self._margins_of_rows(reused, tightened))
        if reused is self._built:
            return self._built_ranges
        return self._ranges(reused)

    @cached_property
    def _built_ranges(self) -> RowRanges:
        """Target ranges of the problem that was built in."""
        return self._ranges(self._built)

    def _ranges(self, reused: ReusedProblem, margins: Sequence[BlockMargins] = ()) -> RowRanges:
        layout = self.row_layout
        lower, upper = layout.bounds(reused.numbers, reused.problem.longest, margins)
        levels = []
        first = len(layout.constraints)  # after them come the rows that freeze level after level
        for level, rows, held in zip(
            reused.problem.levels, layout.levels, layout.held, strict=True
        ):
            stop = first + len(held)
            level_rows = LevelRows(
                name=level.name,
                lower=lower[rows],
                upper=upper[rows],
                relax=level.relax,
                frozen=slice(first, stop),
            )
            levels.append(level_rows)
            first = stop
        return RowRanges(
            levels=tuple(levels),
            lower=lower[layout.constraints],
            upper=upper[layout.constraints],
        )

    def _margins_of_rows(self, reused: ReusedProblem, tightened: Tightening) -> list[BlockMargins]:
        """Return the margins of the rows of constraints that are their quantities."""
        result = []
        for i, (block, numbers) in enumerate(zip(self.blocks, reused.numbers, strict=True)):
            first = 0
            for k, member in enumerate(block.rows.members):
                columns = first + np.arange(member.residual.n_rows)
                first += member.residual.n_rows
                term = reused.problem.terms[member.place]
                margins = tightened.terms.get(term)
                if margins is None or member.level != CONSTRAINT:
                    continue
                if not member.term.rows_are_quantities:
                    continue
                block_margins = BlockMargins(
                    block=i,
                    columns=columns,
                    unit=np.full(len(columns), numbers.roots[k]),
                    margins=margins.at(block.nodes),
                )
                result.append(block_margins)
        return result

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Return the variables (n_x,) of a trajectory; times are taken as they are where durations
        are free.
        """
        return self.variables.pack(trajectory)

    def unpack(self, x: np.ndarray, problem: OcpProblem | None = None) -> Trajectory:
        """Return the trajectory of variables x (n_x,) [unit of x]."""
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
        """Return values (m,) and Jacobian (m, n_x) of all raw rows but those of costs, which are
        the last, at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the parameter].
        """
        values, slopes = self._rows_and_slopes(x, p)
        return values, slopes

    def row_functions(self, raw_rows: np.ndarray) -> dict[str, ca.Function]:
        """Return ``nlp_g``, ``nlp_jac_g`` and ``nlp_hess_l`` of the rows numbered raw_rows (m,), as
        IPOPT asks for them.
        """
        return self._horizon.derivative_functions(0, raw_rows)

    @cached_property
    def _costs(self) -> ca.Function:
        return ca.Function("costs", [self._horizon.x, self._horizon.p], [self._horizon.costs])

    def costs(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the cost (n_levels,) of every level at x (n_x,) [unit of x], with parameters p
        (n_p,) [unit of the parameter].
        """
        return np.array(self._costs(x, p)).ravel()

    def violations(
        self, x: np.ndarray, p: np.ndarray, problem: OcpProblem | None = None
    ) -> dict[str, float]:
        """Return the largest violation [unit of the row] of every group of constraints at x (n_x,)
        [unit of x].

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
        """Return the constraint along the path that the start itself breaks, and by how much."""
        rows = self.blocks[0].rows  # of the steps of the first phase
        is_of_state = (rows.level == CONSTRAINT) & rows.state_only
        if not (problem.fixed_start and is_of_state.any()):
            return None
        numbers = self._fitted(problem).numbers[0]
        z, parameters = self._at_start(problem, numbers)
        values = np.array(rows.value(z, parameters, problem.currents[0])).ravel()
        excess = interval_excess(values, numbers.lower, numbers.upper)
        # What is no number is nothing that another start would mend: solvers meet it, and their
        # verdict names it.
        excess[~is_of_state | np.isnan(excess)] = 0.0
        if not excess.any() or excess.max() < _ROUNDING:
            return None
        return rows.names[int(excess.argmax())], float(excess.max())

    def undefined(self, problem: OcpProblem) -> list[str]:
        """Return the terms whose rows, or their slopes, are no numbers at the start."""
        names: dict[str, None] = {}
        for block, numbers in zip(self.blocks, self._fitted(problem).numbers, strict=True):
            functions = block.rows.functions
            z, parameters = self._at_start(problem, numbers)
            slopes = np.array(functions.jacobian(z, parameters)).ravel()
            values = np.array(functions.value(z, parameters)).ravel()
            row_of_slope = np.array(functions.jacobian_sparsity.row(), dtype=int)
            rows = set(np.flatnonzero(np.isnan(values)).tolist())
            rows |= set(row_of_slope[~np.isfinite(slopes)].tolist())
            names |= dict.fromkeys(block.rows.names[row] for row in sorted(rows))
        return list(names)

    def _at_start(self, problem: OcpProblem, numbers: TermNumbers) -> tuple[np.ndarray, np.ndarray]:
        """Return z (n_z,) of the start without inputs, and the parameters of terms with these
        numbers.
        """
        z = np.zeros(self.model.layout.n_z)
        z[self.model.layout.q] = problem.start.q
        z[self.model.layout.v] = problem.start.v
        start = TermNodes(times=[0.0], active=[False], q=problem.start.q[None], tightened={})
        return z, numbers.parameters(start, 1.0)

    @cached_property
    def program(self) -> LexicographicProgram:
        """The lexicographic program, with derivatives."""
        layout = self.row_layout
        rows = self._horizon.rows
        numbered = np.concatenate([layout.constraints, *layout.held])
        ranges = self._built_ranges
        level_values = []
        for level_rows in layout.levels:
            if len(level_rows):
                level_values.append(rows[level_rows.tolist()])
            else:
                level_values.append(ca.MX(0, 1))
        nlps = []
        for i, level in enumerate(ranges.levels):
            rows_above = numbered[: level.frozen.start]
            nlps.append(self._level_nlp(i, rows_above))
        values = ca.Function("values", [self._horizon.x, self._horizon.p], level_values)
        return LexicographicProgram(ranges=ranges, nlps=tuple(nlps), values=values)

    def _level_nlp(self, index: int, numbered: np.ndarray) -> LevelNlp:
        """Build the NLP of a level; numbered (m,): raw rows of constraints and of levels above."""
        order = np.argsort(self.row_layout.stage[numbered], kind="stable")
        raw_rows = numbered[order]
        nlp = {
            "x": self._horizon.x,
            "p": self._horizon.p,
            "f": self._horizon.costs[index],
            "g": self._horizon.rows[raw_rows.tolist()],
        }
        functions = self._horizon.derivative_functions(index, raw_rows)
        return LevelNlp(nlp=nlp, rows=order, functions=functions)

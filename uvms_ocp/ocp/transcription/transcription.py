"""Multiple shooting on the manifold: an optimal control problem becomes a sparse lexicographic NLP.

Step functions are mapped over the horizon and their nonzeros are placed into the large matrices, so that the
derivatives of a horizon cost as much as those of its steps, and nothing is differentiated twice. Variables and rows are
ordered step by step, as structure-exploiting solvers want them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from threading import RLock

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import interval_excess
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.horizon import horizon
from uvms_ocp.ocp.transcription.layout import VariableLayout, boundary, parameter_layout, row_layout
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import (
    CONSTRAINT,
    ReusedProblem,
    TermNodes,
    TermNumbers,
    fit_problem,
    term_blocks,
)
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.program import LevelNlp, LevelRows, LexicographicProgram, RowRanges

_ROUNDING = 1e-9  # violation of a constraint at the start that is none


class Transcription:
    """The NLP of a problem, kept for all problems of its shape; see `uvms_ocp.ocp.transcription.term_rows`.

    It keeps memory from call to call: whoever shares it between threads holds `turn` meanwhile, as planners do.
    Methods that take a problem raise `InvalidInput` for one of another shape; by default it is the one that was built in.
    """

    def __init__(self, problem: OcpProblem, *, plugin: str = "ipopt", like: Transcription | None = None) -> None:
        """like: of another problem, whose dynamics serve here too where they are the same."""
        self.problem, self._plugin = problem, plugin
        self.model: StageModel = StageModel(problem, like=None if like is None else like.model)
        self.blocks = term_blocks(self.model)
        self.variables = VariableLayout(model=self.model)
        self.parameter_layout = parameter_layout(problem, self.blocks)
        ends = boundary(self.model)
        if plugin != "ipopt" and (ends.coupled or problem.limits_total):
            what = "a periodic motion ties its ends" if ends.coupled else "`longest` ties all steps"
            raise InvalidInput(f"{plugin} goes from step to step, {what}: use plugin='ipopt'")
        self.row_layout = row_layout(problem, self.blocks, ends, n_forces=self.model.n_forces)
        self._horizon = horizon(self.variables, self.parameter_layout, self.row_layout, ends)
        self._own = self._last = fit_problem(self.model, self.blocks, problem)
        self.turn = RLock()
        """Lock of the thread that plans."""
        _ = self.model.inputs_function  # is compiled before any clock runs

    @property
    def n_x(self) -> int:
        """Number of variables."""
        return self.variables.n_x

    def _fitted(self, problem: OcpProblem | None) -> ReusedProblem:
        """Every method of a plan asks for that of the same problem, and for that of the one that was built in."""
        if problem is None or problem is self.problem:
            return self._own
        if problem is not self._last.problem:
            self._last = fit_problem(self.model, self.blocks, problem)
        return self._last

    def parameters(
        self,
        problem: OcpProblem | None = None,
        *,
        t0: float = 0.0,
        start: State | None = None,
        near: np.ndarray | None = None,
        tightened: Mapping[Term, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Parameters (n_p,).

        t0 [s]: time of the first node, for goals that move. start: instead of the problem's, such as a measured one,
        which may be slightly outside the joint limits. near (n_nodes, n_q) [m, rad]: configurations of the nodes where
        terms that follow the guess are written, the start by default, and tightened (n_nodes, ...) [unit of the row] by
        how much more each of these keeps.
        """
        return self.parameter_layout.values(self._fitted(problem), t0=t0, start=start, near=near, tightened=tightened)

    def bounds(self, problem: OcpProblem | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_x,) of the variables: limits of the robot, durations."""
        if problem is None or not problem.free_time:
            return self._own_bounds
        return self.variables.bounds(problem)

    @cached_property
    def _own_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.variables.bounds(self.problem)

    def ranges(self, problem: OcpProblem | None = None) -> RowRanges:
        """Return the target ranges of the rows."""
        given = self._fitted(problem)
        return self._own_ranges if given is self._own else self._ranges(given)

    @cached_property
    def _own_ranges(self) -> RowRanges:
        return self._ranges(self._own)

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Variables (n_x,) of a trajectory; times are taken as they are where durations are free."""
        return self.variables.pack(trajectory)

    def unpack(self, x: np.ndarray, problem: OcpProblem | None = None) -> Trajectory:
        """The trajectory of variables x (n_x,) [unit of x]."""
        return self.variables.unpack(x, problem or self.problem)

    @cached_property
    def _constraint_values(self) -> ca.Function:
        rows = self._horizon.rows[self.row_layout.constraints.tolist()]
        return ca.Function("constraints", [self._horizon.x, self._horizon.p], [rows])

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """(n_constraints,) of what each constraint of the program stands for."""
        return tuple(self.row_layout.names[row] for row in self.row_layout.constraints.tolist())

    def constraint_functions(self) -> dict[str, ca.Function]:
        """``nlp_g``, ``nlp_jac_g`` and ``nlp_hess_l`` of the constraints alone, as IPOPT asks for them."""
        return self._horizon.derivative_functions(0, self.row_layout.constraints, plugin="ipopt")

    @cached_property
    def _costs(self) -> ca.Function:
        return ca.Function("costs", [self._horizon.x, self._horizon.p], [self._horizon.costs])

    def costs(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Cost (n_levels,) of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the parameter]."""
        return np.array(self._costs(x, p)).ravel()

    def violations(self, x: np.ndarray, p: np.ndarray, problem: OcpProblem | None = None) -> dict[str, float]:
        """Largest violation [unit of the row] of every group of constraints at x (n_x,) [unit of x].

        p (n_p,) [unit of the parameter]: see `parameters`.
        """
        g, rows = np.array(self._constraint_values(x, p)).ravel(), self.row_layout.constraints
        ranges = self.ranges(problem)
        broken = interval_excess(g, ranges.lower, ranges.upper)
        worst: dict[str, float] = {}
        for row, value in zip(rows, broken.tolist(), strict=True):
            name = self.row_layout.names[row]
            worst[name] = max(worst.get(name, 0.0), value)
        return worst

    def obstruction(self, problem: OcpProblem) -> tuple[str, float] | None:
        """Constraint along the path that the start itself breaks, and by how much."""
        of_state = (self.blocks[0].rows.level == CONSTRAINT) & self.blocks[0].rows.state_only
        if not (problem.fixed_start and of_state.any()):
            return None
        rows, numbers = self.blocks[0].rows, self._fitted(problem).numbers[0]  # the steps of the first phase
        z, s = self._at_start(problem, numbers)
        broken = interval_excess(np.array(rows.value(z, s, problem.currents[0])).ravel(), numbers.lower, numbers.upper)
        # What is no number is nothing that another start would mend: solvers meet it, and their verdict names it.
        broken[~of_state | np.isnan(broken)] = 0.0
        if not broken.any() or broken.max() < _ROUNDING:
            return None
        return rows.names[int(broken.argmax())], float(broken.max())

    def undefined(self, problem: OcpProblem) -> list[str]:
        """Terms whose rows, or their slopes, are no numbers at the start."""
        names: dict[str, None] = {}
        for block, numbers in zip(self.blocks, self._fitted(problem).numbers, strict=True):
            functions, at = block.rows.functions, self._at_start(problem, numbers)
            slopes = np.array(functions.jacobian(*at)).ravel()
            wrong = set(np.flatnonzero(np.isnan(np.array(functions.value(*at)).ravel())).tolist())
            wrong |= set(np.array(functions.jacobian_sparsity.row(), dtype=int)[~np.isfinite(slopes)].tolist())
            names |= dict.fromkeys(block.rows.names[row] for row in sorted(wrong))
        return list(names)

    def _at_start(self, problem: OcpProblem, numbers: TermNumbers) -> tuple[np.ndarray, np.ndarray]:
        """Z (n_z,) of the start without inputs, and the parameters of terms with these numbers."""
        z = np.zeros(self.model.layout.n_z)
        z[self.model.layout.q], z[self.model.layout.v] = problem.start.q, problem.start.v
        here = TermNodes(times=[0.0], active=[False], q=problem.start.q[None], tightened={})
        return z, numbers.parameters(here, 1.0)

    @cached_property
    def program(self) -> LexicographicProgram:
        """The lexicographic program, with derivatives."""
        layout, x, p = self.row_layout, self._horizon.x, self._horizon.p
        numbered, ranges = np.concatenate([layout.constraints, *layout.held]), self._own_ranges
        y = [self._horizon.rows[rows.tolist()] if len(rows) else ca.MX(0, 1) for rows in layout.levels]
        return LexicographicProgram(
            ranges=ranges,
            nlps=tuple(self._level_nlp(i, numbered[: level.frozen.start]) for i, level in enumerate(ranges.levels)),
            values=ca.Function("values", [x, p], y),
        )

    def _ranges(self, given: ReusedProblem) -> RowRanges:
        layout = self.row_layout
        lower, upper = layout.bounds(given.numbers, given.problem.longest)
        ends = np.cumsum([len(layout.constraints), *(len(rows) for rows in layout.held)]).tolist()
        places = zip(given.problem.levels, layout.levels, ends[:-1], ends[1:], strict=True)
        return RowRanges(
            levels=tuple(
                LevelRows(
                    name=level.name, lower=lower[rows], upper=upper[rows], relax=level.relax, frozen=slice(first, stop)
                )
                for level, rows, first, stop in places
            ),
            lower=lower[layout.constraints],
            upper=upper[layout.constraints],
        )

    def _level_nlp(self, index: int, numbered: np.ndarray) -> LevelNlp:
        order = np.argsort(self.row_layout.stage[numbered], kind="stable")
        raw_rows, whole = numbered[order], self._horizon
        nlp = {"x": whole.x, "p": whole.p, "f": whole.costs[index], "g": whole.rows[raw_rows.tolist()]}
        functions = whole.derivative_functions(index, raw_rows, plugin=self._plugin)
        return LevelNlp(nlp=nlp, rows=order, functions=functions)

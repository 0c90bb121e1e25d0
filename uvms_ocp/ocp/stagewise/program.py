"""The program of a transcription, solved stage by stage: to convergence, or by lexicographic SQP in
real time.
"""

from __future__ import annotations

from collections.abc import Sequence

from uvms_ocp.codegen.background import start_beside
from uvms_ocp.codegen.bound_calls import calls_library
from uvms_ocp.codegen.c_compiler import has_compiler
from uvms_ocp.codegen.compile import finish_compiling, waits_for_compiler
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.ocp.stagewise.levels import StageLevelSolver, StagewiseLevels
from uvms_ocp.ocp.stagewise.memory import StageMemory
from uvms_ocp.ocp.stagewise.real_time_model import StagewiseLevelModel
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.level_solver import Deadline
from uvms_ocp.solvers.nlp.options import STAGEWISE, NlpOptions
from uvms_ocp.solvers.nlp.program import LexicographicProgram, RowBounds, RowRanges
from uvms_ocp.solvers.nlp.solve_monitor import SolveMonitor
from uvms_ocp.solvers.stage_qp.compiled import qp_library
from uvms_ocp.types import Array


class StagewiseProgram:
    """Program that `LexicographicNlp` solves stage by stage; its variables, parameters and rows are
    numbered as in the sparse program.

    Compiled where there is a compiler. Not for use from two threads at once.
    """

    def __init__(self, transcription: Transcription) -> None:
        """Raises `InvalidInput` for a level above others with `relax`, which couples all stages, and
        for a free start.
        """
        relaxed_levels = _relaxed_levels(transcription.problem)
        if relaxed_levels:
            raise InvalidInput(
                f"level {relaxed_levels[0]!r} has relax; plugin 'stagewise' takes none: leave it out, or"
                " use 'ipopt'"
            )
        if not transcription.problem.fixed_start:
            raise InvalidInput(
                "start_freedom is given; plugin 'stagewise' starts at the start: leave it out, or"
                " use 'ipopt'"
            )
        if has_compiler():
            # Begin with the library of all programs, before functions of this one take all processors.
            start_beside(qp_library)
        self._whole = transcription
        self.levels = StagewiseLevels(StageMemory(transcription))
        if transcription.problem.hessian is HessianKind.EXACT:
            self.levels.memory.compile_curvature()
        if has_compiler():
            # Wait for libraries here, not within the time limit of a solve.
            qp_library()
            calls_library()
        if waits_for_compiler():
            finish_compiling()

    @property
    def ranges(self) -> RowRanges:
        """Default ranges of the rows."""
        return self._whole.ranges()

    @property
    def n_x(self) -> int:
        """Number of variables."""
        return self._whole.n_x

    @property
    def n_p(self) -> int:
        """Number of parameters."""
        return self._whole.parameter_layout.n

    def solvers(
        self, options: NlpOptions, deadline: Deadline, watch: SolveMonitor
    ) -> Sequence[StageLevelSolver]:
        """Return a solver for each level."""
        return [
            StageLevelSolver(self.levels, i, options, deadline, watch)
            for i in range(self.levels.memory.n_levels)
        ]

    def level_model(self, tolerance: float) -> StagewiseLevelModel:
        """Return the levels for steps in real time. tolerance [unit of the row]: largest rise of the
        norm of frozen rows.
        """
        return StagewiseLevelModel(self.levels.memory, tolerance)

    def rows_at(self, x: Array, p: Array) -> tuple[Array, ...]:
        """Return the rows of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of
        the parameter].
        """
        return self.levels.rows_at(x, p)

    def violation(self, x: Array, p: Array, bounds: RowBounds) -> float:
        """Return by how much x (n_x,) [unit of x] breaks bounds and constraints; p (n_p,) [unit of
        the parameter].
        """
        self.levels.rows_at(x, p)
        return float(self.levels.ranges(bounds, 0).excess().max(initial=0.0))


def program_for(
    plugin: str, transcription: Transcription
) -> LexicographicProgram | StagewiseProgram:
    """Return the program of a transcription for a solver by its name. Raises `InvalidInput` as
    `StagewiseProgram` does.
    """
    if plugin == STAGEWISE:
        return StagewiseProgram(transcription)
    return transcription.program


def stagewise_or(other_solver: str, problem: OcpProblem) -> str:
    """Return the name of the stagewise solver if it takes a problem and there is a compiler, else
    the other.
    """
    couples_stages = (
        bool(_relaxed_levels(problem))
        or problem.periodic
        or problem.limits_total
        or not problem.fixed_start
    )
    if has_compiler() and not couples_stages:
        return STAGEWISE
    return other_solver


def _relaxed_levels(problem: OcpProblem) -> list[str]:
    """Return the names of levels above others that may be relaxed."""
    return [level.name for level in problem.levels[:-1] if level.relax is not None]

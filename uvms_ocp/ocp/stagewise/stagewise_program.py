"""The program of a transcription, solved stage by stage."""

from __future__ import annotations

from collections.abc import Sequence

from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions import has_compiler
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.ocp.stagewise.stage_levels import StageLevel, StageLevels
from uvms_ocp.ocp.stagewise.stage_memory import StageMemory
from uvms_ocp.ocp.stagewise.turning_stages import TurningStages
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.level_solver import Deadline
from uvms_ocp.solvers.nlp.nlp_options import STAGEWISE, NlpOptions
from uvms_ocp.solvers.nlp.program import LexicographicProgram, RowRanges
from uvms_ocp.solvers.nlp.sqp_options import OF_MATRICES


class StagewiseProgram:
    """What `LexicographicNlp` solves; its variables, parameters and rows are numbered as in the sparse program.

    Compiled where there is a compiler. Not for use from two threads at once.
    """

    def __init__(self, whole: Transcription) -> None:
        """Raises `InvalidInput` for what couples all stages: a level above others with `relax`; and for a start that is free."""
        _check(whole.problem)
        self._whole, self.levels = whole, StageLevels(StageMemory(whole))
        if whole.problem.hessian is HessianKind.EXACT:
            self.levels.memory.compile_curvature()

    @property
    def ranges(self) -> RowRanges:
        """With which it is solved unless others are given."""
        return self._whole.ranges()

    @property
    def n_x(self) -> int:
        """Variables."""
        return self._whole.n_x

    @property
    def n_p(self) -> int:
        """Parameters."""
        return self._whole.parameter_layout.n

    def solvers(self, options: NlpOptions, deadline: Deadline) -> Sequence[StageLevel]:
        """One for each level."""
        return self.levels.made(options, deadline)

    def turning(self, slack: float) -> TurningStages:
        """Its levels for steps in real time; slack [-] as `LevelModel` has it."""
        return TurningStages(self.levels.memory, slack)

    def rows_at(self, x: Array, p: Array) -> tuple[Array, ...]:
        """Rows of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the parameter]."""
        return self.levels.rows_at(x, p)


def program_for(plugin: str, whole: Transcription) -> LexicographicProgram | StagewiseProgram:
    """The program of a transcription as a solver of that name takes it. Raises `InvalidInput` as `StagewiseProgram` does."""
    return StagewiseProgram(whole) if plugin == STAGEWISE else whole.program


def quickest(problem: OcpProblem) -> str:
    """Name of the solver of steps in real time that takes least for a problem."""
    coupled = bool(_relaxed(problem)) or not problem.fixed_start
    return STAGEWISE if has_compiler() and not coupled else OF_MATRICES


def _relaxed(problem: OcpProblem) -> list[str]:
    return [level.name for level in problem.levels[:-1] if level.relax is not None]


def _check(problem: OcpProblem) -> None:
    relaxed = _relaxed(problem)
    if relaxed:
        raise InvalidInput(
            f"level {relaxed[0]!r} has relax; plugin 'stagewise' takes none: leave it out, or use 'ipopt'"
        )
    if not problem.fixed_start:
        raise InvalidInput(
            "start_freedom is given; plugin 'stagewise' starts at the start: leave it out, or use 'ipopt'"
        )

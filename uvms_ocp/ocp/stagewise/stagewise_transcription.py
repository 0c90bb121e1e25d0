"""A problem stage by stage, behind the methods of `uvms_ocp.ocp.transcription.transcription.Transcription`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.stagewise.stage_levels import StageLevel, StageLevels
from uvms_ocp.ocp.stagewise.stage_memory import StageMemory
from uvms_ocp.ocp.stagewise.stage_ranges import StageRanges
from uvms_ocp.ocp.trajectory import Trajectory, has_thrusters
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.intervals import excess
from uvms_ocp.solvers.nlp.level_solver import Deadline
from uvms_ocp.solvers.nlp.nlp_options import NlpOptions
from uvms_ocp.solvers.nlp.program import RowRanges
from uvms_ocp.solvers.nlp.row_bounds import row_bounds


class StagewiseProgram:
    """What `LexicographicNlp` solves; its variables, parameters and rows are numbered as in the sparse program."""

    def __init__(self, whole: Transcription) -> None:
        self._whole, self.levels = whole, StageLevels(StageMemory(whole))

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

    def rows_at(self, x: Array, p: Array) -> tuple[Array, ...]:
        """Rows of every level at x (n_x,) [unit of x], with parameters p (n_p,) [unit of the parameter]."""
        return self.levels.rows_at(x, p)


class StagewiseTranscription:
    """Of one problem, kept for all of its shape. Not for use from two threads at once."""

    def __init__(self, problem: OcpProblem) -> None:
        """Raises `InvalidInput` for a level above others with `relax`, whose cost would couple all stages."""
        relaxed = [level.name for level in problem.levels[:-1] if level.relax is not None]
        if relaxed:
            raise InvalidInput(
                f"level {relaxed[0]!r} has relax; plugin 'stagewise' takes none: leave it out, or use 'ipopt'"
            )
        self.problem, self._whole = problem, Transcription(problem)

    @cached_property
    def program(self) -> StagewiseProgram:
        """Compiled where there is a compiler."""
        return StagewiseProgram(self._whole)

    @property
    def n_x(self) -> int:
        """Number of variables."""
        return self._whole.n_x

    def parameters(self, problem: OcpProblem | None = None, *, t0: float = 0.0, start: State | None = None) -> Array:
        """As `Transcription.parameters`; t0 [s]."""
        return self._whole.parameters(problem, t0=t0, start=start)

    def bounds(self, problem: OcpProblem | None = None) -> tuple[Array, Array]:
        """As `Transcription.bounds`."""
        return self._whole.bounds(problem)

    def ranges(self, problem: OcpProblem | None = None) -> RowRanges:
        """As `Transcription.ranges`."""
        return self._whole.ranges(problem)

    def pack(self, trajectory: Trajectory) -> Array:
        """As `Transcription.pack`."""
        return self._whole.pack(trajectory)

    def obstruction(self, problem: OcpProblem) -> tuple[str, float] | None:
        """As `Transcription.obstruction`."""
        return self._whole.obstruction(problem)

    def violations(self, x: Array, p: Array, problem: OcpProblem | None = None) -> dict[str, float]:
        """As `Transcription.violations` at x (n_x,) [unit of x] with p (n_p,) [unit of the parameter].

        Forces beyond limits are named `thrust` and `torque`.
        """
        levels, memory = self.program.levels, self.program.levels.memory
        levels.point.set_parameters(p)
        levels.point.read(x, p)
        memory.evaluate()
        bounds = row_bounds(self.ranges(problem), *self.bounds(problem), self.n_x)
        ranges = StageRanges(memory, bounds, 0)
        broken = excess(memory.held, ranges.lower, ranges.upper)
        worst = {"motion": float(np.abs(memory.gaps).max(initial=0.0))}
        for name, value in zip(ranges.names, broken.tolist(), strict=True):
            worst[name] = max(worst.get(name, 0.0), value)
        return worst

    def unpack(self, x: Array, problem: OcpProblem | None = None) -> Trajectory:
        """The trajectory of variables x (n_x,) [unit of x], with the forces that it takes."""
        given = problem or self.problem
        memory, layout = self.program.levels.memory, self.program.levels.memory.tangent.model.layout
        p, actuators = self._whole.parameter_layout, memory.tangent.model.actuators
        numbers = np.zeros(p.n)
        numbers[p.start], numbers[p.water] = np.concatenate([given.start.q, given.start.v]), given.current
        numbers[p.steps] = np.diff(given.nominal_times())
        memory.water[:] = given.current
        self.program.levels.point.read(x, numbers)
        memory.find_inputs()
        z, ends = memory.z[memory.steps], memory.z[[*memory.steps, -1]]
        return Trajectory(
            t=np.concatenate([[0.0], np.cumsum(z[:, layout.h])]),
            q=ends[:, layout.q],
            v=ends[:, layout.v],
            a=z[:, layout.a],
            thrust=memory.thrust * actuators.thrust_unit,
            torque=memory.torque * actuators.torque_unit,
            of_wrench=not has_thrusters(given),
        )

"""Layout of the parameters of the NLP: start, currents, lengths of the steps, and those of all
terms in their units.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.problem_reuse import ReusedProblem
from uvms_ocp.ocp.transcription.term_rows import TermBlock, TermNodes
from uvms_ocp.robot import State


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ParameterLayout:
    """Layout of the parameters p."""

    blocks: tuple[TermBlock, ...]
    """Blocks of terms whose parameters these are."""
    start: slice
    """q [m, rad] and v [m/s, rad/s] of the first node."""
    water: slice
    """[m/s] velocities of the water, step after step."""
    steps: slice
    """[s] lengths of the steps."""
    terms: tuple[slice, ...]
    """Ranges of each block, node after node."""

    @property
    def n(self) -> int:
        """Number of parameters."""
        return self.terms[-1].stop

    def values(
        self,
        reused: ReusedProblem,
        *,
        t0: float,
        start: State | None,
        written_at: np.ndarray | None = None,
        tightened: Tightening = NO_TIGHTENING,
    ) -> np.ndarray:
        """Return parameters (n,) with the first node at t0 [s]; see `Transcription.parameters`.

        written_at (n_nodes, n_q) [m, rad]: configurations at which terms that follow the guess are
        written.
        """
        problem = reused.problem
        nominal = problem.nominal_times()
        state = start or problem.start
        times = t0 + nominal
        rate = 1.0 / nominal[-1]
        last_share = 0.5 * (nominal[-1] - nominal[-2]) * rate
        n_phases = len(problem.phases)
        if written_at is None:
            q = np.tile(state.q, (len(times), 1))
        else:
            q = written_at
        parts = [state.q, state.v, problem.currents.ravel(), np.diff(nominal)]
        for i, (block, numbers) in enumerate(zip(self.blocks, reused.numbers, strict=True)):
            is_not_given = (block.nodes > 0) | (not problem.fixed_start)
            nodes = TermNodes(
                times=times[block.nodes].tolist(),
                active=is_not_given.tolist(),
                q=q[block.nodes],
                tightened={
                    term: margins.at(block.nodes) for term, margins in tightened.terms.items()
                },
            )
            is_on_path = i < n_phases
            share = rate if is_on_path else last_share
            parts.append(numbers.parameters(nodes, share))
        return np.concatenate(parts)


def parameter_layout(problem: OcpProblem, blocks: tuple[TermBlock, ...]) -> ParameterLayout:
    """Place the parameters of a problem whose terms are `blocks`."""
    n_state = problem.robot.n_q + problem.robot.n_v
    block_sizes = [block.rows.n_parameters * len(block.nodes) for block in blocks]
    sizes = [n_state, 3 * problem.n_steps, problem.n_steps, *block_sizes]
    ends = np.cumsum([0, *sizes]).tolist()
    start, water, steps, *terms = [slice(first, stop) for first, stop in pairwise(ends)]
    return ParameterLayout(blocks=blocks, start=start, water=water, steps=steps, terms=tuple(terms))

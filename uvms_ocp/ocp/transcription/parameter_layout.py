"""The parameters of the NLP, in this order: start, currents, lengths of the steps, and those of all terms in their units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.transcription.shape import Fitted
from uvms_ocp.ocp.transcription.term_rows import Nodes, TermBlock


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ParameterLayout:
    """Where each part is."""

    blocks: tuple[TermBlock, ...]
    start: slice
    """q [m, rad] and v [m/s, rad/s] of the first node."""
    water: slice
    """[m/s] Velocities of the water, step after step."""
    steps: slice
    """[s] Lengths of the steps."""
    terms: tuple[slice, ...]
    """Of each block, node after node."""

    @property
    def n(self) -> int:
        return self.terms[-1].stop

    def values(
        self,
        given: Fitted,
        *,
        t0: float,
        start: State | None,
        near: np.ndarray | None = None,
        tightened: Mapping[Term, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Parameters (n,) with the first node at t0 [s]; see `Transcription.parameters`.

        near (n_nodes, n_q) [m, rad], tightened (n_nodes, ...) [unit of the row].
        """
        nominal, state = given.problem.nominal_times(), start or given.problem.start
        times, rate = t0 + nominal, 1.0 / nominal[-1]
        about = np.tile(state.q, (len(times), 1)) if near is None else near
        parts = [state.q, state.v, given.problem.currents.ravel(), np.diff(nominal)]
        for block, numbers in zip(self.blocks, given.numbers, strict=True):
            own = block.nodes
            extra = {term: more[own] for term, more in (tightened or {}).items()}
            active = ((own > 0) | (not given.problem.fixed_start)).tolist()
            nodes = Nodes(times=times[own].tolist(), active=active, q=about[own], tightened=extra)
            parts.append(numbers.parameters(nodes, rate))
        return np.concatenate(parts)


def parameter_layout(problem: OcpProblem, blocks: tuple[TermBlock, ...]) -> ParameterLayout:
    """Place the parameters of a problem whose terms are `blocks`."""
    sizes = [block.rows.n_parameters * len(block.nodes) for block in blocks]
    ends = np.cumsum([0, problem.robot.n_q + problem.robot.n_v, 3 * problem.n_steps, problem.n_steps, *sizes]).tolist()
    start, water, steps, *places = (slice(first, stop) for first, stop in pairwise(ends))
    return ParameterLayout(blocks=blocks, start=start, water=water, steps=steps, terms=tuple(places))

"""The parameters of the NLP, in this order: start, current, lengths of the steps, and goals of all terms in their units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.transcription.term_rows import TermBlock, TermRows


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ParameterLayout:
    """Where each part is."""

    problem: OcpProblem
    blocks: tuple[TermBlock, ...]
    start: slice
    """q [m, rad] and v [m/s, rad/s] of the first node."""
    water: slice
    """[m/s] Velocity of the water."""
    steps: slice
    """[s] Lengths of the steps."""
    goals: tuple[slice, ...]
    """Of each block, node after node."""

    @property
    def n(self) -> int:
        return self.goals[-1].stop

    def values(self, given: OcpProblem, *, t0: float, start: State | None) -> np.ndarray:
        """Parameters (n,) with the first node at t0 [s]; see `Transcription.parameters`."""
        times = t0 + given.nominal_times()
        state = start or given.start
        parts = [state.q, state.v, given.current, np.diff(times)]
        for block in self.blocks:
            terms = self._terms_like(block.rows, given)
            for k in block.nodes:
                parts += [np.array([float(k > 0)]), *(term.reference(times[k]) for term in terms)]
        return np.concatenate(parts)

    def _terms_like(self, rows: TermRows, given: OcpProblem) -> Sequence[Term]:
        """The terms of another problem in the places of those that rows were built from."""
        if given is self.problem:
            return rows.terms
        places = {id(term): i for i, term in enumerate(self.problem.terms)}
        return [given.terms[places[id(term)]] for term in rows.terms]


def parameter_layout(problem: OcpProblem, blocks: tuple[TermBlock, ...]) -> ParameterLayout:
    """Place the parameters of a problem whose terms are `blocks`."""
    goals = [block.rows.n_parameters * len(block.nodes) for block in blocks]
    ends = np.cumsum([0, problem.robot.n_q + problem.robot.n_v, 3, problem.n_steps, *goals]).tolist()
    start, water, steps, *places = (slice(first, stop) for first, stop in pairwise(ends))
    return ParameterLayout(problem=problem, blocks=blocks, start=start, water=water, steps=steps, goals=tuple(places))

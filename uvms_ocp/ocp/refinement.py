"""Solve a problem again where terms follow the guess, until they are written at the motion that was
found.

What their rows keep at the nodes they may miss between them: there they are tightened.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from uvms_ocp.checks import unchecked_method
from uvms_ocp.ocp.clearance_certificate import shortfall
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.trajectory import (
    Trajectory,
    admissible,
)
from uvms_ocp.solvers import LexicographicResult, NlpStatus
from uvms_ocp.solvers.nlp.level_solver import Progress

if TYPE_CHECKING:
    from uvms_ocp.ocp.planner import Planner


_MOST_ROUNDS = 14
AGREES = 8e-4  # [m] between rows that decide and distances
# [m] of these, from which on what is missing is missing between nodes, not because rows are
# elsewhere
_NEAR = 5e-3
_GAIN = 1e-3  # share of a residual that is not worth another round
_ZERO = 1e-4  # residual of a level that is met
USABLE = 1e-5  # violation of a point that counts
_KEPT = 2e-4  # [m] of a margin that may be missed between nodes
_BESIDE = 2  # nodes
_MORE = 1.2  # share of what is missing between nodes by which these are tightened


MotionGuess: TypeAlias = Trajectory | Plan
Guess: TypeAlias = MotionGuess | LexicographicResult


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Refinement:
    """One problem, solved until its terms are written where its motion is, or the deadline [s] is
    over.
    """

    planner: Planner
    given: OcpProblem
    t0: float
    """[s] of the first node."""
    deadline: float
    """[s] by the clock on the wall."""
    progress: Progress | None = None
    """Told every iteration."""

    def solved(self, guess: MotionGuess) -> RefinedResult:
        """The last that is no worse, or usable."""
        q = (guess.trajectory if isinstance(guess, Plan) else guess).q
        if len(q) != self.given.n_steps + 1:
            q = np.tile(
                self.given.start.q, (self.given.n_steps + 1, 1)
            )  # a guess that `solve` refuses
        best = self._solved(guess, q, {})
        gained = np.inf
        for _ in range(_MOST_ROUNDS if self._terms else 0):
            times: list[float] = (self.t0 + self.given.nominal_times()).tolist()
            path = admissible(
                self.planner.transcription.unpack(best.result.x, self.given), self.given.robot
            )
            off = max(term.mismatch(times, best.near, path.q) for term in self._terms)
            settled = best.result.status.optimal and (off <= AGREES or gained <= _GAIN)
            missing = self._missing(best, path) if settled or off <= _NEAR else {}
            tightened = {**best.tightened, **missing}
            stopped = NlpStatus.INTERRUPTED in best.result.level_status or self._left <= 0
            if stopped or (settled and not missing):
                break
            found = self._solved(best.result, path.q, tightened).after(best.result)
            if found.result.violation > max(best.result.violation, USABLE):
                break
            best, gained = found, _gain(best.result, found.result)
        return best

    @property
    def _left(self) -> float:
        return self.deadline - perf_counter()

    @property
    def _terms(self) -> list[ShapeClearance]:
        return [term for term in self.given.terms if isinstance(term, ShapeClearance)]

    def _solved(
        self, guess: Guess, q: np.ndarray, tightened: Mapping[Term, np.ndarray]
    ) -> RefinedResult:
        """Written at configurations q (n_nodes, n_q)."""
        p = self.planner.transcription.parameters(
            self.given, t0=self.t0, near=q, tightened=tightened
        )
        solve = unchecked_method(self.planner.solve)
        left = max(self._left, 0.0)
        result = solve(p, guess, problem=self.given, time_limit=left, progress=self.progress)
        return RefinedResult(result=result, p=p, near=q, tightened=tightened)

    def _missing(self, best: RefinedResult, path: Trajectory) -> dict[Term, np.ndarray]:
        """Add the shortfall between nodes to the margins so far; nothing at the last node, whose
        place is the goal's.
        """
        result: dict[Term, np.ndarray] = {}
        for term in held_apart(self.given):
            padded = np.pad(shortfall(term, path, self.t0), ((_BESIDE, _BESIDE), (0, 0)))
            missing = np.asarray(sliding_window_view(padded, 2 * _BESIDE + 1, axis=0).max(axis=-1))
            missing[[0, -1]] = 0.0
            if missing.max(initial=0.0) > _KEPT:
                result[term] = best.tightened.get(term, 0.0) + _MORE * missing
        return result


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RefinedResult:
    """A result, and the parameters of its program."""

    result: LexicographicResult
    p: np.ndarray
    """(n_p,) [unit of the parameter]"""
    near: np.ndarray
    """(n_nodes, n_q) [m, rad] where terms were written."""
    tightened: Mapping[Term, np.ndarray]
    """(n_nodes, n_pairs) [m] for what is missing between nodes."""

    def after(self, before: LexicographicResult) -> RefinedResult:
        """With the iterations of an earlier result as well."""
        spent = tuple(a + b for a, b in zip(before.iterations, self.result.iterations, strict=True))
        return replace(self, result=replace(self.result, iterations=spent))


def _gain(before: LexicographicResult, after: LexicographicResult) -> float:
    """Share of its residual by which the first level that changed has changed."""
    old = before.level_residuals
    new = after.level_residuals
    share = (old - new) / np.maximum(old, _ZERO)
    changed = np.flatnonzero((np.abs(share) > _GAIN) & (np.maximum(old, new) > _ZERO))
    return float(abs(share[changed[0]])) if len(changed) else 0.0


def held_apart(given: OcpProblem) -> list[ShapeClearance]:
    """Constraints on shapes, which are to be kept between nodes too."""
    return [term for term in given.constraints if isinstance(term, ShapeClearance)]

"""Terms that follow the guess are written anew at the motion that was found, until it is the one they were written at.

What their rows keep at the nodes they may miss between them: there they are tightened.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Protocol, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from uvms_ocp.collision.conservative_advancement import ClearanceReport
from uvms_ocp.ocp.clearance.certificate import certificate, shortfall
from uvms_ocp.ocp.clearance.shape_clearance import ShapeClearance
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.watch import Progress

_MOST_ROUNDS = 14
_AGREES = 8e-4  # [m] between rows that decide and distances
_NEAR = 5e-3  # [m] of these, from which on what is missing is missing between nodes, not because rows are elsewhere
_GAIN = 1e-3  # share of a residual that is not worth another round
_ZERO = 1e-4  # residual of a level that is met
_USABLE = 1e-5  # violation of a point that counts
_KEPT = 2e-4  # [m] of a margin that may be missed between nodes
_BESIDE = 2  # nodes
_MORE = 1.2  # share of what is missing between nodes by which these are tightened


Guess: TypeAlias = Trajectory | Plan | LexicographicResult


class Solves(Protocol):
    """A `Planner`, as far as it is needed here."""

    transcription: Transcription

    def solve(
        self,
        p: np.ndarray,
        guess: Guess,
        *,
        problem: OcpProblem,
        time_limit: float | None = None,
        progress: Progress | None = None,
    ) -> LexicographicResult:
        """See `Planner.solve`, for p (n_p,) [unit of the parameter] and time_limit [s]."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Written:
    """A result, and the parameters of its program."""

    result: LexicographicResult
    p: np.ndarray
    """(n_p,) [unit of the parameter]"""
    near: np.ndarray
    """(n_nodes, n_q) [m, rad] where terms were written."""
    tightened: Mapping[Term, np.ndarray]
    """(n_nodes, n_pairs) [m] for what is missing between nodes."""

    def after(self, before: LexicographicResult) -> Written:
        """With the iterations of an earlier result as well."""
        spent = tuple(a + b for a, b in zip(before.iterations, self.result.iterations, strict=True))
        return replace(self, result=replace(self.result, iterations=spent))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Refinement:
    """One problem, solved until its terms are written where its motion is, or the deadline [s] is over."""

    planner: Solves
    given: OcpProblem
    t0: float
    """[s] of the first node."""
    deadline: float
    """[s] by the clock on the wall."""
    progress: Progress | None = None
    """Told every iteration."""

    def solved(self, guess: Trajectory | Plan) -> Written:
        """The last that is no worse, or usable."""
        q = (guess.trajectory if isinstance(guess, Plan) else guess).q
        if len(q) != self.given.n_steps + 1:
            q = np.tile(self.given.start.q, (self.given.n_steps + 1, 1))  # a guess that `solve` refuses
        best, gained = self._solved(guess, q, {}), np.inf
        for _ in range(_MOST_ROUNDS if self._terms else 0):
            path = self.planner.transcription.unpack(best.result.x, self.given)
            off = self._off(best, path.q)
            settled = best.result.status.optimal and (off <= _AGREES or gained <= _GAIN)
            missing = self._missing(best, path) if settled or off <= _NEAR else {}
            tightened = {**best.tightened, **missing}
            stopped = NlpStatus.INTERRUPTED in best.result.level_status or self._left <= 0
            if stopped or (settled and not missing):
                break
            found = self._solved(best.result, path.q, tightened).after(best.result)
            if found.result.violation > max(best.result.violation, _USABLE):
                break
            best, gained = found, _gain(best.result, found.result)
        return best

    @property
    def _left(self) -> float:
        return self.deadline - perf_counter()

    @property
    def _terms(self) -> list[ShapeClearance]:
        return [term for term in self.given.terms if isinstance(term, ShapeClearance)]

    @property
    def _times(self) -> list[float]:
        times: list[float] = (self.t0 + self.given.nominal_times()).tolist()
        return times

    def _solved(self, guess: Guess, q: np.ndarray, tightened: Mapping[Term, np.ndarray]) -> Written:
        """Written at configurations q (n_nodes, n_q)."""
        p = self.planner.transcription.parameters(self.given, t0=self.t0, near=q, tightened=tightened)
        left = max(self._left, 0.0)
        result = self.planner.solve(p, guess, problem=self.given, time_limit=left, progress=self.progress)
        return Written(result=result, p=p, near=q, tightened=tightened)

    def _off(self, found: Written, q: np.ndarray) -> float:
        """[m] Between rows that decide and distances."""
        return max(term.mismatch(self._times, found.near, q) for term in self._terms)

    def _missing(self, best: Written, path: Trajectory) -> dict[Term, np.ndarray]:
        """What is missing between nodes on top of what was; nothing at the last node, whose place is the goal's."""
        result: dict[Term, np.ndarray] = {}
        for term in self.given.constraints:
            if isinstance(term, ShapeClearance):
                missing = _spread(shortfall(term, path, self.t0))
                missing[[0, -1]] = 0.0
                if missing.max(initial=0.0) > _KEPT:
                    result[term] = best.tightened.get(term, 0.0) + _MORE * missing
        return result


def _gain(before: LexicographicResult, after: LexicographicResult) -> float:
    """[-] Share of its residual by which the first level that changed has changed."""
    old, new = before.level_residuals, after.level_residuals
    share = (old - new) / np.maximum(old, _ZERO)
    changed = np.flatnonzero((np.abs(share) > _GAIN) & (np.maximum(old, new) > _ZERO))
    return float(abs(share[changed[0]])) if len(changed) else 0.0


def _spread(missing: np.ndarray) -> np.ndarray:
    """(n_nodes, n_pairs) [m] the largest within two nodes: else the motion dips right beside where it no longer can."""
    padded = np.pad(missing, ((_BESIDE, _BESIDE), (0, 0)))
    return np.asarray(sliding_window_view(padded, 2 * _BESIDE + 1, axis=0).max(axis=-1))


def worst_clearance(given: OcpProblem, path: Trajectory) -> ClearanceReport | None:
    """The certificate of the constraint on shapes that comes out worst; `None` where there is none."""
    reports = [certificate(term, path) for term in given.constraints if isinstance(term, ShapeClearance)]
    return min(reports, key=lambda report: (report.collision_free, report.nearest.distance), default=None)

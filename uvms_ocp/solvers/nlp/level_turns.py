"""One step of a lexicographic program: its levels take their turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.solvers.nlp.acceptance import SHARES, Acceptance, Merit, acceptance
from uvms_ocp.solvers.nlp.level_qp import LevelQp
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.program import LexicographicProgram
from uvms_ocp.solvers.nlp.proximal import ProximalWeights
from uvms_ocp.solvers.nlp.row_bounds import RowBounds
from uvms_ocp.solvers.nlp.sqp_options import SqpOptions


class Deadline:
    """Whether there is time for another QP, judged by those that were solved."""

    def __init__(self, limit: float, clock: Callable[[], float]) -> None:
        """limit [s] from now."""
        self._limit, self._clock, self._begin, self._solved = limit, clock, clock(), 0

    def count(self) -> None:
        """One more QP was solved."""
        self._solved += 1

    @property
    def elapsed(self) -> float:
        """[s] so far."""
        return self._clock() - self._begin

    @property
    def over(self) -> bool:
        """Another QP that takes as long as those before would end too late."""
        return self.elapsed * (self._solved + 1) / max(self._solved, 1) > self._limit


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """Where the levels so far have led."""

    x: np.ndarray
    """(n,) [unit of x]"""
    rows: tuple[np.ndarray, ...]
    """(m,) [unit of the row] of every level."""
    merit: Merit
    reached: tuple[float, ...] = ()
    """(n,) [-] norm of the residual of each level that had its turn, at its end."""

    def after_turn(self) -> Point:
        """The same once the next level has had its turn here."""
        return replace(self, reached=(*self.reached, float(self.merit.residuals[len(self.reached)])))


class LevelTurns:
    """Of one program; its QPs are built once, and the weights of its levels are carried from step to step."""

    def __init__(self, program: LexicographicProgram, options: SqpOptions) -> None:
        """Raises `InvalidInput` for a program without derivative functions."""
        self._program, self._options = program, options
        self._qps = [LevelQp(nlp, i, options) for i, nlp in enumerate(program.nlps)]
        self._weights = ProximalWeights(len(self._qps), options.proximal)

    def step(
        self, x: np.ndarray, p: np.ndarray, bounds: RowBounds, deadline: Deadline
    ) -> tuple[Point, NlpStatus | None]:
        """Where a step from x (n,) [unit of x] leads, and why there is none; p (n_p,) [unit of the parameter]."""
        first, failure = self._qps[0].step(x, p, bounds, self._options.damping)
        deadline.count()
        point = self._point(x + first, p, bounds).after_turn()
        if failure is not None:
            return point, failure
        for i in range(1, len(self._qps)):
            if deadline.over:
                break
            bounds = bounds.with_rows(*self._frozen(i - 1, point))
            point = self._turn(point, p, bounds).after_turn()
            deadline.count()
        return point, None

    def _turn(self, point: Point, p: np.ndarray, bounds: RowBounds) -> Point:
        """Where the next level moves the point."""
        i = len(point.reached)
        step, failure = self._qps[i].step(point.x, p, bounds, self._options.damping + self._weights[i])
        share, found = (0.0, point) if failure is not None else self._searched(point, step, p, bounds)
        self._weights.adapt(i, share)
        return found

    def _searched(self, point: Point, step: np.ndarray, p: np.ndarray, bounds: RowBounds) -> tuple[float, Point]:
        """The largest share of the step that the rule allows, and where it leads."""
        rule = self._rule(point)
        for share in SHARES:
            found = self._point(point.x + share * step, p, bounds)
            if rule.allows(found.merit):
                return share, replace(found, reached=point.reached)
        return 0.0, point

    def _rule(self, point: Point) -> Acceptance:
        options, levels = self._options, self._program.ranges.levels
        return acceptance(levels, point.reached, point.merit, accuracy=options.accuracy, tolerance=options.tolerance)

    def _frozen(self, i: int, point: Point) -> tuple[slice, tuple[np.ndarray, np.ndarray]]:
        """Rows that keep level i where its turn has left it, and their bounds."""
        level, cost = self._program.ranges.levels[i], point.reached[i] ** 2 / 2
        return level.frozen, level.frozen_bounds(point.rows[i], cost, self._options.tolerance)

    def _point(self, x: np.ndarray, p: np.ndarray, bounds: RowBounds) -> Point:
        first, levels = self._program.nlps[0], self._program.ranges.levels
        rows = tuple(np.array(y).ravel() for y in self._program.values.call([x, p]))
        residuals = [float(np.linalg.norm(level.distance(y))) for level, y in zip(levels, rows, strict=True)]
        violation = bounds.violation(x, np.array(first.functions["nlp_g"](x, p)).ravel(), first.rows)
        merit = Merit(violation=violation if np.isfinite(violation) else np.inf, residuals=np.array(residuals))
        return Point(x=x, rows=rows, merit=merit)

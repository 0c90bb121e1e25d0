"""The levels of a program in sparse matrices, by the QP solvers of CasADi."""

from __future__ import annotations

import numpy as np

from uvms_ocp.solvers.nlp.acceptance import Merit
from uvms_ocp.solvers.nlp.level_qp import LevelQp
from uvms_ocp.solvers.nlp.level_turns import Point
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.program import LexicographicProgram
from uvms_ocp.solvers.nlp.row_bounds import RowBounds, row_bounds
from uvms_ocp.solvers.nlp.sqp_options import SqpOptions


class SparseLevels:
    """A `LevelModel`; its QPs are built once, here. Raises `InvalidInput` for a program without derivative functions."""

    def __init__(self, program: LexicographicProgram, options: SqpOptions) -> None:
        self._program, self.slack = program, options.tolerance
        self._qps = [LevelQp(nlp, i, options) for i, nlp in enumerate(program.nlps)]
        self._p, self._from, self._step = np.zeros(program.n_p), np.zeros(program.n_x), np.zeros(program.n_x)
        self._bounds = row_bounds(program.ranges, -np.inf, np.inf, program.n_x)

    def begin(self, x: np.ndarray, p: np.ndarray, bounds: RowBounds) -> Point:
        """As `LevelModel.begin`; x (n_x,) [unit of x], p (n_p,) [unit of the parameter]."""
        self._p, self._bounds = p, bounds
        self._from, self._step = x, np.zeros_like(x)
        return self.moved(0.0)

    def step(self, level: int, point: Point, bounds: RowBounds, damping: float) -> NlpStatus | None:
        """As `LevelModel.step`; damping [1/unit of x^2]."""
        self._from = point.x
        self._step, failure = self._qps[level].step(point.x, self._p, bounds, damping)
        return failure

    def moved(self, share: float) -> Point:
        """As `LevelModel.moved`; share [-]."""
        x, first = self._from + share * self._step, self._program.nlps[0]
        rows = tuple(np.array(y).ravel() for y in self._program.values.call([x, self._p]))
        residuals = [self._residual(i, x, y) for i, y in enumerate(rows)]
        g = np.array(first.functions["nlp_g"](x, self._p)).ravel()
        violation = self._bounds.violation(x, g, first.rows)
        merit = Merit(violation=violation if np.isfinite(violation) else np.inf, residuals=np.array(residuals))
        return Point(x=x, rows=rows, merit=merit)

    def _residual(self, i: int, x: np.ndarray, y: np.ndarray) -> float:
        """Norm of the rows of level i, or that of its cost where the cost is what is kept: there rows may weigh differently."""
        level = self._program.ranges.levels[i]
        if level.relax is None:
            return float(np.linalg.norm(level.distance(y)))
        cost, _ = self._program.nlps[i].functions["nlp_grad_f"](x, self._p)
        return float(np.sqrt(2 * float(cost)))

    def variables(self, point: Point) -> np.ndarray:
        """As `LevelModel.variables`."""
        return point.x

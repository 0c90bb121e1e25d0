"""Tell by how much a small step could still lower the cost of a level of a motion.

Only the rows of the problem are used, linearized at the motion, and nothing of the solver that found
it: neither steps nor damping, multipliers or scaling. Levels above are held at their values. The
Gauss-Newton step within the linearized rows, by an interior point of another library, gains nothing
exactly where the motion is stationary: where the gradient of the Lagrangian, projected on the null
space of the active rows, is zero with multipliers of the right signs, which that library finds too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import At
from uvms_ocp.ocp.trajectory import Trajectory, admissible
from uvms_ocp.ocp.transcription.term_rows import TermBlock
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.spatial import continuous_quaternions
from uvms_ocp.types import Array

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

_QP = "piqp"  # proximal interior point of CasADi's wheel, which plans nothing here
# tolerances of its optimum; the second where rounding keeps it from the first
_QP_TOLERANCES = (1e-9, 1e-7)
_LONGEST_STEP = 1.0  # [unit of the variable] entry of a step up to which rows count as linear
# rounds in which planes at the end of a step are kept too, where shapes are near
_SHAPE_ROUNDS = 6
_STEP_NEAR_SHAPES = 0.1  # [unit of the variable] largest entry of the step of such a round
_SMALLEST_CURVATURE = 1e-9  # [share of the cost / unit^2] makes the step unique
_ROUNDING = 1e-7  # [unit of the row] by which rows that are kept may be violated
_NO_COST = 1e-12  # cost up to which a level is at its best

LinearRows = tuple["csc_matrix", Array, Array]
"""Slopes (m, n_x) of rows by the variables, and lower and upper bounds (m,) of their change."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LevelGain:
    """Gain that one more step promises for a level."""

    residual: float
    """Root of twice the cost of the level: of the squares of its weighted rows at the ends of
    phases, and of their mean over the nominal time along the path.
    """
    gain: float
    """Fall of the residual that one more step promises, to first order; infinite where that was not
    found.
    """
    stationarity: float
    """Largest entry of the gradient of the Lagrangian [cost / unit of the variable], with the
    multipliers that belong to the step.
    """

    @property
    def share(self) -> float:
        """Gain as a share of the residual."""
        if self.residual > 0.0:
            return self.gain / self.residual
        return 0.0


def path_shares(problem: OcpProblem, blocks: tuple[TermBlock, ...], t: Array) -> list[Array]:
    """Return the shares (n_nodes, n_rows) with which the squares of the rows of every block count
    in the cost of their level, for nodes at times t (N + 1,) [s].

    Along the path that of the step in the nominal time, at the last node half of it; 1 for terms at
    the end of a phase; 0 for states that are given.
    """
    total = float(problem.nominal_times()[-1])
    steps = np.diff(t) / total
    last = float(np.diff(problem.nominal_times())[-1]) / (2.0 * total)
    node_shares = np.append(steps, last)
    shares = []
    for block in blocks:
        is_on_path: list[bool] = []
        for member in block.rows.members:
            is_on_path += [member.term.at is At.PATH] * member.residual.n_rows
        share = np.where(np.array(is_on_path, dtype=bool), node_shares[block.nodes][:, None], 1.0)
        if problem.fixed_start:
            share = np.where((block.nodes == 0)[:, None] & block.rows.state_only, 0.0, share)
        shares.append(share)
    return shares


def level_residuals(
    transcription: Transcription, problem: OcpProblem, values: tuple[Array, ...], t: Array
) -> Array:
    """Return the residuals (n_levels,) of levels whose rows have these values, for nodes at times t
    (N + 1,) [s]; see `LevelGain.residual`.
    """
    shares = _row_shares(transcription, problem, t)
    levels = transcription.ranges(problem).levels
    residuals = []
    for level, rows, y in zip(levels, transcription.row_layout.levels, values, strict=True):
        weighted = np.sqrt(shares[rows]) * level.distance(y)
        residuals.append(float(np.linalg.norm(weighted)))
    return np.array(residuals)


def _row_shares(transcription: Transcription, problem: OcpProblem, t: Array) -> Array:
    """Return the shares (n_rows,) of all raw rows."""
    layout = transcription.row_layout
    shares = np.ones(layout.n_rows)
    shares_of_blocks = path_shares(problem, transcription.blocks, t)
    for rows, block_shares in zip(layout.terms, shares_of_blocks, strict=True):
        shares[rows] = block_shares
    return shares


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearizedMotion:
    """All rows of a problem linearized at a motion."""

    transcription: Transcription
    """NLP of problems of this shape."""
    problem: OcpProblem
    """Problem that the motion solves."""
    trajectory: Trajectory
    """The motion."""
    t0: float
    """[s] time of its first node, for goals that move."""
    tightened: Tightening = NO_TIGHTENING
    """Margins of nodes beyond their ranges, so that these are kept between nodes."""

    @cached_property
    def x(self) -> Array:
        """(n_x,) variables. Of the two quaternions of an attitude the one nearer to that of the node
        before, so that for rows of the four numbers there is no turn by 360 deg.
        """
        q = self.trajectory.q.copy()
        if self.problem.robot.n_vehicle:
            attitudes = np.vstack([self.problem.start.q[3:7], q[:, 3:7]])
            q[:, 3:7] = continuous_quaternions(attitudes)[1:]
        return self.transcription.pack(replace_unchecked(self.trajectory, q=q))

    @cached_property
    def _rows(self) -> tuple[Array, csc_matrix]:
        """Values (n_rows,) and slopes (n_rows, n_x) of all rows but those of costs."""
        return self._rows_near(self.trajectory.q)

    def _rows_near(self, q: Array) -> tuple[Array, csc_matrix]:
        """Return values and slopes at the motion, with terms that follow it written at q (n_nodes,
        n_q) [m, rad].
        """
        p = self.transcription.parameters(
            self.problem, t0=self.t0, written_at=q, tightened=self.tightened
        )
        values, slopes = self.transcription.rows_and_slopes(self.x, p)
        return np.array(values).ravel(), slopes.sparse()

    @cached_property
    def _shapes(self) -> Array:
        """(n_constraints,) True for rows of shapes' distances."""
        names = {term.name for term in self.problem.constraints if isinstance(term, ShapeClearance)}
        layout = self.transcription.row_layout
        return np.array([layout.names[row] in names for row in layout.constraints], dtype=bool)

    def _planes_after(self, step: Array) -> LinearRows:
        """Return the rows of shapes linearized after a step (n_x,): edges and corners have other
        separating planes there than at the motion.
        """
        after = self.transcription.unpack(self.x + step, self.problem)
        q = admissible(after, self.problem.robot).q
        return self._constraints_of(self._rows_near(q), self._shapes)

    @cached_property
    def _shares(self) -> Array:
        """(n_rows,) shares of all raw rows in the cost of their level."""
        return _row_shares(self.transcription, self.problem, self.trajectory.t)

    def gains(self, enough: float) -> list[LevelGain]:
        """Find the gain of a step for each level, with those above it held; enough: share of the
        residual up to which planes of shapes are not refined.
        """
        gains = []
        held: list[LinearRows] = [self._constraints()]
        has_shapes = bool(self._shapes.any())
        for level in range(len(self.problem.levels)):
            cost, gradient, jacobian = self.cost(level)
            gain, step = self._gain(cost, gradient, jacobian, held, _LONGEST_STEP)
            rounds = 0
            while has_shapes and rounds < _SHAPE_ROUNDS:
                if gain.share <= enough or not np.isfinite(step).all():
                    break
                held.append(self._planes_after(step))
                gain, step = self._gain(cost, gradient, jacobian, held, _STEP_NEAR_SHAPES)
                rounds += 1
            gains.append(gain)
            held.append(self._held(level, cost, gradient, gain))
        return gains

    def cost(self, level: int) -> tuple[float, Array, csc_matrix]:
        """Return the cost of a level, its gradient (n_x,), and the slopes (m, n_x) of the residuals
        whose half squares it is.
        """
        from scipy.sparse import diags

        values, slopes = self._rows
        layout = self.transcription.row_layout
        rows = layout.levels[level]
        ranges = self.transcription.ranges(self.problem).levels[level]
        distance = ranges.distance(values[rows])
        roots = np.sqrt(self._shares[rows])
        counts = (distance != 0.0) | (ranges.lower == ranges.upper)
        jacobian = (diags(roots * counts) @ slopes[rows]).tocsc()
        residual = roots * distance
        gradient = jacobian.T @ residual + self._by_durations(rows, distance)
        return 0.5 * float(residual @ residual), gradient, jacobian

    def _by_durations(self, rows: Array, distance: Array) -> Array:
        """Return the gradient (n_x,) of the cost by the lengths of steps, which are the weights of
        path terms.
        """
        gradient = np.zeros(self.transcription.n_x)
        if not self.problem.free_time:
            return gradient
        row_costs = np.zeros(self.transcription.row_layout.n_rows)
        row_costs[rows] = 0.5 * distance**2 / float(self.problem.nominal_times()[-1])
        h = self.transcription.variables.all_columns[:, self.transcription.model.layout.h]
        path_blocks = self.transcription.blocks[: len(self.problem.phases)]
        layout = self.transcription.row_layout
        for block, block_rows in zip(path_blocks, layout.terms, strict=False):
            has_share = self._shares[block_rows] > 0.0
            node_costs = (row_costs[block_rows] * has_share).sum(axis=1)
            np.add.at(gradient, h[block.nodes], node_costs)
        return gradient

    def _constraints(self) -> LinearRows:
        """Return the rows of all constraints at the motion."""
        return self._constraints_of(self._rows, np.ones_like(self._shapes))

    def _constraints_of(self, linearized: tuple[Array, csc_matrix], chosen: Array) -> LinearRows:
        """Return the rows of the constraints (n_constraints,) that are chosen and have a range."""
        values, slopes = linearized
        rows = self.transcription.row_layout.constraints
        ranges = self.transcription.ranges(self.problem, self.tightened)
        lower = ranges.lower - values[rows]
        upper = ranges.upper - values[rows]
        is_bounded = chosen & (np.isfinite(lower) | np.isfinite(upper))
        return slopes[rows[is_bounded]], lower[is_bounded], upper[is_bounded]

    def _held(self, level: int, cost: float, gradient: Array, gain: LevelGain) -> LinearRows:
        """Return the rows that keep a level where it is; one that may be relaxed may rise to its
        share above the best that it could have.
        """
        from scipy.sparse import csc_matrix

        values, slopes = self._rows
        rows = self.transcription.row_layout.levels[level]
        ranges = self.transcription.ranges(self.problem).levels[level]
        if ranges.relax is not None:
            best_cost = 0.5 * max(gain.residual - gain.gain, 0.0) ** 2
            allowed_rise = max((1.0 + ranges.relax) * best_cost - cost, 0.0)
            return csc_matrix(gradient[None]), np.array([-np.inf]), np.array([allowed_rise])
        lower, upper = ranges.frozen_bounds(values[rows], cost, 0.0)
        return slopes[rows], lower - values[rows], upper - values[rows]

    def _gain(
        self,
        cost: float,
        gradient: Array,
        jacobian: csc_matrix,
        held: list[LinearRows],
        longest: float,
    ) -> tuple[LevelGain, Array]:
        """Return the gain, and the step (n_x,) that promises it, of entries up to `longest`."""
        from scipy.sparse import identity, vstack

        n = len(gradient)
        residual = float((2.0 * cost) ** 0.5)
        if cost <= _NO_COST:
            return LevelGain(residual=residual, gain=0.0, stationarity=0.0), np.zeros(n)
        slopes, rows_lower, rows_upper = zip(*held, strict=True)
        x_lower, x_upper = self.transcription.bounds(self.problem, self.tightened)
        hessian = (jacobian.T @ jacobian) / cost + _SMALLEST_CURVATURE * identity(n)
        rows = vstack(slopes).tocsc()
        H = _casadi(hessian.tocsc())
        A = _casadi(rows)
        # Rows that the motion violates may not get worse, so that a step of 0 is always allowed.
        bounds = {
            "lba": np.minimum(np.concatenate(rows_lower), 0.0) - _ROUNDING,
            "uba": np.maximum(np.concatenate(rows_upper), 0.0) + _ROUNDING,
            "lbx": np.maximum(np.minimum(x_lower - self.x, 0.0) - _ROUNDING, -longest),
            "ubx": np.minimum(np.maximum(x_upper - self.x, 0.0) + _ROUNDING, longest),
        }
        for tolerance in _QP_TOLERANCES:
            options = {
                "error_on_fail": False,
                "piqp": {"eps_abs": tolerance, "eps_rel": 0.0},
            }
            solver = ca.conic("gain", _QP, {"h": H.sparsity(), "a": A.sparsity()}, options)
            solution = solver(h=H, g=gradient / cost, a=A, **bounds)
            step = np.array(solution["x"]).ravel()
            if solver.stats()["success"] and np.isfinite(step).all():
                break
        else:
            return LevelGain(residual=residual, gain=np.inf, stationarity=np.inf), step
        change = jacobian @ step
        remaining = max(cost + float(gradient @ step) + 0.5 * float(change @ change), 0.0)
        row_multipliers = np.array(solution["lam_a"]).ravel()
        variable_multipliers = np.array(solution["lam_x"]).ravel()
        lagrangian = gradient + cost * (rows.T @ row_multipliers + variable_multipliers)
        gain = LevelGain(
            residual=residual,
            gain=max(residual - float((2.0 * remaining) ** 0.5), 0.0),
            stationarity=float(np.abs(lagrangian).max(initial=0.0)),
        )
        return gain, step


def _casadi(matrix: csc_matrix) -> ca.DM:
    """Convert a matrix to one of CasADi."""
    matrix.sum_duplicates()
    matrix.sort_indices()
    n_rows, n_columns = matrix.shape
    places = ca.Sparsity(n_rows, n_columns, matrix.indptr.tolist(), matrix.indices.tolist())
    return ca.DM(places, matrix.data)

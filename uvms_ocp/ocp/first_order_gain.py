"""Tell by how much a small step could still lower the cost of a level of a motion.

The plain rows of the problem, linearized at the motion, and nothing of the solver that found it: no
step that it took, no damping, no multipliers, no scaling of its own. Levels above are held where
the motion has them. The step of Gauss and Newton within the linearized rows, by an interior point
of another library, gains nothing exactly where the gradient of the Lagrangian, projected on what
the active rows leave free, is zero with multipliers of the right signs; these are found with it.
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

_QP = "piqp"  # proximal interior point of CasADi's wheel, by which nothing here is planned
# largest errors of its optimum; the next where rounding keeps it from one
_QP_TOLERANCES = (1e-9, 1e-7)
_LONGEST_STEP = 1.0  # [unit of the variable] as far as the linearization is followed
# rounds in which planes at the end of a step are kept too, where shapes are near, and how far it
# goes
_ROUNDS = 6
_STEP_NEAR_SHAPES = 0.1  # [unit of the variable]
_CURVATURE = 1e-9  # [share of the cost / unit^2] least one, which makes the step one
_HELD = 1e-7  # [unit of the row] by which rows that are kept may give way: rounding of these
_NOTHING = 1e-12  # cost of a level that has none


@dataclass(frozen=True, kw_only=True, slots=True)
class LevelGain:
    """Gain that one more step promises for a level."""

    residual: float
    """Root of twice the cost of the level: of the squares of its weighted rows at the ends of
    phases, and of their mean over the nominal time along the path.
    """
    gain: float
    """By how much the residual would fall, to first order; infinite where that was not found."""
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
    """Shares (n_nodes, n_rows) with which the squares of the rows of every block count in the cost
    of their level, for nodes at times t (N + 1,) [s].

    Along the path that of the step in the nominal time, at the last node half of it; 1 for terms at
    the end of a phase; 0 for states that are given.
    """
    total = float(problem.nominal_times()[-1])
    steps = np.diff(t) / total
    last = float(np.diff(problem.nominal_times())[-1]) / (2.0 * total)
    shares = []
    for block in blocks:
        on_path = np.concatenate(
            [np.zeros(0, dtype=bool)]
            + [
                np.full(member.residual.n_rows, member.term.at is At.PATH)
                for member in block.rows.members
            ]
        )
        along = np.append(steps, last)[block.nodes][:, None]
        share = np.where(on_path, along, 1.0)
        if problem.fixed_start:
            share = np.where((block.nodes == 0)[:, None] & block.rows.state_only, 0.0, share)
        shares.append(share)
    return shares


def level_residuals(
    transcription: Transcription, problem: OcpProblem, values: tuple[Array, ...], t: Array
) -> Array:
    """Residuals (n_levels,) of levels whose rows have these values, for nodes at times t (N + 1,)
    [s]; see `LevelGain.residual`.
    """
    shares = _row_shares(transcription, problem, t)
    levels = zip(
        transcription.ranges(problem).levels, transcription.row_layout.levels, values, strict=True
    )
    return np.array(
        [
            float(np.linalg.norm(np.sqrt(shares[rows]) * level_ranges.distance(y)))
            for level_ranges, rows, y in levels
        ]
    )


def _row_shares(transcription: Transcription, problem: OcpProblem, t: Array) -> Array:
    """(n_rows,) shares of all raw rows."""
    shares = np.ones(transcription.row_layout.n_rows)
    blocks = transcription.blocks
    for rows, block_shares in zip(
        transcription.row_layout.terms, path_shares(problem, blocks, t), strict=True
    ):
        shares[rows] = block_shares
    return shares


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearizedMotion:
    """All rows of a problem linearized at a motion."""

    transcription: Transcription
    problem: OcpProblem
    trajectory: Trajectory
    t0: float
    tightened: Tightening = NO_TIGHTENING
    """Margins of nodes beyond their ranges, so that these are kept between nodes."""

    @cached_property
    def x(self) -> Array:
        """(n_x,) variables; of the two quaternions of an attitude the nearer one to that of the
        node before, so that rows that work on the four numbers see no turn by 360 deg.
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
        """Values and slopes at the motion, with terms that follow it written at q (n_nodes, n_q)
        [m, rad].
        """
        p = self.transcription.parameters(
            self.problem, t0=self.t0, near=q, tightened=self.tightened
        )
        values, slopes = self.transcription.rows_and_slopes(self.x, p)
        return np.array(values).ravel(), slopes.sparse()

    @cached_property
    def _shapes(self) -> Array:
        """(n_constraints,) True for rows of shapes."""
        names = {term.name for term in self.problem.constraints if isinstance(term, ShapeClearance)}
        layout = self.transcription.row_layout
        return np.array([layout.names[row] in names for row in layout.constraints], dtype=bool)

    def _planes_after(self, step: Array) -> tuple[csc_matrix, Array, Array]:
        """Rows of shapes as they are after a step (n_x,): edges and corners have other planes
        there, of which the linearization at the motion knows nothing.
        """
        after = self.transcription.unpack(self.x + step, self.problem)
        return self._constraints_of(
            self._rows_near(admissible(after, self.problem.robot).q), self._shapes
        )

    @cached_property
    def _shares(self) -> Array:
        return _row_shares(self.transcription, self.problem, self.trajectory.t)

    def gains(self, enough: float) -> list[LevelGain]:
        """Find the gain of a step for each level, with those above it held; enough: share of the
        residual that is not looked at more closely.
        """
        result = []
        held: list[tuple[csc_matrix, Array, Array]] = [self._constraints()]
        for level in range(len(self.problem.levels)):
            cost, gradient, jacobian = self.cost(level)
            gain, step = self._gain(cost, gradient, jacobian, held, _LONGEST_STEP)
            for _ in range(_ROUNDS if self._shapes.any() else 0):
                if gain.share <= enough or not np.isfinite(step).all():
                    break
                held.append(self._planes_after(step))
                gain, step = self._gain(cost, gradient, jacobian, held, _STEP_NEAR_SHAPES)
            result.append(gain)
            held.append(self._held(level, cost, gradient, gain))
        return result

    def cost(self, level: int) -> tuple[float, Array, csc_matrix]:
        """Cost of a level, its gradient (n_x,), and the slopes (m, n_x) of the residuals whose half
        squares it is.
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
        """Gradient (n_x,) of the cost by the lengths of steps, as far as these are shares of
        time.
        """
        gradient = np.zeros(self.transcription.n_x)
        if not self.problem.free_time:
            return gradient
        row_costs = np.zeros(self.transcription.row_layout.n_rows)
        row_costs[rows] = 0.5 * distance**2 / float(self.problem.nominal_times()[-1])
        h = self.transcription.variables.all_columns[:, self.transcription.model.layout.h]
        path = zip(
            self.transcription.blocks[: len(self.problem.phases)],
            self.transcription.row_layout.terms,
            strict=False,
        )
        for block, numbers in path:
            on_path = self._shares[numbers] > 0.0
            np.add.at(gradient, h[block.nodes], (row_costs[numbers] * on_path).sum(axis=1))
        return gradient

    def _constraints(self) -> tuple[csc_matrix, Array, Array]:
        return self._constraints_of(self._rows, np.ones_like(self._shapes))

    def _constraints_of(
        self, linearized: tuple[Array, csc_matrix], chosen: Array
    ) -> tuple[csc_matrix, Array, Array]:
        """Rows of the constraints (n_constraints,) that are chosen and have a range."""
        values, slopes = linearized
        rows = self.transcription.row_layout.constraints
        ranges = self.transcription.ranges(self.problem, self.tightened)
        lower = ranges.lower - values[rows]
        upper = ranges.upper - values[rows]
        bound = chosen & (np.isfinite(lower) | np.isfinite(upper))
        return slopes[rows[bound]], lower[bound], upper[bound]

    def _held(
        self, level: int, cost: float, gradient: Array, gain: LevelGain
    ) -> tuple[csc_matrix, Array, Array]:
        """Rows that keep a level where it is; one that may be relaxed may rise to its share above
        the best that it could have.
        """
        from scipy.sparse import csc_matrix

        values, slopes = self._rows
        rows = self.transcription.row_layout.levels[level]
        ranges = self.transcription.ranges(self.problem).levels[level]
        if ranges.relax is not None:
            best = 0.5 * max(gain.residual - gain.gain, 0.0) ** 2
            room = max((1.0 + ranges.relax) * best - cost, 0.0)
            return csc_matrix(gradient[None]), np.array([-np.inf]), np.array([room])
        lower, upper = ranges.frozen_bounds(values[rows], cost, 0.0)
        return slopes[rows], lower - values[rows], upper - values[rows]

    def _gain(
        self,
        cost: float,
        gradient: Array,
        jacobian: csc_matrix,
        held: list[tuple[csc_matrix, Array, Array]],
        longest: float,
    ) -> tuple[LevelGain, Array]:
        """The gain, and the step (n_x,) that promises it."""
        from scipy.sparse import identity, vstack

        # What the motion leaves already may not get worse, so that no step is a step at all times.
        n = len(gradient)
        residual = float((2.0 * cost) ** 0.5)
        if cost <= _NOTHING:
            return LevelGain(residual=residual, gain=0.0, stationarity=0.0), np.zeros(n)
        low, up = self.transcription.bounds(self.problem, self.tightened)
        hessian = (jacobian.T @ jacobian) / cost + _CURVATURE * identity(n)
        rows = vstack([part for part, _, _ in held]).tocsc()
        H = _casadi(hessian.tocsc())
        A = _casadi(rows)
        bounds = {
            "lba": np.minimum(np.concatenate([part for _, part, _ in held]), 0.0) - _HELD,
            "uba": np.maximum(np.concatenate([part for _, _, part in held]), 0.0) + _HELD,
            "lbx": np.maximum(np.minimum(low - self.x, 0.0) - _HELD, -longest),
            "ubx": np.minimum(np.maximum(up - self.x, 0.0) + _HELD, longest),
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
        bent = jacobian @ step
        remaining = max(cost + float(gradient @ step) + 0.5 * float(bent @ bent), 0.0)
        of_rows = np.array(solution["lam_a"]).ravel()
        of_variables = np.array(solution["lam_x"]).ravel()
        lagrangian = gradient + cost * (rows.T @ of_rows + of_variables)
        gain = LevelGain(
            residual=residual,
            gain=max(residual - float((2.0 * remaining) ** 0.5), 0.0),
            stationarity=float(np.abs(lagrangian).max(initial=0.0)),
        )
        return gain, step


def _casadi(matrix: csc_matrix) -> ca.DM:
    """Convert a matrix for CasADi."""
    matrix.sum_duplicates()
    matrix.sort_indices()
    n_rows, n_columns = matrix.shape
    places = ca.Sparsity(n_rows, n_columns, matrix.indptr.tolist(), matrix.indices.tolist())
    return ca.DM(places, matrix.data)

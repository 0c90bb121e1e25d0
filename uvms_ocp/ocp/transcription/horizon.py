"""Rows and costs of a whole horizon with their derivatives, made of the functions of its steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from uvms_ocp.ocp.transcription.sparse_blocks import Entries, assemble, scatter
from uvms_ocp.ocp.transcription.stage import Derivatives, StageModel
from uvms_ocp.ocp.transcription.term_rows import TermRows

_GRADIENTS = ["f", "g", "grad_gamma_x", "grad_gamma_p"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Block:
    """Terms at some nodes: their functions mapped, and where their rows begin among the raw rows."""

    rows: TermRows
    nodes: np.ndarray  # (n,)
    Z: ca.MX  # (n_z, n)
    S: ca.MX  # (n_parameters, n)
    first: int  # raw row
    last_node: bool  # only the state of the node is a variable

    @property
    def n_rows(self) -> int:
        return len(self.rows.level)

    @property
    def functions(self) -> Derivatives:
        return self.rows.functions

    @property
    def stop(self) -> int:
        return self.first + self.n_rows * len(self.nodes)

    def mapped(self, function: ca.Function, *more: ca.MX) -> ca.MX:
        """Outputs (m, n) of a function at all nodes."""
        n = len(self.nodes)
        wide = [item if item.shape[1] == n else ca.repmat(item, 1, n) for item in more]
        return function.map(n)(self.Z, self.S, *wide)


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon:
    """Raw rows: dynamics of all steps, the start, equal steps where durations are free, terms, costs of the levels."""

    model: StageModel
    x: ca.MX  # (n_x,)
    p: ca.MX  # (n_p,)
    Z: ca.MX  # (n_z, N) variables of the steps
    following: ca.MX  # (n_state, N) state at the end of each step
    water: ca.MX  # (3,) [m/s]
    blocks: tuple[Block, ...]
    columns: Callable[[int], np.ndarray]  # index in x of every entry of z at a node; -1 where it is no variable
    n_dynamics: int  # rows of dynamics per step
    free: bool  # durations are variables
    n_levels: int

    @property
    def N(self) -> int:
        return int(self.Z.shape[1])

    @property
    def n_x(self) -> int:
        return int(self.x.numel())

    @property
    def first_init(self) -> int:
        """First raw row of the start."""
        return self.N * self.n_dynamics

    @property
    def first_steps(self) -> int:
        """First raw row of the equal steps."""
        return self.first_init + self.model.robot.n_q + self.model.robot.n_v

    @property
    def first_cost(self) -> int:
        """First raw row of the costs."""
        return self.blocks[-1].stop

    @cached_property
    def rows(self) -> ca.MX:
        """All rows: dynamics, start, equal steps, terms, costs of the levels."""
        n_q_v = self.model.robot.n_q + self.model.robot.n_v
        values = self.model.dynamics.value.map(self.N)(self.Z, ca.repmat(self.water, 1, self.N))
        parts = [
            ca.vec(ca.vertcat(self.following[:n_q_v, :] - values[:n_q_v, :], values[n_q_v:, :])),
            self.Z[:n_q_v, 0] - self.p[:n_q_v],
        ]
        if self.free:
            h = self.Z[self.model.layout.h, :]
            parts.append((h[1:] - h[:-1]).T)
        parts += [ca.vec(block.mapped(block.functions.value)) for block in self.blocks]
        return ca.vertcat(*parts, self.costs)

    @cached_property
    def costs(self) -> ca.MX:
        """(n_levels,)"""
        return sum((ca.sum2(block.mapped(block.functions.costs)) for block in self.blocks), ca.MX.zeros(self.n_levels))

    def _gradient(self, sigma: ca.MX) -> ca.MX:
        """Gradient (n_x,) of ``sigma' costs``."""
        total = ca.MX.zeros(self.n_x)
        for block in self.blocks:
            values = ca.vec(block.mapped(block.functions.gradient, sigma))
            columns = np.concatenate([self.columns(int(k)) for k in block.nodes])
            total += scatter(values, columns, self.n_x)
        return total

    @cached_property
    def _jacobian_entries(self) -> list[Entries]:
        """Nonzeros of the raw rows, apart from those of the cost rows."""
        n_q_v = self.model.robot.n_q + self.model.robot.n_v
        J = self.model.dynamics
        rows, columns = (np.array(i) for i in J.jacobian_sparsity.get_triplet())
        sign = ca.DM(np.where(rows < n_q_v, -1.0, 1.0))
        nonzeros = J.jacobian.map(self.N)(self.Z, ca.repmat(self.water, 1, self.N)) * ca.repmat(sign, 1, self.N)
        entries = [
            self._placed(nonzeros, rows, columns, np.arange(self.N), 0, self.n_dynamics),
            *self._linear_entries(),
        ]
        for block in self.blocks:
            rows, columns = (np.array(i, dtype=int) for i in block.functions.jacobian_sparsity.get_triplet())
            if len(rows):
                nonzeros = block.mapped(block.functions.jacobian)
                entries.append(self._placed(nonzeros, rows, columns, block.nodes, block.first, block.n_rows))
        return entries

    def _linear_entries(self) -> list[Entries]:
        """Ones and minus ones: the next state, the start, equal steps."""
        n_q_v, k = self.model.robot.n_q + self.model.robot.n_v, np.arange(self.N)
        next_rows = (k[:, None] * self.n_dynamics + np.arange(n_q_v)).ravel()
        next_columns = np.concatenate([self.columns(int(i) + 1)[:n_q_v] for i in k])
        rows = [next_rows, self.first_init + np.arange(n_q_v)]
        columns = [next_columns, self.columns(0)[:n_q_v]]
        values = [np.ones(len(next_rows) + n_q_v)]
        if self.free:
            h = np.array([self.columns(int(i))[self.model.layout.h] for i in k])
            rows += [self.first_steps + k[:-1]] * 2
            columns += [h[1:], h[:-1]]
            values += [np.ones(self.N - 1), -np.ones(self.N - 1)]
        return [
            Entries(
                values=ca.MX(ca.DM(np.concatenate(values))), rows=np.concatenate(rows), columns=np.concatenate(columns)
            )
        ]

    def _placed(
        self, nonzeros: ca.MX, rows: np.ndarray, columns: np.ndarray, nodes: np.ndarray, first: int, m: int
    ) -> Entries:
        places = [self.columns(int(k))[columns] for k in nodes]
        numbers = [first + j * m + rows for j in range(len(nodes))]
        return Entries(values=ca.vec(nonzeros), rows=np.concatenate(numbers), columns=np.concatenate(places))

    def _hessian(self, sigma: ca.MX, lam: ca.MX) -> list[Entries]:
        """Groups of entries of the second derivative of ``sigma' costs + lam' raw``; groups overlap."""
        n_q_v = self.model.robot.n_q + self.model.robot.n_v
        lam_dynamics = ca.reshape(lam[: self.first_init], self.n_dynamics, self.N)
        signed = ca.vertcat(-lam_dynamics[:n_q_v, :], lam_dynamics[n_q_v:, :])
        H, none = self.model.dynamics, ca.MX(0, self.N)
        values = H.hessian.map(self.N)(self.Z, ca.repmat(self.water, 1, self.N), none, signed)
        entries = [self._square(values, H.hessian_sparsity, np.arange(self.N))] if H.hessian_sparsity.nnz() else []
        for block in self.blocks:
            sparsity = block.functions.hessian_sparsity
            if sparsity.nnz():
                own = ca.reshape(lam[block.first : block.stop], block.n_rows, len(block.nodes))
                values = block.mapped(block.functions.hessian, sigma, own)
                entries.append(self._square(values, sparsity, block.nodes))
        return entries

    def _square(self, nonzeros: ca.MX, sparsity: ca.Sparsity, nodes: np.ndarray) -> Entries:
        rows, columns = (np.array(i, dtype=int) for i in sparsity.get_triplet())
        places = [self.columns(int(k)) for k in nodes]
        return Entries(
            values=ca.vec(nonzeros),
            rows=np.concatenate([place[rows] for place in places]),
            columns=np.concatenate([place[columns] for place in places]),
        )

    def derivative_functions(self, index: int, raw_rows: np.ndarray, *, plugin: str) -> dict[str, ca.Function]:
        """What NLP solvers ask for, of the cost of one level and of the chosen rows."""
        x, p, n = self.x, self.p, self.n_levels
        f, g = self.costs[index], self.rows[raw_rows.tolist()]
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(raw_rows))
        position = np.full(self.first_cost + n, len(raw_rows))
        position[raw_rows] = np.arange(len(raw_rows))
        lam = ca.vertcat(lam_g, 0)[position.tolist()]
        sigma = lam[self.first_cost :] + lam_f * ca.DM(np.eye(n)[index])
        J = assemble(self._rows_of(raw_rows, position), (len(raw_rows), self.n_x))
        H = ca.MX(self.n_x, self.n_x)
        for entries in self._hessian(sigma, lam):
            H = H + assemble([entries], (self.n_x, self.n_x))
        gradient = self._gradient(ca.MX(ca.DM(np.eye(n)[index])))
        ipopt = plugin == "ipopt"
        inputs, dual = [x, p], ["x", "p", "lam_f", "lam_g"]
        slope = [f, gradient] if ipopt else [gradient]
        slope_of_all = self._gradient(sigma) + J.T @ lam_g
        curvature = [ca.triu(H)] if ipopt else [slope_of_all, H]
        names = ["triu_hess_gamma_x_x"] if ipopt else ["grad_gamma_x", "hess_gamma_x_x"]
        functions = (
            ca.Function("nlp_f", inputs, [f], dual[:2], ["f"]),
            ca.Function("nlp_g", inputs, [g], dual[:2], ["g"]),
            ca.Function("nlp_grad_f", inputs, slope, dual[:2], ["f", "grad_f_x"][-len(slope) :]),
            ca.Function("nlp_jac_g", inputs, [g, J], dual[:2], ["g", "jac_g_x"]),
            ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], curvature, dual, names),
            # Asked for at construction, never called: multipliers of parameters are off.
            ca.Function("nlp_grad", [x, p, lam_f, lam_g], [f, g, slope_of_all, ca.MX(p.shape[0], 1)], dual, _GRADIENTS),
        )
        return {function.name(): function for function in functions}

    def _rows_of(self, raw_rows: np.ndarray, position: np.ndarray) -> list[Entries]:
        """Entries of the chosen rows, renumbered; frozen costs add one dense row each."""
        chosen = [entries.selected(position, len(raw_rows)) for entries in self._jacobian_entries]
        for raw in raw_rows[raw_rows >= self.first_cost]:
            one = ca.MX(ca.DM(np.eye(self.n_levels)[raw - self.first_cost]))
            columns = np.arange(self.n_x)
            row = np.full(self.n_x, position[raw])
            chosen.append(Entries(values=self._gradient(one), rows=row, columns=columns))
        return chosen

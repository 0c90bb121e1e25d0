"""Rows and costs of a whole horizon with their derivatives, made of the functions of its steps.

Step functions are mapped over the horizon and their nonzeros are placed into the large matrices, so
that the derivatives of a horizon cost as much as those of its steps, and nothing is differentiated
twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from uvms_ocp.ocp.transcription.derivatives import Derivatives
from uvms_ocp.ocp.transcription.layout import BoundaryRows, RowLayout
from uvms_ocp.ocp.transcription.parameters import ParameterLayout
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.variables import NodeVariables, VariableLayout
from uvms_ocp.solvers.nlp.program import nlp_functions


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon:
    """Values and derivatives of all raw rows; see `uvms_ocp.ocp.transcription.layout`."""

    model: StageModel
    layout: RowLayout
    x: ca.MX
    """(n_x,) variables."""
    p: ca.MX
    """(n_p,) parameters."""
    nodes: NodeVariables
    columns: np.ndarray
    """(N + 1, n_z) see `VariableLayout.columns`"""
    dynamics: Block
    """Motion over the steps: the next state less what a step gives, then forces."""
    ends: Block
    """The first and the last state together, as one node."""
    blocks: tuple[Block, ...]
    """Terms."""

    @property
    def n_x(self) -> int:
        """Number of variables."""
        return int(self.x.numel())

    @property
    def n_levels(self) -> int:
        """Number of levels."""
        return len(self.layout.costs)

    @cached_property
    def rows(self) -> ca.MX:
        """(n_rows,) all raw rows."""
        n = self.layout.n_state
        end_and_forces = self.dynamics.mapped(self.dynamics.functions.value)
        gaps = self.nodes.following[:n, :] - end_and_forces[:n, :]
        dynamics = ca.vertcat(gaps, end_and_forces[n:, :])
        parts = [ca.vec(dynamics), self.ends.mapped(self.ends.functions.value)]
        h = self.nodes.steps[self.model.layout.h, :]
        if len(self.layout.equal_steps):
            parts.append((h[1:] - h[:-1]).T)
        if len(self.layout.total):
            parts.append(ca.sum2(h))
        for block in self.blocks:
            parts.append(ca.vec(block.mapped(block.functions.value)))
        return ca.vertcat(*parts, self.costs)

    @cached_property
    def costs(self) -> ca.MX:
        """(n_levels,) cost of each level."""
        costs = ca.MX.zeros(self.n_levels)
        for block in self.blocks:
            costs = costs + ca.sum2(block.mapped(block.functions.costs))
        return costs

    def derivative_functions(self, index: int, raw_rows: np.ndarray) -> dict[str, ca.Function]:
        """Build the functions that IPOPT needs, of the cost of one level and of the rows numbered
        raw_rows (m,).
        """
        m = len(raw_rows)
        of_level = ca.DM(np.eye(self.n_levels)[index])
        values = [self.costs[index], self.rows[raw_rows.tolist()]]
        lam_f = ca.MX.sym("lam_f")
        lam_g = ca.MX.sym("lam_g", m)
        position = np.full(self.layout.n_rows, m)
        position[raw_rows] = np.arange(m)
        lam = ca.vertcat(lam_g, 0)[position.tolist()]
        sigma = lam[self.layout.costs.tolist()] + lam_f * of_level
        gradient = self._gradient(ca.MX(of_level))
        J = assemble(self._entries_of_rows(raw_rows, position), (m, self.n_x))
        H = upper_triangle(self._hessian_entries(sigma, lam), self.n_x)
        return nlp_functions([self.x, self.p], values, [lam_f, lam_g], (gradient, J, H))

    def _gradient(self, sigma: ca.MX) -> ca.MX:
        """Return the gradient (n_x,) of ``sigma' costs``."""
        total = ca.MX.zeros(self.n_x)
        for block in self.blocks:
            rows = block.columns.ravel()
            entries = Entries(
                values=ca.vec(block.mapped(block.functions.gradient, sigma)),
                rows=rows,
                columns=np.where(rows >= 0, 0, -1),
            )
            total += ca.densify(assemble([entries], (self.n_x, 1)))
        return total

    def _entries_of_rows(self, raw_rows: np.ndarray, position: np.ndarray) -> list[Entries]:
        """Return the entries of the Jacobian of some rows, renumbered; frozen costs add one dense
        row each.

        position (n_rows,): index of every raw row among these.
        """
        m = len(raw_rows)
        selected = [entries.selected(position, m) for entries in self._jacobian_entries]
        for level, raw in enumerate(self.layout.costs):
            if position[raw] < m:
                of_level = ca.MX(ca.DM(np.eye(self.n_levels)[level]))
                row = np.full(self.n_x, position[raw])
                columns = np.arange(self.n_x)
                values = self._gradient(of_level)
                selected.append(Entries(values=values, rows=row, columns=columns))
        return selected

    @cached_property
    def _jacobian_entries(self) -> list[Entries]:
        """Nonzeros of the raw rows, apart from those of the cost rows."""
        entries = [self._linear_entries()]
        for block in (self.dynamics, self.ends, *self.blocks):
            sparsity = block.functions.jacobian_sparsity
            if not sparsity.nnz():
                continue
            nonzeros = block.mapped(block.functions.jacobian)
            if block is self.dynamics:
                rows = np.array(sparsity.get_triplet()[0])
                sign = np.where(rows < self.layout.n_state, -1.0, 1.0)
                nonzeros *= ca.repmat(ca.DM(sign), 1, len(block.columns))
            entries.append(_placed(nonzeros, sparsity, block.numbers, block.columns))
        return entries

    def _linear_entries(self) -> Entries:
        """Return ones and minus ones: the next state, equal steps, all steps."""
        layout = self.layout
        n = layout.n_state
        h = self.columns[:-1, self.model.layout.h]
        rows = [layout.dynamics[:, :n].ravel()]
        columns = [self.columns[1:, :n].ravel()]
        values = [np.ones(len(rows[0]))]
        if len(layout.equal_steps):
            n_equal = len(layout.equal_steps)
            rows += [layout.equal_steps, layout.equal_steps]
            columns += [h[1:], h[:-1]]
            values += [np.full(n_equal, 1.0), np.full(n_equal, -1.0)]
        if len(layout.total):
            rows.append(np.repeat(layout.total, len(h)))
            columns.append(h)
            values.append(np.ones(len(h)))
        return Entries(
            values=ca.MX(ca.DM(np.concatenate(values))),
            rows=np.concatenate(rows),
            columns=np.concatenate(columns),
        )

    def _hessian_entries(self, sigma: ca.MX, lam: ca.MX) -> list[Entries]:
        """Return the entries of the second derivative of ``sigma' costs + lam' raw``, which add
        up.
        """
        n = self.layout.n_state
        entries = []
        for block in (self.dynamics, self.ends, *self.blocks):
            if not block.functions.hessian_sparsity.nnz():
                continue
            block_lam = ca.reshape(lam[block.numbers.ravel().tolist()], *block.numbers.T.shape)
            if block is self.dynamics:
                block_lam = ca.vertcat(-block_lam[:n, :], block_lam[n:, :])
            entries.append(block.hessian(sigma, block_lam))
        return entries


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Block:
    """Rows of one kind: functions of one node, what they are called with at all of them, and where
    their rows are.
    """

    functions: Derivatives
    Z: ca.MX
    """(n_z, n) variables of each node."""
    S: ca.MX
    """(n_parameters, n) parameters of each node."""
    columns: np.ndarray
    """(n, n_z) see `VariableLayout.columns`"""
    numbers: np.ndarray
    """(n, m) raw rows of each node."""

    def mapped(self, function: ca.Function, *more: ca.MX) -> ca.MX:
        """Return the outputs (m, n) of a function at all nodes; more: further arguments, for each
        node or for all.
        """
        n = len(self.columns)
        more_of_nodes = []
        for argument in more:
            if argument.shape[1] != n:
                argument = ca.repmat(argument, 1, n)
            more_of_nodes.append(argument)
        return function.map(n)(self.Z, self.S, *more_of_nodes)

    def hessian(self, sigma: ca.MX, lam: ca.MX) -> Entries:
        """Return the entries of the second derivative of ``sigma' costs + lam' rows``, as far as it
        has costs; lam (m, n).
        """
        n_costs = self.functions.costs.numel_out(0)
        values = self.mapped(self.functions.hessian, sigma[:n_costs], lam)
        return _placed(values, self.functions.hessian_sparsity, self.columns, self.columns)


def horizon(
    variables: VariableLayout,
    parameters: ParameterLayout,
    layout: RowLayout,
    ends: BoundaryRows,
) -> Horizon:
    """Return symbols of the variables and parameters of a problem, and its rows in them."""
    x = ca.MX.sym("x", variables.n_x)
    p = ca.MX.sym("p", parameters.n)
    nodes = variables.nodes(x, p[parameters.steps])
    all_nodes = ca.horzcat(nodes.steps, nodes.last)
    columns = variables.all_columns
    blocks = []
    for term_block, own_parameters, numbers in zip(
        parameters.blocks, parameters.terms, layout.terms, strict=True
    ):
        first = int(term_block.nodes[0])
        last = int(term_block.nodes[-1])
        n_parameters = term_block.rows.n_parameters
        block = Block(
            functions=term_block.rows.functions,
            Z=all_nodes[:, first : last + 1],
            S=ca.reshape(p[own_parameters], n_parameters, len(term_block.nodes)),
            columns=columns[term_block.nodes],
            numbers=numbers,
        )
        blocks.append(block)
    dynamics = Block(
        functions=variables.model.dynamics,
        Z=nodes.steps,
        S=ca.reshape(p[parameters.water], 3, variables.N),
        columns=columns[:-1],
        numbers=layout.dynamics,
    )
    n = layout.n_state
    both_ends = Block(
        functions=ends.functions,
        Z=ca.vertcat(nodes.steps[:n, 0], nodes.last[:n]),
        S=p[parameters.start],
        columns=np.concatenate([columns[0, :n], columns[-1, :n]])[None],
        numbers=layout.start[None],
    )
    return Horizon(
        model=variables.model,
        layout=layout,
        x=x,
        p=p,
        nodes=nodes,
        columns=columns,
        dynamics=dynamics,
        ends=both_ends,
        blocks=tuple(blocks),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Entries:
    """Nonzeros of a large sparse matrix with their places; entries in a negative row or column
    count for nothing.
    """

    values: ca.MX
    """(n,) values."""
    rows: np.ndarray
    """(n,) row of each."""
    columns: np.ndarray
    """(n,) column of each."""

    def selected(self, position: np.ndarray, none: int) -> Entries:
        """Move row i to entry i of position (n_rows,); rows that are moved to `none` count for
        nothing.
        """
        rows = position[self.rows]
        columns = np.where(rows == none, -1, self.columns)
        return Entries(values=self.values, rows=rows, columns=columns)


def _placed(
    nonzeros: ca.MX, sparsity: ca.Sparsity, numbers: np.ndarray, columns: np.ndarray
) -> Entries:
    """Place nonzeros (nnz, n) of the same small matrix at n nodes, whose rows and columns are
    numbered (n, ...) in the whole.
    """
    small_rows, small_columns = sparsity.get_triplet()
    return Entries(
        values=ca.vec(nonzeros),
        rows=numbers[:, np.array(small_rows, dtype=int)].ravel(),
        columns=columns[:, np.array(small_columns, dtype=int)].ravel(),
    )


def assemble(entries: Sequence[Entries], shape: tuple[int, int]) -> ca.MX:
    """Return the matrix of all entries; no two may share a place."""
    rows = np.concatenate([item.rows for item in entries])
    columns = np.concatenate([item.columns for item in entries])
    inside = np.flatnonzero((rows >= 0) & (columns >= 0))
    order = inside[np.lexsort((rows[inside], columns[inside]))]
    column_sizes = np.bincount(columns[inside], minlength=shape[1])
    starts = np.concatenate([[0], np.cumsum(column_sizes)])
    sparsity = ca.Sparsity(*shape, starts.tolist(), rows[order].tolist())
    values = ca.vertcat(*(item.values for item in entries))
    return ca.MX(sparsity, values[order.tolist()])


def upper_triangle(entries: Sequence[Entries], n: int) -> ca.MX:
    """Return the upper triangle of the square matrix (n, n) of all entries, which add up where they
    share a place.
    """
    rows = np.concatenate([item.rows for item in entries])
    columns = np.concatenate([item.columns for item in entries])
    is_inside = (rows >= 0) & (columns >= 0)
    upper = np.flatnonzero(is_inside & (rows <= columns))
    flat_places = columns[upper].astype(np.int64) * n + rows[upper]
    places, place_of_entry = np.unique(flat_places, return_inverse=True)
    # One product instead of sums of large matrices, each of which would be gone through anew.
    sums = ca.DM.triplet(
        place_of_entry.tolist(), upper.tolist(), ca.DM.ones(len(upper)), len(places), len(rows)
    )
    sparsity = ca.Sparsity.triplet(n, n, (places % n).tolist(), (places // n).tolist())
    values = ca.vertcat(*(ca.densify(item.values) for item in entries))
    return ca.MX(sparsity, ca.densify(sums @ values))

"""Solve symmetric positive definite block-tridiagonal systems: one node of a trajectory per block.

`[A]` is the unit of the matrix, `[x]` that of a vector; entries may differ in theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.types import Array, Mask


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BlockTridiagonal:
    """A symmetric block-tridiagonal matrix, stored as its lower half."""

    diagonal: Array
    """(n, b, b) [A] blocks on the diagonal."""
    below: Array
    """(n - 1, b, b) [A] row node j + 1, column node j."""

    def __add__(self, other: BlockTridiagonal) -> BlockTridiagonal:
        return BlockTridiagonal(
            diagonal=self.diagonal + other.diagonal, below=self.below + other.below
        )

    def scaled(self, factor: float) -> BlockTridiagonal:
        """Return the matrix times a factor [any]."""
        return BlockTridiagonal(diagonal=factor * self.diagonal, below=factor * self.below)

    def times(self, x: Array) -> Array:
        """Compute the product (n, b) [A x] with x (n, b) [x]."""
        result = (self.diagonal @ x[..., None])[..., 0]
        result[1:] += (self.below @ x[:-1, :, None])[..., 0]
        result[:-1] += (self.below.transpose(0, 2, 1) @ x[1:, :, None])[..., 0]
        return result

    def pinned(self, free: Mask) -> BlockTridiagonal:
        """Return the matrix with the rows and columns of variables not free (n, b) replaced by
        those of the identity.
        """
        diagonal = self.diagonal * (free[:, :, None] & free[:, None, :])
        rows = np.arange(free.shape[1])
        diagonal[:, rows, rows] += ~free
        return BlockTridiagonal(
            diagonal=diagonal, below=self.below * (free[1:, :, None] & free[:-1, None, :])
        )

    def dense(self) -> Array:
        """Return the whole matrix (n b, n b) [A]."""
        n, b = self.diagonal.shape[:2]
        matrix = np.zeros((n, b, n, b))
        nodes = np.arange(n)
        matrix[nodes, :, nodes] = self.diagonal
        matrix[nodes[1:], :, nodes[:-1]] = self.below
        matrix[nodes[:-1], :, nodes[1:]] = self.below.transpose(0, 2, 1)
        return matrix.reshape(n * b, n * b)

    def cholesky(self) -> BlockCholesky | None:
        """Return the Cholesky factor, or None where the matrix is not positive definite."""
        from scipy.linalg import lapack  # a tenth of a second, which only those pay who plan

        factors = []
        couplings = []
        block = self.diagonal[0]
        for j in range(len(self.diagonal)):
            factor, info = lapack.dpotrf(block, lower=1, clean=1)
            if info:
                return None
            factors.append(factor)
            if j < len(self.below):
                coupling, _ = lapack.dtrtrs(factor, self.below[j].T, lower=1)
                couplings.append(coupling)
                block = self.diagonal[j + 1] - coupling.T @ coupling
        return BlockCholesky(factors=tuple(factors), couplings=tuple(couplings))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BlockCholesky:
    """Cholesky factor: lower blocks L_j on the diagonal, and C_j' below them."""

    factors: tuple[Array, ...]
    """(b, b) [A^1/2] L_j of each node."""
    couplings: tuple[Array, ...]
    """(b, b) [A^1/2] C_j of each node but the last."""

    def solve(self, right: Array) -> Array:
        """Return the solution (n, b) [x] for a right-hand side (n, b) [A x]."""
        return self.back(self._forward(right))

    def back(self, right: Array) -> Array:
        """Return the solution (n, b) [x] of L' x = right (n, b) [A^1/2 x].

        It turns white noise into samples of the covariance that is the inverse matrix.
        """
        from scipy.linalg import lapack

        x = np.empty_like(right)
        for j in range(len(self.factors) - 1, -1, -1):
            row = right[j]
            if j < len(self.couplings):
                row = row - self.couplings[j] @ x[j + 1]
            x[j] = lapack.dtrtrs(self.factors[j], row, lower=1, trans=1)[0]
        return x

    def _forward(self, right: Array) -> Array:
        from scipy.linalg import lapack

        y = np.empty_like(right)
        for j, factor in enumerate(self.factors):
            row = right[j]
            if j > 0:
                row = row - self.couplings[j - 1].T @ y[j - 1]
            y[j] = lapack.dtrtrs(factor, row, lower=1)[0]
        return y

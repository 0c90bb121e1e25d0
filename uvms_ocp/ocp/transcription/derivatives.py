"""Rows and costs as CasADi functions with sparse first and second derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import casadi as ca

from uvms_ocp.codegen.cache_entries import content_of
from uvms_ocp.codegen.compile import available_function, compiled_from


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Derivatives:
    """A vector function ``(z, s) -> rows`` of variables z and parameters s, with scalar costs and
    the derivatives of both.
    """

    value: ca.Function
    """``z, s -> rows``"""
    jacobian: ca.Function
    """``z, s -> nonzeros of d rows / dz``"""
    hessian: ca.Function
    """``z, s, sigma, lam -> nonzeros`` of the second derivative of ``sigma' costs + lam' rows``,
    upper and lower part.
    """
    costs: ca.Function
    """``z, s -> costs`` (n_costs,)"""
    gradient: ca.Function
    """``z, s, sigma -> gradient`` of ``sigma' costs``"""
    jacobian_sparsity: ca.Sparsity
    """Sparsity (m, n_z)."""
    hessian_sparsity: ca.Sparsity
    """Sparsity (n_z, n_z)."""


def derivatives(
    name: str,
    z: ca.SX,
    s: ca.SX,
    rows: ca.SX,
    *,
    costs: ca.SX | None = None,
    residuals: Sequence[ca.SX] | None = None,
) -> Derivatives:
    """Build the functions of rows (m,) and costs in z and s.

    residuals: vectors r whose ``1/2 |r|^2`` are the costs; with them, the Hessian is that of Gauss
    and Newton, without the curvature of residuals and rows.
    """
    c = ca.SX(0, 1) if costs is None else costs
    sigma = ca.SX.sym("sigma", c.shape[0])
    lam = ca.SX.sym("lam", rows.shape[0])
    J = ca.jacobian(rows, z)
    if c.numel():
        gradient = ca.gradient(ca.dot(sigma, c), z)
    else:
        gradient = ca.SX.zeros(z.shape)
    if residuals is None:
        lagrangian = ca.dot(sigma, c) + ca.dot(lam, rows)
        H = ca.hessian(lagrangian, z)[0]
    else:
        H = _gauss_newton(residuals, sigma, z)

    def function(kind: str, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
        # Rows already share their common subexpressions: to search for more would double the time
        # for functions that are 4 % faster.
        return ca.Function(f"{name}_{kind}", inputs, [ca.densify(output)])

    return Derivatives(
        value=function("value", [z, s], rows),
        jacobian=function("jacobian", [z, s], _nonzeros(J)),
        hessian=function("hessian", [z, s, sigma, lam], _nonzeros(H)),
        costs=function("costs", [z, s], c),
        gradient=function("gradient", [z, s, sigma], gradient),
        jacobian_sparsity=J.sparsity(),
        hessian_sparsity=H.sparsity(),
    )


def _gauss_newton(residuals: Sequence[ca.SX], sigma: ca.SX, z: ca.SX) -> ca.SX:
    """Return the Hessian of Gauss and Newton, of costs weighted by sigma (n_costs,)."""
    H = ca.SX(z.shape[0], z.shape[0])
    for i, residual in enumerate(residuals):
        J = ca.jacobian(residual, z)
        H += sigma[i] * (J.T @ J)
    return H


def _nonzeros(matrix: ca.SX) -> ca.SX:
    """Return the nonzeros of a matrix as a column."""
    return ca.vertcat(ca.SX(0, 1), *matrix.nonzeros())


def compiled_derivatives(
    name: str,
    z: ca.SX,
    s: ca.SX,
    rows: ca.SX,
    *,
    costs: ca.SX | None = None,
    residuals: Sequence[ca.SX] | None = None,
) -> Derivatives:
    """Build `derivatives` in machine code where a C compiler exists; those that were compiled before
    are taken from the cache.
    """
    outputs = [rows]
    if costs is not None:
        outputs.append(costs)
    if residuals is not None:
        outputs.extend(residuals)
    content = content_of([z, s], outputs, costs is None, residuals is None)

    @cache
    def build() -> Derivatives:
        return derivatives(name, z, s, rows, costs=costs, residuals=residuals)

    def build_kind(kind: str) -> ca.Function:
        return getattr(build(), kind)

    def build_patterns() -> ca.Function:
        jacobian = ca.SX(build().jacobian_sparsity, 1)
        hessian = ca.SX(build().hessian_sparsity, 1)
        return ca.Function(f"{name}_patterns", [], [jacobian, hessian])

    # They compile at the same time: all are begun before the first one is waited for.
    compiling = {}
    for kind in ("value", "jacobian", "hessian", "costs", "gradient"):
        compiling[kind] = compiled_from(
            f"{name}_{kind}", content, partial(build_kind, kind), __file__
        )
    patterns = available_function(
        compiled_from(f"{name}_patterns", content, build_patterns, __file__)
    )
    return Derivatives(
        **{kind: available_function(function) for kind, function in compiling.items()},
        jacobian_sparsity=patterns.sparsity_out(0),
        hessian_sparsity=patterns.sparsity_out(1),
    )

"""Rows that tie the ends of the horizon: the first state is given, or near the given one, and may be the last one too."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.model.symbolic.tree import SymbolicModel
from uvms_ocp.ocp.problem import HessianKind
from uvms_ocp.ocp.transcription.stage import Derivatives, StageModel, derivatives

START, PERIODIC = "start", "periodic"
"""Names of the rows, in reports."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Boundary:
    """Rows of the first and the last state ``[q_0, v_0, q_N, v_N]``; the given state ``[q, v]`` is their parameter."""

    functions: Derivatives
    lower: np.ndarray
    """(m,) [m, rad, m/s, rad/s, -]"""
    upper: np.ndarray
    """(m,) [m, rad, m/s, rad/s, -]"""
    names: tuple[str, ...]
    """(m,)"""
    coupled: bool
    """The rows tie the last state to the first."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Ends:
    """Symbols of one state each."""

    first: ca.SX
    last: ca.SX
    given: ca.SX


def boundary(model: StageModel) -> Boundary:
    """Of the model's problem: `OcpProblem.start_freedom` and `OcpProblem.periodic`."""
    problem, n = model.problem, model.layout.h
    ends = _Ends(first=ca.SX.sym("first", n), last=ca.SX.sym("last", n), given=ca.SX.sym("given", n))
    parts = [(START, *_given(model, ends))] + ([(PERIODIC, *_closed(model, ends))] if problem.periodic else [])
    rows = ca.vertcat(*(rows for _, rows, _ in parts))
    width = np.concatenate([width for _, _, width in parts])
    residuals = None if problem.hessian is HessianKind.EXACT else ()
    return Boundary(
        functions=derivatives("boundary", ca.vertcat(ends.first, ends.last), ends.given, rows, residuals=residuals),
        lower=-width,
        upper=width,
        names=tuple(name for name, part, _ in parts for _ in range(part.numel())),
        coupled=problem.periodic,
    )


def _given(model: StageModel, ends: _Ends) -> tuple[ca.SX, np.ndarray]:
    """Rows of the first state, and by how much each may differ from 0."""
    freedom = model.problem.start_freedom
    if freedom is None:
        rows = ends.first - ends.given
        return rows, np.zeros(rows.numel())
    norms = _norms(model, ends.first)
    rows = ca.vertcat(_difference(model, ends.given, ends.first), norms)
    return rows, np.concatenate([freedom, np.zeros(norms.numel())])


def _closed(model: StageModel, ends: _Ends) -> tuple[ca.SX, np.ndarray]:
    """By axes: the integration keeps the norm of a quaternion, and a row for it would say nothing."""
    rows = _difference(model, ends.first, ends.last)
    return rows, np.zeros(rows.numel())


def _difference(model: StageModel, one: ca.SX, other: ca.SX) -> ca.SX:
    """(2 n_v,) from one state to another."""
    n, tree = model.robot.n_q, SymbolicModel(model.robot.model)
    return ca.vertcat(tree.difference(one[:n], other[:n]), other[n:] - one[n:])


def _norms(model: StageModel, state: ca.SX) -> ca.SX:
    """Of the quaternion of a vehicle, and of the cosine and sine of joints that turn without an end, less 1."""
    parts = [slice(3, 7)] if model.robot.n_vehicle else []
    parts += [slice(joint.q.stop - 2, joint.q.stop) for joint in model.robot.joints if joint.n_q > joint.n_v]
    return ca.vertcat(ca.SX(0, 1), *(ca.sumsqr(state[part]) - 1 for part in parts))

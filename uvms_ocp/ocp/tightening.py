"""Ask more of nodes where ranges are left between them.

One mechanism for every kind of range: by how much it is left inside a step, that much more is asked
of the nodes at both ends, or of the forces of the step; where something thin is passed through
between two nodes, whose distance from it says nothing of that, both stay on one side of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uvms_ocp.ocp.motion_scan import finite_excess
from uvms_ocp.ocp.node_margins import NodeMargins, Side, Tightening
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.range_check import RangeCheck, RangeKind
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.types import Array

KEPT = 2e-4
"""[unit of the quantity] By how much a range may be left between nodes."""
FORCE_KEPT = 1e-2
"""Share of its largest force by which a thruster or a joint may pass it inside a step, whose forces
are those at its middle.
"""
_MORE = 1.2  # times what is missing is what nodes are asked for more
_LEAST_EFFECT = 0.2  # of that, at which what is missing is taken to shrink
_POOR = 0.5  # share of that, below which nodes stay on one side instead
_BESIDE = 2  # nodes beyond both ends of a step that are asked as well, for shapes: planes change
_SHORT = 1e-3  # of a step, after which it is seen where something goes

_PARTS = {
    RangeKind.POSITION: "positions",
    RangeKind.THRUST: "thrust",
    RangeKind.TORQUE: "torque",
}
_OF_STEPS = (RangeKind.THRUST, RangeKind.TORQUE)


def missing_between(checks: Sequence[RangeCheck]) -> list[RangeCheck]:
    """Select what is left between nodes by more than is allowed, as far as nodes can be asked for
    more: velocities and accelerations are never larger there than at nodes.
    """
    kinds = (*_PARTS, RangeKind.TERM, RangeKind.CLEARANCE)
    return [item for item in checks if item.kind in kinds and _amount(item) > 0.0]


def lack(checks: Sequence[RangeCheck]) -> float:
    """By how much more than is allowed ranges are left between nodes, as a multiple of that; 0
    where none is.
    """
    amounts = [np.maximum(*_missing(item)) / allowance(item) for item in missing_between(checks)]
    return max((float(amount.max()) for amount in amounts), default=0.0)


def allowance(item: RangeCheck) -> Array:
    """(m,) [unit of the quantity] By how much ranges may be left between nodes."""
    if item.kind not in _OF_STEPS:
        return np.full(len(item.lower), KEPT)
    largest = np.maximum(np.abs(item.lower), np.abs(item.upper))
    return FORCE_KEPT * np.where(np.isfinite(largest), largest, 1.0)


def _missing(item: RangeCheck) -> tuple[Array, Array]:
    """(N, m) [unit of the quantity] Below and above, of ranges with an inside, where it is a number
    and more than is allowed.
    """
    has_inside = item.upper > item.lower
    counts = has_inside & (np.maximum(item.below, item.above) > allowance(item))
    parts = (finite_excess(item.below), finite_excess(item.above))
    return np.where(counts, parts[0], 0.0), np.where(counts, parts[1], 0.0)


def _amount(item: RangeCheck) -> float:
    return max(float(part.max(initial=0.0)) for part in _missing(item))


def tightened(
    before: Tightening,
    missing: Sequence[RangeCheck],
    problem: OcpProblem,
    path: Trajectory,
    t0: float,
) -> Tightening:
    """Ask for more where something is missing along `path`, which was found with what was asked
    for before; t0 [s] is the time of its first node.
    """
    after = before
    for item in missing:
        if item.term is None:
            name = _PARTS[item.kind]
            old = getattr(before, name)
            parts: dict[str, Any] = {name: _asked(old, item, problem)}
            after = replace(after, **parts)
            continue
        old = before.terms.get(item.term)
        more = _asked(old, item, problem)
        if item.term.has_sides:
            in_vain = old is not None and _effect(old, item) < _POOR
            sides = _new_sides(item, more, path, problem, t0, whatever_binds=in_vain)
            more = replace(more, sides=(*more.sides, *sides))
        after = replace(after, terms={**after.terms, item.term: more})
    return after


def _asked(old: NodeMargins | None, item: RangeCheck, problem: OcpProblem) -> NodeMargins:
    """Add what is missing inside every step to what was asked of its nodes."""
    amount = _amount(item)
    has_sides = item.term is not None and item.term.has_sides
    if old is None or has_sides:
        effect = 1.0
    else:
        effect = _effect(old, item)
    factor = _MORE / effect
    below, above = (factor * _at_nodes(part, item) for part in _missing(item))
    sides: tuple[Side, ...] = ()
    if old is not None:
        below = below + old.below
        above = above + old.above
        sides = old.sides
    return NodeMargins(
        robot=problem.robot,
        below=below,
        above=above,
        sides=sides,
        missing=amount,
        asked=factor * amount,
    )


def _effect(old: NodeMargins, item: RangeCheck) -> float:
    """By how much what is missing shrank for each unit that was asked for more."""
    return float(np.clip((old.missing - _amount(item)) / old.asked, _LEAST_EFFECT, 1.0))


def _at_nodes(amounts: Array, item: RangeCheck) -> Array:
    """(N + 1, m) The largest of amounts (N, m) of the steps that begin or end at a node, and of
    shapes beside these.
    """
    shapes = isinstance(item.term, ShapeClearance)
    reach = 1 + _BESIDE * int(shapes)
    if item.kind in _OF_STEPS:
        shifts = range(1)
    else:
        shifts = range(1 - reach, 1 + reach)
    n = len(amounts)
    result = np.zeros((n + 1, amounts.shape[1]))
    for shift in shifts:
        nodes = np.arange(n) + shift
        inside = (nodes >= 0) & (nodes <= n)
        np.maximum.at(result, nodes[inside], amounts[inside])
    if shapes:
        result[-1] = 0.0  # whose place is the goal's
    return result


def _new_sides(
    item: RangeCheck,
    more: NodeMargins,
    path: Trajectory,
    problem: OcpProblem,
    t0: float,
    *,
    whatever_binds: bool,
) -> list[Side]:
    """Sides for what lies between two nodes that both keep more from it than they are asked for."""
    known = {(side.node, side.row) for side in more.sides}
    result = []
    for k, row in np.argwhere(_missing(item)[0]).tolist():
        ends = [k, k + 1]
        binds = any(item.slack[node, row] <= more.below[node, row] for node in ends)
        nodes = [n for n in ends if 0 < n < len(path.a) and (n, row) not in known]
        if whatever_binds or not binds:
            result += [_side(node, k, row, item, path, problem, t0) for node in nodes]
    return result


def _side(
    node: int, k: int, row: int, item: RangeCheck, path: Trajectory, problem: OcpProblem, t0: float
) -> Side:
    model = problem.robot.model
    moment = float(item.times[k, row])
    later = moment + _SHORT * float(path.t[k + 1] - path.t[k])
    clock = np.interp([moment, later], path.t, problem.nominal_times())
    return Side(
        node=node,
        row=row,
        time=t0 + float(clock[0]),
        q=path.state_at(model, moment)[0],
        later=t0 + float(clock[1]),
        q_later=path.state_at(model, later)[0],
    )

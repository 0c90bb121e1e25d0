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
"""[unit of the quantity] by how much a range may be left between nodes."""
FORCE_KEPT = 1e-2
"""Share of its largest force by which a thruster or a joint may pass it inside a step, whose forces
are those at its middle.
"""
_OVERSHOOT = 1.2  # times what is missing is what nodes are asked for more
_SMALLEST_EFFECT = 0.2  # share of what is asked for more, by which what is missing shrinks at least
_POOR_EFFECT = 0.5  # share below which nodes stay on one side instead
_NEIGHBOURS = (
    2  # nodes beyond both ends of a step that are asked as well, for shapes: planes change
)
_SHORT = 1e-3  # share of a step, after which it is seen where something goes

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
    """Return by how much more than is allowed ranges are left between nodes, as a multiple of that;
    0 where none is.
    """
    largest = 0.0
    for item in missing_between(checks):
        multiples = np.maximum(*_missing(item)) / allowance(item)
        largest = max(largest, float(multiples.max()))
    return largest


def allowance(item: RangeCheck) -> Array:
    """Return by how much (m,) [unit of the quantity] ranges may be left between nodes."""
    if item.kind not in _OF_STEPS:
        return np.full(len(item.lower), KEPT)
    largest = np.maximum(np.abs(item.lower), np.abs(item.upper))
    return FORCE_KEPT * np.where(np.isfinite(largest), largest, 1.0)


def _missing(item: RangeCheck) -> tuple[Array, Array]:
    """Return what is missing below and above (N, m) [unit of the quantity], of ranges with an
    inside, where it is a number and more than is allowed.
    """
    has_inside = item.upper > item.lower
    counts = has_inside & (np.maximum(item.below, item.above) > allowance(item))
    below = np.where(counts, finite_excess(item.below), 0.0)
    above = np.where(counts, finite_excess(item.above), 0.0)
    return below, above


def _amount(item: RangeCheck) -> float:
    """Return the largest amount [unit of the quantity] that is missing."""
    below, above = _missing(item)
    return max(float(below.max(initial=0.0)), float(above.max(initial=0.0)))


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
            margins = _wider_margins(getattr(before, name), item, problem)
            parts: dict[str, Any] = {name: margins}
            after = replace(after, **parts)
            continue
        margins_before = before.terms.get(item.term)
        margins = _wider_margins(margins_before, item, problem)
        if item.term.has_sides:
            was_in_vain = (
                margins_before is not None and _effect(margins_before, item) < _POOR_EFFECT
            )
            sides = _new_sides(item, margins, path, problem, t0, whatever_binds=was_in_vain)
            margins = replace(margins, sides=(*margins.sides, *sides))
        after = replace(after, terms={**after.terms, item.term: margins})
    return after


def _wider_margins(
    before: NodeMargins | None, item: RangeCheck, problem: OcpProblem
) -> NodeMargins:
    """Add what is missing inside every step to what was asked of its nodes."""
    amount = _amount(item)
    has_sides = item.term is not None and item.term.has_sides
    effect = 1.0
    if before is not None and not has_sides:
        effect = _effect(before, item)
    factor = _OVERSHOOT / effect
    missing_below, missing_above = _missing(item)
    below = factor * _at_nodes(missing_below, item)
    above = factor * _at_nodes(missing_above, item)
    sides: tuple[Side, ...] = ()
    if before is not None:
        below = below + before.below
        above = above + before.above
        sides = before.sides
    return NodeMargins(
        robot=problem.robot,
        below=below,
        above=above,
        sides=sides,
        missing=amount,
        requested=factor * amount,
    )


def _effect(before: NodeMargins, item: RangeCheck) -> float:
    """Return by how much what is missing shrank for each unit that was asked for more."""
    shrinkage = before.missing - _amount(item)
    return float(np.clip(shrinkage / before.requested, _SMALLEST_EFFECT, 1.0))


def _at_nodes(amounts: Array, item: RangeCheck) -> Array:
    """Return the largest of amounts (N, m) of the steps that begin or end at a node (N + 1, m), and
    of shapes beside these.
    """
    is_of_shapes = isinstance(item.term, ShapeClearance)
    reach = 1 + _NEIGHBOURS if is_of_shapes else 1
    if item.kind in _OF_STEPS:
        shifts = range(1)
    else:
        shifts = range(1 - reach, 1 + reach)
    n = len(amounts)
    result = np.zeros((n + 1, amounts.shape[1]))
    for shift in shifts:
        nodes = np.arange(n) + shift
        is_inside = (nodes >= 0) & (nodes <= n)
        np.maximum.at(result, nodes[is_inside], amounts[is_inside])
    if is_of_shapes:
        result[-1] = 0.0  # whose place is the goal's
    return result


def _new_sides(
    item: RangeCheck,
    margins: NodeMargins,
    path: Trajectory,
    problem: OcpProblem,
    t0: float,
    *,
    whatever_binds: bool,
) -> list[Side]:
    """Return sides for what lies between two nodes that both keep more from it than they are asked
    for.
    """
    with_side = {(side.node, side.row) for side in margins.sides}
    missing_below, _ = _missing(item)
    sides = []
    for k, row in np.argwhere(missing_below).tolist():
        ends = (k, k + 1)
        binds = any(item.slack[node, row] <= margins.below[node, row] for node in ends)
        if binds and not whatever_binds:
            continue
        for node in ends:
            is_inner = 0 < node < len(path.a)
            if is_inner and (node, row) not in with_side:
                sides.append(_side(node, k, row, item, path, problem, t0))
    return sides


def _side(
    node: int, k: int, row: int, item: RangeCheck, path: Trajectory, problem: OcpProblem, t0: float
) -> Side:
    """Return the side of a node on which the motion is where something is missing most in step
    k.
    """
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

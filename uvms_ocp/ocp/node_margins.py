"""What is asked of nodes beyond their ranges, so that these are kept between nodes too.

`uvms_ocp.ocp.tightening` finds it; the transcription narrows limits and rows by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from uvms_ocp.robot.robot import Robot
from uvms_ocp.types import Array, Indices

if TYPE_CHECKING:
    from uvms_ocp.ocp.terms import Term

_MOST = 0.45
"""Share of a range that either end may give up: the other has as much, and an inside remains."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Side:
    """A moment between nodes at which something thin is nearest: on the side on which it is passed
    there, the node stays.
    """

    node: int
    """Among those of the margins."""
    row: int
    """Among the quantities of the term."""
    time: float
    """[s] of the moment, as references are asked for it."""
    q: Array
    """(n_q,) [m, rad] at the moment."""
    later: float
    """[s] shortly after it."""
    q_later: Array
    """(n_q,) [m, rad] shortly after it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NodeMargins:
    """By how much the quantities of one kind stay inside their ranges, node by node."""

    robot: Robot
    below: Array
    """(n_nodes, m) [unit of the quantity] above its lower end."""
    above: Array
    """(n_nodes, m) [unit of the quantity] below its upper end."""
    sides: tuple[Side, ...] = ()
    missing: float = 0.0
    """[unit of the quantity] What was missing between nodes when they were last asked for more."""
    asked: float = 0.0
    """[unit of the quantity] By how much more they were asked then."""

    def at(self, nodes: Indices) -> NodeMargins:
        """Select consecutive nodes (n,)."""
        if len(nodes):
            first = int(nodes[0])
        else:
            first = 0
        sides = tuple(
            replace(side, node=side.node - first)
            for side in self.sides
            if first <= side.node < first + len(nodes)
        )
        return replace(self, below=self.below[nodes], above=self.above[nodes], sides=sides)

    def narrowed(self, lower: Array, upper: Array, unit: Array) -> tuple[Array, Array]:
        """Ends (n_nodes, m) [unit] of ranges lower and upper (n_nodes, m) [unit], for quantities of
        which one is `unit` (m,); those that are equalities stay so.
        """
        width = upper - lower
        most = np.where(np.isfinite(width), _MOST * np.maximum(width, 0.0), np.inf)
        return (
            lower + np.minimum(self.below * unit, most),
            upper - np.minimum(self.above * unit, most),
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Tightening:
    """Margins that are asked of all nodes of a horizon."""

    positions: NodeMargins | None = None
    """Margins of `Robot.limited_positions`."""
    thrust: NodeMargins | None = None
    """[N] of the steps that begin at the nodes."""
    torque: NodeMargins | None = None
    """[N m, N] of the steps that begin at the nodes."""
    terms: Mapping[Term, NodeMargins] = field(default_factory=dict)
    """Margins of the rows of constraints, of shapes of their pairs."""

    @property
    def nothing(self) -> bool:
        """True where no node is asked for more."""
        return not self.terms and not self.limits

    @property
    def limits(self) -> bool:
        """Limits of the robot are narrower."""
        return any(part is not None for part in (self.positions, self.thrust, self.torque))


NO_TIGHTENING = Tightening()

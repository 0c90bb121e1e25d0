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

_LARGEST_SHARE = 0.45
"""Share of a range that either end may give up: the other has as much, and an inside remains."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Side:
    """A moment between nodes at which something thin is nearest: on the side on which it is passed
    there, the node stays.
    """

    node: int
    """Index of the node among those of the margins."""
    row: int
    """Index of the quantity among those of the term."""
    time: float
    """[s] the moment, as references are asked for it."""
    q: Array
    """(n_q,) [m, rad] configuration at the moment."""
    later: float
    """[s] shortly after the moment."""
    q_later: Array
    """(n_q,) [m, rad] configuration shortly after the moment."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NodeMargins:
    """Margins of the quantities of one kind inside their ranges, node by node."""

    robot: Robot
    below: Array
    """(n_nodes, m) [unit of the quantity] margins inside the lower ends."""
    above: Array
    """(n_nodes, m) [unit of the quantity] margins inside the upper ends."""
    sides: tuple[Side, ...] = ()
    """Sides on which nodes pass thin things."""
    missing: float = 0.0
    """[unit of the quantity] Excess between nodes when margins were last raised."""
    requested: float = 0.0
    """[unit of the quantity] Rise of the margins at that time."""

    def at(self, nodes: Indices) -> NodeMargins:
        """Select consecutive nodes (n,)."""
        first = int(nodes[0]) if len(nodes) else 0
        sides = []
        for side in self.sides:
            node = side.node - first
            if 0 <= node < len(nodes):
                sides.append(replace(side, node=node))
        return replace(self, below=self.below[nodes], above=self.above[nodes], sides=tuple(sides))

    def narrowed(self, lower: Array, upper: Array, unit: Array) -> tuple[Array, Array]:
        """Narrow ranges lower and upper (n_nodes, m) [unit], for quantities of which one is `unit`
        (m,); those that are equalities stay so.
        """
        width = upper - lower
        share = _LARGEST_SHARE * np.maximum(width, 0.0)
        largest = np.where(np.isfinite(width), share, np.inf)
        narrow_lower = lower + np.minimum(self.below * unit, largest)
        narrow_upper = upper - np.minimum(self.above * unit, largest)
        return narrow_lower, narrow_upper


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Tightening:
    """Margins that are asked of all nodes of a horizon."""

    positions: NodeMargins | None = None
    """[m, rad] margins of `Robot.limited_positions`."""
    thrust: NodeMargins | None = None
    """[N] margins of the steps that begin at the nodes."""
    torque: NodeMargins | None = None
    """[N m, N] margins of the steps that begin at the nodes."""
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

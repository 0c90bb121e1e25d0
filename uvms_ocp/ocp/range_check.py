"""By how much the quantities of one kind leave their ranges along a motion: results of a check."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from uvms_ocp.ocp.terms import Term
from uvms_ocp.types import Array


class RangeKind(Enum):
    """Kind of the quantities that have a range."""

    START = "start"
    PERIODIC = "periodic"
    DURATION = "duration"
    MOTION = "motion"
    """The next node is where the acceleration leads."""
    FORCES = "forces"
    """Thrust and torque at the middle of a step are those that the motion takes."""
    POSITION = "position limits"
    VELOCITY = "velocity limits"
    ACCELERATION = "acceleration limits"
    THRUST = "thrust limits"
    TORQUE = "torque limits"
    TERM = "constraint"
    CLEARANCE = "clearance of shapes"


@dataclass(frozen=True, kw_only=True, slots=True)
class Peak:
    """The largest amount by which ranges of one kind are left."""

    amount: float
    """[unit of the quantity] 0 where none is left, infinite where a number is none."""
    time: float
    """[s] since the first node."""
    quantity: str
    """Name of the quantity; empty where none is left."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RangeCheck:
    """Result of a check of one kind of range: by how much its quantities leave it."""

    kind: RangeKind
    term: Term | None = None
    """Constraint whose rows these are."""
    name: str
    """Name of the range, for reports."""
    unit: str
    quantities: tuple[str, ...]
    """(m,) names."""
    at_nodes: Peak
    """Peak at nodes; of thrust, torque and forces at the middle of the steps, where they are given.
    """
    between: Peak
    """Peak anywhere else."""
    resolution: float
    """[unit of the quantity] By how much more than `between` it may be where nobody looked: 0 where
    peaks are exact, a bound for shapes that nothing else moves, else an estimate by curvature.
    """
    below: Array
    """(N, m) [unit of the quantity] the largest amount below the range inside each step."""
    above: Array
    """(N, m) [unit of the quantity] the largest amount above the range inside each step."""
    times: Array
    """(N, m) [s] since the first node, of the larger of the two."""
    slack: Array
    """(N + 1, m) [unit of the quantity] how far inside it is at the nodes, negative outside;
    infinite at those where it does not count.
    """
    lower: Array
    """(m,) [unit of the quantity] lower ends of the ranges."""
    upper: Array
    """(m,) [unit of the quantity] upper ends of the ranges."""

    @property
    def worst(self) -> Peak:
        """The larger of the two peaks."""
        return max(self.at_nodes, self.between, key=lambda peak: peak.amount)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MotionCheck:
    """Result of the check of a motion."""

    ranges: tuple[RangeCheck, ...]
    """One for each kind that the problem has, and for each constraint."""
    time_resolution: float
    """[s] Between two looks inside a step, at most; where ranges are near it looks closer."""

    def of(self, *kinds: RangeKind) -> tuple[RangeCheck, ...]:
        """Select the ranges of some kinds."""
        return tuple(item for item in self.ranges if item.kind in kinds)

    def beyond(self, tolerance: float) -> tuple[RangeCheck, ...]:
        """Select the ranges that are left by more than a tolerance [unit of the quantity]
        anywhere.
        """
        return tuple(item for item in self.ranges if not item.worst.amount <= tolerance)

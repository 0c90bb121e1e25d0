"""The viability rule: a velocity is accepted only if a full stop from it respects every limit on positions.

A velocity that is refused gives way to the one nearest to it, on the way to the stop's own next velocity, from which the
stop is clear. That next velocity was part of the stop that the tick before accepted, so that from a viable state there is
always an answer, whatever the hierarchy asks for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.control.velocity.stop import Stop
from uvms_ocp.model.limits import PositionLimit
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.limits import ENDLESS
from uvms_ocp.tasks.task import Task

_HALVINGS = 5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Kept:
    """What the rule makes of a velocity."""

    v: np.ndarray
    """(n_v,) [m/s, rad/s] for this tick."""
    share: float
    """[-] in [0, 1], of the velocity that was wanted; the rest is slowing down."""
    near: bool
    """A stop from the wanted velocity could come to a limit."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Guard:
    """A limit of one task, and where its measured quantity is."""

    limit: PositionLimit
    """As its task has it."""
    task: int
    """Index in the hierarchy."""
    quantity: int
    """Index in the vector of quantities."""
    reach: np.ndarray
    """(n_v,) finite, of the limit [m, or 1]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Barrier:
    """A limit at one tick: its slack stays at or above a floor along the stop."""

    slack: Callable[[np.ndarray], np.ndarray]
    """Function of q (n_q,): how far the m positions that matter are above the limit (m,) [m]."""
    floor: np.ndarray
    """(m,) [m]"""
    room: float
    """[m] by which all positions are above the floor now."""
    reach: np.ndarray
    """(n_v,) as that of the guard."""


class Viability:
    """The rule for a robot and the tasks of its hierarchy."""

    def __init__(self, *, robot: Robot, tasks: Sequence[Task], quantity_names: Sequence[str], dt: float) -> None:
        """dt [s]: control period. quantity_names: of the vector of quantities, "task.quantity"."""
        self.stop, self._dt = Stop(robot, dt), dt
        self._guards = [
            _Guard(
                limit=limit,
                task=index,
                quantity=quantity_names.index(f"{task.name}.{limit.quantity}"),
                reach=np.fmin(limit.reach, ENDLESS),
            )
            for index, task in enumerate(tasks)
            if (limit := task.position_limit(robot)) is not None
        ]

    def kept(
        self, *, q: np.ndarray, previous: np.ndarray, wanted: np.ndarray, gates: np.ndarray, quantities: np.ndarray
    ) -> Kept:
        """The velocity for this tick in place of `wanted` (n_v,) [m/s, rad/s].

        q (n_q,) [m, rad]: now. previous (n_v,) [m/s, rad/s]: of the tick before. gates (n_tasks,) [-]: a limit counts while
        its task is on at all. quantities (n_quantities,) [in their units]: as measured at q. A position that the stop from
        `previous` would not keep either may fall as far as it does there, no farther.
        """
        travel = self.stop.travel(wanted)
        if not self._within(travel, gates, quantities):
            return Kept(v=wanted, share=1.0, near=False)
        slower = self.stop.slower(q, previous)
        # Of every mixture of the two: it may be as fast as the one and need as long to rest as the other.
        travel = self.stop.travel(np.maximum(np.abs(wanted), np.abs(slower)))
        near = self._within(travel, gates, quantities)
        barriers = [_barrier(guard, q, travel, float(quantities[guard.quantity])) for guard in near]
        if self._clear(barriers, q, wanted):
            return Kept(v=wanted, share=1.0, near=True)
        barriers = self._lowered(barriers, q, slower)
        share = _largest_share(lambda s: self._clear(barriers, q, slower + s * (wanted - slower)))
        return Kept(v=slower + share * (wanted - slower), share=share, near=True)

    def _within(self, travel: np.ndarray, gates: np.ndarray, quantities: np.ndarray) -> list[_Guard]:
        """Guards of the limits that count and that some position may come to while each axis moves by `travel` (n_v,)."""
        return [
            guard
            for guard in self._guards
            if gates[guard.task] > 0 and quantities[guard.quantity] - guard.limit.lower <= guard.reach @ travel
        ]

    def _lowered(self, barriers: Sequence[_Barrier], q: np.ndarray, v: np.ndarray) -> list[_Barrier]:
        """With floors where the stop from v leads, if that is below the limit."""
        configurations = [row for row, _ in self.stop.path(q, v)]
        floors = [np.min([np.minimum(b.slack(row), 0.0) for row in configurations], axis=0) for b in barriers]
        return [replace(b, floor=floor, room=0.0) for b, floor in zip(barriers, floors, strict=True)]

    def _clear(self, barriers: Sequence[_Barrier], q: np.ndarray, v: np.ndarray) -> bool:
        """Whether the stop from v respects all barriers at every tick.

        Ticks that no position can have reached its floor at since it was last looked at are passed over
        (conservative advancement).
        """
        rooms = [barrier.room for barrier in barriers]
        for configuration, velocity in self.stop.path(q, v):
            moved = np.abs(velocity) * self._dt
            for k, barrier in enumerate(barriers):
                rooms[k] -= float(barrier.reach @ moved)
                if rooms[k] < 0.0:
                    rooms[k] = float((barrier.slack(configuration) - barrier.floor).min(initial=np.inf))
                    if rooms[k] < 0.0:
                        return False
        return True


def _barrier(guard: _Guard, q: np.ndarray, travel: np.ndarray, measured: float) -> _Barrier:
    """The positions that may come to the limit while no axis moves farther than `travel` (n_v,)."""
    limit, now = guard.limit, guard.limit.values(q, None)
    base = limit.lower + (float(now.min()) - measured if limit.relative else 0.0)
    rows = np.flatnonzero(now - base <= guard.reach @ travel)
    return _Barrier(
        slack=lambda row: limit.values(row, rows) - base,
        floor=np.zeros(len(rows)),
        room=measured - limit.lower,
        reach=guard.reach,
    )


def _largest_share(clear: Callable[[float], bool]) -> float:
    """By halving; 0 is known to be clear."""
    if clear(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if clear(middle) else (low, middle)
    return low

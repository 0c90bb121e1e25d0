"""The viability rule: a velocity is accepted only if a full stop from it respects every limit on positions.

A velocity that is refused gives way to the one nearest to it, on the way to the stop's own next velocity, from which the
stop is clear. That next velocity was part of the stop that the tick before accepted, so that from a viable state there is
always an answer, whatever the hierarchy asks for.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from uvms_ocp.control.velocity.stop import NONE, Stop, time_to_rest
from uvms_ocp.functions.kernels.binding import bind_kernels
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, structure_of, view
from uvms_ocp.model.limits import PositionLimit
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.limits import ENDLESS
from uvms_ocp.tasks.task import Task

_HALVINGS = 5


class RuleMemory(Layout):
    """Limits, and which of them a velocity could come to within its stop."""

    dt: float
    """[s] control period."""
    acceleration: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] of a stop, finite."""
    n_guards: int
    """[-] limits."""
    lower: Annotated[Vector, Sized("n_guards")]
    """(n_guards,) [m] the limits."""
    task: Annotated[list[int], Sized("n_guards")]
    """(n_guards,) whose they are."""
    quantity: Annotated[list[int], Sized("n_guards")]
    """(n_guards,) index of what they limit."""
    reach: Annotated[list[Vector], Sized("n_guards", "n_v")]
    """(n_guards, n_v) [m, or 1] as that of `PositionLimit`, finite."""
    travel: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m, rad] that each axis moves at most."""
    near: Annotated[list[int], Sized("n_guards")]
    """(n_guards,) which of them some position may come to."""


def comes_near(m: RuleMemory, v: Vector, gates: Vector, quantities: Vector) -> bool:
    """Whether some position may come to a limit that counts until the robot rests from v [m/s, rad/s]. A kernel.

    gates [-] of tasks, quantities [in their units] as measured. Leaves what each axis moves at most, and which limits it is.
    """
    any_near, n = False, len(m.acceleration)
    time = time_to_rest(m.acceleration, v, n)
    for i in range(n):
        m.travel[i] = abs(v[i]) * (m.dt + 0.5 * time)
    for k in range(m.n_guards):
        reach, way = m.reach[k], 0.0
        for i in range(n):
            way += reach[i] * m.travel[i]
        m.near[k] = gates[m.task[k]] > 0 and quantities[m.quantity[k]] - m.lower[k] <= way
        any_near = any_near or m.near[k] != 0
    return any_near


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

    def __init__(
        self, *, robot: Robot, tasks: Sequence[Task], quantity_names: Sequence[str], dt: float, memory: Any = None
    ) -> None:
        """dt [s]: control period. quantity_names: of the vector of quantities, "task.quantity".

        memory: a `RuleMemory` of the caller's, with a place for each of the `guards_of` the tasks.
        """
        self._guards, self._dt = guards_of(robot, tasks, quantity_names), dt
        self.stop = Stop(robot, dt, max(1, len(self._guards)))
        self._rooms, self._reaches = view(self.stop.way.room), view(self.stop.way.reach)
        if memory is None:
            memory = structure_of(RuleMemory, n_v=robot.n_v, n_guards=len(self._guards))()
        (self._comes_near,) = bind_kernels((comes_near,), (type(memory),))
        self._memory, self._travel = memory, view(memory.travel)
        self._write()

    def kept(
        self, *, q: np.ndarray, previous: np.ndarray, wanted: np.ndarray, gates: np.ndarray, quantities: np.ndarray
    ) -> Kept:
        """The velocity for this tick in place of `wanted` (n_v,) [m/s, rad/s].

        q (n_q,) [m, rad]: now. previous (n_v,) [m/s, rad/s]: of the tick before. gates (n_tasks,) [-]: a limit counts while
        its task is on at all. quantities (n_quantities,) [in their units]: as measured at q. A position that the stop from
        `previous` would not keep either may fall as far as it does there, no farther.
        """
        if not self._near(wanted, gates, quantities):
            return Kept(v=wanted, share=1.0, near=False)
        slower = self.stop.slower(q, previous)
        # Of every mixture of the two: it may be as fast as the one and need as long to rest as the other.
        near = self._near(np.maximum(np.abs(wanted), np.abs(slower)), gates, quantities)
        barriers = [_barrier(guard, q, self._travel, float(quantities[guard.quantity])) for guard in near]
        if self._clear(barriers, q, wanted):
            return Kept(v=wanted, share=1.0, near=True)
        barriers = self._lowered(barriers, q, slower)
        share = _largest_share(lambda s: self._clear(barriers, q, slower + s * (wanted - slower)))
        return Kept(v=slower + share * (wanted - slower), share=share, near=True)

    def _near(self, v: np.ndarray, gates: np.ndarray, quantities: np.ndarray) -> list[_Guard]:
        """Guards of the limits that count and that some position may come to within the stop from v (n_v,)."""
        if not self._comes_near(self._memory, *map(_doubles, (v, gates, quantities))):
            return []
        return [guard for guard, near in zip(self._guards, self._memory.near, strict=False) if near]

    def _write(self) -> None:
        memory = self._memory
        memory.dt, memory.n_guards = self._dt, len(self._guards)
        view(memory.acceleration)[:] = self.stop.acceleration
        for k, guard in enumerate(self._guards):
            memory.lower[k], memory.task[k], memory.quantity[k] = guard.limit.lower, guard.task, guard.quantity
            memory.reach[k][:] = guard.reach.tolist()

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
        way = self.stop.way
        way.n_limits = len(barriers)
        for k, barrier in enumerate(barriers):
            self._rooms[k], self._reaches[k] = barrier.room, barrier.reach
        self.stop.begin(q, v)
        k, there = self.stop.until_near()
        while k != NONE:
            self._rooms[k] = (barriers[k].slack(there) - barriers[k].floor).min(initial=np.inf)
            if self._rooms[k] < 0.0:
                return False
            k, there = self.stop.until_near()
        return True


def guards_of(robot: Robot, tasks: Sequence[Task], quantity_names: Sequence[str]) -> list[_Guard]:
    """The limits that `tasks` stand for."""
    return [
        _Guard(
            limit=limit,
            task=index,
            quantity=quantity_names.index(f"{task.name}.{limit.quantity}"),
            reach=np.fmin(limit.reach, ENDLESS),
        )
        for index, task in enumerate(tasks)
        if (limit := task.position_limit(robot)) is not None
    ]


def _doubles(values: np.ndarray) -> Any:
    """As kernels take them, in C and in Python."""
    return (ctypes.c_double * len(values))(*values)


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

"""The viability rule: a velocity is accepted only if a full stop from it respects every limit on positions.

The stop slows all axes down in proportion, as fast as the first of them can: what glides along an obstacle goes on
gliding along it until it stands, while axes that stop one after the other would swing into it. A velocity that is
refused gives way to the one nearest to it, on the way to the stop's own next velocity, from which the stop is clear.
That next velocity was part of the stop that the tick before accepted, so that from a viable state there is always an
answer, whatever the hierarchy asks for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from uvms_ocp.model.limits import bounded_joints
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.task import PositionLimit, StopAhead, Task

_SAMPLES = np.array([0.25, 0.5, 0.75, 1.0])  # shares of the way to rest
_HALVINGS = 5
_ENDLESS = 1e6  # stands in for infinite accelerations and for reaches that nobody knows: its product with 0 is 0
_STILL = 1e-12  # [s] to rest


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Kept:
    """What the rule makes of a velocity."""

    v: np.ndarray  # (n_v,) for this tick
    share: float  # in [0, 1], of the velocity that was wanted; the rest is slowing down
    near: bool  # a stop from the wanted velocity could come to a limit


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Guard:
    """A limit of one task, and where its measured quantity is."""

    limit: PositionLimit
    task: int
    quantity: int
    reach: np.ndarray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Barrier:
    """A limit at one tick: `slack` (m,) [m] must stay at or above `floor` (m,) along the stop."""

    slack: Callable[[np.ndarray], np.ndarray]
    floor: np.ndarray
    room: float  # [m] by which all positions are above the floor now
    reach: np.ndarray


class Stop:
    """How a robot comes to rest: the velocity of the next tick as a function of this one's."""

    def __init__(self, robot: Robot, dt: float) -> None:
        """dt [s] is the control period."""
        self._model, self._dt = robot.model, dt
        self._acceleration = np.minimum(robot.limits.acceleration, _ENDLESS)
        self._step = self._acceleration * dt
        joints = bounded_joints(robot.joints, robot.limits)
        self._idx_q = np.array([joint.idx_q for joint, _, _ in joints], dtype=int)
        self._idx_v = np.array([joint.idx_v for joint, _, _ in joints], dtype=int)
        self._lower, self._upper = np.array([bounds for _, *bounds in joints]).reshape(-1, 2).T

    def slower(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """v (n_v,) one tick nearer to rest; joints brake harder where their position limit, not far from q, asks for it."""
        time = self._time(v)
        slower = v * (1.0 - self._dt / time) if time > self._dt else np.zeros_like(v)
        joints, position = self._idx_v, q[self._idx_q]
        down, up = self._stopping_speed(position - self._lower), self._stopping_speed(self._upper - position)
        slower[joints] = np.maximum(np.minimum(slower[joints], up), -down)
        return np.maximum(np.minimum(slower, v + self._step), v - self._step)

    def path(self, q: np.ndarray, v: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Configuration at the end of every tick and velocity during it, from q with v until rest."""
        while True:
            q = pin.integrate(self._model, q, v * self._dt)
            yield q, v
            v = self.slower(q, v)
            # Also where v is not a number.
            if not self._time(v) >= _STILL:
                return

    def ahead(self, q: np.ndarray, v: np.ndarray) -> StopAhead | None:
        """The proportional stop alone, which is one motion along v; None at rest."""
        length = 0.5 * self._time(v)
        if length < self._dt:
            return None
        durations = length * _SAMPLES
        configurations = tuple(pin.integrate(self._model, q, v * duration) for duration in durations)
        return StopAhead(velocity=v, durations=durations, configurations=configurations)

    def travel(self, v: np.ndarray) -> np.ndarray:
        """(n_v,) upper bound on how far each axis moves from v until it stands still."""
        return np.asarray(np.abs(v) * (self._dt + 0.5 * self._time(v)))

    def _time(self, v: np.ndarray) -> float:
        """[s] that the slowest axis needs to rest."""
        return float((np.abs(v) / self._acceleration).max())

    def _stopping_speed(self, distance: np.ndarray) -> np.ndarray:
        """As `uvms_ocp.tasks.limits.stopping_speed`."""
        a = self._acceleration[self._idx_v]
        return np.asarray(a * (np.sqrt(self._dt**2 + 2.0 * np.maximum(distance, 0.0) / a) - self._dt))


class Viability:
    """The rule for a robot and the tasks of its hierarchy."""

    def __init__(self, *, robot: Robot, tasks: Sequence[Task], quantity_names: Sequence[str], dt: float) -> None:
        """dt [s] is the control period; quantity_names: of the vector of quantities, "task.quantity"."""
        self.stop, self._dt = Stop(robot, dt), dt
        self._guards = [
            _Guard(
                limit=limit,
                task=index,
                quantity=quantity_names.index(f"{task.name}.{limit.quantity}"),
                reach=np.fmin(limit.reach, _ENDLESS),
            )
            for index, task in enumerate(tasks)
            if (limit := task.position_limit(robot)) is not None
        ]

    def kept(
        self, *, q: np.ndarray, previous: np.ndarray, wanted: np.ndarray, gates: np.ndarray, quantities: np.ndarray
    ) -> Kept:
        """The velocity for this tick in place of `wanted` (n_v,).

        q (n_q,) now; previous (n_v,): velocity of the tick before; gates (n_tasks,): a limit counts while its task is on
        at all; quantities as measured at q. A position that the stop from `previous` would not keep either may fall as
        far as it does there, no farther.
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

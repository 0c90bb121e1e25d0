"""The limits on positions of a hierarchy, in the memory of the viability rule, and the rule as a thing to call.

And what of a mission has no form in C, where limits are much of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MethodType
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.control.velocity.parameters import asked_in_phases, asking_of
from uvms_ocp.control.velocity.stop import NONE, Stop, stop_sizes
from uvms_ocp.control.velocity.tracks import tracks_of
from uvms_ocp.control.velocity.viability import RuleMemory, comes_near, keep
from uvms_ocp.functions.kernels.ask import Answer
from uvms_ocp.functions.kernels.binding import bind_to
from uvms_ocp.functions.kernels.layout import doubles, structure_of, view
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model.limits import PositionLimit
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.distance_room import distance_room, in_c
from uvms_ocp.model.shapes.distance_room import without_c_form as not_measured
from uvms_ocp.tasks.limits import ENDLESS
from uvms_ocp.tasks.task import Task

_MOVES = "a goal that moves without telling its end"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Guard:
    """A limit of one task, and where its measured quantity is."""

    limit: PositionLimit
    """As its task has it."""
    task: int
    """Index in the hierarchy."""
    quantity: int
    """Index in the vector of quantities."""
    first: int
    """Index of its first position."""

    @property
    def positions(self) -> slice:
        """Where they are among those of all limits."""
        return slice(self.first, self.first + self.limit.n)

    @property
    def model(self) -> CollisionModel | None:
        """Whose distances the positions are, where they are."""
        values = self.limit.values
        owner = values.__self__ if isinstance(values, MethodType) and not self.limit.relative else None
        return owner if isinstance(owner, CollisionModel) and values == owner.values else None


def guards_of(robot: Robot, tasks: Sequence[Task], quantity_names: Sequence[str]) -> tuple[Guard, ...]:
    """The limits that `tasks` stand for, those with an expression first; quantity_names: of the vector, "task.quantity"."""
    found = [(k, task, limit) for k, task in enumerate(tasks) if (limit := task.position_limit(robot)) is not None]
    found.sort(key=lambda item: not isinstance(item[2].values, ca.Function))
    firsts = np.cumsum([0, *(limit.n for _, _, limit in found)])
    return tuple(
        Guard(limit=limit, task=k, quantity=quantity_names.index(f"{task.name}.{limit.quantity}"), first=int(first))
        for (k, task, limit), first in zip(found, firsts, strict=False)
    )


def without_c_form(robot: Robot, mission: Mission, dt: float, quantity_names: Sequence[str]) -> dict[str, str]:
    """Names of tasks that Python is asked about wherever kernels run, and for what; dt [s]: control period.

    Told without a controller, for which something would have to be compiled.
    """
    tasks = mission.hierarchy.tasks
    found = {item.name: _MOVES for phase in asked_in_phases(mission, tracks_of(mission, dt)) for item in phase}
    limits = {guard.task: _told_by_python(guard, robot) for guard in guards_of(robot, tasks, quantity_names)}
    distances = {task: not_measured(pairs.model, robot) for task, _, pairs in asking_of(mission)}
    told = [(tasks[task].name, why) for known in (limits, distances) for task, why in known.items()]
    return found | {name: why for name, why in told if why}


def _told_by_python(guard: Guard, robot: Robot) -> str:
    """Why it is; empty where it is not."""
    if guard.model is not None:
        return not_measured(guard.model, robot)
    return "" if isinstance(guard.limit.values, ca.Function) else "a limit on positions without an expression"


def models_of(guards: Sequence[Guard]) -> list[CollisionModel]:
    """Those that the guards have."""
    return [guard.model for guard in guards if guard.model is not None]


def rule_sizes(robot: Robot, guards: Sequence[Guard], dt: float) -> dict[str, Any]:
    """Of a `RuleMemory` at control period dt [s], but for the `distance_room` of its guards."""
    q = ca.SX.sym("q", robot.n_q)
    smooth = [guard.limit.values(q) for guard in guards if isinstance(guard.limit.values, ca.Function)]
    return {
        "n_distances": sum(in_c(model, robot) for model in models_of(guards)),
        "n_limits": len(guards),
        "n_positions": sum(guard.limit.n for guard in guards),
        "smooth": ca.Function("positions", [q], [ca.densify(ca.vertcat(ca.SX(0, 1), *smooth))], {"cse": True}),
        **stop_sizes(robot, dt),
    }


class Guarding:
    """What a `RuleMemory` knows of a robot and its limits, and who answers for those without expression."""

    def __init__(self, robot: Robot, guards: Sequence[Guard], dt: float, memory: Any) -> None:
        """dt [s]: control period. memory: of the `rule_sizes` of the guards, which is set up."""
        self.stop = Stop(robot, dt, memory.stop)
        """On the way to rest that the rule looks along."""
        self._guards, self._memory = guards, memory
        self._robot, self._n_distances = robot, 0
        self._place, self._position, self._counts = map(view, (memory.place, memory.position, memory.counts))
        self.answer = Answer(memory.ask, self._look)
        memory.n_limits = memory.stop.n_limits = len(guards)
        for k, guard in enumerate(guards):
            self._write(k, guard)

    def _write(self, k: int, guard: Guard) -> None:
        memory, limit = self._memory, guard.limit
        memory.lower[k], memory.relative[k] = limit.lower, limit.relative
        memory.task[k], memory.quantity[k] = guard.task, guard.quantity
        memory.first[k], memory.end[k] = guard.positions.start, guard.positions.stop
        memory.pairs[k] = self._measured_by(guard.model)
        memory.asks[k] = memory.pairs[k] == NONE and not isinstance(limit.values, ca.Function)
        view(memory.stop.reach)[k] = np.fmin(limit.reach, ENDLESS)

    def _measured_by(self, model: CollisionModel | None) -> int:
        """Which of `distances` it is, or `NONE`."""
        if model is None or not in_c(model, self._robot):
            return NONE
        model.write(self._memory.distances[self._n_distances])
        self._n_distances += 1
        return self._n_distances - 1

    def _look(self) -> None:
        guard = self._guards[self._memory.asked]
        rows = np.flatnonzero(self._counts[guard.positions])
        which = None if len(rows) == guard.limit.n else rows
        self._position[guard.positions][rows] = guard.limit.values(self._place, which)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Kept:
    """What the rule makes of a velocity."""

    v: np.ndarray
    """(n_v,) [m/s, rad/s] for this tick."""
    share: float
    """[-] in [0, 1], of the velocity that was wanted; the rest is slowing down."""
    near: bool
    """A stop from the wanted velocity could come to a limit."""


class Viability:
    """The rule for a robot and the tasks of its hierarchy, by itself."""

    def __init__(self, *, robot: Robot, tasks: Sequence[Task], quantity_names: Sequence[str], dt: float) -> None:
        """dt [s]: control period. quantity_names: of the vector of quantities, "task.quantity"."""
        guards = guards_of(robot, tasks, quantity_names)
        sizes = {**rule_sizes(robot, guards, dt), **distance_room(models_of(guards), robot)}
        self._memory: Any = structure_of(RuleMemory, **sizes)()
        self._comes_near, self._keep = bind_to(self._memory, (comes_near, keep))
        self._guarding = Guarding(robot, guards, dt, self._memory)

    @property
    def stop(self) -> Stop:
        """That it looks along."""
        return self._guarding.stop

    def kept(
        self, *, q: np.ndarray, previous: np.ndarray, wanted: np.ndarray, gates: np.ndarray, quantities: np.ndarray
    ) -> Kept:
        """The velocity for this tick in place of `wanted` (n_v,) [m/s, rad/s].

        q (n_q,) [m, rad], previous (n_v,) [m/s, rad/s], gates (n_tasks,) [-] and quantities (n_quantities,) [in their units] as
        in `keep`.
        """
        now, before, v, on, measured = map(doubles, (q, previous, wanted, gates, quantities))
        near, share = bool(self._comes_near(self._memory, v, on, measured)), 1.0
        if near:
            share = self._keep(self._memory, now, before, v, on, measured)
            self._guarding.answer.check()
        return Kept(v=np.array(v), share=share, near=near)

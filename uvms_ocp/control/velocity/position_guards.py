"""Write the limits on positions of a hierarchy into the memory of the viability rule.

Also tells which tasks have no form in C, for which limits are the usual reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MethodType

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import (
    CallbackBinding,
    assign,
    view,
)
from uvms_ocp.control.velocity import braking, goal_tracks, goals
from uvms_ocp.control.velocity.viability import ViabilityMemory
from uvms_ocp.mission.mission import Mission
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.limits import PositionLimit
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import (
    CollisionModel,
    in_c,
    without_c_form as not_measured,
)
from uvms_ocp.tasks.approach_speed import ENDLESS
from uvms_ocp.tasks.task import Task

_MOVES = "a goal that moves without telling its end"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PositionGuard:
    """A limit of one task, and where its measured quantity is."""

    limit: PositionLimit
    """Limit, as its task has it."""
    task: int
    """Index in the hierarchy."""
    quantity: int
    """Index in the vector of quantities."""
    first: int
    """Index of its first position."""

    @property
    def positions(self) -> slice:
        """Slice of these positions among those of all limits."""
        return slice(self.first, self.first + self.limit.n)

    @property
    def model(self) -> CollisionModel | None:
        """Collision model whose distances are the positions; `None` for positions of joints."""
        values = self.limit.values
        if not isinstance(values, MethodType) or self.limit.relative:
            return None
        owner = values.__self__
        if isinstance(owner, CollisionModel) and values == owner.values:
            return owner
        return None


def position_guards(
    robot: Robot, tasks: Sequence[Task], quantity_names: Sequence[str]
) -> tuple[PositionGuard, ...]:
    """Return the limits that `tasks` stand for, those with an expression first; quantity_names: of
    the vector, "task.quantity".
    """
    with_expression = list[tuple[int, PositionLimit]]()
    without_expression = list[tuple[int, PositionLimit]]()
    for k, task in enumerate(tasks):
        limit = task.position_limit(robot)
        if limit is None:
            continue
        if isinstance(limit.values, ca.Function):
            with_expression.append((k, limit))
        else:
            without_expression.append((k, limit))
    guards = list[PositionGuard]()
    first = 0
    for k, limit in with_expression + without_expression:
        quantity = quantity_names.index(f"{tasks[k].name}.{limit.quantity}")
        guards.append(PositionGuard(limit=limit, task=k, quantity=quantity, first=first))
        first += limit.n
    return tuple(guards)


def without_c_form(
    robot: Robot, mission: Mission, dt: float, quantity_names: Sequence[str]
) -> dict[str, str]:
    """Return the names of tasks that Python is asked about wherever kernels run, and for what;
    dt [s]: control period.

    It takes no controller, for which something would have to be compiled.
    """
    tasks = mission.hierarchy.tasks
    reasons = dict[str, str]()
    tracks = goal_tracks.tracks_of(mission, dt)
    for moving_goals in goals.asked_in_phases(mission, tracks):
        for goal in moving_goals:
            reasons[goal.name] = _MOVES
    for guard in position_guards(robot, tasks, quantity_names):
        reason = _refusal(guard, robot)
        if reason:
            reasons[tasks[guard.task].name] = reason
    for k, _, pairs in goals.distance_tasks(mission):
        reason = not_measured(pairs.model, robot)
        if reason:
            reasons[tasks[k].name] = reason
    return reasons


def _refusal(guard: PositionGuard, robot: Robot) -> str:
    """Return why Python is asked for the positions of a limit; empty where it is not."""
    if guard.model is not None:
        return not_measured(guard.model, robot)
    if isinstance(guard.limit.values, ca.Function):
        return ""
    return "a limit on positions without an expression"


def models_of(guards: Sequence[PositionGuard]) -> list[CollisionModel]:
    """Return the collision models whose distances are positions of guards."""
    return [guard.model for guard in guards if guard.model is not None]


def with_guards(
    dimensions: Dimensions, robot: Robot, guards: Sequence[PositionGuard]
) -> Dimensions:
    """Return the dimensions with those of a `ViabilityMemory`, but for the distances of its guards."""
    return replace(
        dimensions,
        n_distances=sum(in_c(model, robot) for model in models_of(guards)),
        n_limits=len(guards),
        n_positions=sum(guard.limit.n for guard in guards),
    )


def viability_functions(
    robot: Robot, guards: Sequence[PositionGuard], dt: float
) -> dict[str, ca.Function]:
    """Return the functions of a `ViabilityMemory` at control period dt [s]."""
    values = [guard.limit.values for guard in guards]
    functions = tuple(positions for positions in values if isinstance(positions, ca.Function))
    return {"smooth": _positions(robot, functions), **braking.stop_functions(robot, dt)}


@lru_cache(maxsize=8)
def _positions(robot: Robot, values: tuple[ca.Function, ...]) -> ca.Function:
    """Build the function from q to the positions of limits that have an expression."""
    q = ca.SX.sym("q", robot.n_q)
    positions = ca.vertcat(ca.SX(0, 1), *[position(q) for position in values])
    return ca.Function("positions", [q], [ca.densify(positions)], {"cse": True})


class ViabilitySetup:
    """Write a robot and its limits into a `ViabilityMemory`; return the guards of limits without
    expression.
    """

    def __init__(
        self, robot: Robot, guards: Sequence[PositionGuard], dt: float, memory: ViabilityMemory
    ) -> None:
        """dt [s]: control period. memory: for the guards, which is set
        up.
        """
        self._guards = guards
        self._memory = memory
        self._robot = robot
        self._n_distances = 0
        self._place = view(memory.place)
        self._position = view(memory.position)
        self._counts = view(memory.counts)
        self.answer = CallbackBinding(memory.ask, self._look)
        memory.n_limits = len(guards)
        assign(
            memory.stop,
            dt=dt,
            acceleration=braking.finite_acceleration(robot),
            n_limits=len(guards),
        )
        for k, guard in enumerate(guards):
            self._write(k, guard)

    def _write(self, k: int, guard: PositionGuard) -> None:
        memory = self._memory
        limit = guard.limit
        memory.lower[k] = limit.lower
        memory.relative[k] = limit.relative
        memory.task[k] = guard.task
        memory.quantity[k] = guard.quantity
        memory.first[k] = guard.positions.start
        memory.end[k] = guard.positions.stop
        memory.pairs[k] = self._measured_by(guard.model)
        has_expression = isinstance(limit.values, ca.Function)
        memory.asks[k] = memory.pairs[k] == braking.NONE and not has_expression
        view(memory.stop.reach)[k] = np.fmin(limit.reach, ENDLESS)

    def _measured_by(self, model: CollisionModel | None) -> int:
        """Return the index among `distances` of a model that kernels measure, or `NONE`."""
        if model is None or not in_c(model, self._robot):
            return braking.NONE
        model.write(self._memory.distances[self._n_distances])
        self._n_distances += 1
        return self._n_distances - 1

    def _look(self) -> None:
        guard = self._guards[self._memory.asked]
        rows = np.flatnonzero(self._counts[guard.positions])
        requested = None if len(rows) == guard.limit.n else rows
        self._position[guard.positions][rows] = guard.limit.values(self._place, requested)

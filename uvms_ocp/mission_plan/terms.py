"""Terms of a mission plan: the conditions and tasks of its phases, and the energy that it takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission import Condition, Mission, Phase
from uvms_ocp.mission_plan.segments import (
    ANGLES,
    HorizonSegment,
    PlanMargins,
    active_constraints,
    active_tasks,
    delay_task,
    exit_transition,
    is_prerequisite,
    tightened_limit,
)
from uvms_ocp.ocp import OcpLevel
from uvms_ocp.ocp.terms import (
    At,
    Duration,
    Effort,
    Energy,
    Smoothness,
    StageSymbols,
    TaskRows,
    TaskTerm,
    Term,
)
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks import JointTracking, LandingAltitude, MinimumAltitude, attitude
from uvms_ocp.tasks.pose import PoseTask, ToolPosition
from uvms_ocp.tasks.task import Residual, Task, TaskClass, bounded_residual, zero_residual
from uvms_ocp.tasks.vehicle_velocity import NullVelocity
from uvms_ocp.types import Bound

_ROWS: dict[tuple[type[Task], str], tuple[int, ...]] = {
    (PoseTask, "position_error"): (0, 1, 2),
    (PoseTask, "orientation_error"): (3, 4, 5),
    (PoseTask, "horizontal_error"): (0, 1),
    (ToolPosition, "position_error"): (0, 1, 2),
}
"""Rows of residuals whose norm is the quantity."""

_SMOOTHNESS_WEIGHT = 0.3  # what is free to swing would ring from node to node
_PREFERENCE_WEIGHT = 3e-4  # 0.3 W for 1 rad


@checked_dataclass(eq=False)
class BoundedRows(TaskRows):
    """Bounds on some rows of the residual of a task."""

    rows: tuple[int, ...]
    """Indices into the residual."""
    lower: Bound = -np.inf
    """[unit of the rows] lower bound."""
    upper: Bound = np.inf
    """[unit of the rows] upper bound."""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        value = self.task.residual(stage.tick, parameters).value[list(self.rows)]
        return bounded_residual(value, lower=self.lower, upper=self.upper)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TaskPreference(TaskRows):
    """The residual of a task as a cost, not as something to be reached."""

    is_goal: ClassVar[bool] = False

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return self.task.residual(stage.tick, parameters)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ZeroVelocities(Term):
    """Velocities are zero that nothing else keeps at zero."""

    name = "at rest"
    axes: tuple[int, ...]
    """Indices in v."""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(stage.tick.velocity[list(self.axes)])


@dataclass(frozen=True, kw_only=True, slots=True)
class ConditionPlacement:
    """Phase and segment in which a condition applies."""

    phase: str
    """Phase of the mission, for errors."""
    segment: str
    """Segment of the horizon."""
    at: At

    def rows(
        self, task: Task, rows: tuple[int, ...], lower: float = -np.inf, upper: float = np.inf
    ) -> BoundedRows:
        """Bound rows of the residual of a task, at least `lower` and at most `upper` [unit of the
        rows].
        """
        return BoundedRows(
            task=task, rows=rows, lower=lower, upper=upper, at=self.at, phase=self.segment
        )


def condition_term(
    tasks: Sequence[Task],
    condition: Condition,
    place: ConditionPlacement,
    margins: PlanMargins,
    *,
    met: bool,
) -> Term:
    """Return the rows that make a condition hold, or where it is not to be `met`, fail.

    tasks: with the goals that they have in the phase. Raises `InvalidInput` where no residual
    states the quantity.
    """
    name, _, quantity = condition.quantity.rpartition(".")
    limit = condition.limit
    below = condition.is_below is met
    task = _task_called(name, tasks)
    if task is None:
        raise _refused(condition, place, below)
    if isinstance(task, attitude.AngleTask) and quantity in ANGLES and below:
        aim = tightened_limit(limit, margins.angle)
        return TaskTerm(task=replace(task, aim=aim), at=place.at, phase=place.segment)
    if isinstance(task, (LandingAltitude, MinimumAltitude)) and quantity == "altitude":
        lower, upper = _altitude_range(task, limit, margins.altitude, below)
        return place.rows(task, (0,), lower, upper)
    rows = _rows_of(task, quantity)
    if not (rows and below):
        raise _refused(condition, place, below)
    margin = margins.position
    if quantity == "orientation_error":
        margin = margins.angle
    # A box inside the ball that the condition asks for.
    half_width = tightened_limit(limit, margin) / np.sqrt(len(rows))
    return place.rows(task, rows, -half_width, half_width)


def _task_called(name: str, tasks: Sequence[Task]) -> Task | None:
    """Return the task of that name, if there is one."""
    for task in tasks:
        if task.name == name:
            return task
    return None


def _refused(condition: Condition, place: ConditionPlacement, below: bool) -> InvalidInput:
    """Describe a condition that no residual states."""
    sign = "<" if below else ">"
    request = f"{condition.quantity} {sign} {condition.limit:g}, which no residual states"
    allowed = (
        "fly this mission without a plan, or look at the error of a pose, an angle or an altitude"
    )
    return InvalidInput(f"phase {place.phase!r} looks at {request}; {allowed}")


def _altitude_range(
    task: LandingAltitude | MinimumAltitude, limit: float, margin: float, below: bool
) -> tuple[float, float]:
    """Return the range of the residual [m] for an altitude below the limit [m], or above."""
    if below:
        lowest = -np.inf
        highest = tightened_limit(limit, margin)
    else:
        lowest = limit + margin
        highest = np.inf
    if isinstance(task, LandingAltitude):
        # Its residual is the altitude of rest less the altitude.
        return task.rest_altitude - highest, task.rest_altitude - lowest
    return lowest, highest


def _rows_of(task: Task, quantity: str) -> tuple[int, ...]:
    """Return the rows of a task's residual whose norm is the quantity; none where there are none."""
    if isinstance(task, JointTracking) and quantity == "posture_error":
        return tuple(range(len(task.joints)))
    for (kind, name), rows in _ROWS.items():
        if isinstance(task, kind) and name == quantity:
            return rows
    return ()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionTerms:
    """Terms of a whole mission."""

    goals: tuple[tuple[TaskClass, Term], ...]
    """Conditions that transitions wait for, with the class of the task that reaches them."""
    constraints: tuple[Term, ...]
    """Constraints that tasks of constraints and safety keep all along their phases."""
    preferences: tuple[Term, ...]
    """Preferences of tasks of optimization, for a small share of the last level."""


def mission_terms(
    robot: Robot,
    mission: Mission,
    route: Sequence[int],
    segments: Sequence[HorizonSegment],
    margins: PlanMargins,
) -> MissionTerms:
    """Collect the terms of all phases; route: indices of the phases, in their order. Raises
    `InvalidInput` for tasks and conditions that no residual states, by their names.
    """
    goals: list[tuple[TaskClass, Term]] = []
    constraints: list[Term] = []
    preferences: list[Term] = []
    established: set[str] = set()
    for k in range(len(route)):
        phase = _PlannedPhase(mission, route, k, segments, margins)
        goals += phase.goals()
        constraints += phase.kept(established)
        constraints += phase.not_triggered()
        preferences += phase.preferences()
        established = phase.reached
    constraints += _rest(robot, phase.on)
    return MissionTerms(
        goals=tuple(goals), constraints=tuple(constraints), preferences=tuple(preferences)
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class MissionWeights:
    """Weights of the last level."""

    energy: float = 1.0
    """[1/kW] weight of the energy."""
    effort: float = 0.2
    """Weight of thrust and torque, in shares of their limits."""
    price: float = 1e-6
    """[kW] price of time."""


def mission_levels(
    robot: Robot, terms: MissionTerms, weights: MissionWeights
) -> tuple[OcpLevel, ...]:
    """Make levels of goals in the order of the classes of their tasks, then energy with a little
    smoothness, as far as it is known.
    """
    levels = []
    for task_class in sorted({task_class for task_class, _ in terms.goals}):
        goals = [term for goal_class, term in terms.goals if goal_class is task_class]
        levels.append(OcpLevel(name=task_class.name.lower(), terms=tuple(goals)))
    costs: list[Term] = []
    knows_power = all(thruster.power is not None for thruster in robot.description.thrusters)
    if knows_power:
        costs.append(Energy(weight=weights.energy))
    costs.append(Effort(weight=weights.effort))
    costs.append(Smoothness(weight=_SMOOTHNESS_WEIGHT))
    costs.append(Duration(weight=weights.price))
    costs += terms.preferences
    levels.append(OcpLevel(name="energy", terms=tuple(costs)))
    return tuple(levels)


class _PlannedPhase:
    """The k-th phase of a route through the mission, with its segments of the horizon."""

    def __init__(
        self,
        mission: Mission,
        route: Sequence[int],
        k: int,
        segments: Sequence[HorizonSegment],
        margins: PlanMargins,
    ) -> None:
        index = route[k]
        self._phase: Phase = mission.phases[index]
        self._exit = exit_transition(mission.phases, route, k)
        self._segments = [segment for segment in segments if segment.phase == index]
        self._margins = margins
        self._is_last = k + 1 == len(route)
        begin = _nominal_begin(index, segments)
        tasks = [delay_task(task, self._phase, begin) for task in mission.tasks_of(index)]
        self.tasks = tuple(tasks)
        self.on = active_tasks(self._phase, self.tasks)
        self._awaited = {condition.quantity.rpartition(".")[0] for condition in self._exit.when}
        self.reached = {task.name for task in self.on if is_prerequisite(task)}

    def goals(self) -> Iterator[tuple[TaskClass, Term]]:
        """Yield the goals at the end of the phase, or all along what has to be held."""
        for condition in self._exit.when:
            task = _task_called(condition.quantity.rpartition(".")[0], self.tasks)
            task_class = TaskClass.ACTION if task is None else task.task_class
            for segment in self._segments:
                if segment.holds:
                    yield task_class, self._term(condition, segment, At.PATH, met=True)
                if segment.ends and not (segment.holds and self._is_last):
                    yield task_class, self._term(condition, segment, At.END, met=True)

    def kept(self, established: set[str]) -> Iterator[Term]:
        """Yield the constraints of tasks all along the phase. established: names of prerequisites
        that the phase before has reached.
        """
        constraints = active_constraints(
            self._phase, self.on, self._exit, established, self._margins
        )
        for task in constraints:
            for segment in self._segments:
                is_held_by_goal = segment.holds and task.name in self._awaited
                if task.name not in segment.waits_for and not is_held_by_goal:
                    yield TaskTerm(task=task, at=At.PATH, phase=segment.ocp.name)

    def preferences(self) -> Iterator[Term]:
        """Yield the preferences of equality tasks of the lowest class that no transition waits
        for.
        """
        for task in self.on:
            is_preference = task.task_class is TaskClass.OPTIMIZATION and task.equality
            if not is_preference or task.name in self._awaited:
                continue
            for segment in self._segments:
                yield TaskPreference(
                    task=task, at=At.PATH, phase=segment.ocp.name, weight=_PREFERENCE_WEIGHT
                )

    def not_triggered(self) -> Iterator[Term]:
        """Yield for every other way out of the phase the constraint that one of its conditions
        fails all along.
        """
        for transition in self._phase.transitions:
            if transition is not self._exit:
                yield from self._prevented(transition.when)

    def _prevented(self, conditions: Sequence[Condition]) -> list[Term]:
        """Return the terms by which the first condition fails that a residual states."""
        refusal = None
        for condition in conditions:
            terms = []
            try:
                for segment in self._segments:
                    terms.append(self._term(condition, segment, At.PATH, met=False))
            except InvalidInput as error:
                refusal = error
            else:
                return terms
        assert refusal is not None
        raise refusal

    def _term(self, condition: Condition, segment: HorizonSegment, at: At, *, met: bool) -> Term:
        place = ConditionPlacement(phase=self._phase.name, segment=segment.ocp.name, at=at)
        return condition_term(self.tasks, condition, place, self._margins, met=met)


def _nominal_begin(phase: int, segments: Sequence[HorizonSegment]) -> float:
    """Return the time [s] at which the first segment of a phase begins, with nominal durations."""
    begin = 0.0
    for segment in segments:
        if segment.phase == phase:
            break
        begin += segment.ocp.nominal
    return begin


def _rest(robot: Robot, tasks: Sequence[Task]) -> list[Term]:
    """Return the rest at the very end, but for axes that a task keeps at rest anyway."""
    moving_axes = list(range(robot.n_v))
    for task in tasks:
        if isinstance(task, NullVelocity):
            moving_axes = [axis for axis in moving_axes if axis not in task.axes]
    if not moving_axes:
        return []
    return [ZeroVelocities(axes=tuple(moving_axes))]

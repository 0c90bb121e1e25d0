"""Divide the horizon of a mission into segments of free length, and select the tasks that stay
active along each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control.velocity.levels import build_levels
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission import Mission, Phase, Transition
from uvms_ocp.ocp.problem import OcpPhase
from uvms_ocp.record.meta_values import DONE, EventMeta
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import IDEAL_SENSORS
from uvms_ocp.robot.size import size
from uvms_ocp.scenario.part_factories import our_controller
from uvms_ocp.scenario.preflight.phase_forecast import forecast, main_path
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import (
    Clearance,
    JointLimits,
    MinimumAltitude,
    Task,
    TaskClass,
    UnderActuation,
    attitude,
    goals,
)
from uvms_ocp.types import Magnitude

ANGLES = ("tilt", "misalignment", "angle")
"""Quantities of tasks that bound an angle."""
_SMALLEST_LIMIT = 0.25
"""Share of a threshold that a plan may use, however large the margin."""
_PERIOD = 0.05
"""[s] Control period of the greedy mission: a guess needs no better."""
_TICKS_PER_SAMPLE = 4
"""Ticks between two configurations that are kept."""
_NOMINAL_PHASE_TIME = 10.0
"""[s] Duration of a phase that the greedy mission does not come to, or not out of, or that is
foretold.
"""
_FORECAST_PERIOD = 0.5
"""[s] Time between two configurations that are foretold."""
_SHORTEST_SHARE = 0.25
"""Share of the greedy duration of a segment that a plan takes at least."""
_LONGEST_SHARE = 1.5
"""Share of the greedy duration of a segment that a plan takes at most, with `_LEEWAY` added."""
_FEWEST_STEPS = 4
"""Steps of a segment of free duration."""
_MOVING_GOAL_STEP = 0.5
"""[s] Longest step where a goal moves."""
_LEEWAY = 1.0
"""[s] Time that a segment may take, however soon the greedy mission is through."""


# margins that are not given: sizes of the robot, and [m] at most, as large robots do not stray by more
_POSITION = (0.08, 0.02)
_ALTITUDE = (0.04, 0.01)
_LINKS = (0.12, 0.03)


@checked_dataclass()
class Margins:
    """Margins of thresholds and limits: of each a quarter is left in any case."""

    position: Magnitude | None = None
    """[m] margin of positions and distances; default: 0.08 of the robot's size, at most 0.02 m."""
    angle: Magnitude = 0.01
    """[rad] margin of angles."""
    altitude: Magnitude | None = None
    """[m] margin of altitudes; default: 0.04 of the robot's size, at most 0.01 m."""
    links: Magnitude | None = None
    """[m] margin of distances between the robot's own links; default: 0.12 of the robot's size, at
    most 0.03 m.
    """
    hold: Magnitude = 0.2
    """[s] time beyond that for which conditions have to hold."""

    def of(self, robot: Robot) -> PlanMargins:
        """Return the margins of a robot: shares of its size where none are given."""
        length = size(robot.model)
        return PlanMargins(
            position=_given(self.position, _POSITION, length),
            angle=self.angle,
            altitude=_given(self.altitude, _ALTITUDE, length),
            links=_given(self.links, _LINKS, length),
            hold=self.hold,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class PlanMargins:
    """The `Margins` of one robot."""

    position: float
    """[m] margin of positions and distances."""
    angle: float
    """[rad] margin of angles."""
    altitude: float
    """[m] margin of altitudes."""
    links: float
    """[m] margin of distances between the robot's own links."""
    hold: float
    """[s] time beyond that for which conditions have to hold."""


def _given(margin: float | None, default: tuple[float, float], length: float) -> float:
    """Return a margin, or the default of a robot of that size [m] where none is given."""
    share, largest = default
    return min(share * length, largest) if margin is None else margin


def tightened_limit(limit: float, margin: float) -> float:
    """Tighten a limit [m or rad], so that the motion carried out stays below it; margin [m or
    rad].
    """
    return max(limit - margin, _SMALLEST_LIMIT * limit)


def active_tasks(phase: Phase, tasks: Collection[Task]) -> list[Task]:
    """Return the tasks that the phase has on."""
    return [task for task in tasks if task.name in phase.on]


def active_constraints(
    phase: Phase,
    tasks: Collection[Task],
    out: Transition,
    established: Collection[str],
    margins: PlanMargins,
) -> list[Task]:
    """Return the tasks that a plan keeps all along a phase, stricter than the mission has them:
    constraints, safety tasks, and prerequisites that are established.

    tasks: that are on. out: the transition by which the mission leaves the phase. established:
    names of the prerequisites that were on in the phase before. Raises `InvalidInput` for a task
    without residual, by its name.
    """
    limits = {condition.quantity.rpartition(".")[0]: condition.limit for condition in out.when}
    constraints = []
    for task in tasks:
        if not _is_kept(task, limits, established) or _kept_otherwise(task):
            continue
        if type(task).residual is Task.residual:
            problem = (
                f"phase {phase.name!r}: {task.name}, a {type(task).__name__}, has no residual over"
                " a horizon"
            )
            raise InvalidInput(f"{problem}; turn it off, or fly this mission without a plan")
        constraints.append(_tightened_task(task, limits, margins))
    return constraints


def is_prerequisite(task: Task) -> bool:
    """Check whether a task is one that is reached first and kept then."""
    return task.task_class is TaskClass.PREREQUISITE and not task.equality


def is_violated(task: Task, quantities: Mapping[str, float]) -> bool:
    """Check whether quantities [in their units] are outside the limits of a task of
    `active_constraints`, as far as they are given.
    """
    if isinstance(task, MinimumAltitude):
        return quantities[f"{task.name}.altitude"] < task.threshold
    if isinstance(task, attitude.AngleTask):
        return any(quantities.get(f"{task.name}.{angle}", 0.0) > task.aim for angle in ANGLES)
    return False


def _is_kept(task: Task, awaited_tasks: Collection[str], established: Collection[str]) -> bool:
    """Check whether a task is kept all along its phase: a constraint or a safety task always, a
    prerequisite where the phase before has reached it, or no transition out of this
    one waits for it.
    """
    is_established = task.name not in awaited_tasks or task.name in established
    if is_prerequisite(task):
        return is_established
    return task.task_class <= TaskClass.SAFETY


def _kept_otherwise(task: Task) -> bool:
    """Check whether the dynamics, the bounds on joints or clearances between shapes keep the
    task.
    """
    if isinstance(task, JointLimits):
        return task.guard == 0
    return isinstance(task, (UnderActuation, Clearance))


def _tightened_task(task: Task, limits: Mapping[str, float], margins: PlanMargins) -> Task:
    """Return a task with its own threshold, or the limit of a condition on it, tightened."""
    if isinstance(task, attitude.AngleTask):
        limit = limits.get(task.name, task.activation.end)
        return replace(task, aim=tightened_limit(limit, margins.angle))
    if isinstance(task, MinimumAltitude):
        return replace(task, threshold=task.threshold + margins.altitude)
    return task


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GreedyRollout:
    """Configurations of the mission as the hierarchy of tasks flies it, or may fly it."""

    t: np.ndarray
    """(n,) [s] times of the samples."""
    q: np.ndarray
    """(n, n_q) [m, rad] configurations at these times."""
    phases: tuple[int, ...]
    """Indices in the mission of the phases on the way to its end, in their order."""
    begins: np.ndarray
    """(n_phases + 1,) [s] beginning of each phase, and the end of the last."""
    quantities: Mapping[str, np.ndarray]
    """Quantities (n,) by the names of conditions [in their units]."""

    def rows(self, k: int) -> np.ndarray:
        """Return the indices of the samples of the k-th phase on the way."""
        is_inside = (self.t >= self.begins[k]) & (self.t < self.begins[k + 1])
        return np.flatnonzero(is_inside)

    def at(self, row: int) -> dict[str, float]:
        """Return all quantities in a row."""
        return {name: float(values[row]) for name, values in self.quantities.items()}


def greedy_rollout(scenario: Scenario) -> GreedyRollout:
    """Fly the greedy mission without water, noise and faults."""
    record = replace(
        scenario,
        plant="kinematic",
        sensors=IDEAL_SENSORS,
        faults=(),
        plant_robot=None,
        controller=our_controller,
        dt=_PERIOD,
        duration=max(scenario.duration, _PERIOD),
    ).run()
    phases = main_path(scenario.mission.phases)
    sampled_rows = slice(None, None, _TICKS_PER_SAMPLE)
    quantities = record["quantities"][sampled_rows].T
    return GreedyRollout(
        t=record["t"][sampled_rows],
        q=record["q"][sampled_rows],
        phases=tuple(phases),
        begins=_begins(scenario.mission, phases, record.run_meta.events),
        quantities=dict(zip(record.meta.quantities, quantities, strict=True)),
    )


def _begins(mission: Mission, phases: Sequence[int], events: Sequence[EventMeta]) -> np.ndarray:
    """Return the beginnings (n_phases + 1,) [s] of phases, and the last end, as far as a mission
    with these events goes through them in their order.
    """
    begins = [0.0]
    for index, event in zip_longest(phases, events[: len(phases)]):
        if event is not None and event.source == mission.phases[index].name:
            begins.append(max(event.t, begins[-1]))
        else:
            begins.append(begins[-1] + _NOMINAL_PHASE_TIME)
    return np.array(begins)


def foretold_rollout(scenario: Scenario) -> GreedyRollout:
    """Roll the mission out as pre-flight does: what cannot be planned is found before anything is
    simulated, and compiled for that.

    It leads straight from stance to stance, with phases of the same duration; no quantity is known
    on it. Raises `FrameNotFound` and `NameNotFound` for what tasks name and the robot does not
    have.
    """
    phases = main_path(scenario.mission.phases)
    begins = _NOMINAL_PHASE_TIME * np.arange(len(phases) + 1)
    t = np.arange(0.0, begins[-1] + _FORECAST_PERIOD / 2, _FORECAST_PERIOD)
    q = np.tile(scenario.start, (len(t), 1))
    if scenario.robot.n_vehicle:
        stances = [visit.stances[0].position for visit in forecast(scenario.setup())]
        marks = np.array([scenario.start[:3], *stances])
        for axis in range(3):
            q[:, axis] = np.interp(t, begins, marks[:, axis])
    mission = scenario.mission
    names = build_levels(
        scenario.robot, mission.hierarchy, scenario.dt, mission.beside_tasks
    ).quantity_names
    return GreedyRollout(
        t=t,
        q=q,
        phases=tuple(phases),
        begins=begins,
        quantities=dict.fromkeys(names, np.full(len(t), np.nan)),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HorizonSegment:
    """A part of the horizon within one phase of the mission."""

    phase: int
    """Index of that phase in the mission."""
    ocp: OcpPhase
    """Name, steps and range of durations of the segment."""
    greedy: tuple[float, float]
    """[s] beginning and end of the segment in the greedy mission."""
    holds: bool = False
    """True where the conditions of the phase's transition hold all along it."""
    ends: bool = False
    """True where the phase ends with the segment."""
    waits_for: frozenset[str] = frozenset()
    """Names of tasks that do not hold yet when it begins, but when it ends."""


def exit_transition(phases: Sequence[Phase], route: Sequence[int], k: int) -> Transition:
    """Return the transition by which the mission leaves the k-th phase of a route; route: indices
    of phases. Raises `InvalidInput` where there is none.
    """
    phase = phases[route[k]]
    target = DONE
    if k + 1 < len(route):
        target = phases[route[k + 1]].name
    for transition in phase.transitions:
        if transition.to == target:
            return transition
    raise InvalidInput(
        f"no transition leads from phase {phase.name!r} to {target}; a plan needs a mission that"
        " can be completed"
    )


def horizon_segments(
    mission: Mission, greedy: GreedyRollout, margins: PlanMargins, *, step: float
) -> list[HorizonSegment]:
    """Divide the way of the greedy mission into segments, in their order. step [s]: of the
    horizon.
    """
    segments: list[HorizonSegment] = []
    prerequisites: set[str] = set()
    for k, index in enumerate(greedy.phases):
        phase = mission.phases[index]
        out = exit_transition(mission.phases, greedy.phases, k)
        on = active_tasks(phase, mission.tasks_of(index))
        constraints = active_constraints(phase, on, out, prerequisites, margins)
        prerequisites = {task.name for task in on if is_prerequisite(task)}
        moving_time = goals_end_time(phase, on)
        hold = out.hold
        segment_step = step
        if moving_time:
            segment_step = min(step, _MOVING_GOAL_STEP)
        begin = greedy.begins[k]
        entered = _time_entered(greedy, k, constraints)
        end = greedy.begins[k + 1]
        hold_begin = max(entered, end - hold)
        violated = _violated_at_begin(greedy, k, constraints)
        if violated:
            ocp = _free_phase(f"{phase.name} entered", entered - begin, moving_time, segment_step)
            segments.append(
                HorizonSegment(phase=index, ocp=ocp, greedy=(begin, entered), waits_for=violated)
            )
        # Where the goal comes to rest while conditions have to hold, the whole phase is held:
        # nothing is free then.
        if not 0 < moving_time <= hold:
            ocp = _free_phase(phase.name, hold_begin - entered, moving_time, segment_step)
            segments.append(
                HorizonSegment(phase=index, ocp=ocp, greedy=(entered, hold_begin), ends=not hold)
            )
        if hold:
            ocp = OcpPhase(
                name=f"{phase.name} held",
                n_steps=max(2, math.ceil(hold / segment_step)),
                duration=hold + margins.hold,
            )
            segments.append(
                HorizonSegment(
                    phase=index, ocp=ocp, greedy=(hold_begin, end), ends=True, holds=True
                )
            )
    return segments


def _free_phase(name: str, greedy_time: float, moving_time: float, step: float) -> OcpPhase:
    """Return a phase of free duration, about as long as the greedy mission takes [s], and no
    shorter than its goals are moving [s].
    """
    longest = max(_LONGEST_SHARE * greedy_time, moving_time) + _LEEWAY
    shortest = max(_SHORTEST_SHARE * greedy_time, moving_time, 0.2 * _LEEWAY)
    n_steps = max(_FEWEST_STEPS, math.ceil(greedy_time / step))
    return OcpPhase(name=name, n_steps=n_steps, duration=(shortest, longest))


def _violated_at_begin(
    greedy: GreedyRollout, k: int, constraints: Sequence[Task]
) -> frozenset[str]:
    """Return the names of the constraints that do not hold as the k-th phase begins."""
    rows = greedy.rows(k)
    if not len(rows):
        return frozenset()
    quantities = greedy.at(rows[0])
    return frozenset(task.name for task in constraints if is_violated(task, quantities))


def _time_entered(greedy: GreedyRollout, k: int, constraints: Sequence[Task]) -> float:
    """Return the time [s] at which all constraints hold for the first time in the k-th phase of the
    greedy way.
    """
    rows = greedy.rows(k)
    for row in rows:
        quantities = greedy.at(row)
        if not any(is_violated(task, quantities) for task in constraints):
            if row == rows[0]:
                return float(greedy.begins[k])
            return float(greedy.t[row])
    return float(greedy.begins[k + 1])


def goals_end_time(phase: Phase, on: Sequence[Task]) -> float:
    """Return the time [s after the beginning of the phase] at which the goals that are its own come
    to rest; 0 where none moves. on: its tasks.
    """
    last_end = 0.0
    for task in on:
        goal = phase.goals.get(task.name)
        if callable(goal) and isinstance(goal, goals.EndingReference):
            last_end = max(last_end, float(goal.end))
    return last_end


def delay_task(task: Task, phase: Phase, begin: float) -> Task:
    """Return a task of a phase that begins at `begin` [s] on the horizon, with its goal delayed."""
    goal = getattr(task, "goal", None)
    if task.name in phase.goals and callable(goal):
        return task.with_goal(partial(_delayed, goal, begin))
    return task


def _delayed(goal: Callable[[float], Any], start: float, t: float) -> Any:
    """Return value and rate at t [s] of a reference that begins at `start` [s]."""
    return goal(max(t - start, 0.0))

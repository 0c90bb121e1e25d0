"""Divide the horizon of a mission into segments of free length, and select the tasks that stay
active along each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control.velocity.levels import build_levels
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission import Mission, Phase, Transition
from uvms_ocp.ocp.problem import OcpPhase
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot.signals import IDEAL_SENSORS
from uvms_ocp.scenario.part_factories import our_controller
from uvms_ocp.scenario.preflight.setup import forecast, main_path
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

_LEAST_SHARE = 0.25  # share of a threshold that a plan may use, however large the margin

ANGLES = ("tilt", "misalignment", "angle")
"""Quantities of tasks that bound an angle."""

_PERIOD = 0.05  # [s] control period: a guess needs no better
_TICKS_PER_SAMPLE = 4  # ticks between two configurations that are kept
# [s] of a phase that the greedy mission does not come to, or not out of, or that is foretold
_NOMINAL_PHASE_TIME = 10.0
_FORECAST_PERIOD = 0.5  # [s] between two configurations that are foretold

# shares of the greedy duration of a phase
_SHORTEST_SHARE = 0.25
_LONGEST_SHARE = 1.5
_FEWEST_STEPS = 4  # steps of a segment
_MOVING_GOAL_STEP = 0.5  # [s] steps where a goal moves
_LEEWAY = 1.0  # [s] that a segment may take however soon the greedy mission is through


@checked_dataclass()
class Margins:
    """Margins of thresholds and limits: of each a quarter is left in any case."""

    position: Magnitude = 0.02
    """[m] margin of positions and distances."""
    angle: Magnitude = 0.01
    """[rad] margin of angles."""
    altitude: Magnitude = 0.01
    """[m] margin of altitudes."""
    links: Magnitude = 0.03
    """[m] margin of distances between the robot's own links."""
    hold: Magnitude = 0.2
    """[s] time beyond that for which conditions have to hold."""


def tightened_limit(limit: float, margin: float) -> float:
    """Tighten a limit [m or rad], so that the motion carried out stays below it; margin [m or
    rad].
    """
    return max(limit - margin, _LEAST_SHARE * limit)


def active_tasks(phase: Phase, tasks: Collection[Task]) -> list[Task]:
    """Return the tasks that the phase has on."""
    return [task for task in tasks if task.name in phase.on]


def active_constraints(
    phase: Phase,
    tasks: Collection[Task],
    out: Transition,
    established: Collection[str],
    margins: Margins,
) -> list[Task]:
    """Constraints, what keeps the robot safe, and prerequisites that are established: stricter than
    the mission has them.

    tasks: that are on. out: the transition by which the mission leaves the phase. established:
    names of the prerequisites that were on in the phase before. Raises `InvalidInput` for a task
    without residual, by its name.
    """
    limits = {condition.quantity.rpartition(".")[0]: condition.limit for condition in out.when}
    constraints = [
        task for task in tasks if _is_kept(task, limits, established) and not _kept_otherwise(task)
    ]
    for task in constraints:
        if type(task).residual is Task.residual:
            problem = (
                f"phase {phase.name!r}: {task.name}, a {type(task).__name__}, has no residual over"
                " a horizon"
            )
            raise InvalidInput(f"{problem}; turn it off, or fly this mission without a plan")
    return [_tightened_task(task, limits, margins) for task in constraints]


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
    return isinstance(task, (UnderActuation, Clearance)) or (
        isinstance(task, JointLimits) and task.guard == 0
    )


def _tightened_task(task: Task, limits: Mapping[str, float], margins: Margins) -> Task:
    if isinstance(task, attitude.AngleTask):
        return replace(
            task, aim=tightened_limit(limits.get(task.name, task.activation.end), margins.angle)
        )
    if isinstance(task, MinimumAltitude):
        return replace(task, threshold=task.threshold + margins.altitude)
    return task


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GreedyRollout:
    """Configurations, and when each phase of the way begins."""

    t: np.ndarray
    """(n,) [s]"""
    q: np.ndarray
    """(n, n_q) [m, rad]"""
    phases: tuple[int, ...]
    """Indices in the mission of the phases on the way."""
    begins: np.ndarray
    """(n_phases + 1,) [s] beginning of each phase, and the end of the last."""

    quantities: Mapping[str, np.ndarray]
    """Quantities (n,) by the names of conditions [in their units]."""

    def rows(self, k: int) -> np.ndarray:
        """Return the indices of the samples of the k-th phase on the way."""
        return np.flatnonzero((self.t >= self.begins[k]) & (self.t < self.begins[k + 1]))

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
    ends = [(event.source, event.t) for event in record.run_meta.events]
    phases = main_path(scenario.mission.phases)
    names = [scenario.mission.phases[index].name for index in phases]
    sampled_rows = slice(None, None, _TICKS_PER_SAMPLE)
    # Beginnings of the phases [s], as far as the greedy mission goes through them in their order,
    # and the last end.
    begins = [0.0]
    for k, name in enumerate(names):
        is_completed = k < len(ends) and ends[k][0] == name
        if is_completed:
            begins.append(max(ends[k][1], begins[-1]))
        else:
            begins.append(begins[-1] + _NOMINAL_PHASE_TIME)
    return GreedyRollout(
        t=record["t"][sampled_rows],
        q=record["q"][sampled_rows],
        phases=tuple(phases),
        begins=np.array(begins),
        quantities=dict(
            zip(record.meta.quantities, record["quantities"][sampled_rows].T, strict=True)
        ),
    )


def foretold_way(scenario: Scenario) -> GreedyRollout:
    """Roll the mission out as pre-flight does: what cannot be planned is found before anything is
    simulated, and compiled for that.

    Straight from stance to stance, as long in every phase; no quantity is known on it. Raises
    `FrameNotFound` and `NameNotFound` for what tasks name and the robot does not have.
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
    """Index in the mission."""
    ocp: OcpPhase
    """Name, steps and range of durations."""
    greedy: tuple[float, float]
    """[s] beginning and end of the segment in the greedy mission."""
    holds: bool = False
    """True where the conditions of the phase's transition hold all along it."""
    ends: bool = False
    """True where the phase ends with the segment."""
    waits_for: frozenset[str] = frozenset()
    """Names of tasks that do not hold yet when it begins, but when it ends."""


def exit_transition(phases: Sequence[Phase], way: Sequence[int], k: int) -> Transition:
    """The transition by which the mission leaves the k-th phase of its way. Raises `InvalidInput`
    where there is none.
    """
    phase = phases[way[k]]
    to = phases[way[k + 1]].name if k + 1 < len(way) else DONE
    for transition in phase.transitions:
        if transition.to == to:
            return transition
    raise InvalidInput(
        f"no transition leads from phase {phase.name!r} to {to}; a plan needs a mission that can be"
        " completed"
    )


def horizon_segments(
    mission: Mission, greedy: GreedyRollout, margins: Margins, *, step: float
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
        moving = goals_end_time(phase, on)
        hold = out.hold
        if moving:
            segment_step = min(step, _MOVING_GOAL_STEP)
        else:
            segment_step = step
        begin = greedy.begins[k]
        entered = _time_entered(greedy, k, constraints)
        end = greedy.begins[k + 1]
        middle = max(entered, end - hold)
        broken = frozenset(
            task.name
            for task in constraints
            if len(greedy.rows(k)) and is_violated(task, greedy.at(greedy.rows(k)[0]))
        )
        if broken:
            ocp = _free_phase(f"{phase.name} entered", entered - begin, moving, segment_step)
            segments.append(
                HorizonSegment(phase=index, ocp=ocp, greedy=(begin, entered), waits_for=broken)
            )
        # A goal that rests while conditions have to hold is followed from the beginning of that:
        # nothing is free then.
        if not 0 < moving <= hold:
            ocp = _free_phase(phase.name, middle - entered, moving, segment_step)
            segments.append(
                HorizonSegment(phase=index, ocp=ocp, greedy=(entered, middle), ends=not hold)
            )
        if hold:
            ocp = OcpPhase(
                name=f"{phase.name} held",
                n_steps=max(2, math.ceil(hold / segment_step)),
                duration=hold + margins.hold,
            )
            segments.append(
                HorizonSegment(phase=index, ocp=ocp, greedy=(middle, end), ends=True, holds=True)
            )
    return segments


def _free_phase(name: str, greedy: float, moving: float, step: float) -> OcpPhase:
    """Phase of a free duration, about as long as the greedy mission takes [s], and no shorter than
    its goals are moving [s].
    """
    longest = max(_LONGEST_SHARE * greedy, moving) + _LEEWAY
    shortest = max(_SHORTEST_SHARE * greedy, moving, 0.2 * _LEEWAY)
    return OcpPhase(
        name=name,
        n_steps=max(_FEWEST_STEPS, math.ceil(greedy / step)),
        duration=(shortest, longest),
    )


def _time_entered(greedy: GreedyRollout, k: int, constraints: Sequence[Task]) -> float:
    """Return the time [s] at which all constraints hold for the first time in the k-th phase of the
    greedy way.
    """
    for row in greedy.rows(k):
        if not any(is_violated(task, greedy.at(row)) for task in constraints):
            if row > greedy.rows(k)[0]:
                return float(greedy.t[row])
            return float(greedy.begins[k])
    return float(greedy.begins[k + 1])


def goals_end_time(phase: Phase, on: Sequence[Task]) -> float:
    """Return the time [s after the beginning of the phase] at which the goals that are its own come
    to rest; 0 where none moves. on: its tasks.
    """
    phase_goals = [phase.goals.get(task.name) for task in on]
    ends = [
        float(goal.end)
        for goal in phase_goals
        if callable(goal) and isinstance(goal, goals.EndingReference)
    ]
    return max([0.0, *ends])


def _delayed(goal: Callable[[float], Any], start: float, t: float) -> Any:
    """Value and rate at t [s] of a reference that begins at `start` [s]."""
    return goal(max(t - start, 0.0))


def delay_task(task: Task, phase: Phase, begin: float) -> Task:
    """A task of a phase that begins at `begin` [s] on the horizon."""
    goal = getattr(task, "goal", None)
    if task.name in phase.goals and callable(goal):
        return task.with_goal(partial(_delayed, goal, begin))
    return task

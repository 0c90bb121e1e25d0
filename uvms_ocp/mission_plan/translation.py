"""From a mission to an optimal control problem: what its tasks keep, what its transitions ask for, and then the energy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import Condition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.mission_plan.condition_terms import Place, condition_term
from uvms_ocp.mission_plan.kept_tasks import active, is_prerequisite, kept_tasks
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.mission_terms import Preferred, Rest
from uvms_ocp.mission_plan.stretches import Stretch, task_in_time, way_out
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.problem import OcpLevel
from uvms_ocp.ocp.terms import At, Duration, Effort, Energy, Smoothness, TaskTerm, Term
from uvms_ocp.tasks.task import Task, TaskClass
from uvms_ocp.tasks.velocity import NullVelocity

_SMOOTH = 0.3  # weight of smoothness: what is free to swing would ring from node to node

_LIKED = 3e-4  # weight of preferences: 0.3 W for 1 rad


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Terms:
    """Of a whole mission."""

    goals: tuple[tuple[TaskClass, Term], ...]
    """What transitions wait for, with the class of the task that reaches it."""
    constraints: tuple[Term, ...]
    """What tasks of constraints and safety keep all along their phases."""
    preferences: tuple[Term, ...]
    """What tasks of optimization would like, for a little of what is least in the end."""


def terms_of(
    robot: Robot, mission: Mission, way: Sequence[int], stretches: Sequence[Stretch], margins: Margins
) -> Terms:
    """Raises `InvalidInput` for tasks and conditions that no residual states, by their names."""
    goals: list[tuple[TaskClass, Term]] = []
    constraints: list[Term] = []
    preferences: list[Term] = []
    kept: set[str] = set()
    starts = np.cumsum([0.0, *(stretch.ocp.nominal for stretch in stretches)])
    for k, index in enumerate(way):
        own = [i for i, stretch in enumerate(stretches) if stretch.phase == index]
        phase = _Phase(mission, way, k, [stretches[i] for i in own], float(starts[own[0]]), margins)
        goals += phase.goals()
        constraints += phase.kept(kept)
        constraints += phase.not_triggered()
        preferences += phase.preferences()
        kept = phase.reached
    constraints += _rest(robot, phase.on)
    return Terms(goals=tuple(goals), constraints=tuple(constraints), preferences=tuple(preferences))


@dataclass(frozen=True, kw_only=True, slots=True)
class Weights:
    """Of what is least in the end."""

    energy: float = 1.0
    """[1/kW]"""
    effort: float = 0.2
    """[-] of thrust and torque, in shares of their limits."""
    price: float = 1e-6
    """[kW] of time."""


def levels_of(robot: Robot, terms: Terms, weights: Weights) -> tuple[OcpLevel, ...]:
    """Goals in the order of the classes of their tasks, then energy with a little smoothness, as far as it is known."""
    classes = sorted({kind for kind, _ in terms.goals})
    asked = [
        OcpLevel(name=kind.name.lower(), terms=tuple(term for own, term in terms.goals if own is kind))
        for kind in classes
    ]
    powers = [thruster.power for thruster in robot.description.thrusters]
    known: tuple[Term, ...] = () if None in powers else (Energy(weight=weights.energy),)
    spent = (*known, Effort(weight=weights.effort), Smoothness(weight=_SMOOTH), Duration(weight=weights.price))
    return (*asked, OcpLevel(name="energy", terms=(*spent, *terms.preferences)))


class _Phase:
    """One phase on the way, with its parts of the horizon."""

    def __init__(
        self,
        mission: Mission,
        way: Sequence[int],
        k: int,
        parts: Sequence[Stretch],
        begin: float,
        margins: Margins,
    ) -> None:
        self._phase: Phase = mission.phases[way[k]]
        self._out, self._parts, self._margins = way_out(mission.phases, way, k), parts, margins
        self._last = k + 1 == len(way)
        self.tasks = tuple(task_in_time(task, self._phase, begin) for task in mission.tasks_of(way[k]))
        self.on = active(self._phase, self.tasks)
        self._asked = {condition.quantity.rpartition(".")[0] for condition in self._out.when}
        self.reached = {task.name for task in self.on if is_prerequisite(task)}

    def goals(self) -> Iterator[tuple[TaskClass, Term]]:
        """At the end of the phase, or all along what has to be held."""
        for condition in self._out.when:
            kind = self._task_of(condition).task_class
            for part in self._parts:
                if part.holds:
                    yield kind, self._term(condition, part, At.PATH, met=True)
                if part.ends and not (part.holds and self._last):
                    yield kind, self._term(condition, part, At.END, met=True)

    def kept(self, before: set[str]) -> Iterator[Term]:
        """By tasks all along the phase. before: names of prerequisites that the phase before has established."""
        for task in kept_tasks(self._phase, self.on, self._out, before, self._margins):
            for part in self._parts:
                if task.name not in part.waits_for and not (part.holds and task.name in self._asked):
                    yield TaskTerm(task=task, at=At.PATH, phase=part.ocp.name)

    def preferences(self) -> Iterator[Term]:
        """Of equality tasks of the lowest class that no transition waits for."""
        for task in self.on:
            if task.task_class is TaskClass.OPTIMIZATION and task.equality and task.name not in self._asked:
                for part in self._parts:
                    yield Preferred(task=task, at=At.PATH, phase=part.ocp.name, weight=_LIKED)

    def not_triggered(self) -> Iterator[Term]:
        """Of every other way out of the phase, one condition fails all along."""
        for transition in self._phase.transitions:
            if transition is not self._out:
                yield from self._prevented(transition.when)

    def _prevented(self, conditions: Sequence[Condition]) -> Iterator[Term]:
        refused = None
        for condition in conditions:
            try:
                found = [self._term(condition, part, At.PATH, met=False) for part in self._parts]
            except InvalidInput as error:
                refused = error
                continue
            yield from found
            return
        assert refused is not None
        raise refused

    def _task_of(self, condition: Condition) -> Task:
        name = condition.quantity.rpartition(".")[0]
        return next(task for task in self.tasks if task.name == name)

    def _term(self, condition: Condition, part: Stretch, at: At, *, met: bool) -> Term:
        place = Place(phase=self._phase.name, stretch=part.ocp.name, at=at)
        return condition_term(self.tasks, condition, place, self._margins, met=met)


def _rest(robot: Robot, tasks: Sequence[Task]) -> Iterator[Term]:
    """At the very end, but for what a task keeps at rest anyway."""
    still = {axis for task in tasks if isinstance(task, NullVelocity) for axis in task.axes}
    axes = tuple(axis for axis in range(robot.n_v) if axis not in still)
    if axes:
        yield Rest(axes=axes)

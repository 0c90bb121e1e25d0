"""The horizon of a mission: each phase as a stretch of free length, and what has to be held at its end as one more."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import DONE, Transition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.mission_plan.greedy_way import GreedyWay
from uvms_ocp.mission_plan.kept_tasks import active, is_broken, is_prerequisite, kept_tasks
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.ocp.problem import OcpPhase
from uvms_ocp.tasks.reference import EndingReference
from uvms_ocp.tasks.task import Task

_SHORTEST, _LONGEST = 0.25, 1.5  # shares of the greedy duration of a phase
_FEWEST = 4  # steps of a stretch
_FOLLOWED = 0.5  # [s] steps where a goal moves
_LEEWAY = 1.0  # [s] that a stretch may take however soon the greedy mission is through


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stretch:
    """A part of the horizon within one phase of the mission."""

    phase: int
    """Index in the mission."""
    ocp: OcpPhase
    """Name, steps and range of durations."""
    greedy: tuple[float, float]
    """[s] when the greedy mission is in it."""
    holds: bool = False
    """The conditions of the phase's transition hold all along it."""
    ends: bool = False
    """The phase ends with it."""
    waits_for: frozenset[str] = frozenset()
    """Names of tasks that do not hold yet when it begins, but when it ends."""


def way_out(phases: Sequence[Phase], way: Sequence[int], k: int) -> Transition:
    """The transition by which the mission leaves the k-th phase of its way. Raises `InvalidInput` where there is none."""
    phase = phases[way[k]]
    to = phases[way[k + 1]].name if k + 1 < len(way) else DONE
    for transition in phase.transitions:
        if transition.to == to:
            return transition
    raise InvalidInput(
        f"no transition leads from phase {phase.name!r} to {to}; a plan needs a mission that can be completed"
    )


def stretches_of(mission: Mission, greedy: GreedyWay, margins: Margins, *, step: float) -> list[Stretch]:
    """All parts in their order. step [s]: of the horizon."""
    found: list[Stretch] = []
    before: set[str] = set()
    for k, index in enumerate(greedy.phases):
        phase, out = mission.phases[index], way_out(mission.phases, greedy.phases, k)
        on = active(phase, mission.tasks_of(index))
        kept = kept_tasks(phase, on, out, before, margins)
        before = {task.name for task in on if is_prerequisite(task)}
        moving = end_of_goals(phase, on)
        marks = _Marks(begin=greedy.begins[k], entered=_entered(greedy, k, kept), end=greedy.begins[k + 1])
        parts = _Parts(index=index, phase=phase, hold=out.hold, moving=moving, step=min(step, _FOLLOWED) if moving else step)
        broken = frozenset(task.name for task in kept if len(greedy.rows(k)) and is_broken(task, greedy.at(greedy.rows(k)[0])))
        found += parts.entering(marks, broken)
        found += parts.free(marks)
        found += parts.held(marks, margins)
    return found


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Marks:
    """[s] of a phase on the greedy way."""

    begin: float
    entered: float
    """When all that is kept holds."""
    end: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Parts:
    """Makes those of one phase."""

    index: int
    phase: Phase
    hold: float
    """[s] of its way out."""
    moving: float
    """[s] as `end_of_goals`."""
    step: float
    """[s]"""

    def entering(self, marks: _Marks, broken: frozenset[str]) -> Iterator[Stretch]:
        """Until what is broken at the beginning holds."""
        if broken:
            ocp = self._free_phase(f"{self.phase.name} entered", marks.entered - marks.begin)
            yield self._stretch(ocp, (marks.begin, marks.entered), waits_for=broken)

    def free(self, marks: _Marks) -> Iterator[Stretch]:
        """A goal that rests while conditions have to hold is followed from the beginning of that: nothing is free then."""
        if not 0 < self.moving <= self.hold:
            middle = max(marks.entered, marks.end - self.hold)
            ocp = self._free_phase(self.phase.name, middle - marks.entered)
            yield self._stretch(ocp, (marks.entered, middle), ends=not self.hold)

    def held(self, marks: _Marks, margins: Margins) -> Iterator[Stretch]:
        """Where the conditions of the way out hold."""
        if self.hold:
            n, duration = max(2, math.ceil(self.hold / self.step)), self.hold + margins.hold
            ocp = OcpPhase(name=f"{self.phase.name} held", n_steps=n, duration=duration)
            yield self._stretch(ocp, (max(marks.entered, marks.end - self.hold), marks.end), ends=True, holds=True)

    def _stretch(self, ocp: OcpPhase, greedy: tuple[float, float], **more: Any) -> Stretch:
        return Stretch(phase=self.index, ocp=ocp, greedy=greedy, **more)

    def _free_phase(self, name: str, greedy: float) -> OcpPhase:
        longest = max(_LONGEST * greedy, self.moving) + _LEEWAY
        shortest = max(_SHORTEST * greedy, self.moving, 0.2 * _LEEWAY)
        return OcpPhase(
            name=name, n_steps=max(_FEWEST, math.ceil(greedy / self.step)), duration=(shortest, longest)
        )


def _entered(greedy: GreedyWay, k: int, kept: Sequence[Task]) -> float:
    """When [s] all of the kept tasks hold for the first time in the k-th phase of the greedy way."""
    for row in greedy.rows(k):
        if not any(is_broken(task, greedy.at(row)) for task in kept):
            return float(greedy.t[row]) if row > greedy.rows(k)[0] else float(greedy.begins[k])
    return float(greedy.begins[k + 1])


def end_of_goals(phase: Phase, on: Sequence[Task]) -> float:
    """on: tasks that are. When the goals that are the phase's own come to rest [s after its beginning]; 0 where none of them moves."""
    ends = [0.0]
    for task in on:
        goal = phase.goals.get(task.name)
        if callable(goal):
            ends.append(float(goal.end) if isinstance(goal, EndingReference) else 0.0)
    return max(ends)

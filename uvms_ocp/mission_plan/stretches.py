"""The horizon of a mission: each phase as a stretch of free length, and what has to be held at its end as one more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import DONE, Transition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.mission_plan.greedy_way import GreedyWay
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
    holds: bool
    """The conditions of the phase's transition hold all along it."""
    ends: bool
    """The phase ends with it."""
    ocp: OcpPhase
    """Name, steps and range of durations."""
    greedy: tuple[float, float]
    """[s] when the greedy mission is in it."""


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
    for k, index in enumerate(greedy.phases):
        found += _of_phase(mission, greedy, k, index, margins, step=step)
    return found


def _of_phase(
    mission: Mission, greedy: GreedyWay, k: int, index: int, margins: Margins, *, step: float
) -> list[Stretch]:
    phase, hold = mission.phases[index], way_out(mission.phases, greedy.phases, k).hold
    begin, end = greedy.begins[k : k + 2].tolist()
    middle = max(begin, end - hold)
    moving = end_of_goals(phase, mission.tasks_of(index))
    parts = []
    step = min(step, _FOLLOWED) if moving else step
    if not 0 < moving <= hold:
        # A goal that rests while conditions have to hold is followed from the beginning of that.
        span = (begin, middle)
        ocp = _free(phase.name, middle - begin, moving, step=step)
        parts.append(Stretch(phase=index, holds=False, ends=not hold, ocp=ocp, greedy=span))
    if hold:
        ocp = OcpPhase(
            name=f"{phase.name} held", n_steps=max(2, math.ceil(hold / step)), duration=hold + margins.hold
        )
        parts.append(Stretch(phase=index, holds=True, ends=True, ocp=ocp, greedy=(middle, end)))
    return parts


def _free(name: str, greedy: float, moving: float, *, step: float) -> OcpPhase:
    longest = max(_LONGEST * greedy, moving) + _LEEWAY
    shortest = max(_SHORTEST * greedy, moving, 0.2 * _LEEWAY)
    return OcpPhase(name=name, n_steps=max(_FEWEST, math.ceil(greedy / step)), duration=(shortest, longest))


def end_of_goals(phase: Phase, tasks: Sequence[Task]) -> float:
    """When the goals that are the phase's own come to rest [s after its beginning]; 0 where none of them moves."""
    ends = [0.0]
    for task in tasks:
        goal = phase.goals.get(task.name)
        if phase.gates.get(task.name, 0.0) > 0 and callable(goal):
            ends.append(float(goal.end) if isinstance(goal, EndingReference) else 0.0)
    return max(ends)

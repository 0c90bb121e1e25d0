"""What kernels have made of a mission's memory, in words: the state after, and the event that tells of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from uvms_ocp.arguments import changed
from uvms_ocp.mission.conditions import ABORT, Transition
from uvms_ocp.mission.phase import Event, GoalFunctions, MissionState, Phase
from uvms_ocp.mission.progress import NONE, is_over, is_used_up


def went_on(
    phases: Sequence[Phase], state: MissionState, memory: Any, due: int, t: float, quantities: Mapping[str, float]
) -> tuple[MissionState, Event | None]:
    """What `Mission.step` returns, from the state before, after `transition_due` and where one was due, `follow` at t [s].

    quantities: those that it was due with [in their units].
    """
    if due == NONE:
        return changed(state, held_since=_held_since(memory)) if memory.changed else state, None
    phase = phases[state.phase]
    transition, n_fired = phase.transitions[due], state.fired.get((state.phase, due), 0)
    reason, target = _reason(transition, quantities), transition.to
    if transition.retries is not None and is_used_up(n_fired, transition.retries):
        reason, target = f"{n_fired} retries are used up: {reason}", ABORT
    values = tuple((condition, quantities[condition.quantity]) for condition in transition.when)
    event = Event(t=t, source=phase.name, target=target, reason=reason, conditions=values)
    return _after(phases, state, memory, reason), event


def gave_up(
    phases: Sequence[Phase], state: MissionState, memory: Any, t: float, why: str, goals: GoalFunctions
) -> tuple[MissionState, Event]:
    """What `Mission.abandon` returns, from the state before, after `give_up` at t [s]. goals: of the abort phase."""
    after, source = _after(phases, state, memory, why), phases[state.phase].name
    target = ABORT if after.over else phases[after.phase].name
    event = Event(t=t, source=source, target=target, reason=why, conditions=())
    return after if after.over else changed(after, why=why, goals=goals), event


def _after(phases: Sequence[Phase], state: MissionState, memory: Any, reason: str) -> MissionState:
    if is_over(memory):
        return changed(state, completed=bool(memory.completed), aborted=(state.why or reason) * bool(memory.aborted))
    return MissionState(
        phase=memory.phase,
        since=memory.since,
        gates_before=np.array(memory.gates_before)[: len(state.gates_before)],
        held_since=_held_since(memory),
        fired=_fired(phases, memory),
    )


def _fired(phases: Sequence[Phase], memory: Any) -> dict[tuple[int, int], int]:
    """As `MissionState` has it."""
    counted = {
        (k, i): memory.fired[memory.first[k] + i]
        for k, phase in enumerate(phases)
        for i in range(len(phase.transitions))
    }
    return {which: n for which, n in counted.items() if n}


def _held_since(memory: Any) -> tuple[float | None, ...]:
    """As `MissionState` has it."""
    times = [memory.held_since[k] for k in range(memory.first[memory.phase], memory.end[memory.phase])]
    return tuple(None if math.isnan(since) else since for since in times)


def _reason(transition: Transition, quantities: Mapping[str, float]) -> str:
    held = f" for {transition.hold:g} s" if transition.hold else ""
    return transition.describe(quantities) + held

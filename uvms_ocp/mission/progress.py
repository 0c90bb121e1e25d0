"""State machine of a mission as kernels: activations, due transitions, abort; and its memory as
`MissionState` and `Event`.

Transitions are those of all phases one after the other, conditions those of all transitions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import IntEnum
from typing import Annotated

import numpy as np

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, view
from uvms_ocp.mission.phase import (
    Condition,
    Event,
    GoalFunctions,
    MissionState,
    Phase,
    is_met,
)
from uvms_ocp.record.meta_values import ABORT, DONE, OWN_QUANTITIES
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.signals import SAME_TIME

NONE = -1
"""Instead of the index of a transition, phase or quantity."""


class Terminal(IntEnum):
    """Ends of a mission, to which a transition may lead in place of a phase."""

    DONE = -1
    ABORT = -2


class MissionMemory(Layout):
    """The conditions of a mission, and where it is."""

    ramp: float
    """[s] Length of the cosine step of external activations."""
    targets: Annotated[list[Vector], Sized("n_phases", "n_tasks")]
    """(n_phases, n_tasks) external activations."""
    first: Annotated[list[int], Sized("n_phases")]
    """(n_phases,) first transition of each phase."""
    end: Annotated[list[int], Sized("n_phases")]
    """(n_phases,) the transition after the last one of each phase."""
    first_condition: Annotated[list[int], Sized("n_transitions")]
    """(n_transitions,) first condition of each transition."""
    end_condition: Annotated[list[int], Sized("n_transitions")]
    """(n_transitions,) the condition after the last one of each transition."""
    hold: Annotated[Vector, Sized("n_transitions")]
    """(n_transitions,) [s] duration for which the conditions of each must hold."""
    to: Annotated[list[int], Sized("n_transitions")]
    """(n_transitions,) the phase that each leads to, or a `Terminal`."""
    retries: Annotated[list[int], Sized("n_transitions")]
    """(n_transitions,) number of times that each may fire; below 0 for any number."""
    quantity: Annotated[list[int], Sized("n_conditions")]
    """(n_conditions,) index of the quantity that each limits."""
    below: Annotated[list[int], Sized("n_conditions")]
    """(n_conditions,) 1 where the quantity has to be below its limit, 0 above."""
    limit: Annotated[Vector, Sized("n_conditions")]
    """(n_conditions,) [unit of the quantity] limit."""
    release: Annotated[Vector, Sized("n_conditions")]
    """(n_conditions,) [unit of the quantity] limit while the transition holds."""
    abort_phase: int
    """Index of the phase of `Abort`, or `NONE`."""
    phase: int
    """Index of the present phase."""
    since: float
    """[s] start of the phase."""
    began: float
    """[s] start of the mission."""
    started: bool
    """True once the mission has begun."""
    activations_before: Annotated[Vector, Sized("n_tasks")]
    """(n_tasks,) external activations at the start of the phase, from which the step begins."""
    held_since: Annotated[Vector, Sized("n_transitions")]
    """(n_transitions,) [s] since when each holds; NaN where it does not."""
    changed: bool
    """True where any of these changed in the last evaluation."""
    fired: Annotated[list[int], Sized("n_transitions")]
    """(n_transitions,) number of times that each was taken."""
    completed: bool
    """True where the mission has ended as wanted."""
    aborted: bool
    """True where the mission has ended otherwise."""
    given_up: bool
    """True where the mission is, or was at its end, in the abort phase."""
    own: Annotated[list[int], Sized(6)]
    """(6,) index of each of `OWN_QUANTITIES` among the quantities, or `NONE`."""
    spent: float
    """[J] energy used so far."""
    spent_before: float
    """[J] energy used before the phase."""


def start_at_first_tick(mission: MissionMemory, t: float) -> None:
    """Let the mission begin at t [s], whatever clock that is of, where it has not begun."""
    if not mission.started:
        mission.started = True
        mission.began = t
        mission.since = t


def activations_at(mission: MissionMemory, t: float, activations: Vector) -> None:
    """Compute the external activation of each task at time t [s] ([Gao2022] eq. 22 in time)."""
    target = mission.targets[mission.phase]
    passed = t - mission.since
    blend = 0.0
    if 0.0 < passed < mission.ramp:
        blend = 0.5 - 0.5 * math.cos(math.pi * (passed / mission.ramp))
    for i in range(len(mission.activations_before)):
        if passed >= mission.ramp:
            activations[i] = target[i]
        else:
            activations[i] = (1.0 - blend) * mission.activations_before[i] + blend * target[i]


def measure_own(
    mission: MissionMemory, t: float, load: float, spent: float, quantities: Vector
) -> None:
    """Write those of `OWN_QUANTITIES` that conditions read, at t [s], with a load [N] and energy
    spent so far [J].
    """
    mission.spent = spent
    if mission.own[0] != NONE:
        quantities[mission.own[0]] = t - mission.began
    if mission.own[1] != NONE:
        quantities[mission.own[1]] = t - mission.since
    if mission.own[2] != NONE:
        if mission.phase == 0 or mission.given_up:
            visits = 1.0
        else:
            visits = 0.0
        for i in range(len(mission.to)):
            visits += mission.fired[i] if mission.to[i] == mission.phase else 0.0
        quantities[mission.own[2]] = visits
    if mission.own[3] != NONE:
        quantities[mission.own[3]] = load
    if mission.own[4] != NONE:
        quantities[mission.own[4]] = spent
    if mission.own[5] != NONE:
        quantities[mission.own[5]] = spent - mission.spent_before


def always_grows(mission: MissionMemory, quantity: int) -> bool:
    """Return whether a quantity, by its index, grows whatever the robot does: time and energy. A
    kernel.
    """
    return (
        quantity == mission.own[0]
        or quantity == mission.own[1]
        or quantity == mission.own[4]
        or quantity == mission.own[5]
    )


def transition_due(mission: MissionMemory, t: float, quantities: Vector) -> int:
    """Find the transition of the phase that fires at t [s], or `NONE`; note since when each of them
    holds.
    """
    due = NONE
    first = mission.first[mission.phase]
    mission.changed = False
    for i in range(first, mission.end[mission.phase]):
        held = not math.isnan(mission.held_since[i])
        holds = True
        for k in range(mission.first_condition[i], mission.end_condition[i]):
            met = is_met(
                quantities[mission.quantity[k]],
                mission.release[k] if held else mission.limit[k],
                mission.below[k] != 0,
            )
            holds = holds and met
        if holds != held:
            mission.held_since[i] = t if holds else math.nan
            mission.changed = True
        if holds and due == NONE and t - mission.held_since[i] >= mission.hold[i] - SAME_TIME:
            due = i - first
    return due


def take_transition(mission: MissionMemory, t: float, due: int) -> None:
    """Take a transition of the phase at t [s], or end where it has no retries left."""
    i = mission.first[mission.phase] + due
    to = Terminal.ABORT if is_used_up(mission.fired[i], mission.retries[i]) else mission.to[i]
    mission.completed = to == Terminal.DONE
    mission.aborted = to == Terminal.ABORT
    if to >= 0:
        mission.fired[i] += 1
        _enter(mission, to, t)


def is_used_up(fired: int, retries: int) -> bool:
    """Check that a transition that `fired` so often may not do so again. A kernel."""
    return 0 <= retries <= fired


def abort_mission(mission: MissionMemory, t: float, climbs: bool) -> None:
    """Give the mission up at t [s]: the abort phase begins, or where there is none, or nothing to
    climb to, all ends.
    """
    mission.aborted = not climbs or mission.given_up or mission.abort_phase == NONE
    if not mission.aborted:
        _enter(mission, mission.abort_phase, t)
        mission.given_up = True


def is_over(mission: MissionMemory) -> bool:
    """Check whether the mission has ended, completed or not."""
    return mission.completed or mission.aborted


def _enter(mission: MissionMemory, phase: int, t: float) -> None:
    activations_at(mission, t, mission.activations_before)
    mission.phase = phase
    mission.since = t
    mission.spent_before = mission.spent
    for i in range(len(mission.held_since)):
        mission.held_since[i] = math.nan


def with_phases(dimensions: Dimensions, phases: Sequence[Phase], n_tasks: int) -> Dimensions:
    """Return the dimensions with those of a mission of these phases, with that of an abort."""
    return replace(
        dimensions,
        n_tasks=n_tasks,
        n_phases=len(phases),
        n_transitions=sum(len(phase.transitions) for phase in phases),
        n_conditions=sum(len(phase.conditions) for phase in phases),
    )


def quantities_read(phases: Sequence[Phase]) -> tuple[str, ...]:
    """Return the names of all quantities in conditions."""
    names: list[str] = []
    for phase in phases:
        names += [condition.quantity for condition in phase.conditions]
    return tuple(dict.fromkeys(names))


def write_conditions(memory: MissionMemory, phases: Sequence[Phase], names: Sequence[str]) -> None:
    """Write the conditions of all phases into a `MissionMemory`; names: of the entries of its
    vector of quantities.
    """
    for k, name in enumerate(OWN_QUANTITIES):
        memory.own[k] = names.index(name) if name in names else NONE
    targets: dict[str, int] = {DONE: Terminal.DONE, ABORT: Terminal.ABORT}
    for index, phase in enumerate(phases):
        targets[phase.name] = index
    n_transitions = 0
    n_conditions = 0
    for index, phase in enumerate(phases):
        memory.first[index] = n_transitions
        for transition in phase.transitions:
            memory.first_condition[n_transitions] = n_conditions
            memory.hold[n_transitions] = transition.hold
            memory.to[n_transitions] = targets[transition.to]
            memory.retries[n_transitions] = -1
            if transition.retries is not None:
                memory.retries[n_transitions] = transition.retries
            for condition in transition.when:
                _write_condition(memory, n_conditions, condition, names)
                n_conditions += 1
            memory.end_condition[n_transitions] = n_conditions
            n_transitions += 1
        memory.end[index] = n_transitions


def _write_condition(
    memory: MissionMemory, index: int, condition: Condition, names: Sequence[str]
) -> None:
    """Write a condition into a `MissionMemory`, under its index among all conditions."""
    memory.quantity[index] = names.index(condition.quantity)
    memory.below[index] = condition.is_below
    memory.limit[index] = condition.limit
    memory.release[index] = condition.limit
    if condition.release is not None:
        memory.release[index] = condition.release


def write_state(memory: MissionMemory, state: MissionState) -> None:
    """Write the state of a mission to the memory."""
    memory.phase = state.phase
    memory.since = state.since
    memory.began = state.began
    memory.started = True
    memory.completed = state.completed
    memory.aborted = bool(state.aborted)
    memory.given_up = bool(state.abort_reason)
    view(memory.activations_before)[: len(state.activations_before)] = state.activations_before
    view(memory.fired)[:] = 0
    for (phase, index), n in state.fired.items():
        memory.fired[memory.first[phase] + index] = n
    view(memory.held_since)[:] = math.nan
    for k, since in enumerate(state.held_since, memory.first[state.phase]):
        if since is not None:
            memory.held_since[k] = since


def state_after_transition(
    phases: Sequence[Phase],
    state: MissionState,
    memory: MissionMemory,
    due: int,
    t: float,
    quantities: Mapping[str, float],
) -> tuple[MissionState, Event | None]:
    """Return state and event after `transition_due` and, where one was due, `take_transition` at t
    [s].

    quantities: those that it was due with [in their units].
    """
    if due == NONE:
        if memory.changed:
            state = replace_unchecked(state, held_since=_held_since(memory))
        return state, None
    phase = phases[state.phase]
    transition = phase.transitions[due]
    n_fired = state.fired.get((state.phase, due), 0)
    reason = transition.describe(quantities)
    if transition.hold:
        reason += f" for {transition.hold:g} s"
    target = transition.to
    if transition.retries is not None and is_used_up(n_fired, transition.retries):
        reason = f"{n_fired} retries are used up: {reason}"
        target = ABORT
    measurements = []
    for condition in transition.when:
        measurements.append((condition, quantities[condition.quantity]))
    event = Event(
        t=t, source=phase.name, target=target, reason=reason, conditions=tuple(measurements)
    )
    return _after(phases, state, memory, reason), event


def state_after_abort(
    phases: Sequence[Phase],
    state: MissionState,
    memory: MissionMemory,
    t: float,
    reason: str,
    goals: GoalFunctions,
) -> tuple[MissionState, Event]:
    """Return state and event after `abort_mission` at t [s]. goals: of the abort phase."""
    next_state = _after(phases, state, memory, reason)
    target = ABORT
    if not next_state.over:
        next_state = replace_unchecked(next_state, abort_reason=reason, goals=goals)
        target = phases[next_state.phase].name
    source = phases[state.phase].name
    event = Event(t=t, source=source, target=target, reason=reason, conditions=())
    return next_state, event


def _after(
    phases: Sequence[Phase], state: MissionState, memory: MissionMemory, reason: str
) -> MissionState:
    """Return the state that a memory holds; reason: why the mission ends, if it is aborted."""
    if is_over(memory):
        aborted = ""
        if memory.aborted:
            aborted = state.abort_reason or reason
        return replace_unchecked(state, completed=bool(memory.completed), aborted=aborted)
    fired = {}
    for k, phase in enumerate(phases):
        for i in range(len(phase.transitions)):
            n_fired = memory.fired[memory.first[k] + i]
            if n_fired:
                fired[k, i] = n_fired
    return MissionState(
        phase=memory.phase,
        since=memory.since,
        began=memory.began,
        activations_before=np.array(memory.activations_before)[: len(state.activations_before)],
        held_since=_held_since(memory),
        fired=fired,
    )


def _held_since(memory: MissionMemory) -> tuple[float | None, ...]:
    """Return since when [s] each transition of the phase holds; None where it does not."""
    times: list[float | None] = []
    for k in range(memory.first[memory.phase], memory.end[memory.phase]):
        since = memory.held_since[k]
        if math.isnan(since):
            times.append(None)
        else:
            times.append(since)
    return tuple(times)

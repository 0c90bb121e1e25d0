"""Where a mission is and what ends its phases, as numbers: what `Mission` asks at every tick, as kernels.

Transitions are those of all phases one after the other, conditions those of all transitions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, view
from uvms_ocp.mission.conditions import Below, Condition, is_met
from uvms_ocp.mission.phase import MissionState, Phase

_SAME_TIME = 1e-9  # [s] rounding of times
NONE = -1
"""Instead of the index of a transition."""


class MissionMemory(Layout):
    """The conditions of a mission, and where it is."""

    ramp: float
    """[s] of the bell on external activations."""
    targets: Annotated[list[Vector], Sized("n_phases", "n_tasks")]
    """(n_phases, n_tasks) [-] external activations."""
    first: Annotated[list[int], Sized("n_phases")]
    """(n_phases,) first transition of each phase."""
    end: Annotated[list[int], Sized("n_phases")]
    """(n_phases,) the one after its last."""
    first_condition: Annotated[list[int], Sized("n_transitions")]
    """(n_transitions,) first condition of each transition."""
    end_condition: Annotated[list[int], Sized("n_transitions")]
    """(n_transitions,) the one after its last."""
    hold: Annotated[Vector, Sized("n_transitions")]
    """(n_transitions,) [s] as that of `Transition`."""
    quantity: Annotated[list[int], Sized("n_conditions")]
    """(n_conditions,) index of what each is about."""
    below: Annotated[list[int], Sized("n_conditions")]
    """(n_conditions,) whether that has to be below its limit, not above."""
    limit: Annotated[Vector, Sized("n_conditions")]
    """(n_conditions,) [unit of the quantity]"""
    release: Annotated[Vector, Sized("n_conditions")]
    """(n_conditions,) [unit of the quantity] its limit while the transition holds."""
    phase: int
    """Where it is."""
    since: float
    """[s] start of the phase."""
    gates_before: Annotated[Vector, Sized("n_tasks")]
    """(n_tasks,) [-] as in `MissionState`."""
    held_since: Annotated[Vector, Sized("n_transitions")]
    """(n_transitions,) [s] since when each holds; NaN where it does not."""
    changed: bool
    """Whether any of these has, in the last look."""
    over: bool
    """It has ended."""
    given_up: bool
    """It is in the abort phase."""


def gates_at(m: MissionMemory, t: float, gates: Vector) -> None:
    """External activation of each task at time t [s] ([Gao2022] eq. 22 in time)."""
    target, passed = m.targets[m.phase], t - m.since
    blend = 0.0
    if 0.0 < passed < m.ramp:
        blend = 0.5 - 0.5 * math.cos(math.pi * (passed / m.ramp))
    for i in range(len(m.gates_before)):
        gates[i] = target[i] if passed >= m.ramp else (1.0 - blend) * m.gates_before[i] + blend * target[i]


def transition_due(m: MissionMemory, t: float, quantities: Vector) -> int:
    """The transition of the phase that fires at t [s], or `NONE`; notes since when each of them holds."""
    due, first = NONE, m.first[m.phase]
    m.changed = False
    for i in range(first, m.end[m.phase]):
        held = not math.isnan(m.held_since[i])
        holds = True
        for k in range(m.first_condition[i], m.end_condition[i]):
            met = is_met(quantities[m.quantity[k]], m.release[k] if held else m.limit[k], m.below[k] != 0)
            holds = holds and met
        if holds != held:
            m.held_since[i] = t if holds else math.nan
            m.changed = True
        if holds and due == NONE and t - m.held_since[i] >= m.hold[i] - _SAME_TIME:
            due = i - first
    return due


def sizes_of(phases: Sequence[Phase]) -> dict[str, int]:
    """Of a `MissionMemory`, but for the number of tasks."""
    transitions = [transition for phase in phases for transition in phase.transitions]
    n_conditions = sum(len(transition.when) for transition in transitions)
    return {"n_phases": len(phases), "n_transitions": len(transitions), "n_conditions": n_conditions}


def quantities_read(phases: Sequence[Phase]) -> tuple[str, ...]:
    """Names of all quantities in conditions."""
    return tuple(dict.fromkeys(c.quantity for phase in phases for tr in phase.transitions for c in tr.when))


def write_conditions(memory: Any, phases: Sequence[Phase], names: Sequence[str]) -> None:
    """Those of all phases into a `MissionMemory`; names: of the vector of quantities that they are asked with."""
    transitions = conditions = 0
    for index, phase in enumerate(phases):
        memory.first[index] = transitions
        for transition in phase.transitions:
            memory.first_condition[transitions], memory.hold[transitions] = conditions, transition.hold
            for condition in transition.when:
                _write_condition(memory, conditions, condition, names)
                conditions += 1
            memory.end_condition[transitions] = conditions
            transitions += 1
        memory.end[index] = transitions


def _write_condition(memory: Any, at: int, condition: Condition, names: Sequence[str]) -> None:
    memory.quantity[at], memory.below[at] = names.index(condition.quantity), isinstance(condition, Below)
    memory.limit[at] = condition.limit
    memory.release[at] = condition.limit if condition.release is None else condition.release


def write_state(memory: Any, state: MissionState) -> None:
    """Where a mission is."""
    memory.phase, memory.since = state.phase, state.since
    memory.over, memory.given_up = state.over, bool(state.why)
    view(memory.gates_before)[: len(state.gates_before)] = state.gates_before
    first = memory.first[state.phase]
    for k, since in enumerate(state.held_since, first):
        memory.held_since[k] = math.nan if since is None else since


def held_since(memory: Any) -> tuple[float | None, ...]:
    """As `MissionState` has it."""
    times = [memory.held_since[k] for k in range(memory.first[memory.phase], memory.end[memory.phase])]
    return tuple(None if math.isnan(since) else since for since in times)

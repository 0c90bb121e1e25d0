"""Which tasks act when: phases, their transitions, and the log of why ([Gao2022] figures 3 and 4).

`Mission` is a value without memory. Its memory is `MissionState`, another value: `Mission.step` maps one to the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.tasks.activation import Bell
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.task import StopAhead, Task

DONE, ABORT = "done", "abort"
"""Where a mission ends: as wanted, or given up."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Below:
    """True once a measured quantity, named ``task.quantity``, is below `limit`, until it reaches `release` again.

    Without `release` there is no hysteresis: both are the same.
    """

    quantity: str
    limit: float
    release: float | None = None

    def __post_init__(self) -> None:
        _check_threshold(self.quantity, self.limit)
        if self.release is not None and not (math.isfinite(self.release) and self.release >= self.limit):
            raise InvalidInput(f"release of {self.quantity} = {self.release}; give at least the limit {self.limit:g}")

    def holds(self, quantities: Mapping[str, float], held: bool = False) -> bool:
        """Whether it is true now, given whether it was `held` to be true before."""
        limit = self.limit if self.release is None or not held else self.release
        return quantities[self.quantity] < limit

    def describe(self, quantities: Mapping[str, float]) -> str:
        """One clause with the measured value, true or not."""
        sign = "<" if self.holds(quantities) else "not <"
        return f"{self.quantity} = {quantities[self.quantity]:.4g} {sign} {self.limit:g}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Above:
    """True once a measured quantity exceeds `limit`, and until it falls to `release`; mirror of `Below`."""

    quantity: str
    limit: float
    release: float | None = None

    def __post_init__(self) -> None:
        _check_threshold(self.quantity, self.limit)
        if self.release is not None and not (math.isfinite(self.release) and self.release <= self.limit):
            raise InvalidInput(f"release of {self.quantity} = {self.release}; give at most the limit {self.limit:g}")

    def holds(self, quantities: Mapping[str, float], held: bool = False) -> bool:
        """Whether it is true now, given whether it was `held` to be true before."""
        limit = self.limit if self.release is None or not held else self.release
        return quantities[self.quantity] > limit

    def describe(self, quantities: Mapping[str, float]) -> str:
        """One clause with the measured value, true or not."""
        sign = ">" if self.holds(quantities) else "not >"
        return f"{self.quantity} = {quantities[self.quantity]:.4g} {sign} {self.limit:g}"


Condition: TypeAlias = Below | Above


@dataclass(frozen=True, kw_only=True, slots=True)
class Transition:
    """Leads to phase `to` (or `DONE`, or `ABORT`) once every condition has held for `hold` seconds without a gap.

    A transition to an earlier phase is a back-step. It fires at most `retries` times; the next time the mission is
    given up, with that as the reason.
    """

    to: str
    when: tuple[Condition, ...]
    hold: float = 0.0  # [s]
    retries: int | None = None  # None: as often as it likes

    def __post_init__(self) -> None:
        if not isinstance(self.when, tuple):
            raise InvalidInput(f"transition to {self.to!r}: when = {self.when!r}; give a tuple of conditions")
        if not self.when:
            raise InvalidInput(f"transition to {self.to!r} has no conditions; give at least one")
        if not (math.isfinite(self.hold) and self.hold >= 0):
            raise InvalidInput(f"transition to {self.to!r}: hold = {self.hold} s; give a finite time >= 0")
        if self.retries is not None and self.retries < 0:
            raise InvalidInput(f"transition to {self.to!r}: retries = {self.retries}; give 0 or more")

    def holds(self, quantities: Mapping[str, float], held: bool = False) -> bool:
        return all(condition.holds(quantities, held) for condition in self.when)

    def describe(self, quantities: Mapping[str, float]) -> str:
        return ", ".join(condition.describe(quantities) for condition in self.when)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Phase:
    """One action: the external activation of each task, and what ends it.

    `gates` maps task names to values in [0, 1]; tasks that are not named are off. `goals` maps task names to goals that
    replace the task's own during this phase; those that move count their time from the start of the phase.
    """

    name: str
    title: str = ""
    gates: Mapping[str, float]
    transitions: tuple[Transition, ...]
    goals: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.transitions, tuple):
            raise InvalidInput(f"phase {self.name!r}: transitions = {self.transitions!r}; give a tuple of transitions")
        bad = {name: gate for name, gate in self.gates.items() if not 0 <= gate <= 1}
        if bad:
            raise InvalidInput(f"phase {self.name!r}: activations {bad}; give values from 0 to 1")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionState:
    """Where a mission is."""

    phase: int
    since: float  # [s] start of the phase
    gates_before: np.ndarray  # (n_tasks,) gates when the phase began; the bell leads on from them
    held_since: tuple[float | None, ...]  # [s] since when each transition of the phase holds
    completed: bool = False
    aborted: str = ""  # why the mission was given up
    fired: Mapping[tuple[int, int], int] = field(default_factory=dict)  # how often, by phase and transition

    @property
    def over(self) -> bool:
        """The mission has ended, one way or the other."""
        return self.completed or bool(self.aborted)


@dataclass(frozen=True, kw_only=True, slots=True)
class Event:
    """Why a phase ended."""

    t: float  # [s]
    source: str
    target: str
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mission:
    """Phases over one hierarchy; the first phase begins at t = 0.

    Raises `NameNotFound` for an unknown task or phase name, and `InvalidInput` for quantities that no task measures.
    """

    hierarchy: Hierarchy
    phases: tuple[Phase, ...]
    ramp: float = 0.2  # [s] duration of the bell on external activations
    _targets: np.ndarray = field(init=False, repr=False)  # (n_phases, n_tasks)
    _tasks: tuple[tuple[Task, ...], ...] = field(init=False, repr=False)  # per phase, with its goals

    def __post_init__(self) -> None:
        if not self.phases:
            raise InvalidInput("mission without phases; give at least one")
        if not (math.isfinite(self.ramp) and self.ramp >= 0):
            raise InvalidInput(f"mission: ramp = {self.ramp} s; give a finite time >= 0")
        self._check_targets()
        object.__setattr__(self, "_targets", np.array([self._gates_of(phase) for phase in self.phases]))
        object.__setattr__(self, "_tasks", tuple(self._tasks_of(phase) for phase in self.phases))

    @property
    def phase_names(self) -> tuple[str, ...]:
        return tuple(phase.name for phase in self.phases)

    def tasks_of(self, phase: int) -> tuple[Task, ...]:
        """All tasks with the goals that they have in a phase, highest priority first."""
        return self._tasks[phase]

    def check_quantities(self, known: Sequence[str]) -> None:
        """Raise `NameNotFound` where a transition reads a quantity that is not in `known`."""
        for phase in self.phases:
            for transition in phase.transitions:
                for condition in transition.when:
                    if condition.quantity not in known:
                        raise NameNotFound(f"quantity in phase {phase.name!r}", condition.quantity, known)

    def start(self) -> MissionState:
        """The state at t = 0: every gate rises from zero."""
        return self._enter(0, 0.0, np.zeros(len(self.hierarchy.tasks)))

    def gates(self, state: MissionState, t: float) -> np.ndarray:
        """External activation (n_tasks,) of each task at time t [s] ([Gao2022] eq. 22 in time)."""
        if t - state.since >= self.ramp:
            return self._targets[state.phase].copy()
        blend = float(Bell(0.0, self.ramp).increasing(t - state.since))
        return (1 - blend) * state.gates_before + blend * self._targets[state.phase]

    def reference(self, state: MissionState, t: float) -> np.ndarray:
        """Goals of all tasks at time t [s], one after the other, as `Task.reference` gives them."""
        return np.concatenate([task.reference(self._clock(state, task, t)) for task in self._tasks[state.phase]])

    def parameters(self, state: MissionState, t: float, q: np.ndarray, stop: StopAhead | None = None) -> np.ndarray:
        """Parameters of all tasks at time t [s] and measured configuration q (n_q,), as `Task.parameters` gives them.

        Tasks that are off, and stay off, are not asked for what they would have to measure.
        """
        off = (self._targets[state.phase] == 0) & (self.gates(state, t) == 0)
        return np.concatenate(
            [
                task.reference(time) if idle else task.parameters(time, q, stop)
                for task, idle in zip(self._tasks[state.phase], off, strict=True)
                for time in [self._clock(state, task, t)]
            ]
        )

    def step(self, state: MissionState, t: float, quantities: Mapping[str, float]) -> tuple[MissionState, Event | None]:
        """The state after the quantities measured at t, and the event if a transition fired."""
        if state.over:
            return state, None
        phase = self.phases[state.phase]
        held = tuple(
            _held(tr, since, t, quantities) for tr, since in zip(phase.transitions, state.held_since, strict=True)
        )
        for index, (transition, since) in enumerate(zip(phase.transitions, held, strict=True)):
            if since is not None and t - since >= transition.hold - 1e-9:
                return self._follow(state, index, t, quantities)
        return replace(state, held_since=held), None

    def pending(self, state: MissionState, quantities: Mapping[str, float]) -> str:
        """What the current phase still waits for, or why the mission was given up."""
        if state.aborted:
            return f"given up, {state.aborted}"
        return " or ".join(tr.describe(quantities) for tr in self.phases[state.phase].transitions)

    def table(self) -> list[dict[str, Any]]:
        """Tasks by phases: one row per task with its external activation in each phase ([Gao2022] Table 4)."""
        return [
            {"task": task.name, "type": task.label, **dict(zip(self.phase_names, column, strict=True))}
            for task, column in zip(self.hierarchy.tasks, self._targets.T.tolist(), strict=True)
        ]

    def __str__(self) -> str:
        """The table of `table` as text, 1 for on and a dot for off, with the titles of the phases below."""
        width = max(len(name) for name in (*self.hierarchy.names, "task"))
        columns = [max(len(name), 4) for name in self.phase_names]
        head = [name.rjust(size) for name, size in zip(self.phase_names, columns, strict=True)]
        lines = [f"{'task'.ljust(width)}  {'type':<9} {' '.join(head)}"]
        for task, gates in zip(self.hierarchy.tasks, self._targets.T, strict=True):
            cells = [(f"{gate:g}" if gate else ".").rjust(size) for gate, size in zip(gates, columns, strict=True)]
            lines.append(f"{task.name.ljust(width)}  {task.label:<9} {' '.join(cells)}")
        return "\n".join([*lines, *(f"{phase.name}: {phase.title}" for phase in self.phases if phase.title)])

    def _clock(self, state: MissionState, task: Task, t: float) -> float:
        """Time [s] that a task's goal sees: since the start of the phase where the goal is the phase's own."""
        return t - state.since if task.name in self.phases[state.phase].goals else t

    def unreachable_phases(self) -> tuple[str, ...]:
        """Names of the phases that no chain of transitions leads to from the first."""
        reached = _closure({self.phase_names[0]}, self._successors())
        return tuple(name for name in self.phase_names if name not in reached)

    def phases_without_exit(self) -> tuple[str, ...]:
        """Names of the phases from which no chain of transitions leads to `DONE`."""
        return tuple(name for name in self.phase_names if DONE not in _closure({name}, self._successors()))

    def mermaid(self) -> str:
        """The phases and transitions as a state diagram in Mermaid's notation."""
        lines = ["stateDiagram-v2", f"    [*] --> {self.phase_names[0]}"]
        for phase in self.phases:
            lines.append(f"    {phase.name} : {phase.name} {phase.title}".rstrip())
            lines += [f"    {phase.name} --> {_arrow(transition)}" for transition in phase.transitions]
        return "\n".join(lines) + "\n"

    def _successors(self) -> dict[str, set[str]]:
        return {phase.name: {transition.to for transition in phase.transitions} for phase in self.phases}

    def _follow(
        self, state: MissionState, index: int, t: float, quantities: Mapping[str, float]
    ) -> tuple[MissionState, Event]:
        """Take the transition `index` of the current phase, or give up where it has no retries left."""
        phase = self.phases[state.phase]
        transition, n_fired = phase.transitions[index], state.fired.get((state.phase, index), 0)
        reason, target = _reason(transition, quantities), transition.to
        if transition.retries is not None and n_fired >= transition.retries:
            reason, target = f"{n_fired} retries are used up: {reason}", ABORT
        event = Event(t=t, source=phase.name, target=target, reason=reason)
        if target == DONE:
            return replace(state, completed=True), event
        if target == ABORT:
            return replace(state, aborted=reason), event
        fired = {**state.fired, (state.phase, index): n_fired + 1}
        return self._enter(self.phase_names.index(target), t, self.gates(state, t), fired), event

    def _enter(
        self, phase: int, t: float, gates: np.ndarray, fired: Mapping[tuple[int, int], int] | None = None
    ) -> MissionState:
        waiting = (None,) * len(self.phases[phase].transitions)
        return MissionState(phase=phase, since=t, gates_before=gates, held_since=waiting, fired=fired or {})

    def _gates_of(self, phase: Phase) -> np.ndarray:
        gates = np.zeros(len(self.hierarchy.tasks))
        for name, gate in phase.gates.items():
            gates[self.hierarchy.index(name)] = gate
        return gates

    def _tasks_of(self, phase: Phase) -> tuple[Task, ...]:
        tasks = list(self.hierarchy.tasks)
        for name, goal in phase.goals.items():
            index = self.hierarchy.index(name)
            tasks[index] = tasks[index].with_goal(goal)
        return tuple(tasks)

    def _check_targets(self) -> None:
        for phase in self.phases:
            for transition in phase.transitions:
                if transition.to not in (*self.phase_names, DONE, ABORT):
                    raise NameNotFound("phase", transition.to, (*self.phase_names, DONE))


def _held(transition: Transition, since: float | None, t: float, quantities: Mapping[str, float]) -> float | None:
    if not transition.holds(quantities, since is not None):
        return None
    return t if since is None else since


def _reason(transition: Transition, quantities: Mapping[str, float]) -> str:
    held = f" for {transition.hold:g} s" if transition.hold else ""
    return transition.describe(quantities) + held


def _check_threshold(quantity: str, limit: float) -> None:
    if not (math.isfinite(limit) and limit > 0):
        raise InvalidInput(f"threshold of {quantity} = {limit}; give a finite value > 0")


def _closure(names: set[str], successors: Mapping[str, set[str]]) -> set[str]:
    """Everything that can be reached from `names`, themselves included."""
    reached, fresh = set(names), set(names)
    while fresh:
        fresh = set().union(*(successors.get(name, set()) for name in fresh)) - reached
        reached |= fresh
    return reached


def _arrow(transition: Transition) -> str:
    signs = {Below: "<", Above: ">"}
    conditions = ", ".join(f"{c.quantity} {signs[type(c)]} {c.limit:g}" for c in transition.when)
    held = f" for {transition.hold:g} s" if transition.hold else ""
    retries = "" if transition.retries is None else f" (at most {transition.retries} times)"
    target = "[*]" if transition.to in (DONE, ABORT) else transition.to
    return f"{target} : {conditions}{held}{retries}"

"""Mission: phases over one hierarchy, how its state follows from what is measured, and its tables
and diagrams.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass, checked_on_failure, unchecked_method
from uvms_ocp.codegen.kernel_layout import structure_of, view
from uvms_ocp.errors import InvalidInput, NameNotFound, plain_line
from uvms_ocp.mission import progress
from uvms_ocp.mission.phase import (
    Abort,
    Event,
    GoalFunctions,
    MissionState,
    Phase,
    Transition,
    measured,
)
from uvms_ocp.record.display import SmallTable, TableDisplay, TableRows
from uvms_ocp.record.meta_values import ABORT, DONE, OWN_QUANTITIES
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import PoseTask
from uvms_ocp.tasks.task import Task
from uvms_ocp.types import Finite, Magnitude, Shape

_NUMBERED = "phase_"
_WORDS = (
    "as",
    "class",
    "classdef",
    "default",
    "direction",
    "end",
    "fork",
    "join",
    "note",
    "root",
    "state",
    "style",
)


# A mission as a graph, as a table and as a diagram.


def text_table(hierarchy: Hierarchy, phases: Sequence[Phase], targets: np.ndarray) -> str:
    """Tasks by phases, from their targets (n_phases, n_tasks), the external activations."""
    tasks = [plain_line(name) for name in hierarchy.names]
    names = [plain_line(phase.name) for phase in phases]
    width = max(len(name) for name in (*tasks, "task"))
    columns = [max(len(name), 4) for name in names]
    head = [name.rjust(size) for name, size in zip(names, columns, strict=True)]
    lines = [f"{'task'.ljust(width)}  {'type':<9} {' '.join(head)}"]
    for name, task, activations in zip(tasks, hierarchy.tasks, targets.T, strict=True):
        cells = [
            (f"{gate:g}" if gate else ".").rjust(size)
            for gate, size in zip(activations, columns, strict=True)
        ]
        lines.append(f"{name.ljust(width)}  {task.label:<9} {' '.join(cells)}")
    return "\n".join(
        [*lines, *(plain_line(f"{phase.name}: {phase.title}") for phase in phases if phase.title)]
    )


def mermaid(phases: Sequence[Phase], abort: Phase | None = None) -> str:
    """State diagram. Names that the notation would take for something else get a number and stand
    in the text only.

    abort: the phase that every other one may lead to, if there is one.
    """
    n = len(phases)
    if abort is None:
        phases = list(phases)
    else:
        phases = [*phases, abort]
    states = {phase.name: _state(phase.name, i) for i, phase in enumerate(phases)} | {
        DONE: "[*]",
        ABORT: "[*]",
    }
    lines = ["stateDiagram-v2", f"    [*] --> {states[phases[0].name]}"]
    for phase in phases:
        lines.append(f"    {states[phase.name]} : {_text(f'{phase.name} {phase.title}')}".rstrip())
        for transition in phase.transitions:
            lines.append(
                f"    {states[phase.name]} --> {states[transition.to]} : {_label(transition)}"
            )
    if abort is not None:
        lines += [
            f"    {states[phase.name]} --> {states[abort.name]} : abort" for phase in phases[:n]
        ]
    return "\n".join(lines) + "\n"


def successors(phases: Sequence[Phase]) -> dict[str, set[str]]:
    """Map the name of each phase to where its transitions lead."""
    return {phase.name: {transition.to for transition in phase.transitions} for phase in phases}


def closure(names: set[str], edges: Mapping[str, set[str]]) -> set[str]:
    """Everything that can be reached from `names`, themselves included."""
    reached = set(names)
    fresh = set(names)
    while fresh:
        fresh = set().union(*(edges.get(name, set()) for name in fresh)) - reached
        reached |= fresh
    return reached


def _state(name: str, index: int) -> str:
    is_reserved = name.lower() in _WORDS or name.startswith(_NUMBERED)
    if name.isascii() and name.isidentifier() and not is_reserved:
        return name
    return f"{_NUMBERED}{index + 1}"


def _text(text: str) -> str:
    """Replace all but words and a few marks by their code, as the notation writes them."""
    return "".join(
        letter if letter.isalnum() or letter in " ._-,()" else f"#{ord(letter)};"
        for letter in plain_line(text)
    )


def _label(transition: Transition) -> str:
    conditions = ", ".join(f"{_text(c.quantity)} {c.sign} {c.limit:g}" for c in transition.when)
    hold = f" for {transition.hold:g} s" if transition.hold else ""
    if transition.retries is None:
        retries = ""
    else:
        retries = f" (at most {transition.retries} times)"
    return f"{conditions}{hold}{retries}"


# Phases over one hierarchy, and how the state of a mission follows from what is measured.


@checked_dataclass(eq=False, repr=False)
class Mission(TableDisplay):
    """Phases over one hierarchy; the first phase begins with the first tick.

    Raises `NameNotFound` for an unknown task or phase name, and `InvalidInput` without phases, for
    a ramp below 0, and for a goal of a task that has none.
    """

    hierarchy: Hierarchy
    """Hierarchy of all tasks that any phase uses."""
    phases: tuple[Phase, ...]
    """The first is where it begins."""
    ramp: Magnitude = 0.2
    """[s] duration of the cosine step of external activations."""
    abort: Abort | None = None
    """How it is given up; without, a robot that cannot go on holds or stops where it is."""
    all_phases: tuple[Phase, ...] = field(init=False, repr=False)
    """`phases`, and that of `abort` as the last; a state counts them."""
    _targets: np.ndarray = field(init=False, repr=False)
    """(n_phases, n_tasks) external activations, of all phases."""
    _tasks: tuple[tuple[Task, ...], ...] = field(init=False, repr=False)
    """Tasks of each phase, with the goals that they have in it."""
    _references: tuple[GoalFunctions, ...] = field(init=False, repr=False)
    """References of each phase and task, without the check of t, each with True where the goal is
    the phase's own.
    """

    def __post_init__(self) -> None:
        if not self.phases:
            raise InvalidInput("mission without phases; give at least one")
        abort_phases = () if self.abort is None else (self.abort.phase,)
        object.__setattr__(self, "all_phases", (*self.phases, *abort_phases))
        for name in self.phase_names:
            if name in (DONE, ABORT) or self.phase_names.count(name) > 1:
                raise InvalidInput(
                    f"phase {name!r}; give each a name of its own, and not {DONE!r} or {ABORT!r}"
                )
        self._check_targets()
        if self.abort is not None:
            _pose_task(self.hierarchy, self.abort.ascent_task)
        object.__setattr__(
            self, "_targets", np.array([self._gates_of(phase) for phase in self.all_phases])
        )
        object.__setattr__(
            self, "_tasks", tuple(self._tasks_of(phase) for phase in self.all_phases)
        )
        object.__setattr__(
            self, "_references", tuple(map(_references, self.all_phases, self._tasks))
        )

    @property
    def phase_names(self) -> tuple[str, ...]:
        """Names of all phases."""
        return tuple(phase.name for phase in self.all_phases)

    @property
    def ascent_frame(self) -> str:
        """The frame that `abort` climbs with. Raises `InvalidInput` where there is none."""
        if self.abort is None:
            raise InvalidInput("mission without abort climbs with no frame; give it one")
        return _pose_task(self.hierarchy, self.abort.ascent_task).frame

    @checked_on_failure
    def tasks_of(self, phase: int) -> tuple[Task, ...]:
        """Return all tasks with the goals that they have in a phase, highest priority first."""
        return self._tasks[phase]

    @property
    def beside_tasks(self) -> tuple[str, ...]:
        """Quantities that conditions read and no task measures."""
        names = progress.quantities_read(self.all_phases)
        return tuple(name for name in names if name.rpartition(".")[0] not in self.hierarchy.names)

    def check_quantities(self, known: Sequence[str]) -> None:
        """Raise `NameNotFound` where a transition reads a quantity that is not in `known`."""
        for phase in self.all_phases:
            for condition in phase.conditions:
                if condition.quantity not in known:
                    names = dict.fromkeys((*known, *OWN_QUANTITIES))
                    raise NameNotFound(
                        f"quantity in phase {phase.name!r}", condition.quantity, names
                    )

    @checked_on_failure
    def start(self, t: Finite = 0.0) -> MissionState:
        """The state as the mission begins, at t [s]: every gate rises from zero."""
        waiting = (None,) * len(self.all_phases[0].transitions)
        return MissionState(
            phase=0, since=t, began=t, activations_before=np.zeros(self.n_tasks), held_since=waiting
        )

    @checked_on_failure
    def activations(self, state: MissionState, t: float) -> np.ndarray:
        """External activation (n_tasks,) of each task at time t [s] ([Gao2022] eq. 22 in time)."""
        activations = [0.0] * max(1, self.n_tasks)
        progress.activations_at(self._memory(state), t, activations)
        return np.array(activations[: self.n_tasks])

    @property
    def n_tasks(self) -> int:
        """Number of tasks of the hierarchy."""
        return len(self.hierarchy.tasks)

    @checked_on_failure
    def idle(
        self, state: MissionState, activations: Annotated[np.ndarray, Shape("self.n_tasks")]
    ) -> np.ndarray:
        """Tell which tasks (n_tasks,) are off, by the present `activations` (n_tasks,), and stay
        off in this phase.
        """
        return np.asarray((self._targets[state.phase] == 0) & (activations == 0))

    @checked_on_failure
    def references(self, state: MissionState, t: float) -> list[np.ndarray]:
        """Goal of each task at time t [s], highest priority first, as `Task.reference` gives it."""
        # A goal sees the time since the start of the mission, or of the phase where it is the
        # phase's own.
        since = t - state.since
        elapsed = t - state.began
        return [
            reference(since if from_phase_start else elapsed)
            for reference, from_phase_start in self.goals(state)
        ]

    def goals(self, state: MissionState) -> GoalFunctions:
        """Goals of all tasks in a state, highest priority first."""
        if state.goals is None:
            return self._references[state.phase]
        return state.goals

    def references_of(self, phase: int) -> GoalFunctions:
        """Goals of all tasks in a phase, highest priority first, but for one that is made as the
        phase begins.
        """
        return self._references[phase]

    @checked_on_failure
    def step(
        self, state: MissionState, t: float, quantities: Mapping[str, float]
    ) -> tuple[MissionState, Event | None]:
        """The state after the quantities [in their units] measured at t [s], and the event if a
        transition fired.
        """
        if state.over:
            return state, None
        names = progress.quantities_read(self.all_phases)
        phase = self.all_phases[state.phase]
        quantities = {**self.own_quantities(state, t), **quantities}
        read = {c.quantity: measured(c.quantity, quantities) for c in phase.conditions}
        memory = self._memory(state)
        due = progress.transition_due(memory, t, [read.get(name, math.nan) for name in names])
        if due != progress.NONE:
            progress.take_transition(memory, t, due)
        return progress.state_after_transition(self.all_phases, state, memory, due, t, quantities)

    @checked_on_failure
    def own_quantities(self, state: MissionState, t: float) -> dict[str, float]:
        """Return the values of `OWN_QUANTITIES` that conditions read, at t [s]; load and energy are
        not known here.
        """
        names = progress.quantities_read(self.all_phases)
        values = [math.nan] * len(names)
        progress.measure_own(self._memory(state), t, math.nan, math.nan, values)
        return {
            name: value for name, value in zip(names, values, strict=True) if name in OWN_QUANTITIES
        }

    def _memory(self, state: MissionState) -> Any:
        """Memory of the kernels for a state, asked with the quantities that conditions read."""
        memory = structure_of(
            progress.MissionMemory, n_tasks=self.n_tasks, **progress.sizes_of(self.all_phases)
        )()
        write_mission(memory, self, progress.quantities_read(self.all_phases))
        progress.write_state(memory, state)
        return memory

    @checked_on_failure
    def abandon(
        self, state: MissionState, t: float, reason: str, ascent_pose: pin.SE3 | None = None
    ) -> tuple[MissionState, Event]:
        """The state after the mission is given up at t [s], for a reason, and the event that tells
        of it.

        ascent_pose: the goal of the task that climbs in the abort phase, which begins. Without,
        without such a phase, or already in it, the mission ends.
        """
        memory = self._memory(state)
        progress.abort_mission(memory, t, ascent_pose is not None)
        goals: tuple[Any, ...] = ()
        if ascent_pose is not None:
            goals = self.ascent_goals(ascent_pose)
        return progress.state_after_abort(self.all_phases, state, memory, t, reason, goals)

    def has_ascent_goal(self, phase: int, task: int) -> bool:
        """Check for a task whose goal is made as a phase begins: the ascent task in the abort
        phase.
        """
        return (
            self.abort is not None
            and phase == len(self.phases)
            and self.hierarchy.tasks[task].name == self.abort.ascent_task
        )

    def ascent_goals(self, ascent_pose: pin.SE3) -> GoalFunctions:
        """Goals of all tasks in the abort phase, which climbs to a pose; none without such a
        phase.
        """
        if self.abort is None:
            return ()
        tasks = [
            task.with_goal(ascent_pose) if task.name == self.abort.ascent_task else task
            for task in self._tasks[-1]
        ]
        return _references(self.abort.phase, tasks)

    def pending(self, state: MissionState, quantities: Mapping[str, float]) -> str:
        """Describe what the phase still waits for, with the quantities [in their units], or why the
        mission was given up.
        """
        if state.aborted:
            return f"given up, {state.aborted}"
        waits = " or ".join(
            tr.describe(quantities) for tr in self.all_phases[state.phase].transitions
        )
        if state.abort_reason:
            return f"giving up, {state.abort_reason}; {waits}"
        return waits

    def describe(self, state: MissionState) -> dict[str, str]:
        """Return tasks, phases and where it is now, each in a few words."""
        if state.completed:
            situation = "completed"
        else:
            situation = state.aborted or f"in phase {self.phase_names[state.phase]}"
        return {
            "tasks": ", ".join(self.hierarchy.names),
            "phases": ", ".join(self.phase_names),
            "now": situation,
        }

    def table(self) -> TableRows:
        """Tasks by phases: one row per task with its external activation in each phase ([Gao2022]
        Table 4).
        """
        return TableRows(
            {
                "task": task.name,
                "type": task.label,
                **dict(zip(self.phase_names, column, strict=True)),
            }
            for task, column in zip(self.hierarchy.tasks, self._targets.T.tolist(), strict=True)
        )

    def _table(self) -> SmallTable:
        rows = []
        for row in self.table():
            cells = [f"{cell:g}" if isinstance(cell, float) else cell for cell in row.values()]
            rows.append(tuple(cells))
        return SmallTable(
            title="Mission, tasks by phases",
            head=("task", "type", *self.phase_names),
            rows=tuple(rows),
        )

    def __str__(self) -> str:
        """The table of `table` as text, 1 for on and a dot for off, with the titles of the phases
        below.
        """
        return text_table(self.hierarchy, self.all_phases, self._targets)

    def unreachable_phases(self) -> tuple[str, ...]:
        """Names of the phases that no chain of transitions leads to from the first, that of `abort`
        aside.
        """
        edges = successors(self.phases)
        reached = closure({self.phases[0].name}, edges)
        return tuple(name for name in edges if name not in reached)

    def phases_without_exit(self) -> tuple[str, ...]:
        """Names of the phases from which no chain of transitions leads to `DONE`, that of `abort`
        aside.
        """
        edges = successors(self.phases)
        return tuple(name for name in edges if DONE not in closure({name}, edges))

    def mermaid(self) -> str:
        """The phases and transitions as a state diagram in Mermaid's notation."""
        return mermaid(self.phases, None if self.abort is None else self.abort.phase)

    def _gates_of(self, phase: Phase) -> np.ndarray:
        activations = np.zeros(len(self.hierarchy.tasks))
        for name, gate in phase.activations.items():
            activations[self.hierarchy.index(name)] = gate
        return activations

    def _tasks_of(self, phase: Phase) -> tuple[Task, ...]:
        tasks = list(self.hierarchy.tasks)
        for name, goal in phase.goals.items():
            index = self.hierarchy.index(name)
            tasks[index] = tasks[index].with_goal(goal)
        return tuple(tasks)

    def _check_targets(self) -> None:
        names = tuple(phase.name for phase in self.phases)
        for phase in self.phases:
            for transition in phase.transitions:
                if transition.to not in (*names, DONE, ABORT):
                    raise NameNotFound("phase", transition.to, (*names, DONE))


def write_mission(memory: progress.MissionMemory, mission: Mission, names: Sequence[str]) -> None:
    """A mission into a `MissionMemory`; names: of the vector of quantities that it is asked
    with.
    """
    memory.ramp = mission.ramp
    if mission.abort is None:
        memory.abort_phase = progress.NONE
    else:
        memory.abort_phase = len(mission.phases)
    view(memory.targets)[:, : mission.n_tasks] = mission._targets
    progress.write_conditions(memory, mission.all_phases, names)


def _pose_task(hierarchy: Hierarchy, name: str) -> PoseTask:
    task = hierarchy.tasks[hierarchy.index(name)]
    if not isinstance(task, PoseTask):
        raise InvalidInput(
            f"abort climbs by {task.name}, a {type(task).__name__}; give a task on a pose"
        )
    return task


def _references(phase: Phase, tasks: Sequence[Task]) -> GoalFunctions:
    return tuple((unchecked_method(task.reference), task.name in phase.goals) for task in tasks)


def is_constant(reference: Callable[[float], np.ndarray]) -> bool:
    """Check for a function of `GoalFunctions` that never changes, see `Task.is_constant`."""
    task = getattr(reference, "__self__", None)
    return isinstance(task, Task) and task.is_constant

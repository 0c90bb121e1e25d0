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
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import PoseTask
from uvms_ocp.tasks.task import Task
from uvms_ocp.types import Finite, Magnitude, Shape

_NUMBERED = "phase_"  # prefix of states that get a number in place of their name
# words that the notation of diagrams takes for something else
_RESERVED_WORDS = (
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
    """Phase that leads to safety, and what enters it; without, a robot that cannot go on holds or
    stops where it is.
    """
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
        all_phases = self.phases
        if self.abort is not None:
            all_phases = (*self.phases, self.abort.phase)
        object.__setattr__(self, "all_phases", all_phases)
        for name in self.phase_names:
            if name in (DONE, ABORT) or self.phase_names.count(name) > 1:
                raise InvalidInput(
                    f"phase {name!r}; give each a name of its own, and not {DONE!r} or {ABORT!r}"
                )
        self._check_targets()
        if self.abort is not None:
            _pose_task(self.hierarchy, self.abort.ascent_task)
        targets = np.zeros((len(all_phases), self.n_tasks))
        tasks = []
        references = []
        for index, phase in enumerate(all_phases):
            for name, activation in phase.activations.items():
                targets[index, self.hierarchy.index(name)] = activation
            phase_tasks = self._tasks_of(phase)
            tasks.append(phase_tasks)
            references.append(_references(phase, phase_tasks))
        object.__setattr__(self, "_targets", targets)
        object.__setattr__(self, "_tasks", tuple(tasks))
        object.__setattr__(self, "_references", tuple(references))

    @property
    def phase_names(self) -> tuple[str, ...]:
        """Names of all phases."""
        return tuple(phase.name for phase in self.all_phases)

    @property
    def ascent_frame(self) -> str:
        """Frame that `abort` climbs with. Raises `InvalidInput` where there is none."""
        if self.abort is None:
            raise InvalidInput("mission without abort climbs with no frame; give it one")
        return _pose_task(self.hierarchy, self.abort.ascent_task).frame

    @checked_on_failure
    def tasks_of(self, phase: int) -> tuple[Task, ...]:
        """Return all tasks with the goals that they have in a phase, highest priority first. Raises
        `InvalidInput` for the index of none.
        """
        _require_index("phase", phase, len(self._tasks))
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
        """Return the state as the mission begins, at t [s]: every activation rises from zero."""
        waiting = (None,) * len(self.all_phases[0].transitions)
        return MissionState(
            phase=0, since=t, began=t, activations_before=np.zeros(self.n_tasks), held_since=waiting
        )

    @checked_on_failure
    def activations(self, state: MissionState, t: float) -> np.ndarray:
        """Return the external activation (n_tasks,) of each task at time t [s] ([Gao2022] eq. 22 in
        time).
        """
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
        """Return the goal of each task at time t [s], highest priority first, as `Task.reference`
        gives it.
        """
        # A goal sees the time since the start of the mission, or of the phase where it is the
        # phase's own.
        since_phase = t - state.since
        since_mission = t - state.began
        references = []
        for reference, from_phase_start in self.goals(state):
            if from_phase_start:
                references.append(reference(since_phase))
            else:
                references.append(reference(since_mission))
        return references

    def goals(self, state: MissionState) -> GoalFunctions:
        """Return the goals of all tasks in a state, highest priority first."""
        if state.goals is None:
            return self._references[state.phase]
        return state.goals

    def references_of(self, phase: int) -> GoalFunctions:
        """Return the goals of all tasks in a phase, highest priority first, but for one that is
        made as the phase begins. Raises `InvalidInput` for the index of no phase.
        """
        _require_index("phase", phase, len(self._references))
        return self._references[phase]

    @checked_on_failure
    def step(
        self, state: MissionState, t: float, quantities: Mapping[str, float]
    ) -> tuple[MissionState, Event | None]:
        """Return the state after the quantities [in their units] measured at t [s], and the event
        if a transition fired.
        """
        if state.over:
            return state, None
        names = progress.quantities_read(self.all_phases)
        quantities = {**self.own_quantities(state, t), **quantities}
        values = [math.nan] * len(names)
        for condition in self.all_phases[state.phase].conditions:
            value = measured(condition.quantity, quantities)
            values[names.index(condition.quantity)] = value
        memory = self._memory(state)
        due = progress.transition_due(memory, t, values)
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
        own_quantities = {}
        for name, value in zip(names, values, strict=True):
            if name in OWN_QUANTITIES:
                own_quantities[name] = value
        return own_quantities

    def _memory(self, state: MissionState) -> Any:
        """Return memory of the kernels for a state; its quantities are those that conditions
        read.
        """
        dimensions = progress.with_phases(Dimensions(), self.all_phases, self.n_tasks)
        structure = structure_of(progress.MissionMemory, dimensions)
        memory = structure()
        write_mission(memory, self, progress.quantities_read(self.all_phases))
        progress.write_state(memory, state)
        return memory

    @checked_on_failure
    def abandon(
        self, state: MissionState, t: float, reason: str, ascent_pose: pin.SE3 | None = None
    ) -> tuple[MissionState, Event]:
        """Give the mission up at t [s]; return the state after that, and its event with the reason.

        ascent_pose: goal of the task that climbs in the abort phase, which begins. The mission ends
        where there is no such pose, no such phase, or where it is in that phase already.
        """
        memory = self._memory(state)
        progress.abort_mission(memory, t, ascent_pose is not None)
        goals: tuple[Any, ...] = ()
        if ascent_pose is not None:
            goals = self.ascent_goals(ascent_pose)
        return progress.state_after_abort(self.all_phases, state, memory, t, reason, goals)

    def has_ascent_goal(self, phase: int, task: int) -> bool:
        """Check for a task whose goal is made as a phase begins: the ascent task in the abort
        phase. Raises `InvalidInput` for the index of no phase or task.
        """
        _require_index("phase", phase, len(self._tasks))
        _require_index("task", task, len(self.hierarchy.tasks))
        return (
            self.abort is not None
            and phase == len(self.phases)
            and self.hierarchy.tasks[task].name == self.abort.ascent_task
        )

    def ascent_goals(self, ascent_pose: pin.SE3) -> GoalFunctions:
        """Return the goals of all tasks in the abort phase, which climbs to a pose; none without
        such a phase.
        """
        if self.abort is None:
            return ()
        tasks = list(self._tasks[-1])
        ascent_index = self.hierarchy.index(self.abort.ascent_task)
        tasks[ascent_index] = tasks[ascent_index].with_goal(ascent_pose)
        return _references(self.abort.phase, tasks)

    def pending(self, state: MissionState, quantities: Mapping[str, float]) -> str:
        """Describe what the phase still waits for, with the quantities [in their units], or why the
        mission was given up.
        """
        if state.aborted:
            return f"given up, {state.aborted}"
        transitions = self.all_phases[state.phase].transitions
        awaited = " or ".join(transition.describe(quantities) for transition in transitions)
        if state.abort_reason:
            return f"giving up, {state.abort_reason}; {awaited}"
        return awaited

    def describe(self, state: MissionState) -> dict[str, str]:
        """Return tasks, phases and where it is now, each in a few words."""
        if state.completed:
            situation = "completed"
        elif state.aborted:
            situation = state.aborted
        else:
            situation = f"in phase {self.phase_names[state.phase]}"
        return {
            "tasks": ", ".join(self.hierarchy.names),
            "phases": ", ".join(self.phase_names),
            "now": situation,
        }

    def table(self) -> TableRows:
        """Return tasks by phases: one row per task with its external activation in each phase
        ([Gao2022] Table 4).
        """
        rows = []
        for task, activations in zip(self.hierarchy.tasks, self._targets.T.tolist(), strict=True):
            row = {"task": task.name, "type": task.label}
            rows.append(row | dict(zip(self.phase_names, activations, strict=True)))
        return TableRows(rows)

    def _table(self) -> SmallTable:
        rows = []
        for task, activations in zip(self.hierarchy.tasks, self._targets.T.tolist(), strict=True):
            cells = [f"{activation:g}" for activation in activations]
            rows.append((task.name, task.label, *cells))
        return SmallTable(
            title="Mission, tasks by phases",
            head=("task", "type", *self.phase_names),
            rows=tuple(rows),
        )

    def __str__(self) -> str:
        """Return `table` as text, 1 for on and a dot for off, with the titles of the phases
        below.
        """
        return text_table(self.hierarchy, self.all_phases, self._targets)

    def unreachable_phases(self) -> tuple[str, ...]:
        """Return the names of the phases that no chain of transitions leads to from the first, that
        of `abort` aside.
        """
        edges = successors(self.phases)
        reached = closure({self.phases[0].name}, edges)
        return tuple(name for name in edges if name not in reached)

    def phases_without_exit(self) -> tuple[str, ...]:
        """Return the names of the phases from which no chain of transitions leads to `DONE`, that
        of `abort` aside.
        """
        edges = successors(self.phases)
        return tuple(name for name in edges if DONE not in closure({name}, edges))

    def mermaid(self) -> str:
        """Return the phases and transitions as a state diagram in Mermaid's notation."""
        if self.abort is None:
            return mermaid(self.phases)
        return mermaid(self.phases, self.abort.phase)

    def _tasks_of(self, phase: Phase) -> tuple[Task, ...]:
        """Return all tasks, with the goals that a phase gives them."""
        tasks = list(self.hierarchy.tasks)
        for name, goal in phase.goals.items():
            index = self.hierarchy.index(name)
            tasks[index] = tasks[index].with_goal(goal)
        return tuple(tasks)

    def _check_targets(self) -> None:
        """Raise `NameNotFound` where a transition leads to no phase of the mission."""
        names = tuple(phase.name for phase in self.phases)
        for phase in self.phases:
            for transition in phase.transitions:
                if transition.to not in (*names, DONE, ABORT):
                    raise NameNotFound("phase", transition.to, (*names, DONE))


def write_mission(memory: progress.MissionMemory, mission: Mission, names: Sequence[str]) -> None:
    """Write a mission into a `MissionMemory`; names: of the entries of its vector of quantities."""
    memory.ramp = mission.ramp
    if mission.abort is None:
        memory.abort_phase = progress.NONE
    else:
        memory.abort_phase = len(mission.phases)
    view(memory.targets)[:, : mission.n_tasks] = mission._targets
    progress.write_conditions(memory, mission.all_phases, names)


def _pose_task(hierarchy: Hierarchy, name: str) -> PoseTask:
    """Return the task of that name; raises `InvalidInput` where it is none on a pose."""
    task = hierarchy.tasks[hierarchy.index(name)]
    if not isinstance(task, PoseTask):
        raise InvalidInput(
            f"abort climbs by {task.name}, a {type(task).__name__}; give a task on a pose"
        )
    return task


def _references(phase: Phase, tasks: Sequence[Task]) -> GoalFunctions:
    """Return the goals of tasks in a phase, as functions of time."""
    references = []
    for task in tasks:
        from_phase_start = task.name in phase.goals
        references.append((unchecked_method(task.reference), from_phase_start))
    return tuple(references)


def is_constant(reference: Callable[[float], np.ndarray]) -> bool:
    """Check for a function of `GoalFunctions` that never changes, see `Task.is_constant`."""
    # It is the bound method `reference` of a task, and the task tells.
    task = getattr(reference, "__self__", None)
    return isinstance(task, Task) and task.is_constant


def text_table(hierarchy: Hierarchy, phases: Sequence[Phase], targets: np.ndarray) -> str:
    """Write tasks by phases as text, from their targets (n_phases, n_tasks), the external
    activations.
    """
    task_names = [plain_line(name) for name in hierarchy.names]
    task_width = max(map(len, [*task_names, "task"]))
    widths = []
    head = []
    for phase in phases:
        name = plain_line(phase.name)
        width = max(len(name), 4)
        widths.append(width)
        head.append(name.rjust(width))
    lines = [f"{'task'.ljust(task_width)}  {'type':<9} {' '.join(head)}"]
    for name, task, activations in zip(task_names, hierarchy.tasks, targets.T, strict=True):
        cells = []
        for activation, width in zip(activations, widths, strict=True):
            cell = f"{activation:g}" if activation else "."
            cells.append(cell.rjust(width))
        lines.append(f"{name.ljust(task_width)}  {task.label:<9} {' '.join(cells)}")
    for phase in phases:
        if phase.title:
            lines.append(plain_line(f"{phase.name}: {phase.title}"))
    return "\n".join(lines)


def mermaid(phases: Sequence[Phase], abort: Phase | None = None) -> str:
    """Write a state diagram. Names that the notation would take for something else get a number and
    stand in the text only.

    abort: the phase that every other one may lead to, if there is one.
    """
    all_phases = list(phases)
    if abort is not None:
        all_phases.append(abort)
    states = {DONE: "[*]", ABORT: "[*]"}
    for index, phase in enumerate(all_phases):
        states[phase.name] = _state(phase.name, index)
    lines = ["stateDiagram-v2", f"    [*] --> {states[all_phases[0].name]}"]
    for phase in all_phases:
        state = states[phase.name]
        title = _text(f"{phase.name} {phase.title}")
        lines.append(f"    {state} : {title}".rstrip())
        for transition in phase.transitions:
            lines.append(f"    {state} --> {states[transition.to]} : {_label(transition)}")
    if abort is not None:
        for phase in phases:
            lines.append(f"    {states[phase.name]} --> {states[abort.name]} : abort")
    return "\n".join(lines) + "\n"


def successors(phases: Sequence[Phase]) -> dict[str, set[str]]:
    """Map the name of each phase to where its transitions lead."""
    edges = {}
    for phase in phases:
        edges[phase.name] = {transition.to for transition in phase.transitions}
    return edges


def closure(names: set[str], edges: Mapping[str, set[str]]) -> set[str]:
    """Return everything that can be reached from `names`, themselves included."""
    reached = set(names)
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        for successor in edges.get(name, set()):
            if successor not in reached:
                reached.add(successor)
                waiting.append(successor)
    return reached


def _require_index(name: str, index: int, count: int) -> None:
    """Raise `InvalidInput` for the index of no phase or task."""
    if not 0 <= index < count:
        raise InvalidInput(f"{name} {index} given; allowed: 0 to {count - 1}, in their order")


def _state(name: str, index: int) -> str:
    """Return the name of a phase as the notation takes it, or a number."""
    is_reserved = name.lower() in _RESERVED_WORDS or name.startswith(_NUMBERED)
    if name.isascii() and name.isidentifier() and not is_reserved:
        return name
    return f"{_NUMBERED}{index + 1}"


def _text(text: str) -> str:
    """Replace all but words and a few marks by their code, as the notation writes them."""
    escaped = ""
    for letter in plain_line(text):
        if letter.isalnum() or letter in " ._-,()":
            escaped += letter
        else:
            escaped += f"#{ord(letter)};"
    return escaped


def _label(transition: Transition) -> str:
    """Describe when a transition fires."""
    conditions = []
    for condition in transition.when:
        conditions.append(f"{_text(condition.quantity)} {condition.sign} {condition.limit:g}")
    label = ", ".join(conditions)
    if transition.hold:
        label += f" for {transition.hold:g} s"
    if transition.retries is not None:
        label += f" (at most {transition.retries} times)"
    return label

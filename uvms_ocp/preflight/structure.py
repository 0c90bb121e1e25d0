"""Checks on the mission alone: phases, transitions and activations."""

from __future__ import annotations

from collections.abc import Iterator

from uvms_ocp.mission.conditions import DONE, Below
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.tasks.task import TaskClass

CHECK = "activations"


def check_structure(mission: Mission) -> Iterator[Finding]:
    """Findings on phases that nothing leads to, that nothing ends, or in which nothing acts."""
    yield from (_unreachable(name) for name in mission.unreachable_phases())
    yield from (_trap(name) for name in mission.phases_without_exit())
    for phase in mission.all_phases:
        yield from _idle(mission, phase)
        yield from _waiting_in_vain(mission, phase)
    used = {name for phase in mission.all_phases for name, gate in phase.gates.items() if gate > 0}
    for name in mission.hierarchy.names:
        if name not in used:
            text = f"task {name} is never switched on; use it or drop it"
            yield Finding(severity=Severity.WARNING, check=CHECK, text=text)


def _unreachable(name: str) -> Finding:
    text = f"no transition leads to phase {name!r}; add one or drop the phase"
    return Finding(severity=Severity.WARNING, check="phases", phase=name, text=text)


def _trap(name: str) -> Finding:
    text = f"the mission cannot end from phase {name!r}; add a transition towards {DONE!r}"
    return Finding(severity=Severity.ERROR, check="phases", phase=name, text=text)


def _idle(mission: Mission, phase: Phase) -> Iterator[Finding]:
    """A phase needs a task that acts; constraints, safety and preferences that it does not wait for move nothing on purpose."""
    acting = (TaskClass.PREREQUISITE, TaskClass.ACTION)
    awaited = {c.quantity.rpartition(".")[0] for transition in phase.transitions for c in transition.when}
    active = [task for task in mission.hierarchy.tasks if phase.gates.get(task.name, 0.0) > 0]
    if not any(task.task_class in acting or task.name in awaited for task in active):
        text = f"phase {phase.name!r} has no acting task switched on; nothing would happen in it"
        yield Finding(severity=Severity.ERROR, check=CHECK, phase=phase.name, text=text)


def _waiting_in_vain(mission: Mission, phase: Phase) -> Iterator[Finding]:
    """A phase that waits for a quantity to fall must have the task on that makes it fall."""
    for transition in phase.transitions:
        for condition in transition.when:
            task = condition.quantity.rpartition(".")[0]
            if isinstance(condition, Below) and not phase.gates.get(task, 0.0) > 0 and not _alternatives(phase):
                text = f"phase {phase.name!r} waits for {condition.quantity}, but task {task} is off in it"
                yield Finding(severity=Severity.WARNING, check=CHECK, phase=phase.name, text=text)


def _alternatives(phase: Phase) -> bool:
    return len(phase.transitions) > 1

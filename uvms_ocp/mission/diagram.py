"""A mission as a graph, as a table and as a diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from uvms_ocp.mission.conditions import ABORT, DONE, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.tasks.hierarchy import Hierarchy


def text_table(hierarchy: Hierarchy, phases: Sequence[Phase], targets: np.ndarray) -> str:
    """Tasks by phases, from their targets (n_phases, n_tasks) [-], the external activations."""
    width = max(len(name) for name in (*hierarchy.names, "task"))
    columns = [max(len(phase.name), 4) for phase in phases]
    head = [phase.name.rjust(size) for phase, size in zip(phases, columns, strict=True)]
    lines = [f"{'task'.ljust(width)}  {'type':<9} {' '.join(head)}"]
    for task, gates in zip(hierarchy.tasks, targets.T, strict=True):
        cells = [(f"{gate:g}" if gate else ".").rjust(size) for gate, size in zip(gates, columns, strict=True)]
        lines.append(f"{task.name.ljust(width)}  {task.label:<9} {' '.join(cells)}")
    return "\n".join([*lines, *(f"{phase.name}: {phase.title}" for phase in phases if phase.title)])


def mermaid(phases: Sequence[Phase]) -> str:
    """State diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {phases[0].name}"]
    for phase in phases:
        lines.append(f"    {phase.name} : {phase.name} {phase.title}".rstrip())
        lines += [f"    {phase.name} --> {_arrow(transition)}" for transition in phase.transitions]
    return "\n".join(lines) + "\n"


def successors(phases: Sequence[Phase]) -> dict[str, set[str]]:
    """By the name of each phase, where its transitions lead."""
    return {phase.name: {transition.to for transition in phase.transitions} for phase in phases}


def closure(names: set[str], edges: Mapping[str, set[str]]) -> set[str]:
    """Everything that can be reached from `names`, themselves included."""
    reached, fresh = set(names), set(names)
    while fresh:
        fresh = set().union(*(edges.get(name, set()) for name in fresh)) - reached
        reached |= fresh
    return reached


def _arrow(transition: Transition) -> str:
    conditions = ", ".join(f"{c.quantity} {c.sign} {c.limit:g}" for c in transition.when)
    held = f" for {transition.hold:g} s" if transition.hold else ""
    retries = "" if transition.retries is None else f" (at most {transition.retries} times)"
    target = "[*]" if transition.to in (DONE, ABORT) else transition.to
    return f"{target} : {conditions}{held}{retries}"

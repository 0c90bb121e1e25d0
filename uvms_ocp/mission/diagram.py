"""A mission as a graph, as a table and as a diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from uvms_ocp.exceptions import plain_line
from uvms_ocp.mission.conditions import ABORT, DONE, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.tasks.hierarchy import Hierarchy


def text_table(hierarchy: Hierarchy, phases: Sequence[Phase], targets: np.ndarray) -> str:
    """Tasks by phases, from their targets (n_phases, n_tasks) [-], the external activations."""
    tasks, names = [plain_line(name) for name in hierarchy.names], [plain_line(phase.name) for phase in phases]
    width = max(len(name) for name in (*tasks, "task"))
    columns = [max(len(name), 4) for name in names]
    head = [name.rjust(size) for name, size in zip(names, columns, strict=True)]
    lines = [f"{'task'.ljust(width)}  {'type':<9} {' '.join(head)}"]
    for name, task, gates in zip(tasks, hierarchy.tasks, targets.T, strict=True):
        cells = [(f"{gate:g}" if gate else ".").rjust(size) for gate, size in zip(gates, columns, strict=True)]
        lines.append(f"{name.ljust(width)}  {task.label:<9} {' '.join(cells)}")
    return "\n".join([*lines, *(plain_line(f"{phase.name}: {phase.title}") for phase in phases if phase.title)])


def mermaid(phases: Sequence[Phase], abort: Phase | None = None) -> str:
    """State diagram. Names that the notation would take for something else get a number and stand in the text only.

    abort: the phase that every other one may lead to, if there is one.
    """
    n, phases = len(phases), [*phases, *(() if abort is None else (abort,))]
    states = {phase.name: _state(phase.name, i) for i, phase in enumerate(phases)} | {DONE: "[*]", ABORT: "[*]"}
    lines = ["stateDiagram-v2", f"    [*] --> {states[phases[0].name]}"]
    for phase in phases:
        lines.append(f"    {states[phase.name]} : {_text(f'{phase.name} {phase.title}')}".rstrip())
        for transition in phase.transitions:
            lines.append(f"    {states[phase.name]} --> {states[transition.to]} : {_label(transition)}")
    if abort is not None:
        lines += [f"    {states[phase.name]} --> {states[abort.name]} : abort" for phase in phases[:n]]
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


_NUMBERED = "phase_"
_WORDS = ("as", "class", "classdef", "default", "direction", "end", "fork", "join", "note", "root", "state", "style")


def _state(name: str, index: int) -> str:
    taken = name.lower() in _WORDS or name.startswith(_NUMBERED)
    return name if name.isascii() and name.isidentifier() and not taken else f"{_NUMBERED}{index + 1}"


def _text(text: str) -> str:
    """With all but words and a few marks by their code, as the notation writes them."""
    plain = plain_line(text)
    return "".join(letter if letter.isalnum() or letter in " ._-,()" else f"#{ord(letter)};" for letter in plain)


def _label(transition: Transition) -> str:
    conditions = ", ".join(f"{_text(c.quantity)} {c.sign} {c.limit:g}" for c in transition.when)
    held = f" for {transition.hold:g} s" if transition.hold else ""
    retries = "" if transition.retries is None else f" (at most {transition.retries} times)"
    return f"{conditions}{held}{retries}"

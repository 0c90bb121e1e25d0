"""One action of a mission, where a mission is, and why it went on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias

import numpy as np

from uvms_ocp.arguments import Shape, checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import Condition, Transition
from uvms_ocp.shown.fielded import Fielded

GoalFunctions: TypeAlias = tuple[tuple[Callable[[float], np.ndarray], bool], ...]
"""Of each task, highest priority first: its goal at a time [s] as `Task.reference` gives it, and whether that time is the
time since the start of the phase."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Phase(Fielded):
    """One action: the external activation of each task, and what ends it.

    Raises `InvalidInput` where the transitions are not a tuple, and for an activation outside [0, 1].
    """

    name: str
    """Unique in a mission."""
    title: str = ""
    """A few words, to print beside the name."""
    gates: Mapping[str, float]
    """External activation [-] in [0, 1] by the name of a task; tasks that are not named are off. Between 0 and 1 a task has a
    tolerance with strict solvers (`uvms_ocp.solvers.hierarchy.gated_rows`), and less weight with `Icat`."""
    transitions: tuple[Transition, ...]
    """The first that fires is taken."""
    goals: Mapping[str, Any] = field(default_factory=dict)
    """By the name of a task, the goal that replaces its own in this phase; one that moves starts with the phase."""

    def __post_init__(self) -> None:
        if not isinstance(self.transitions, tuple):
            raise InvalidInput(f"phase {self.name!r}: transitions = {self.transitions!r}; give a tuple of transitions")
        bad = {name: gate for name, gate in self.gates.items() if not 0 <= gate <= 1}
        if bad:
            raise InvalidInput(f"phase {self.name!r}: activations {bad}; give values from 0 to 1")


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionState:
    """Where a mission is."""

    phase: int
    """Index among all phases of the mission."""
    since: float
    """[s] start of the phase."""
    gates_before: Annotated[np.ndarray, Shape("n_tasks")]
    """(n_tasks,) [-] gates when the phase began; the bell leads on from them."""
    held_since: tuple[float | None, ...]
    """[s] since when each transition of the phase holds."""
    completed: bool = False
    """The mission has ended as wanted."""
    aborted: str = ""
    """Why the mission was given up."""
    fired: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """How often each transition was taken, by the indices of phase and transition."""
    why: str = ""
    """Why it is being given up, in the phase that does so."""
    goals: GoalFunctions | None = None
    """Goals that were made when the phase began, in place of those of the mission."""

    @property
    def over(self) -> bool:
        """The mission has ended, one way or the other."""
        return self.completed or bool(self.aborted)


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Event:
    """Why a phase ended."""

    t: float
    """[s]"""
    source: str
    """Name of the phase."""
    target: str
    """Name of the next phase, `DONE` or `ABORT`."""
    reason: str
    """The conditions, as measured, or why the mission is given up."""
    conditions: tuple[tuple[Condition, float], ...]
    """The same, each with the value that was measured [unit of the quantity]; none where nothing was waited for."""

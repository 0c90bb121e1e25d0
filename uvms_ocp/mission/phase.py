"""One action of a mission, where a mission is, and why it went on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import Transition


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

"""How a mission is given up, and what sends it there."""

from __future__ import annotations

from dataclasses import dataclass

from uvms_ocp.arguments import Positive, checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import ABORT
from uvms_ocp.mission.phase import Phase


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Abort:
    """A phase that leads to safety, and what enters it beside the loss of sensors (`uvms_ocp.control.navigation.degraded`).

    Raises `InvalidInput` for a transition of that phase to anything but `ABORT`, and where it does not have `climb` on.
    """

    phase: Phase
    """Stands beside the phases of the mission: no transition leads there, and its own end the mission."""
    climb: str = "PC"
    """Name of the task on the vehicle's pose that climbs, upright and where it is; its goal is made as the phase begins."""
    altitude: Positive = 3.0
    """[m] that is safe: above the last floor that is known, or where none is, above where the phase begins."""
    time_limit: Positive = 60.0
    """[s] after which the mission ends wherever the phase has led to."""
    stall_after: Positive = 60.0
    """[s] without progress towards any condition that a phase waits for."""
    thrust_after: Positive = 20.0
    """[s] for which the limits of the thrusters keep them from what is asked for."""
    contact: Positive = 0.3
    """[-] upward force that the model does not know, as a share of the thrusters' largest, that counts as contact."""
    contact_after: Positive = 2.0
    """[s] for which it lasts while a minimum altitude is asked for."""

    def __post_init__(self) -> None:
        others = sorted({transition.to for transition in self.phase.transitions} - {ABORT})
        if others:
            raise InvalidInput(
                f"phase {self.phase.name!r} aborts a mission but leads to {others}; lead to {ABORT!r} alone"
            )
        if not self.phase.gates.get(self.climb, 0.0) > 0:
            raise InvalidInput(
                f"abort: climb = {self.climb!r}, off in phase {self.phase.name!r}; name a task that is on in it"
            )

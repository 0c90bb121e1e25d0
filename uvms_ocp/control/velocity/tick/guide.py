"""What may stand in for the hierarchy: a velocity from elsewhere, as long as it lasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uvms_ocp.arguments import changed
from uvms_ocp.control.navigation.watchdog import Watchdog
from uvms_ocp.control.velocity.distress import Strain
from uvms_ocp.control.velocity.tick_state import TickState
from uvms_ocp.model.state import Command


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Guided:
    """What a guide says at a tick."""

    v: np.ndarray | None
    """(n_v,) [m/s, rad/s] in place of what the hierarchy commands; `None` once and for all after it is left to that."""
    why: str = ""
    """Why it is left, at the tick where that happens."""


class Guide(Protocol):
    """Asked at every tick after the mission has looked at it."""

    @property
    def bandwidth(self) -> float:
        """[-] Share of the usual feedback of velocities that is enough: what it knows beforehand needs little."""

    def __call__(self, tick: TickState, strain: Strain, waiting: Callable[[], str]) -> Guided:
        """waiting: tells what the mission waits for, in words; strain: what the layer of forces meets."""


class Led(Protocol):
    """What is told of a guide's velocities: a `KinematicController`."""

    watchdog: Watchdog

    def pending(self) -> str:
        """What the mission waits for."""

    def follow(self, command: Command) -> None:
        """Take what is commanded in place of its own."""


def led(layer: Led, guide: Guide, tick: TickState, strain: Strain, command: Command) -> Command:
    """The command of a layer as its guide has it; that it is left is an alarm."""
    said = guide(tick, strain, layer.pending)
    if said.why:
        layer.watchdog.alarms.append((tick.t, said.why))
    telemetry = {**command.telemetry, "guided": said.v is not None}
    if said.v is None:
        return changed(command, telemetry=telemetry)
    new = changed(command, v=said.v, telemetry=telemetry)
    layer.follow(new)
    return new

"""What may stand in for the hierarchy: a velocity from elsewhere, as long as it lasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uvms_ocp.control.velocity.distress import Strain
from uvms_ocp.control.velocity.tick_state import TickState


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Guided:
    """What a guide says at a tick."""

    v: np.ndarray | None
    """(n_v,) [m/s, rad/s] in place of what the hierarchy commands; `None` once and for all after it is left to that."""
    why: str = ""
    """Why it is left, at the tick where that happens."""


class Guide(Protocol):
    """Asked at every tick after the mission has looked at it."""

    def __call__(self, tick: TickState, strain: Strain, waiting: Callable[[], str]) -> Guided:
        """waiting: tells what the mission waits for, in words; strain: what the layer of forces meets."""

"""Guide of a mission: velocities that replace those of the hierarchy, such as a plan's, until it
gives up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uvms_ocp.control.velocity.abort import (
    ActuationFeedback,
)
from uvms_ocp.control.velocity.tick_state import TickInputs


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GuideOutput:
    """Velocity of a guide at a tick, or the reason why it gives up."""

    v: np.ndarray | None
    """(n_v,) [m/s, rad/s] velocity in place of the hierarchy's; `None` from the tick on at which
    the guide gives up.
    """
    why: str = ""
    """Reason why the guide is left, at the tick where that happens."""


class Guide(Protocol):
    """Source of velocities in place of the hierarchy's, asked at every tick after the mission."""

    @property
    def bandwidth(self) -> float:
        """Share of the usual feedback of velocities that suffices: a planned motion needs
        little.
        """

    def __call__(
        self, tick: TickInputs, feedback: ActuationFeedback, waiting: Callable[[], str]
    ) -> GuideOutput:
        """Return the velocity for a tick. waiting: describes what the mission waits for. feedback:
        of the force layer.
        """

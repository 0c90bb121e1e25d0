"""What may stand in for the hierarchy: a velocity from elsewhere, as long as it lasts."""

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
    """Output of a guide at a tick."""

    v: np.ndarray | None
    """(n_v,) [m/s, rad/s] in place of what the hierarchy commands; `None` once and for all after it
    is left to that.
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
        """waiting: describes what the mission waits for; feedback: of the force layer."""

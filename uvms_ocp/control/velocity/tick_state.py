"""Inputs of one tick of the velocity layer: the estimate, the altitude, the mission and what is
restricted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.estimation.degraded_modes import FREE, Restriction
from uvms_ocp.estimation.fallbacks import Freshness
from uvms_ocp.mission.phase import MissionState
from uvms_ocp.robot.signals import StateEstimate


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TickInputs:
    """Inputs of a tick: estimate, restriction and state of the mission."""

    begin: float
    """[s] time at which the tick began, by the computer's clock."""
    t: float
    """[s] time of the tick."""
    estimate: StateEstimate
    """Newest estimate that is sound, with finite q and v."""
    echo: float
    """[m] range of the altimeter that tasks act on: carried along with the motion where there is no
    echo, cautious before the first one.
    """
    altitude_valid: bool
    """True where an echo supports the altitude, of now or of not too long ago."""
    mission: MissionState
    """State of the mission."""
    gates: np.ndarray
    """(n_tasks,) external activations."""
    freshness: Freshness
    """Degree to which the estimate can be trusted."""
    restriction: Restriction = FREE
    """Restriction by channels that cannot be trusted."""
    blind: bool = False
    """True where no measurement of the velocity can be trusted."""
    stopped: bool = False
    """True where nothing is known of the state any more: there is no thrust."""

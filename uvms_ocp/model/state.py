"""What flows between plant and controller: `Measurement` in, `Command` out.

Configuration ``q`` and velocity ``v`` follow Pinocchio's free-flyer order, see `uvms_ocp.model.spatial`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class State:
    """True or estimated state of the robot."""

    q: np.ndarray  # (n_q,) configuration
    v: np.ndarray  # (n_v,) [m/s, rad/s] generalized velocity, vehicle part in B


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Measurement:
    """What the sensors say at one tick; the only thing a controller sees."""

    q: np.ndarray  # (n_q,) measured configuration
    v: np.ndarray  # (n_v,) [m/s, rad/s] measured generalized velocity
    altimeter_range: float  # [m] range along -z of the altimeter frame; nan where there is no echo


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Command:
    """What a controller asks of the plant at one tick."""

    v: np.ndarray  # (n_v,) [m/s, rad/s] reference velocity
    finished: bool = False  # the mission is complete; the loop may stop
    telemetry: Mapping[str, Any] = field(default_factory=dict)  # scalars and arrays to record

"""Somebody else's sensors, whose readings are looked at before the monitor sees them."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any

import numpy as np

from uvms_ocp.arguments import trusted
from uvms_ocp.control.navigation.health.health_settings import sizes_of
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import CHANNELS, SensorSpecs
from uvms_ocp.model.state import Reading, Readings, State

_all = attrgetter(*CHANNELS)
_state = trusted(State)


class WatchedSensors:
    """A callable ``(State, t) -> Readings`` that asks another one."""

    def __init__(self, sensors: Any, robot: Robot, specs: SensorSpecs, name: str) -> None:
        """specs: which channels to expect. name: what messages call them. Raises `InvalidInput` for what cannot be called."""
        if not callable(sensors):
            raise InvalidInput(f"sensors {name} made {type(sensors).__name__}; make a callable (State, t) -> Readings")
        self._theirs: Callable[[State, float], Readings] = sensors
        self._name, self._sizes = name, sizes_of(robot)
        self._expected = {channel for channel in CHANNELS if getattr(specs, channel) is not None}
        self._seen: dict[str, Reading[Any] | None] = dict.fromkeys(CHANNELS)

    def __call__(self, state: State, t: float) -> Readings:
        """Their readings of the true state at time t [s]. Raises `InvalidInput` for what is no reading of that channel."""
        # Copied: nobody who writes to a reading reaches the true state.
        readings = self._theirs(_state(q=state.q.copy(), v=state.v.copy(), a=state.a), t)
        if not isinstance(readings, Readings):
            raise InvalidInput(f"sensors {self._name} returned {type(readings).__name__}; return Readings")
        for channel, reading in zip(CHANNELS, _all(readings), strict=True):
            if reading is not None and reading is not self._seen[channel]:
                self._require(channel, reading)
                self._seen[channel] = reading
        return readings

    def _require(self, channel: str, reading: Reading[Any]) -> None:
        if channel not in self._expected:
            raise InvalidInput(f"sensors {self._name} read {channel}, which their specs leave out; add it to them")
        shape, right = np.shape(reading.value), self._sizes[channel]
        if shape != right:
            raise InvalidInput(f"sensors {self._name} read {channel} of shape {shape}; give {right}")

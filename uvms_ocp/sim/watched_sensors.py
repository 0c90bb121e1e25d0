"""Check the readings of a user's sensors before the monitor sees them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.channels import shapes_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    Reading,
    Readings,
    SensorSpecs,
    State,
    readings_by_channel,
    unchecked_state,
)


class WatchedSensors:
    """A user's sensors whose readings are checked: a callable ``(State, t) -> Readings``."""

    def __init__(self, sensors: Any, robot: Robot, specs: SensorSpecs, name: str) -> None:
        """specs: which channels to expect. name: what messages call them. Raises `InvalidInput` for
        what cannot be called.
        """
        if not callable(sensors):
            raise InvalidInput(
                f"sensors {name} made {type(sensors).__name__}; make a callable (State, t) ->"
                " Readings"
            )
        self._wrapped: Callable[[State, float], Readings] = sensors
        self._name = name
        self._shapes = shapes_of(robot, specs.own)
        self._expected = specs.present.keys()
        self._own = tuple(channel.name for channel in specs.own)
        self._seen: dict[str, Reading[Any] | None] = dict.fromkeys(self._shapes)

    def __call__(self, state: State, t: float) -> Readings:
        """Return the readings of the true state at time t [s]. Raises `InvalidInput` for what is no
        reading of that channel.
        """
        # Copied: nobody who writes to a reading reaches the true state.
        readings = self._wrapped(unchecked_state(q=state.q.copy(), v=state.v.copy(), a=state.a), t)
        if not isinstance(readings, Readings):
            raise InvalidInput(
                f"sensors {self._name} returned {type(readings).__name__}; return Readings"
            )
        for name in readings.own:
            if name not in self._own:
                raise InvalidInput(
                    f"sensors {self._name} read {name}, which is no own channel of their specs; add"
                    " it to them"
                )
        given = readings_by_channel(readings, self._own)
        for channel, reading in zip(self._shapes, given, strict=True):
            if reading is not None and reading is not self._seen[channel]:
                self._require(channel, reading)
                self._seen[channel] = reading
        return readings

    def _require(self, channel: str, reading: Reading[Any]) -> None:
        if channel not in self._expected:
            raise InvalidInput(
                f"sensors {self._name} read {channel}, which their specs leave out; add it to them"
            )
        shape = np.shape(reading.value)
        right = self._shapes[channel]
        if shape != right:
            raise InvalidInput(
                f"sensors {self._name} read {channel} of shape {shape}; give {right}"
            )

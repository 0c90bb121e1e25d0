"""What a controller was given and told at every tick of a run."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from uvms_ocp.control.export.interface import write_measurement
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.functions.kernels.layout import view
from uvms_ocp.model.state import Command, Measurement

_TOLD = ("phase", "freshness", "status", "viable_share")


class RecordingController:
    """A controller that keeps, for each tick, `ControllerInputs` and `ControllerOutputs` as numbers."""

    def __init__(
        self,
        controller: Callable[[Measurement, float], Command],
        kinematic: KinematicController,
        inputs: ctypes.Structure,
        outputs: ctypes.Structure,
    ) -> None:
        """inputs, outputs: what numbers are written to on their way."""
        self.kinematic = kinematic
        """The layer below."""
        self._controller, self._inputs, self._outputs = controller, inputs, outputs
        self.ticks: list[list[float]] = []
        """(n,) each [in their units]."""

    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""
        write_measurement(self._inputs, measurement, t)
        command = self._controller(measurement, t)
        _write_command(self._outputs, command)
        self.ticks.append([*numbers_in(self._inputs), *numbers_in(self._outputs)])
        return command

    def as_bytes(self) -> bytes:
        """Eight for each number, least first."""
        return np.array(self.ticks).astype("<f8").tobytes()


def _write_command(outputs: Any, command: Command) -> None:
    view(outputs.v)[:] = command.v
    if command.thrust is not None and command.torque is not None:
        outputs.thrust[: len(command.thrust)] = command.thrust.tolist()
        outputs.torque[: len(command.torque)] = command.torque.tolist()
    for name in ("hold", "stop", "brakes", "finished"):
        setattr(outputs, name, getattr(command, name))
    for name in _TOLD:
        setattr(outputs, name, command.telemetry[name])
    quantities = command.telemetry["quantities"]
    outputs.quantities[: len(quantities)] = quantities.tolist()


def numbers_in(value: Any) -> Iterator[float]:
    """All of a structure, field after field."""
    if isinstance(value, ctypes.Structure):
        for name, *_ in value._fields_:
            yield from numbers_in(getattr(value, name))
    elif isinstance(value, ctypes.Array):
        for item in value:
            yield from numbers_in(item)
    else:
        yield value

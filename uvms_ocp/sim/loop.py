"""The closed loop: plant, sensors and any callable ``(Measurement, t) -> Command``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from uvms_ocp.model.state import Command, Measurement, State
from uvms_ocp.record import Recorder

Controller = Callable[[Measurement, float], Command]
Progress = Callable[[float, Command], None]


class Plant(Protocol):
    """Something with a true state that a command advances."""

    state: State

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s]."""


def simulate(
    *,
    plant: Plant,
    sense: Callable[[State], Measurement],
    controller: Controller,
    dt: float,
    duration: float,
    progress: Progress | None = None,
) -> Recorder:
    """Run until the command says finished or `duration` [s] is over; one row per tick, before its step.

    dt [s] is the control period. `progress` is called after every tick with the time and the command.
    """
    recorder = Recorder()
    for k in range(round(duration / dt) + 1):
        t = k * dt
        measurement = sense(plant.state)
        command = controller(measurement, t)
        recorder.append(_row(t, plant.state, measurement, command))
        if progress is not None:
            progress(t, command)
        if command.finished:
            break
        plant.step(command, dt)
    return recorder


def _row(t: float, state: State, measurement: Measurement, command: Command) -> Mapping[str, Any]:
    return {
        "t": np.float64(t),
        "q": state.q,
        "v": state.v,
        "altimeter_range": np.float64(measurement.altimeter_range),
        "command": command.v,
        **command.telemetry,
    }

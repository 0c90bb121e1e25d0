"""Plants: what a command does to the true state."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Period, checked, late, trusted
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, State

_state = trusted(State)


class Plant(Protocol):
    """Something with a true state that a command advances."""

    state: State
    """The true one."""

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s]."""

    def telemetry(self) -> dict[str, Any]:
        """What it knows beside its state, for the record."""


@checked
class KinematicPlant(Plant):
    """The paper's plant: velocities follow the command at once."""

    def __init__(self, robot: Robot, q0: np.ndarray) -> None:
        """q0 (n_q,) [m, rad]: the start. Raises `InvalidInput`, as `Robot.check_configuration`."""
        self._model = robot.model
        self.state = State(q=robot.check_configuration(q0), v=np.zeros(robot.n_v))

    @late
    def step(self, command: Command, dt: Period) -> None:
        self.state = _state(q=pin.integrate(self._model, self.state.q, command.v * dt), v=command.v)

    def telemetry(self) -> dict[str, Any]:
        """Nothing: the state is all there is."""
        return {}

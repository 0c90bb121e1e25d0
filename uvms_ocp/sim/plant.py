"""Plants: what a command does to the true state."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, State
from uvms_ocp.sim.environment import Seafloor


class KinematicPlant:
    """The paper's plant: velocities follow the command at once."""

    def __init__(self, robot: Robot, q0: np.ndarray) -> None:
        """q0 (n_q,) is the start; raises what `Robot.check_configuration` raises."""
        self._model = robot.model
        self.state = State(q=robot.check_configuration(q0), v=np.zeros(robot.n_v))

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s]."""
        self.state = State(q=pin.integrate(self._model, self.state.q, command.v * dt), v=command.v)


class Altimeter:
    """Range along -z of a frame of the robot to the seafloor, without noise."""

    def __init__(self, robot: Robot, seafloor: Seafloor, frame: str = "altimeter") -> None:
        self._model, self._data = robot.model, robot.model.createData()
        self._frame = robot.frame_id(frame)
        self._seafloor = seafloor

    def measure(self, q: np.ndarray) -> float:
        """Range [m] at configuration q (n_q,); nan without an echo."""
        pin.forwardKinematics(self._model, self._data, q)
        X_WS = pin.updateFramePlacement(self._model, self._data, self._frame)
        return self._seafloor.range_along(X_WS.translation, -X_WS.rotation[:, 2])

"""Encoders that do not change by a bit while their joints are asked to move."""

from __future__ import annotations

import numpy as np

from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command

_FASTEST = 10.0  # [rad/s or m/s] of a joint without limits


class StillEncoders:
    """How far each joint was asked to go since its encoder last changed.

    This holds for exact and for coarse encoders too: a joint that follows its command changes them. Joints with locked brakes
    are not asked to move, and robots whose joints have several numbers each are not judged.
    """

    def __init__(self, robot: Robot, *, delay: float, travel: float) -> None:
        """delay [s] of the encoders. travel [rad or m] that may be asked beyond what they are late by at full speed."""
        self._joint_v, self._names = robot.joint_v, robot.joint_names
        self._allowed = travel + delay * np.minimum(robot.limits.velocity[robot.joint_v], _FASTEST)
        self._judged = robot.n_joints == len(robot.home) == len(self._names)
        self._asked = np.zeros(robot.n_joints)
        self._last: np.ndarray | None = None

    def ask(self, command: Command | None, dt: float) -> None:
        """The command that has been acting for dt [s]."""
        if command is None or command.brakes or not self._judged:
            self._asked[:] = 0.0
        else:
            self._asked += command.v[self._joint_v] * dt

    def frozen(self, value: np.ndarray) -> str | None:
        """Why an encoder counts as frozen, by the newest value (n_joints,) [rad or m]."""
        if not self._judged or not len(self._asked):
            return None
        if self._last is not None:
            self._asked[value != self._last] = 0.0
        self._last = value.copy()
        worst = int((np.abs(self._asked) - self._allowed).argmax())
        if abs(self._asked[worst]) <= self._allowed[worst]:
            return None
        return f"{self._names[worst]} does not change while {self._asked[worst]:.2g} were asked of it"

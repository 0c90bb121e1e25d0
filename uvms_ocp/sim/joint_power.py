"""Electrical energy of the joint drives."""

from __future__ import annotations

import numpy as np

from uvms_ocp.model.robot import Robot


class JointMeter:
    """Counts the energy of the joints of a robot; ``power`` and ``energy`` are to be read only.

    A drive takes ``|tau rate| / joint_efficiency``; braking gives nothing back, standing still is free.
    """

    def __init__(self, robot: Robot) -> None:
        """Nothing has been taken yet."""
        self._efficiency = robot.description.joint_efficiency
        self.power = np.zeros(robot.n_joints)
        """(n_joints,) [W] at the last step."""
        self.energy = np.zeros(robot.n_joints)
        """(n_joints,) [J] taken so far: the trapezoidal rule over the steps."""

    def add(self, tau: np.ndarray, rate: np.ndarray, dt: float) -> None:
        """Count a step of dt [s] that ends with joint efforts tau (n_joints,) [N m, N] at rates [rad/s, m/s]."""
        power = np.abs(tau * rate) / self._efficiency
        self.energy = self.energy + 0.5 * dt * (self.power + power)
        self.power = power

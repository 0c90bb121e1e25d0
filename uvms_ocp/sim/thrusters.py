"""Actuators in time: lag, dead zone and saturation of thrusters, and the electrical power of all drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.files.description import Thruster
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thrust_limits, thrust_of_signals
from uvms_ocp.sim.faults.thruster_condition import ThrusterCondition

_AT_LIMIT = 1.0 - 1e-9  # share of a limit that counts as reaching it
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """What a step of one length needs; computed once."""

    dt: float
    """[s]"""
    decay: np.ndarray
    """(n,) [-] of the distance to the command, over the step."""
    decay_at_nodes: np.ndarray
    """(4, n) [-] the same, at the nodes of the energy integral."""
    weights: np.ndarray
    """(4,) [s]"""


class ThrusterBank:
    """Thrust of all thrusters of a robot in time; ``thrust``, ``power`` and the totals are to be read only.

    Thrust follows the command, clipped to the limits and cut in the dead zone, with the first-order lag
    ``time_constant thrust_dot = command - thrust``, exact for a command held over the step. What a thruster
    without power data takes is not known: NaN.
    """

    def __init__(self, robot: Robot) -> None:
        """All thrusters start at rest."""
        thrusters = robot.description.thrusters
        self._robot = robot
        self._lower, self._upper = thrust_limits(robot)
        self._dead_zone = np.array([thruster.dead_zone for thruster in thrusters])
        self._time_constant = np.array([thruster.time_constant for thruster in thrusters])
        self._factor, self._exponent = _power_law(thrusters)
        self._condition: ThrusterCondition | None = None
        self._step: _Step | None = None
        n = len(thrusters)
        self.thrust = np.zeros(n)
        """(n,) [N] now."""
        self.energy = 0.0 * self._factor
        """(n,) [J] taken so far: the integral of the electrical power, NaN where that is not known."""
        self.saturation_time = np.zeros(n)
        """(n,) [s] with the command at a limit or beyond."""

    @property
    def power(self) -> np.ndarray:
        """Electrical power now (n,) [W], NaN where it is not known."""
        return self._factor * np.abs(self.thrust) ** self._exponent

    def suffer(self, condition: ThrusterCondition | None) -> None:
        """Be in this condition from now on; `None`: all are sound. What is dead stops at once."""
        self._condition = condition
        if condition is not None:
            self.thrust = np.where(condition.dead, 0.0, self.thrust)

    def step(self, command: ArrayLike, dt: float) -> np.ndarray:
        """Hold a command (n,) [N] for dt [s] and return the thrust (n,) [N] at the end.

        Raises `InvalidInput` for a command that is not n finite numbers, or a dt that is not > 0.
        """
        target, saturated = self._target(_checked_command(command, self.thrust.shape))
        step = self._of_length(dt)
        distance = self.thrust - target
        path = np.abs(target + distance * step.decay_at_nodes)
        self.energy = self.energy + step.weights @ (self._factor * path**self._exponent)
        self.saturation_time = self.saturation_time + dt * saturated
        self.thrust = target + distance * step.decay
        return self.thrust

    def step_signals(self, signals: ArrayLike, dt: float) -> np.ndarray:
        """`step` over dt [s] for command signals (n,) [-], turned into thrust by the curve of each thruster.

        Raises `InvalidInput` where `step` does.
        """
        checked = _checked_command(signals, self.thrust.shape)
        return self.step(thrust_of_signals(self._robot, checked), dt)

    def _target(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        saturated = (command >= _AT_LIMIT * self._upper) | (command <= _AT_LIMIT * self._lower)
        clipped = np.minimum(np.maximum(command, self._lower), self._upper)
        target = np.where(np.abs(clipped) < self._dead_zone, 0.0, clipped)
        if self._condition is not None:
            target = np.minimum(np.maximum(self._condition.thrust(target), self._lower), self._upper)
        return target, saturated & (command != 0.0)

    def _of_length(self, dt: float) -> _Step:
        if self._step is None or self._step.dt != dt:
            self._step = _step(dt, self._time_constant)
        return self._step


def joint_power(tau: np.ndarray, rate: np.ndarray, efficiency: float) -> np.ndarray:
    """Electrical power (n_joints,) [W] of drives with effort tau (n_joints,) [N m or N] at rate (n_joints,) [rad/s or m/s].

    ``|tau rate|`` divided by the efficiency [-]: braking gives nothing back, standing still is free.
    """
    return np.abs(tau * rate) / efficiency


def _step(dt: float, time_constant: np.ndarray) -> _Step:
    if not (np.isfinite(dt) and dt > 0.0):
        raise InvalidInput(f"dt = {dt} s given; allowed: more than 0")
    nodes = dt * (_NODES + 1.0) / 2.0
    return _Step(
        dt=dt,
        decay=_decay(dt, time_constant),
        decay_at_nodes=np.array([_decay(node, time_constant) for node in nodes]),
        weights=dt * _WEIGHTS / 2.0,
    )


def _decay(t: float, time_constant: np.ndarray) -> np.ndarray:
    # No lag: the distance to the command is gone at once.
    lagging = time_constant > 0.0
    return np.where(lagging, np.exp(-t / np.where(lagging, time_constant, 1.0)), 0.0)


def _power_law(thrusters: tuple[Thruster, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Factor (n,) [W/N^exponent], NaN where the file gives none, and exponent (n,)."""
    powers = [thruster.power for thruster in thrusters]
    factor = [power.watts / power.thrust**power.exponent if power else np.nan for power in powers]
    return np.array(factor), np.array([power.exponent if power else 1.0 for power in powers])


def _checked_command(command: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(command, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InvalidInput(f"command {array} given; allowed: {shape[0]} finite numbers, one per thruster")
    return array

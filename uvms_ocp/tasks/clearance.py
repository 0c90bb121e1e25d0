"""Clearance: the robot keeps away from obstacles and from itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.collision import CollisionModel
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.activation import Bell
from uvms_ocp.tasks.limits import approach_speed, saturate
from uvms_ocp.tasks.task import Rows, Task, TaskClass, TickSymbols, require_positive

_FAR = 1e3  # [m] stands for the distance of pairs that do not exist


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Clearance(Task):
    """CL: the nearest pairs of shapes stay `threshold` apart, one row per pair.

    Distances and gradients are numbers: they come from coal at every tick, as parameters.
    """

    equality: ClassVar[bool] = False
    name: str = "CL"
    task_class: TaskClass = TaskClass.SAFETY
    model: CollisionModel
    n_nearest: int = 8
    threshold: float = 0.1  # [m]
    margin: float = 0.2  # [m] range of the bell beyond the threshold
    gain: float = 0.5  # [1/s]
    saturation: float = 0.5  # [m/s]
    _n_rows: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        require_positive(
            self.name, threshold=self.threshold, margin=self.margin, gain=self.gain, saturation=self.saturation
        )
        if self.n_nearest < 1:
            raise InvalidInput(f"{self.name}: n_nearest = {self.n_nearest}; give 1 or more")
        object.__setattr__(self, "_n_rows", min(self.n_nearest, self.model.n_pairs))

    def n_parameters(self, robot: Robot) -> int:
        return self._n_rows * (1 + robot.n_v)

    def reference(self, t: float) -> np.ndarray:
        """Pairs that are far away and do not move."""
        return np.concatenate([np.full(self._n_rows, _FAR), np.zeros(self._n_rows * self.model.n_v)])

    def parameters(self, t: float, q: np.ndarray) -> np.ndarray:
        nearest = self.model.nearest(q, self._n_rows)
        return np.concatenate([nearest.value, nearest.gradient.ravel(order="F")])

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        n, robot = self._n_rows, symbols.robot
        distance = parameters[:n]
        closing = approach_speed(
            distance - self.threshold,
            gain=self.gain,
            deceleration=float(min(robot.limits.acceleration[:3])),
            dt=symbols.dt,
            saturation=self.saturation,
        )
        bell = Bell(self.threshold, self.threshold + self.margin)
        rates = [saturate(self.gain * (bell.end - distance[k]), self.saturation) for k in range(n)]
        return Rows(
            jacobian=ca.reshape(parameters[n:], n, robot.n_v),
            rate=ca.vertcat(*rates),
            lower=-closing,
            upper=ca.SX.inf(n),
            activation=ca.vertcat(*(bell.decreasing(distance[k]) for k in range(n))),
            quantities={"clearance": ca.mmin(distance)},
        )

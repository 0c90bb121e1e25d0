"""Clearance (CL): the robot keeps its distance from obstacles and from itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.clearance import ClearanceSensor, Solid
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.activation import Bell
from uvms_ocp.tasks.limits import approach_speed, saturate
from uvms_ocp.tasks.task import Rows, Sensor, Task, TaskClass, TickSymbols, require_positive


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Clearance(Task):
    """CL: every distance stays above `threshold`, one row per pair of shapes, the nearest first to be watched.

    Distances and gradients are coal's, measured at every tick; see `uvms_ocp.model.clearance`.
    """

    equality: ClassVar[bool] = False
    name: str = "CL"
    task_class: TaskClass = TaskClass.SAFETY
    obstacles: tuple[Solid, ...] = ()
    self_clearance: bool = True
    nearest: int = 6  # pairs that get a row
    threshold: float = 0.05  # [m]
    margin: float = 0.1  # [m] of the activation above the threshold
    gain: float = 1.0  # [1/s]
    deceleration: float = 0.5  # [m/s^2] that the robot can give along any normal
    saturation: float = 0.5  # [m/s]

    def __post_init__(self) -> None:
        require_positive(
            self.name,
            threshold=self.threshold,
            margin=self.margin,
            gain=self.gain,
            deceleration=self.deceleration,
            saturation=self.saturation,
        )
        if self.nearest < 1:
            raise InvalidInput(f"{self.name}: nearest = {self.nearest} pairs; give a number >= 1")

    def n_measured(self, robot: Robot) -> int:
        return self.nearest * (1 + robot.n_v)

    def sensor(self, robot: Robot) -> Sensor:
        return ClearanceSensor(robot, self.obstacles, nearest=self.nearest, self_clearance=self.self_clearance)

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        d = parameters[: self.nearest]
        jacobian = ca.reshape(parameters[self.nearest :], symbols.robot.n_v, self.nearest).T
        closing = approach_speed(
            d - self.threshold,
            gain=self.gain,
            deceleration=self.deceleration,
            dt=symbols.dt,
            saturation=self.saturation,
        )
        bell = Bell(self.threshold, self.threshold + self.margin)
        return Rows(
            jacobian=jacobian,
            rate=ca.vertcat(*(saturate(self.gain * (bell.end - x), self.saturation) for x in ca.vertsplit(d))),
            lower=-closing,
            upper=ca.SX.ones(self.nearest) * ca.inf,
            activation=ca.vertcat(*(bell.decreasing(x) for x in ca.vertsplit(d))),
            quantities={"clearance": ca.mmin(d)},
        )

"""Altitude tasks: minimum altitude (MAC) and landing (LA)."""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar

import casadi as ca

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Robot, SymbolicModel, kinematics, limits
from uvms_ocp.tasks.activation import SmoothActivation
from uvms_ocp.tasks.approach_speed import saturate
from uvms_ocp.tasks.task import (
    Residual,
    Rows,
    Task,
    TaskClass,
    TickSymbols,
    bounded_residual,
    equality_rows,
    zero_residual,
)
from uvms_ocp.types import Finite, Positive


def altitude_of(symbols: TickSymbols, frame: str) -> ca.SX:
    """Compute the altitude [m] of the altimeter above the floor: the z component of its beam in W
    ([Gao2022] eq. 16).
    """
    R_WS, _ = symbols.kinematics.pose(frame)
    return R_WS[2, 2] * symbols.altimeter_range


def altitude_row(symbols: TickSymbols, frame: str) -> ca.SX:
    """Return row (1, n_v) [-, m] of the world-z velocity of the sensor point."""
    return symbols.kinematics.jacobian(frame)[2, :]


def altimeter_of(task: str, symbols: TickSymbols, frame: str | None) -> str:
    """Return the frame given, or the robot's altimeter; raises `InvalidInput` where there is none."""
    altimeter = frame or symbols.robot.description.altimeter
    if altimeter is None:
        raise InvalidInput(
            f"{task}: the robot has no altimeter; name its frame in the YAML (altimeter: FRAME) or"
            " as frame="
        )
    return altimeter


@lru_cache(maxsize=8)
def height_of(robot: Robot, frame: str) -> ca.Function:
    """Return values of a `PositionLimit`: z [m] of a frame's origin in W. Raises `FrameNotFound`."""
    q = ca.SX.sym("q", robot.n_q)
    _, p_WS = SymbolicModel(robot.model).forward_kinematics(q).pose(frame)
    return ca.Function("height", [q], [ca.densify(p_WS[2])])


@checked_dataclass(eq=False)
class MinimumAltitude(Task):
    """MAC: the altimeter stays above `threshold` ([Gao2022] eqs 16-26)."""

    equality: ClassVar[bool] = False
    needs_altimeter: ClassVar[bool] = True
    symbolic_numbers: ClassVar[tuple[str, ...]] = ("threshold", "margin", "gain", "saturation")
    name: str = "MAC"
    task_class: TaskClass = TaskClass.SAFETY
    frame: str | None = None
    """Frame of the range sensor; by default the altimeter of the robot's file."""
    threshold: Positive = 1.0
    """[m] h_min"""
    margin: Positive = 0.5
    """[m] Delta"""
    gain: Positive = 0.4
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.5
    """[m/s] Largest rate that is asked for."""

    @property
    def rest_altitude(self) -> float:
        """`threshold` [m]."""
        return self.threshold

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Keep the altitude >= `threshold` [m]."""
        return bounded_residual(
            altitude_of(symbols, altimeter_of(self.name, symbols, self.frame)), lower=self.threshold
        )

    def position_limit(self, robot: Robot) -> limits.PositionLimit:
        """Return the limit that keeps the altimeter at `threshold` or above; the floor is taken as
        level around the robot.
        """
        frame = self.frame or robot.description.altimeter or ""
        return limits.PositionLimit(
            quantity="altitude",
            lower=self.threshold,
            values=height_of(robot, frame),
            relative=True,
            reach=kinematics.point_reach(robot, frame),
        )

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        frame = altimeter_of(self.name, symbols, self.frame)
        h = altitude_of(symbols, frame)
        row = altitude_row(symbols, frame)
        bell = SmoothActivation(self.threshold, self.threshold + self.margin)
        return Rows(
            jacobian=row,
            rate=saturate(self.gain * (bell.end - h), self.saturation),
            lower=-symbols.approach(self, h - self.threshold, row),
            upper=ca.SX(ca.inf),
            activation=bell.decreasing(h),
            quantities={"altitude": h},
        )


@checked_dataclass(eq=False)
class LandingAltitude(Task):
    """LA: the altimeter descends to ``landing_distance + safeguard`` ([Gao2022] eqs 34-35)."""

    needs_altimeter: ClassVar[bool] = True
    symbolic_numbers: ClassVar[tuple[str, ...]] = (
        "landing_distance",
        "safeguard",
        "gain",
        "saturation",
    )
    name: str = "LA"
    task_class: TaskClass = TaskClass.ACTION
    frame: str | None = None
    """Frame of the range sensor; by default the altimeter of the robot's file."""
    landing_distance: Finite = -0.02
    """[m] d_landing; below 0 so that the safeguard's height is crossed."""
    safeguard: Positive = 0.17
    """[m] Delta_safeguard"""
    gain: Positive = 0.4
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.2
    """[m/s] Largest rate that is asked for."""

    @property
    def rest_altitude(self) -> float:
        """``landing_distance + safeguard`` [m]."""
        return self.landing_distance + self.safeguard

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """``landing_distance + safeguard - altitude`` = 0 [m]."""
        return zero_residual(
            self.rest_altitude - altitude_of(symbols, altimeter_of(self.name, symbols, self.frame))
        )

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        frame = altimeter_of(self.name, symbols, self.frame)
        rate = saturate(self.gain * self.residual(symbols, parameters).value, self.saturation)
        return equality_rows(
            altitude_row(symbols, frame), rate, {"altitude": altitude_of(symbols, frame)}
        )

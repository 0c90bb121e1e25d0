"""Attitude tasks: horizontal attitude (HA), alignment with a target (AT), field of view (FV)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.spatial import skew
from uvms_ocp.tasks.activation import SmoothActivation, approach_speed, row_acceleration, saturate
from uvms_ocp.tasks.task import (
    Residual,
    Rows,
    Task,
    TaskClass,
    TickSymbols,
    VectorGoal,
    bounded_residual,
    evaluate_vector,
    require_positive,
)

_SINE_FLOOR = 1e-9  # below this sine of the angle the rotation axis comes from the fallback
_ROUNDING = 1e-3  # [rad] below which the smooth angle of a residual flattens out
_OVERHEAD = 1e-3  # [m] horizontal distance below which the direction to a target is undefined


def misalignment(a: ca.SX, b: ca.SX, fallback: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Angle theta [rad] in [0, pi] and unit axis n (3,) of the rotation that takes unit vector a to unit vector b.

    Where a and b are parallel the axis is `fallback`, so that theta = pi can be left and theta = 0 is no 0 / 0.
    """
    normal = ca.cross(a, b)
    sine = ca.norm_2(normal)
    parallel = sine < _SINE_FLOOR
    axis = ca.if_else(parallel, fallback, normal / ca.fmax(sine, _SINE_FLOOR))
    return ca.atan2(sine, ca.dot(a, b)), axis


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class AngleTask(Task):
    """Shared fields of tasks that keep one angle theta small by an inequality."""

    equality: ClassVar[bool] = False
    frame: str = "base_link"
    """Whose angle it is."""
    gain: float
    """[1/s]"""
    saturation: float
    """[rad/s]"""
    activation: SmoothActivation
    """[rad] activation rises over this range."""
    aim: float
    """[rad] angle at which the strict hierarchy's bound lets theta rest."""

    def __post_init__(self) -> None:
        require_positive(self.name, gain=self.gain, saturation=self.saturation, aim=self.aim)

    def _angle_residual(self, a: ca.SX, b: ca.SX) -> Residual:
        """Chord between unit vectors, ``2 sin(theta / 2)``: smooth at theta = 0 and steep where theta is large."""
        chord = ca.sqrt(ca.sumsqr(a - b) + _ROUNDING**2)
        return bounded_residual(chord, upper=float(np.hypot(2 * np.sin(self.aim / 2), _ROUNDING)))

    def _angle_rows(self, symbols: TickSymbols, theta: ca.SX, row: ca.SX, quantities: dict[str, ca.SX]) -> Rows:
        """Rows that hold d theta / dt = `row` @ v at a rate that brings theta inside `aim`."""
        rising = approach_speed(
            self.aim - theta,
            gain=self.gain,
            deceleration=row_acceleration(row, symbols.robot.limits.acceleration),
            dt=symbols.dt,
            saturation=self.saturation,
        )
        return Rows(
            jacobian=row,
            rate=saturate(-self.gain * theta, self.saturation),
            lower=ca.SX(-ca.inf),
            upper=rising,
            activation=self.activation.increasing(theta),
            quantities=quantities,
        )


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HorizontalAttitude(AngleTask):
    """HA: the body z axis stays vertical. Row ``-n . omega`` ([Gao2022], horizontal attitude)."""

    name: str = "HA"
    task_class: TaskClass = TaskClass.SAFETY
    gain: float = 0.2
    """[1/s]"""
    saturation: float = 0.5
    """[rad/s]"""
    activation: SmoothActivation = SmoothActivation(0.025, 0.1)
    """[rad]"""
    aim: float = 0.025
    """[rad]"""

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Tilt <= `aim` [rad]."""
        R_WB, _ = symbols.kinematics.pose(self.frame)
        return self._angle_residual(R_WB[:, 2], ca.SX([0, 0, 1]))

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        R_WB, _ = symbols.kinematics.pose(self.frame)
        theta, n = misalignment(R_WB[:, 2], ca.SX([0, 0, 1]), R_WB[:, 0])
        row = -n.T @ symbols.kinematics.jacobian(self.frame)[3:, :]
        return self._angle_rows(symbols, theta, row, {"tilt": theta})


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Alignment(AngleTask):
    """AT: the body x axis points along the horizontal direction to a target ([Gao2022] eqs 36-58).

    theta takes a = body x axis to b = d / |d|, d the horizontal part of target minus vehicle position, and
    ``d theta / dt = -n . (omega_W + [d x] diag(1,1,0) v_W / |d|^2)``. A target straight above or below has no
    direction: the row is zero then and the quantity ``overhead`` is 1. Raises `InvalidInput` for a goal that is no position.
    """

    name: str = "AT"
    task_class: TaskClass = TaskClass.PREREQUISITE
    goal: VectorGoal
    """(3,) [m] target position in W."""
    gain: float = 0.6
    """[1/s]"""
    saturation: float = 0.2
    """[rad/s]"""
    activation: SmoothActivation = SmoothActivation(0.0, 0.07)
    """[rad]"""
    aim: float = 0.035
    """[rad]"""

    def __post_init__(self) -> None:
        AngleTask.__post_init__(self)
        value, _ = evaluate_vector(self.name, self.goal, 0.0)
        if value.shape != (3,):
            raise InvalidInput(f"{self.name}: goal of shape {value.shape}; give a position (3,) in W")

    def n_parameters(self, robot: Robot) -> int:
        return 6

    @checked_on_failure
    def reference(self, t: float) -> np.ndarray:
        return np.concatenate(evaluate_vector(self.name, self.goal, t))

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Angle to the target's horizontal direction <= `aim` [rad]; free below or above the target."""
        R_WB, p_WB = symbols.kinematics.pose(self.frame)
        d = ca.vertcat(parameters[:2] - p_WB[:2], 0)
        return self._angle_residual(R_WB[:, 0], d / ca.sqrt(ca.sumsqr(d) + _OVERHEAD**2))

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        R_WB, p_WB = symbols.kinematics.pose(self.frame)
        J = symbols.kinematics.jacobian(self.frame)
        d = ca.vertcat(parameters[:2] - p_WB[:2], 0)
        overhead = ca.norm_2(d) < _OVERHEAD
        distance = ca.fmax(ca.norm_2(d), _OVERHEAD)
        theta, n = misalignment(R_WB[:, 0], d / distance, ca.SX([0, 0, 1]))
        turning = skew(d) @ ca.diag(ca.SX([1, 1, 0])) / distance**2
        row = -n.T @ (J[3:, :] + turning @ J[:3, :])
        quantities = {"misalignment": ca.if_else(overhead, 0, theta), "overhead": overhead}
        rows = self._angle_rows(symbols, quantities["misalignment"], ca.if_else(overhead, 0, row), quantities)
        # A moving target turns the line of sight by itself: that part of d theta / dt is not ours to choose.
        drift = ca.if_else(overhead, 0, n.T @ turning @ parameters[3:])
        return Rows(
            jacobian=rows.jacobian,
            rate=rows.rate - drift,
            lower=rows.lower,
            upper=rows.upper - drift,
            activation=rows.activation,
            quantities=quantities,
        )


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FieldOfView(AngleTask):
    """FV: a point stays inside the cone that a camera sees.

    theta takes the optical axis to the direction d / |d| of the point, and
    ``d theta / dt = -n . (omega_W + d x v_W / |d|^2)`` with the velocity of the camera's frame. A point at the camera
    itself has no direction: the row is zero then. Raises `InvalidInput` for a goal that is no position or an axis that is
    no unit vector.
    """

    name: str = "FV"
    task_class: TaskClass = TaskClass.PREREQUISITE
    goal: VectorGoal
    """(3,) [m] point in W."""
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """(3,) optical axis in `frame`, of length 1."""
    gain: float = 0.6
    """[1/s]"""
    saturation: float = 0.3
    """[rad/s]"""
    activation: SmoothActivation = SmoothActivation(0.3, 0.5)
    """[rad]"""
    aim: float = 0.4
    """[rad]"""

    def __post_init__(self) -> None:
        AngleTask.__post_init__(self)
        value, _ = evaluate_vector(self.name, self.goal, 0.0)
        if value.shape != (3,) or not np.isclose(np.linalg.norm(self.axis), 1.0):
            raise InvalidInput(f"{self.name}: goal {value}, axis {self.axis}; give a position (3,) and a unit vector")

    def n_parameters(self, robot: Robot) -> int:
        return 6

    @checked_on_failure
    def reference(self, t: float) -> np.ndarray:
        return np.concatenate(evaluate_vector(self.name, self.goal, t))

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Angle to the point <= `aim` [rad]; free at the camera itself."""
        R_WC, p_WC = symbols.kinematics.pose(self.frame)
        d = parameters[:3] - p_WC
        return self._angle_residual(R_WC @ ca.DM(self.axis), d / ca.sqrt(ca.sumsqr(d) + _OVERHEAD**2))

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        R_WC, p_WC = symbols.kinematics.pose(self.frame)
        J = symbols.kinematics.jacobian(self.frame)
        d = parameters[:3] - p_WC
        near = ca.norm_2(d) < _OVERHEAD
        distance = ca.fmax(ca.norm_2(d), _OVERHEAD)
        axis = R_WC @ ca.DM(self.axis)
        theta, n = misalignment(axis, d / distance, _perpendicular(R_WC, self.axis))
        turning = skew(d) / distance**2
        row = ca.if_else(near, 0, -n.T @ (J[3:, :] + turning @ J[:3, :]))
        angle = ca.if_else(near, 0, theta)
        rows = self._angle_rows(symbols, angle, row, {"angle": angle, "distance": ca.norm_2(d)})
        drift = ca.if_else(near, 0, n.T @ turning @ parameters[3:])
        return replace(rows, rate=rows.rate - drift, upper=rows.upper - drift)


def _perpendicular(R_WC: ca.SX, axis: tuple[float, float, float]) -> ca.SX:
    """A unit vector (3,) in W perpendicular to an axis of the frame C."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = np.cross(np.asarray(axis), other)
    return R_WC @ ca.DM(across / np.linalg.norm(across))

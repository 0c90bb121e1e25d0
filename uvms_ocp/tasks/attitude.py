"""Attitude tasks: horizontal attitude (HA), alignment with a target (AT), field of view (FV).

On vehicles whose thrusters do not drive all axes, a task controls the angle only in the plane in
which driven axes turn it, and not by translation: the strict hierarchy would otherwise meet the row
by driving away.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import spatial, thrusters
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.activation import SmoothActivation
from uvms_ocp.tasks.approach_speed import saturate
from uvms_ocp.tasks.goals import VectorGoal, evaluate_vector
from uvms_ocp.tasks.task import (
    Residual,
    Rows,
    Task,
    TaskClass,
    TickSymbols,
    bounded_residual,
    determined_by_goal,
)
from uvms_ocp.types import Positive

_SINE_FLOOR = 1e-9  # below this sine of the angle the rotation axis is the fallback
_ROUNDING = 1e-3  # [rad] angle below which the smooth angle of a residual flattens out
_PARALLEL = 1e-6  # a driven axis turns no axis that is parallel to it up to this sine
# Least length of a unit vector's part in the plane in which an axis is turned: of shorter ones the
# angle in it is taken as 0.
_IN_PLANE = 1e-3
_ANGLE_NUMBERS = ("gain", "saturation", "aim")  # `symbolic_numbers` of tasks on one angle
# [m] distance below which the direction to a target is undefined: less than a position is known to, of toys
# too
_OVERHEAD = 1e-3


def misalignment(a: ca.SX, b: ca.SX, fallback: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Compute the angle theta [rad] in [0, pi] and unit axis n (3,) of the rotation that takes unit
    vector a to unit vector b.

    Where a and b are parallel the axis is `fallback`: theta = pi has an axis to turn about, and
    theta = 0 divides by no zero.
    """
    normal = ca.cross(a, b)
    sine = ca.norm_2(normal)
    axis = ca.if_else(sine < _SINE_FLOOR, fallback, normal / ca.fmax(sine, _SINE_FLOOR))
    return ca.atan2(sine, ca.dot(a, b)), axis


@checked_dataclass(eq=False)
class AngleTask(Task):
    """Shared fields of tasks that keep one angle theta small by an inequality."""

    equality: ClassVar[bool] = False
    frame: str = "base_link"
    """Frame whose angle is kept small."""
    gain: Positive
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive
    """[rad/s] Largest rate that is asked for."""
    activation: SmoothActivation
    """[rad] angles between which the activation rises."""
    aim: Positive
    """[rad] angle at which the strict hierarchy's bound lets theta rest."""

    @property
    def watched_axis(self) -> tuple[float, float, float]:
        """(3,) unit vector in `frame` whose angle is kept small."""
        return 1.0, 0.0, 0.0

    def turning_directions(self, robot: Robot) -> np.ndarray | None:
        """Return unit vectors (3, k) in B, perpendicular to the axis, towards which the thrusters
        can turn it; `None` where they can turn it everywhere.

        Raises `FrameNotFound`.
        """
        turns = thrusters.driven_turns(robot, self.frame)
        if turns is None:
            return None
        axis = _in_vehicle(robot, self.frame, self.watched_axis)
        moves_of_axis = np.cross(np.eye(3)[list(turns)], axis).reshape(-1, 3).T
        U, s, _ = np.linalg.svd(moves_of_axis)
        directions = U[:, : int((s > _PARALLEL).sum())]
        if directions.shape[1] == 2:
            return None
        return directions

    def _turn(self, symbols: TickSymbols, b: ca.SX, fallback: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Compute angle [rad] and axis (3,) in W of the rotation towards b (3,), as `misalignment`
        does, in the plane in which the thrusters can turn the axis.

        Both are 0 where b has no part in that plane, and the axis is 0 where nothing turns it, and
        where it points to b.
        """
        R_WF, _ = symbols.kinematics.pose(self.frame)
        a = R_WF @ ca.DM(self.watched_axis)
        directions = self.turning_directions(symbols.robot)
        if directions is None:
            return misalignment(a, b, fallback)
        if not directions.shape[1]:
            return misalignment(a, b, fallback)[0], ca.SX.zeros(3)
        axis = _in_vehicle(symbols.robot, self.frame, self.watched_axis)
        across = symbols.R_WB @ ca.DM(directions)
        ahead = ca.dot(a, b)
        aside = ca.dot(across, b)
        is_in_view = ahead**2 + aside**2 > _IN_PLANE**2
        normal = symbols.R_WB @ ca.DM(np.cross(axis, directions[:, 0]))
        n = ca.if_else(aside < 0, -normal, normal)
        # At b either turn leads away from it: a bound on one would depend on the axes of the file.
        is_there = ca.logic_and(ca.fabs(aside) < _SINE_FLOOR, ahead > 0)
        n = ca.if_else(is_there, 0, n)
        theta = ca.atan2(ca.fabs(aside), ahead)
        return ca.if_else(is_in_view, theta, 0), ca.if_else(is_in_view, n, 0)

    def _angle_residual(self, a: ca.SX, b: ca.SX) -> Residual:
        """Bound the chord between unit vectors, ``2 sin(theta / 2)``, which is smooth at theta = 0
        and steep where theta is large.
        """
        chord = ca.sqrt(ca.sumsqr(a - b) + _ROUNDING**2)
        return bounded_residual(chord, upper=float(np.hypot(2 * np.sin(self.aim / 2), _ROUNDING)))

    def _angle_rows(
        self, symbols: TickSymbols, theta: ca.SX, row: ca.SX, quantities: dict[str, ca.SX]
    ) -> Rows:
        """Build the rows that hold d theta / dt = `row` @ v at a rate that brings theta inside
        `aim`.

        The part of d theta / dt from translation and from axes that no thruster drives is taken as
        measured, and not asked for.
        """
        undriven_rate = ca.SX(0)
        directions = self.turning_directions(symbols.robot)
        if directions is not None and not directions.shape[1]:
            theta = ca.SX(0)  # a row that nothing moves asks for nothing
        undriven = thrusters.undriven_axes(symbols.robot)
        if undriven:
            measured_axes = sorted({0, 1, 2, *undriven})
            undriven_rate = row[:, measured_axes] @ symbols.velocity[measured_axes]
            row = ca.SX(row)
            row[:, measured_axes] = 0
        return Rows(
            jacobian=row,
            rate=saturate(-self.gain * theta, self.saturation) - undriven_rate,
            lower=ca.SX(-ca.inf),
            upper=symbols.approach(self, self.aim - theta, row) - undriven_rate,
            activation=self.activation.increasing(theta),
            quantities=quantities,
        )


@checked_dataclass(eq=False)
class HorizontalAttitude(AngleTask):
    """HA: the body z axis stays vertical. Row ``-n . omega`` ([Gao2022], horizontal attitude).

    The quantity ``tilt`` is the whole angle, also where a part of it is left to weight and
    buoyancy.
    """

    symbolic_numbers: ClassVar[tuple[str, ...]] = _ANGLE_NUMBERS
    name: str = "HA"
    task_class: TaskClass = TaskClass.SAFETY
    gain: Positive = 0.2
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.5
    """[rad/s] Largest rate that is asked for."""
    activation: SmoothActivation = SmoothActivation(0.025, 0.1)
    """[rad] angles between which the task is activated."""
    aim: Positive = 0.025
    """[rad] angle within which the vehicle is to be."""

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Keep the tilt <= `aim` [rad]."""
        R_WB, _ = symbols.kinematics.pose(self.frame)
        return self._angle_residual(R_WB[:, 2], ca.SX([0, 0, 1]))

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        R_WB, _ = symbols.kinematics.pose(self.frame)
        up = ca.SX([0, 0, 1])
        tilt, _ = misalignment(R_WB[:, 2], up, R_WB[:, 0])
        theta, n = self._turn(symbols, up, R_WB[:, 0])
        return self._angle_rows(
            symbols, theta, -n.T @ symbols.kinematics.jacobian(self.frame)[3:, :], {"tilt": tilt}
        )

    @property
    def watched_axis(self) -> tuple[float, float, float]:
        return 0.0, 0.0, 1.0


@checked_dataclass(eq=False)
class TargetTask(AngleTask):
    """Shared part of tasks that turn an axis towards a point. Raises `InvalidInput` for a goal that
    is no position.
    """

    goal: VectorGoal
    """(3,) [m] target position in W."""

    def __post_init__(self) -> None:
        value, _ = evaluate_vector(self.name, self.goal, 0.0)
        if value.shape != (3,):
            raise InvalidInput(
                f"{self.name}: goal of shape {value.shape}; give a position (3,) in W"
            )

    def n_parameters(self, robot: Robot) -> int:
        return 6

    @determined_by_goal
    def reference(self, t: float) -> np.ndarray:
        return np.concatenate(evaluate_vector(self.name, self.goal, t))

    def _target_rows(
        self,
        symbols: TickSymbols,
        d: ca.SX,
        across: ca.SX,
        fallback: ca.SX,
        speed: ca.SX,
        quantities: dict[str, ca.SX],
        name: str,
    ) -> Rows:
        """Return rows for the way d (3,) [m] to the target, which translation turns by ``across @ v
        / |d|^2``, across (3, 3) [m].

        speed (3,) [m/s]: velocity of the target. name: of the angle among quantities; `quantities`
        are the others. At d = 0 nothing is asked for.
        """
        J = symbols.kinematics.jacobian(self.frame)
        is_overhead = ca.norm_2(d) < _OVERHEAD
        distance = ca.fmax(ca.norm_2(d), _OVERHEAD)
        theta, n = self._turn(symbols, d / distance, fallback)
        turning = across / distance**2
        row = -n.T @ (J[3:, :] + turning @ J[:3, :])
        angle = ca.if_else(is_overhead, 0, theta)
        rows = self._angle_rows(
            symbols, angle, ca.if_else(is_overhead, 0, row), {name: angle, **quantities}
        )
        # A moving target turns the line of sight too: no motion of the robot changes that part.
        drift = ca.if_else(is_overhead, 0, n.T @ turning @ speed)
        return replace(rows, rate=rows.rate - drift, upper=rows.upper - drift)


@checked_dataclass(eq=False)
class Alignment(TargetTask):
    """AT: the body x axis points along the horizontal direction to a target ([Gao2022] eqs 36-58).

    theta takes a = body x axis to b = d / |d|, d the horizontal part of target minus vehicle
    position, and ``d theta / dt = -n . (omega_W + [d x] diag(1,1,0) v_W / |d|^2)``. A target
    straight above or below has no direction: the row is zero then and the quantity ``overhead`` is
    1. Raises `InvalidInput` for a goal that is no position.
    """

    symbolic_numbers: ClassVar[tuple[str, ...]] = _ANGLE_NUMBERS
    name: str = "AT"
    task_class: TaskClass = TaskClass.PREREQUISITE
    gain: Positive = 0.6
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.2
    """[rad/s] Largest rate that is asked for."""
    activation: SmoothActivation = SmoothActivation(0.0, 0.07)
    """[rad] angles between which the task is activated."""
    aim: Positive = 0.035
    """[rad] angle within which the vehicle is to be."""

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Keep the angle to the target's horizontal direction <= `aim` [rad]; below or above the
        target it is free.
        """
        R_WB, p_WB = symbols.kinematics.pose(self.frame)
        d = ca.vertcat(parameters[:2] - p_WB[:2], 0)
        return self._angle_residual(R_WB[:, 0], d / ca.sqrt(ca.sumsqr(d) + _OVERHEAD**2))

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        d = ca.vertcat(parameters[:2] - symbols.kinematics.pose(self.frame)[1][:2], 0)
        across = spatial.skew(d) @ ca.diag(ca.SX([1, 1, 0]))
        is_overhead = ca.norm_2(d) < _OVERHEAD
        return self._target_rows(
            symbols,
            d,
            across,
            ca.SX([0, 0, 1]),
            parameters[3:],
            {"overhead": is_overhead},
            "misalignment",
        )


@checked_dataclass(eq=False)
class FieldOfView(TargetTask):
    """FV: a point stays inside the cone that a camera sees.

    theta takes the optical axis to the direction d / |d| of the point, and ``d theta / dt = -n .
    (omega_W + d x v_W / |d|^2)`` with the velocity of the camera's frame. A point at the camera
    itself has no direction: the row is zero then. Raises `InvalidInput` for a goal that is no
    position or an axis that is no unit vector.
    """

    symbolic_numbers: ClassVar[tuple[str, ...]] = _ANGLE_NUMBERS
    name: str = "FV"
    task_class: TaskClass = TaskClass.PREREQUISITE
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """(3,) optical axis in `frame`, of length 1."""
    gain: Positive = 0.6
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.3
    """[rad/s] Largest rate that is asked for."""
    activation: SmoothActivation = SmoothActivation(0.3, 0.5)
    """[rad] angles between which the task is activated."""
    aim: Positive = 0.4
    """[rad] angle within which the vehicle is to be."""

    def __post_init__(self) -> None:
        TargetTask.__post_init__(self)
        if not np.isclose(np.linalg.norm(self.axis), 1.0):
            raise InvalidInput(f"{self.name}: axis {self.axis}; give a unit vector")

    @property
    def watched_axis(self) -> tuple[float, float, float]:
        return self.axis

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Keep the angle to the point <= `aim` [rad]; at the camera itself it is free."""
        R_WC, p_WC = symbols.kinematics.pose(self.frame)
        d = parameters[:3] - p_WC
        return self._angle_residual(
            R_WC @ ca.DM(self.axis), d / ca.sqrt(ca.sumsqr(d) + _OVERHEAD**2)
        )

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        R_WC, p_WC = symbols.kinematics.pose(self.frame)
        d = parameters[:3] - p_WC
        fallback = _perpendicular(R_WC, self.axis)
        return self._target_rows(
            symbols,
            d,
            spatial.skew(d),
            fallback,
            parameters[3:],
            {"distance": ca.norm_2(d)},
            "angle",
        )


def _in_vehicle(robot: Robot, frame: str, axis: tuple[float, float, float]) -> np.ndarray:
    """Return the axis (3,) in B of a frame that is fixed to the vehicle."""
    return np.asarray(
        robot.model.frames[robot.frame_id(frame)].placement.rotation @ np.asarray(axis)
    )


def _perpendicular(R_WC: ca.SX, axis: tuple[float, float, float]) -> ca.SX:
    """Return a unit vector (3,) in W perpendicular to an axis of the frame C."""
    across = np.cross(np.asarray(axis), np.eye(3)[int(np.argmin(np.abs(axis)))])
    return R_WC @ ca.DM(across / np.linalg.norm(across))

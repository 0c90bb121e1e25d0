"""Joint tasks: joint limits (JL), tracking of a posture or trajectory (MP), manipulability (MU)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Robot, SymbolicModel, limits
from uvms_ocp.tasks.activation import SmoothActivation
from uvms_ocp.tasks.approach_speed import approach_speed, saturate
from uvms_ocp.tasks.goals import VectorGoal, evaluate_vector
from uvms_ocp.tasks.task import (
    Residual,
    Rows,
    Task,
    TaskClass,
    TickSymbols,
    bounded_residual,
    determined_by_goal,
    equality_rows,
    zero_residual,
)
from uvms_ocp.types import Positive

_SINGULAR = 1e-12  # keeps the square root of the manipulability differentiable at singular postures


@checked_dataclass(eq=False)
class JointLimits(Task):
    """JL: every bounded joint stays inside its range, one row per joint ([Gao2022] Case 2).

    The range is that of the robot's limits without `guard` on each side, in the hierarchy and over
    a horizon alike. The activation rises over its last `margin`, and the rate leads back from
    there. Raises `InvalidInput` for a guard that is negative, and for a guard and a margin of 0.5
    or more together.
    """

    equality: ClassVar[bool] = False
    symbolic_numbers: ClassVar[tuple[str, ...]] = ("margin", "guard", "gain", "saturation")
    name: str = "JL"
    task_class: TaskClass = TaskClass.SAFETY
    margin: Positive = 0.1
    """Share of the robot's range on each side, inside of `guard`."""
    guard: float = 0.0
    """Share of the robot's range on each side that is never used."""
    gain: Positive = 0.2
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.5
    """[rad/s or m/s] Largest rate that is asked for."""

    def __post_init__(self) -> None:
        if not (self.guard >= 0 and self.guard + self.margin < 0.5):
            problem = f"{self.name}: margin = {self.margin}, guard = {self.guard}"
            raise InvalidInput(f"{problem}; give shares of the range, together below 0.5")

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Bound the joints by their ranges [rad or m]."""
        positions = list[ca.SX]()
        lower_ends = list[float]()
        upper_ends = list[float]()
        for joint, lower, upper in limits.bounded_joints(
            symbols.robot.joints, symbols.robot.limits
        ):
            guarded_lower, guarded_upper = self._guarded_range(lower, upper)
            positions.append(joint.position(symbols.q))
            lower_ends.append(guarded_lower)
            upper_ends.append(guarded_upper)
        return Residual(
            value=_column_of(positions),
            lower=np.array(lower_ends, dtype=float),
            upper=np.array(upper_ends, dtype=float),
        )

    def _guarded_range(self, lower: float, upper: float) -> tuple[float, float]:
        """Return the range [rad or m] without the guard, which a joint with one limit has not."""
        if not np.isfinite([lower, upper]).all():
            return lower, upper
        guard = self.guard * (upper - lower)
        return lower + guard, upper - guard

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        axes = list[int]()
        rows = list[_JointRow]()
        has_range = False
        for joint, lower, upper in limits.bounded_joints(
            symbols.robot.joints, symbols.robot.limits
        ):
            if np.isfinite([lower, upper]).all():
                axes.append(joint.idx_v)
                rows.append(self._joint_row(symbols, joint, lower, upper))
                has_range = has_range or lower < upper
        quantities = dict[str, ca.SX]()
        if has_range:
            quantities["margin"] = ca.mmin(_column_of(row.margin for row in rows))
        return Rows(
            jacobian=symbols.velocity_rows(axes),
            rate=_column_of(row.rate for row in rows),
            lower=_column_of(row.lower for row in rows),
            upper=_column_of(row.upper for row in rows),
            activation=_column_of(row.activation for row in rows),
            quantities=quantities,
        )

    def _joint_row(
        self, symbols: TickSymbols, joint: limits.Joint, lower: float, upper: float
    ) -> _JointRow:
        q = joint.position(symbols.q)
        margin = self.margin * (upper - lower)
        if lower == upper:  # it is held there, also by solvers that know no limits of velocity
            rate = saturate(self.gain * (lower - q), self.saturation)
            return _JointRow(rate, rate, rate, activation=ca.SX(1), margin=ca.SX.inf())
        guarded_lower, guarded_upper = self._guarded_range(lower, upper)
        at_lower = SmoothActivation(guarded_lower, guarded_lower + margin)
        at_upper = SmoothActivation(guarded_upper - margin, guarded_upper)
        way_back = ca.if_else(q < at_lower.end, at_lower.end - q, ca.fmin(at_upper.start - q, 0))
        return _JointRow(
            rate=saturate(self.gain * way_back, self.saturation),
            lower=-self._approach(symbols, joint, q - guarded_lower),
            upper=self._approach(symbols, joint, guarded_upper - q),
            activation=at_lower.decreasing(q) + at_upper.increasing(q),
            margin=ca.fmin(q - lower, upper - q),
        )

    def _approach(self, symbols: TickSymbols, joint: limits.Joint, distance: ca.SX) -> ca.SX:
        """Return the largest speed [rad/s or m/s] towards a limit at this distance [rad or m]."""
        return approach_speed(
            distance,
            gain=self.gain,
            deceleration=float(symbols.robot.limits.acceleration[joint.idx_v]),
            dt=symbols.dt,
            saturation=self.saturation,
        )


class _JointRow(NamedTuple):
    """Row of one joint with a limit on each side, as in `Rows`."""

    rate: ca.SX
    """[rad/s or m/s] desired rate."""
    lower: ca.SX
    """[rad/s or m/s] smallest rate."""
    upper: ca.SX
    """[rad/s or m/s] largest rate."""
    activation: ca.SX
    """Activation in [0, 1]."""
    margin: ca.SX
    """[rad or m] distance to the nearer limit."""


@checked_dataclass(eq=False)
class JointTracking(Task):
    """MP: chosen joints follow a trajectory or hold a preferred posture ([Gao2022] Case 2).

    A joint that turns without end goes the shorter way round. Raises `InvalidInput` for a goal that
    does not give each joint one number, and in `rows` for a joint of several degrees of freedom.
    """

    symbolic_numbers: ClassVar[tuple[str, ...]] = ("gain", "saturation")
    name: str = "MP"
    task_class: TaskClass = TaskClass.OPTIMIZATION
    joints: tuple[str, ...]
    """Names of the joints that follow the goal."""
    goal: VectorGoal
    """Positions of the joints (len(joints),) [rad or m], constant or over time."""
    gain: Positive = 0.5
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.5
    """[rad/s or m/s] Largest rate that is asked for."""

    def __post_init__(self) -> None:
        value, _ = evaluate_vector(self.name, self.goal, 0.0)
        if value.shape != (len(self.joints),):
            raise InvalidInput(
                f"{self.name}: goal of shape {value.shape} for {len(self.joints)} joints; give one"
                " each"
            )

    def n_parameters(self, robot: Robot) -> int:
        return 2 * len(self.joints)

    @determined_by_goal
    def reference(self, t: float) -> np.ndarray:
        return np.concatenate(evaluate_vector(self.name, self.goal, t))

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Ask for no way left from the chosen joints to the goal [rad or m]."""
        goals = ca.vertsplit(parameters[: len(self.joints)])
        ways = list[ca.SX]()
        for name, goal in zip(self.joints, goals, strict=True):
            ways.append(symbols.robot.joint(name).way(symbols.q, goal))
        return zero_residual(_column_of(ways))

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        axes = [symbols.robot.joint(name).idx_v for name in self.joints]
        error = self.residual(symbols, parameters).value
        rate = parameters[len(axes) :] + saturate(self.gain * error, self.saturation)
        return equality_rows(symbols.velocity_rows(axes), rate, {"posture_error": ca.norm_2(error)})


@checked_dataclass(eq=False)
class Manipulability(Task):
    """MU: the manipulability ``mu = sqrt(det(J J'))`` of the arm stays away from 0.

    J is the Jacobian of `frame` with the joints alone that move it; its rows raise `InvalidInput`
    where none does. Rate ``gain (target - mu)``. For six revolute joints mu is in [m^3].
    """

    equality: ClassVar[bool] = False
    symbolic_numbers: ClassVar[tuple[str, ...]] = ("gain", "target")
    name: str = "MU"
    task_class: TaskClass = TaskClass.PREREQUISITE
    frame: str = "tool"
    """Frame whose Jacobian has the manipulability."""
    gain: Positive = 0.1
    """[1/s] Rate that is asked for, per error."""
    target: Positive = 0.12
    """[unit of mu] value that the rate leads to."""
    activation: SmoothActivation = SmoothActivation(0.02, 0.05)
    """[unit of mu] activation falls over this range."""

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Bound the manipulability by the end of the activation."""
        return bounded_residual(manipulability(symbols, self.frame), lower=self.activation.end)

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        mu = self.residual(symbols, parameters).value
        return Rows(
            jacobian=_arm_gradient(symbols, mu),
            rate=self.gain * (self.target - mu),
            lower=self.gain * (self.activation.end - mu),
            upper=ca.SX(ca.inf),
            activation=self.activation.decreasing(mu),
            quantities={"manipulability": mu},
        )


def manipulability(symbols: TickSymbols, frame: str) -> ca.SX:
    """Compute ``sqrt(det(J J'))`` of the Jacobian (6, n) at `frame` of the joints that move it; of J' J
    where these are fewer than 6.

    Raises `InvalidInput` where no joint with a range moves it.
    """
    robot = symbols.robot
    J = symbols.kinematics.jacobian(frame)
    held_joints = limits.held_joints(robot.model, robot.joints)
    held_axes = [robot.joint(name).idx_v for name in held_joints]
    moving_axes = list[int]()
    for axis in range(robot.n_vehicle, robot.n_v):
        if axis not in held_axes and not J[:, axis].is_zero():
            moving_axes.append(axis)
    if not moving_axes:
        raise InvalidInput(
            f"manipulability of {frame!r}: no joint with a range moves it; give one on an arm, as"
            " its tool"
        )
    J = J[:, moving_axes]
    if J.shape[1] >= 6:
        gram = J @ J.T
    else:
        gram = J.T @ J
    pivots, _, _ = ca.ldl(gram + _SINGULAR * ca.SX.eye(gram.shape[0]), False)
    return ca.sqrt(ca.fmax(math.prod(ca.vertsplit(pivots), start=ca.SX(1)), 0) + _SINGULAR**2)


def _arm_gradient(symbols: TickSymbols, scalar: ca.SX) -> ca.SX:
    """Return row (1, n_v) of a scalar that depends on the joints of the arm: its rate per velocity,
    on the manifold of q.
    """
    q = symbols.q
    model = SymbolicModel(symbols.robot.model)
    v = ca.SX.sym("v", symbols.robot.n_v)
    steps = ca.substitute(ca.jacobian(model.integrate(q, v), v), v, ca.SX.zeros(symbols.robot.n_v))
    joints = symbols.robot.joint_q  # the rest of q may be an expression, as at a mean attitude
    row = ca.jacobian(scalar, q[joints]) @ steps[joints, :]
    row[:, symbols.robot.vehicle_v] = 0
    return row


def _column_of(entries: Iterable[ca.SX]) -> ca.SX:
    """Stack scalar expressions into a column (n,), also where there are none: (0, 1), and not
    CasADi's (0, 0).
    """
    return ca.vertcat(ca.SX(0, 1), *entries)

"""Joint tasks: joint limits (JL), tracking of a posture or trajectory (MP), manipulability (MU)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Robot, SymbolicModel, limits
from uvms_ocp.tasks.activation import SmoothActivation, approach_speed, saturate
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
    """[1/s]"""
    saturation: Positive = 0.5
    """[rad/s or m/s]"""

    def __post_init__(self) -> None:
        if not (self.guard >= 0 and self.guard + self.margin < 0.5):
            problem = f"{self.name}: margin = {self.margin}, guard = {self.guard}"
            raise InvalidInput(f"{problem}; give shares of the range, together below 0.5")

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Bounded joints inside their range [rad or m]."""
        joints = limits.bounded_joints(symbols.robot.joints, symbols.robot.limits)
        ranges = np.array([self._kept(low, up) for _, low, up in joints]).reshape(-1, 2)
        value = _column_of(joint.position(symbols.q) for joint, _, _ in joints)
        return Residual(value=value, lower=ranges[:, 0], upper=ranges[:, 1])

    def _kept(self, lower: float, upper: float) -> tuple[float, float]:
        """The range without the guard, which a joint with one limit has not."""
        guard = self.guard * (upper - lower) if np.isfinite([lower, upper]).all() else 0.0
        return lower + guard, upper - guard

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        joints = [
            bounded
            for bounded in limits.bounded_joints(symbols.robot.joints, symbols.robot.limits)
            if np.isfinite(bounded[1:]).all()
        ]
        rows = [self._joint_row(symbols, joint, lower, upper) for joint, lower, upper in joints]
        rate, lower, upper, activation, margin = (
            _column_of(row[k] for row in rows) for k in range(5)
        )
        return Rows(
            jacobian=symbols.velocity_rows([joint.idx_v for joint, _, _ in joints]),
            rate=rate,
            lower=lower,
            upper=upper,
            activation=activation,
            quantities={"margin": ca.mmin(margin)}
            if any(lower < upper for _, lower, upper in joints)
            else {},
        )

    def _joint_row(
        self, symbols: TickSymbols, joint: limits.Joint, lower: float, upper: float
    ) -> tuple[ca.SX, ...]:
        """Rate, lower, upper, activation and distance to the nearer limit of one joint."""
        q = joint.position(symbols.q)
        margin = self.margin * (upper - lower)
        if lower == upper:  # it is held there, also by solvers that know no limits of velocity
            rate = saturate(self.gain * (lower - q), self.saturation)
            return rate, rate, rate, ca.SX(1), ca.SX.inf()
        low, high = self._kept(lower, upper)
        bell_low = SmoothActivation(low, low + margin)
        bell_high = SmoothActivation(high - margin, high)
        back = ca.if_else(q < bell_low.end, bell_low.end - q, ca.fmin(bell_high.start - q, 0))
        return (
            saturate(self.gain * back, self.saturation),
            -self._approach(symbols, joint, q - low),
            self._approach(symbols, joint, high - q),
            bell_low.decreasing(q) + bell_high.increasing(q),
            ca.fmin(q - lower, upper - q),
        )

    def _approach(self, symbols: TickSymbols, joint: limits.Joint, distance: ca.SX) -> ca.SX:
        return approach_speed(
            distance,
            gain=self.gain,
            deceleration=float(symbols.robot.limits.acceleration[joint.idx_v]),
            dt=symbols.dt,
            saturation=self.saturation,
        )


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
    """Names."""
    goal: VectorGoal
    """(len(joints),) [rad or m]"""
    gain: Positive = 0.5
    """[1/s]"""
    saturation: Positive = 0.5
    """[rad/s or m/s]"""

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
        """The way of the chosen joints to the goal = 0 [rad or m]."""
        joints = [symbols.robot.joint(name) for name in self.joints]
        goals = ca.vertsplit(parameters[: len(joints)])
        return zero_residual(
            _column_of(
                joint.way(symbols.q, goal) for joint, goal in zip(joints, goals, strict=True)
            )
        )

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        joints = [symbols.robot.joint(name) for name in self.joints]
        error = self.residual(symbols, parameters).value
        rate = parameters[len(joints) :] + saturate(self.gain * error, self.saturation)
        return equality_rows(
            symbols.velocity_rows([joint.idx_v for joint in joints]),
            rate,
            {"posture_error": ca.norm_2(error)},
        )


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
    """[1/s]"""
    target: Positive = 0.12
    """[unit of mu] value that the rate leads to."""
    activation: SmoothActivation = SmoothActivation(0.02, 0.05)
    """[unit of mu] activation falls over this range."""

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Manipulability above the end of the activation."""
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
    """sqrt(det(J J')) of the Jacobian (6, n) at `frame` of the joints that move it; of J' J where
    these are fewer than 6.

    Raises `InvalidInput` where no joint with a range moves it.
    """
    robot = symbols.robot
    J = symbols.kinematics.jacobian(frame)
    held_axes = [robot.joint(name).idx_v for name in limits.held_joints(robot.model, robot.joints)]
    moving = [
        k for k in range(robot.n_vehicle, robot.n_v) if k not in held_axes and not J[:, k].is_zero()
    ]
    if not moving:
        raise InvalidInput(
            f"manipulability of {frame!r}: no joint with a range moves it; give one on an arm, as"
            " its tool"
        )
    J = J[:, moving]
    gram = J @ J.T if J.shape[1] >= 6 else J.T @ J
    pivots, _, _ = ca.ldl(gram + _SINGULAR * ca.SX.eye(gram.shape[0]), False)
    return ca.sqrt(ca.fmax(math.prod(ca.vertsplit(pivots), start=ca.SX(1)), 0) + _SINGULAR**2)


def _arm_gradient(symbols: TickSymbols, scalar: ca.SX) -> ca.SX:
    """Row (1, n_v) of a scalar that depends on the joints of the arm: its rate per velocity, on the
    manifold of q.
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
    """A column (n,) of scalar expressions, also where there are none: (0, 1), and not CasADi's (0,
    0).
    """
    return ca.vertcat(ca.SX(0, 1), *entries)

"""A problem of optimal control twice: as the package takes it, and as rows of its own for judges.

Judges read the rows of this file alone. Nothing in it comes from the package's terms, so that a
mistake in those is seen as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.ocp import OcpProblem, Trajectory
from uvms_ocp.robot import Robot
from uvms_ocp.robot.symbolic_model import SymbolicKinematics, SymbolicModel
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix

_UNLIMITED_TORQUE = 10.0  # [N m] unit of a torque without limit
_UNLIMITED_WRENCH = 100.0  # [N, N m] unit of a wrench that no thrusters make
_POWER_CORNER = 0.02  # share of the unit below which powers flatten out, as the guide says


@dataclass(frozen=True, kw_only=True, eq=False)
class Node:
    """Symbols of one node of the horizon, in which rows are written."""

    robot: Robot
    q: ca.SX
    """(n_q,) [m, rad]"""
    v: ca.SX
    """(n_v,) [m/s, rad/s]"""
    a: ca.SX
    """(n_v,) [m/s2, rad/s2]"""
    thrust: ca.SX
    """(n_thrust,) in shares of `Units.thrust`."""
    torque: ca.SX
    """(n_joints,) in shares of `Units.torque`."""
    t: ca.SX
    """(1,) [s]"""
    kinematics: SymbolicKinematics

    def pose(self, frame: str) -> tuple[ca.SX, ca.SX]:
        """R_WF (3, 3) and p_WF (3,) [m]."""
        return self.kinematics.pose(frame)


def node_symbols(robot: Robot, n_thrust: int) -> Node:
    """Make symbols for a robot whose vehicle is moved by `n_thrust` inputs."""
    q = ca.SX.sym("q", robot.n_q)
    return Node(
        robot=robot,
        q=q,
        v=ca.SX.sym("v", robot.n_v),
        a=ca.SX.sym("a", robot.n_v),
        thrust=ca.SX.sym("thrust", n_thrust),
        torque=ca.SX.sym("torque", robot.n_joints),
        t=ca.SX.sym("t"),
        kinematics=SymbolicModel(robot.model).forward_kinematics(q),
    )


RowsOf = Callable[[Node], ca.SX]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PathRows:
    """Rows that are to stay within a range all along."""

    name: str
    rows: RowsOf
    """Rows (m,) of a node."""
    lower: float = -np.inf
    """[unit of the row]"""
    upper: float = np.inf
    """[unit of the row]"""
    of_inputs: bool = False
    """The rows read accelerations or forces: they hold over the steps, not at the last node."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class EndRows:
    """Rows that are to be 0 at the end of a phase."""

    name: str
    rows: RowsOf
    """Rows (m,) of a node."""
    phase: int = -1
    """Number of the phase; -1 is the last."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Cost:
    """One cost: the integral of ``weight / 2 density`` over the nominal time of the horizon."""

    name: str
    density: RowsOf
    """(1,) of a node: a sum of squares, or a power."""
    weight: float = 1.0
    level: int = 0
    """Index among the levels of costs, the higher priority first."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ShapeRows:
    """Pairs of shapes that are to stay apart by margins all along."""

    geometry: pin.GeometryModel
    """Shapes of the robot and of the obstacles; its collision pairs are those that are kept
    apart. Solid: a closed surface stands as the solid that it encloses.
    """
    margins: np.ndarray
    """(n_pairs,) [m]"""
    moving: Mapping[str, Callable[[float], pin.SE3]] = field(default_factory=dict)
    """X_WO of obstacles that move at time t [s], by name."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Statement:
    """Rows and costs that a problem asks for, written for the judges."""

    path: tuple[PathRows, ...]
    ends: tuple[EndRows, ...]
    costs: tuple[Cost, ...]
    shapes: ShapeRows | None = None


# The forces that move a robot, in units of their own.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Units:
    """Matrix, units and limits of the inputs."""

    matrix: np.ndarray
    """(n_vehicle, n_thrust) wrench per input."""
    thrust: np.ndarray
    """(n_thrust,) [N, N m]"""
    thrust_lower: np.ndarray
    """(n_thrust,) in shares."""
    thrust_upper: np.ndarray
    """(n_thrust,) in shares."""
    torque: np.ndarray
    """(n_joints,) [N m, N]"""
    torque_limit: np.ndarray
    """(n_joints,) in shares, or infinite."""


@lru_cache(maxsize=64)
def units_of(robot: Robot, *, wrench: bool) -> Units:
    """Read the inputs of a robot, or those of a wrench on its vehicle."""
    n = robot.n_vehicle
    if wrench or not n:
        matrix = np.eye(n)
        lower = np.full(n, -np.inf)
        upper = np.full(n, np.inf)
    else:
        matrix = thruster_matrix(robot)[:n]
        lower, upper = thrust_limits(robot)
    unit = np.maximum(np.abs(lower), np.abs(upper))
    unit = np.where(np.isfinite(unit) & (unit > 0.0), unit, _UNLIMITED_WRENCH)
    effort = robot.limits.effort
    torque = np.where(np.isfinite(effort) & (effort > 0.0), effort, _UNLIMITED_TORQUE)
    return Units(
        matrix=matrix,
        thrust=unit,
        thrust_lower=lower / unit,
        thrust_upper=upper / unit,
        torque=torque,
        torque_limit=effort / torque,
    )


def n_thrust_of(problem: OcpProblem) -> int:
    """Number of inputs that move the vehicle."""
    return units_of_problem(problem).matrix.shape[1]


def units_of_problem(problem: OcpProblem) -> Units:
    """Inputs of the robot of a problem."""
    return units_of(problem.robot, wrench=problem.actuation.value == "wrench")


# Costs, as the guide states them.


def effort(node: Node) -> ca.SX:
    """Sum of squares of all inputs, in shares of their limits."""
    return ca.sumsqr(node.thrust) + ca.sumsqr(node.torque)


def smoothness(node: Node) -> ca.SX:
    """Sum of squares of all accelerations, in shares of their limits."""
    limit = node.robot.limits.acceleration
    unit = np.where(np.isfinite(limit) & (limit > 0.0), limit, 1.0)
    return ca.sumsqr(node.a / ca.DM(unit))


def duration(node: Node) -> ca.SX:
    """One: its integral is the time."""
    return ca.SX(1)


def electrical_power(node: Node) -> ca.SX:
    """Electrical power of thrusters and joints [kW], smooth at zero."""
    robot = node.robot
    units = units_of(robot, wrench=False)
    total = ca.SX(0)
    for k, thruster in enumerate(robot.description.thrusters):
        assert thruster.power is not None
        share = node.thrust[k] * units.thrust[k] / thruster.power.thrust
        total += thruster.power.watts / 1e3 * _smooth_power(share, thruster.power.exponent)
    for k in range(robot.n_joints):
        rate = node.v[robot.n_vehicle + k]
        torque = node.torque[k] * units.torque[k]
        total += _smooth_power(torque * rate / (1e3 * robot.description.joint_efficiency), 1.0)
    return total


def _smooth_power(x: ca.SX, exponent: float) -> ca.SX:
    """``|x|^exponent``, a parabola near zero."""
    return x**2 * (x**2 + _POWER_CORNER**2) ** (exponent / 2 - 1)


# A motion between its nodes.


def node_times(trajectory: Trajectory, per_step: int) -> np.ndarray:
    """(N per_step + 1,) [s] times of all nodes, and as many between them in every step."""
    steps = np.arange(len(trajectory.a) * per_step + 1) / per_step
    return np.interp(steps, np.arange(len(trajectory.t)), trajectory.t)

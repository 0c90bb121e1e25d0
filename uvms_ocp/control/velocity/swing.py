"""Tasks on top of a vehicle that swings: roll and pitch that no thruster drives.

A velocity that follows a free axis at its own frequency drives it: by feedback, which lags by a
quarter of a period, more than water damps it. So tasks are asked for at the attitude about which
the vehicle swings, and what it swings by is left to the joints alone, with a lead that damps it.
Where the arm leans out, the vehicle leans after it, by a load as much again: rows hold that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial

import casadi as ca
import numpy as np

from uvms_ocp.robot import Robot, SymbolicModel, dynamics, symbolic_bodies, thrusters
from uvms_ocp.robot.size import size
from uvms_ocp.tasks.approach_speed import ENDLESS, approach_speed, row_acceleration
from uvms_ocp.tasks.task import Rows, TickSymbols

N_PASSIVE = 4
"""Rotation of the vehicle from its mean (3,) [rad], 0 about driven axes; weight [N] at the tool
that the model does not know.
"""
_FREE = 6  # axes of a vehicle that can swing
# range of frequencies of a swing, of that of a pendulum as long as the robot's size
_SLOWEST = 0.05
_QUICKEST = 1.5
_LEAD = 0.5  # lead of the joints over the swing, share of its frequency
_MEMORY = 8.0  # time in which the mean of a swing is learnt, in radians of its phase
_JOINT_SHARE = 0.5  # share of the velocity limits of joints that may counter a swing
_SINGULAR = 0.05  # share of the largest lever of the joints below which they counter no row
_SOFT = 0.1  # share of the righting moment upright below which a lean is not followed any more
# [rad] lean that joints may bring about; from 0.9 on heavy loads in a current swing for ever
_LARGEST_LEAN = 0.7
_LEAN_GAIN = 0.3  # gain of the limit of lean, share of the swing's frequency
_NOTHING = 1e-12  # keeps divisions by nothing finite


def swinging_axes(robot: Robot) -> list[int]:
    """Return roll and pitch (3, 4), as far as no thruster drives them."""
    if robot.n_vehicle == _FREE:
        return [axis for axis in thrusters.undriven_axes(robot) if axis in (3, 4)]
    return []


def _swinging_motions(robot: Robot) -> ca.DM:
    """Return the `free_motions` about the swinging axes (n_v, n), each as quick as its rotation.

    That rotation is what swings, not the momentum in it: of that a vehicle has some that goes on
    steadily, and does not turn.
    """
    swinging = [thrusters.undriven_axes(robot).index(axis) for axis in swinging_axes(robot)]
    return symbolic_bodies.sparse(thrusters.free_motions(robot)[0][:, swinging])


@lru_cache(maxsize=8)
def swing_frequency(robot: Robot) -> float:
    """Return the slowest [rad/s] of the free axes upright with the arm stowed, within what can be
    countered.
    """
    axes = swinging_axes(robot)
    q = robot.configuration()
    M = dynamics.cached_dynamics(robot).mass_matrix(q)[np.ix_(axes, axes)]
    K = np.array(_balance(robot)(q, 0.0)[0])[:, axes]
    smallest_eigenvalue = np.linalg.eigvals(np.linalg.solve(M, K)).real.min()
    frequency = np.sqrt(max(smallest_eigenvalue, 0.0))
    pendulum = np.sqrt(np.linalg.norm(robot.model.gravity.linear) / size(robot.model))
    return float(np.clip(frequency, _SLOWEST * pendulum, _QUICKEST * pendulum))


def memory_time(robot: Robot) -> float:
    """Return the time [s] in which the mean attitude is learnt; infinite where nothing swings."""
    if swinging_axes(robot):
        return _MEMORY / swing_frequency(robot)
    return np.inf


def mean_attitude(symbols: TickSymbols, passive: ca.SX) -> TickSymbols:
    """Return the symbols at rest in the motions that swing, at their mean; passive (4,): see
    `N_PASSIVE`.
    """
    robot = symbols.robot
    axes = swinging_axes(symbols.robot)
    motions = _swinging_motions(robot)
    model = SymbolicModel(robot.model)
    velocity = symbols.velocity - motions @ symbols.velocity[axes]
    q = model.integrate(symbols.q, -motions @ _swing_angles(robot, passive))
    # As symbols, which tasks differentiate by, of endless joints too.
    q[robot.joint_q] = symbols.q[robot.joint_q]
    return replace(symbols, kinematics=model.forward_kinematics(q), q=q, velocity=velocity)


def countered_rows(
    rows: Rows, mean: Rows, symbols: TickSymbols, passive: ca.SX, lean: Lean
) -> Rows:
    """Return the rows of a task with its rates at the mean attitude, in which joints alone counter
    the swing.

    All joints counter the same share of it, so that what they cannot counter stays in phase with
    it. passive (4,): see `N_PASSIVE`; lean: result of `lean_of`.
    """
    robot = symbols.robot
    axes = swinging_axes(symbols.robot)
    free = rows.jacobian @ _swinging_motions(robot)
    J = ca.SX(rows.jacobian)
    J[:, axes] -= free
    if robot.n_joints:
        J[:, robot.n_vehicle :] += free @ lean.slope
    limit = ca.diag(ca.DM(np.minimum(robot.limits.velocity[robot.joint_v], ENDLESS)))
    arm = rows.jacobian[:, robot.n_vehicle :] @ limit
    lead = _LEAD * swing_frequency(robot) * _swing_angles(robot, passive)
    ahead = symbols.velocity[axes] - lead
    regularization = (_SINGULAR * ca.norm_fro(arm)) ** 2 + _NOTHING
    gram = arm @ arm.T + regularization * ca.SX.eye(rows.n_rows)
    joint_shares = -arm.T @ ca.solve(gram, free @ ahead)
    largest_joint_share: ca.SX | int = 1
    if robot.n_joints:
        largest_joint_share = ca.fmax(_JOINT_SHARE, ca.mmax(ca.fabs(joint_shares)))
    countered_rate = (
        J[:, robot.n_vehicle :] @ limit @ joint_shares * _JOINT_SHARE / largest_joint_share
    )
    return replace(
        rows,
        jacobian=J,
        rate=mean.rate + countered_rate,
        lower=mean.lower + countered_rate,
        upper=mean.upper + countered_rate,
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lean:
    """Configuration in which the free axes come to rest."""

    slope: ca.SX
    """(n_swinging, n_joints) [rad/rad or rad/m] change of the configuration by each joint."""
    offset: ca.SX
    """(n_swinging,) [rad] distance of the configuration from the mean attitude."""


def lean_of(symbols: TickSymbols, passive: ca.SX) -> Lean:
    """Return the lean at which weight, buoyancy and the weight at the tool balance, less where the
    vehicle hardly rights itself.

    symbols: result of `mean_attitude`; passive (4,): see `N_PASSIVE`.
    """
    robot = symbols.robot
    axes = swinging_axes(symbols.robot)
    slope, moment = _balance(robot)(symbols.q, passive[3])
    K = slope[:, axes]
    upright = np.array(_balance(robot)(robot.configuration(), 0.0)[0])[:, axes]
    regularization = (_SOFT * np.linalg.norm(upright)) ** 2 + _NOTHING
    gram = K @ K.T + regularization * ca.SX.eye(len(axes))
    moments = ca.horzcat(slope[:, robot.n_vehicle :], moment)
    lean = -K.T @ ca.solve(gram, moments)
    return Lean(slope=lean[:, :-1], offset=lean[:, -1])


def lean_rows(symbols: TickSymbols, lean: Lean) -> Rows:
    """Return rows that keep joints from leaning the vehicle farther than it rights itself.

    symbols: result of `mean_attitude`; lean: result of `lean_of`.
    """
    robot = symbols.robot
    axes = swinging_axes(symbols.robot)
    up = symbols.R_WB[2, :]
    roll = ca.atan2(up[1], up[2])
    pitch = ca.atan2(-up[0], up[2])
    angle = _swing_angles(robot, ca.vertcat(roll, pitch)) + lean.offset
    J = ca.horzcat(ca.SX(len(axes), robot.n_vehicle), lean.slope)
    bound = partial(
        approach_speed,
        gain=_LEAN_GAIN * swing_frequency(robot),
        deceleration=row_acceleration(J, robot.limits.acceleration),
        dt=symbols.dt,
        saturation=ENDLESS,
    )
    zeros = ca.SX.zeros(len(axes))
    return Rows(
        jacobian=J,
        rate=zeros,
        lower=-bound(_LARGEST_LEAN + angle),
        upper=bound(_LARGEST_LEAN - angle),
        activation=zeros,
    )


def _swing_angles(robot: Robot, angles: ca.SX) -> ca.SX:
    """Return the angles (n_swinging,) [rad] of the axes that swing, of roll and pitch first in
    `angles` [rad].
    """
    return angles[[axis - 3 for axis in swinging_axes(robot)]]


@lru_cache(maxsize=8)
def _balance(robot: Robot) -> ca.Function:
    """Make the function ``q (n_q,), weight [N] -> slope (n_swinging, n_v), moment (n_swinging,)`` of
    the moments about the free axes; weight: at the tool.
    """
    model = SymbolicModel(robot.model)
    axes = swinging_axes(robot)
    q = ca.SX.sym("q", robot.n_q)
    weight = ca.SX.sym("weight")
    step = ca.SX.sym("step", robot.n_v)
    moved = model.integrate(q, step)
    energy = dynamics.cached_dynamics(robot).symbolic.potential_energy(moved)
    if robot.tools:
        energy += weight * model.forward_kinematics(moved).pose(robot.tools[0])[1][2]
    moment = ca.jacobian(energy, step).T[axes]
    outputs = ca.substitute([ca.jacobian(moment, step), moment], [step], [ca.SX.zeros(robot.n_v)])
    return ca.Function("balance", [q, weight], ca.cse([ca.densify(x) for x in outputs]))

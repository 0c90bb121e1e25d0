"""Check the limits of a robot along a motion."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from uvms_ocp.ocp.motion_dynamics import axis_names, given_forces, required_forces
from uvms_ocp.ocp.motion_scan import Motion, QuantityRange, Samples, given_by_start, scanned
from uvms_ocp.ocp.range_check import RangeCheck, RangeKind
from uvms_ocp.ocp.trajectory import has_thrusters
from uvms_ocp.ocp.transcription.actuation import ActuationModel
from uvms_ocp.types import Array


def check_positions(motion: Motion) -> RangeCheck:
    """Check joint positions, which are parabolas over a step: their peaks are at their vertices."""
    robot = motion.robot
    path = motion.trajectory
    lower, upper = robot.configuration_bounds
    positions = robot.limited_positions
    axes: list[int] = []
    for joint in robot.joints:
        if joint.n_q == joint.n_v:
            axes += range(robot.n_v)[joint.v]
    names = axis_names(robot)
    scope = QuantityRange(
        kind=RangeKind.POSITION,
        name="joint limits",
        unit="m, rad",
        quantities=tuple(names[i] for i in axes),
        lower=lower[positions],
        upper=upper[positions],
    )
    nodes = path.q[:, positions]
    v = motion.leaving[:, axes]
    a = path.a[:, axes]
    h = motion.h[:, None]
    time_to_vertex = np.divide(-v, a, out=np.zeros_like(a), where=a != 0.0)
    s = np.clip(time_to_vertex, 0.0, h)
    below, above = scope.beyond(nodes[:-1] + s * v + s**2 / 2 * a)
    below_at_start, above_at_start = given_by_start(motion, scope, nodes[0])
    below[:1] -= below_at_start
    above[:1] -= above_at_start
    is_inside_step = (s > 0.0) & (s < h)
    return scope.checked(
        nodes=scope.peak(node_excess(motion, scope, nodes), path.t),
        slack=scope.inside(motion, np.arange(motion.N + 1), nodes),
        below=np.where(is_inside_step, below, 0.0),
        above=np.where(is_inside_step, above, 0.0),
        times=path.t[:-1, None] + s,
    )


def node_excess(motion: Motion, scope: QuantityRange, nodes: Array) -> Array:
    """Return the excess (N + 1, m) at the nodes, of a given start none."""
    excess = scope.excess(nodes)
    if motion.problem.fixed_start:
        excess[0] = 0.0
    return excess


def check_velocities(motion: Motion) -> RangeCheck:
    """Check velocities, which are straight lines over a step: their peaks are at its ends."""
    path = motion.trajectory
    limit = motion.robot.limits.velocity
    scope = QuantityRange(
        kind=RangeKind.VELOCITY,
        name="velocity limits",
        unit="m/s, rad/s",
        quantities=axis_names(motion.robot),
        lower=-limit,
        upper=limit,
    )
    below, above = scope.beyond(path.v[:-1] + motion.h[:, None] * path.a)
    return scope.checked(
        nodes=scope.peak(node_excess(motion, scope, path.v), path.t),
        slack=scope.inside(motion, np.arange(motion.N + 1), path.v),
        below=below,
        above=above,
        times=np.broadcast_to(path.t[1:, None], below.shape),
    )


def check_accelerations(motion: Motion) -> RangeCheck:
    """Check accelerations, which are constant over each step."""
    limit = motion.robot.limits.acceleration
    scope = QuantityRange(
        kind=RangeKind.ACCELERATION,
        name="acceleration limits",
        unit="m/s2, rad/s2",
        quantities=axis_names(motion.robot),
        lower=-limit,
        upper=limit,
    )
    return scope.of_nodes(motion, motion.trajectory.a, motion.trajectory.t[:-1])


def check_forces(motion: Motion) -> list[RangeCheck]:
    """Check thrust and torque. Inside a step thrust is that of the plan, with the least that makes
    up for what the motion takes there more or less than at its middle; joints have what it takes.
    """
    robot = motion.robot
    path = motion.trajectory
    n = robot.n_vehicle
    actuators = ActuationModel(robot, motion.problem.actuation)
    spread = actuators.thrust_unit[:, None] * actuators.spread
    if has_thrusters(motion.problem):
        thrusters = tuple(thruster.name for thruster in robot.description.thrusters)
    else:
        thrusters = axis_names(robot)[:n]
    thrust = QuantityRange(
        kind=RangeKind.THRUST,
        name="thrust limits",
        unit="N",
        quantities=thrusters,
        lower=actuators.thrust_lower * actuators.thrust_unit,
        upper=actuators.thrust_upper * actuators.thrust_unit,
    )
    effort = robot.limits.effort
    torque = QuantityRange(
        kind=RangeKind.TORQUE,
        name="torque limits",
        unit="N m, N",
        quantities=axis_names(robot)[n:],
        lower=-effort,
        upper=effort,
    )
    planned = given_forces(motion)

    @lru_cache(maxsize=4)
    def required(samples: Samples) -> Array:
        return required_forces(motion, *samples.flat).reshape(*samples.t.shape, -1)

    def thrusts(samples: Samples) -> Array:
        more = required(samples)[..., :n] - planned[samples.steps, None, :n]
        return np.asarray(path.thrust[samples.steps, None] + more @ spread.T)

    def torques(samples: Samples) -> Array:
        return required(samples)[..., n:]

    middles = path.t[:-1] + motion.h / 2
    all_steps = np.arange(motion.N)
    checks = []
    for scope, rows, at_middles in (
        (thrust, thrusts, path.thrust),
        (torque, torques, path.torque),
    ):
        if not np.isfinite([*scope.lower, *scope.upper]).any():
            continue
        peak = scope.peak(scope.excess(at_middles), middles)
        checks.append(scanned(motion, scope, rows, peak, all_steps, inputs=True))
    return checks

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
    """Parabolas: their peaks are at their vertices."""
    robot = motion.robot
    path = motion.trajectory
    lower, upper = robot.configuration_bounds
    joints = [joint for joint in robot.joints if joint.n_q == joint.n_v]
    places = robot.limited_positions
    axes = np.array([i for joint in joints for i in range(*joint.v.indices(robot.n_v))], dtype=int)
    names = axis_names(robot)
    scope = QuantityRange(
        kind=RangeKind.POSITION,
        name="joint limits",
        unit="m, rad",
        quantities=tuple(names[i] for i in axes),
        lower=lower[places],
        upper=upper[places],
    )
    nodes = path.q[:, places]
    speed = motion.leaving[:, axes]
    a = path.a[:, axes]
    h = motion.h[:, None]
    turn = np.clip(np.divide(-speed, a, out=np.zeros_like(a), where=a != 0.0), 0.0, h)
    under, over = scope.beyond(nodes[:-1] + turn * speed + turn**2 / 2 * a)
    inside = (turn > 0.0) & (turn < h)
    own = given_by_start(motion, scope, nodes[0])
    under[:1] -= own[0]
    over[:1] -= own[1]
    return scope.checked(
        nodes=scope.peak(node_excess(motion, scope, nodes), path.t),
        slack=scope.inside(motion, np.arange(motion.N + 1), nodes),
        below=np.where(inside, under, 0.0),
        above=np.where(inside, over, 0.0),
        times=path.t[:-1, None] + turn,
    )


def node_excess(motion: Motion, scope: QuantityRange, nodes: Array) -> Array:
    """(N + 1, m) Excess at the nodes, of a given start none."""
    excess = scope.excess(nodes)
    if motion.problem.fixed_start:
        excess[0] = 0.0
    return excess


def check_velocities(motion: Motion) -> RangeCheck:
    """Straight lines: their peaks are at the ends of steps."""
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
    under, over = scope.beyond(path.v[:-1] + motion.h[:, None] * path.a)
    return scope.checked(
        nodes=scope.peak(node_excess(motion, scope, path.v), path.t),
        slack=scope.inside(motion, np.arange(motion.N + 1), path.v),
        below=under,
        above=over,
        times=np.broadcast_to(path.t[1:, None], under.shape),
    )


def check_accelerations(motion: Motion) -> RangeCheck:
    """Constant over each step."""
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
    """Inside a step the plan's thrust, with the least that makes up for what the motion takes there
    more or less than at its middle; joints have what it takes.
    """
    robot = motion.robot
    path = motion.trajectory
    n = robot.n_vehicle
    actuators = ActuationModel(robot, motion.problem.actuation)
    spread = actuators.thrust_unit[:, None] * actuators.spread
    middles = path.t[:-1] + motion.h / 2
    every = np.arange(motion.N)
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

    return [
        scanned(
            motion,
            scope,
            rows,
            scope.peak(scope.excess(given), middles),
            every,
            inputs=True,
        )
        for scope, rows, given in (
            (thrust, thrusts, path.thrust),
            (torque, torques, path.torque),
        )
        if np.isfinite([*scope.lower, *scope.upper]).any()
    ]

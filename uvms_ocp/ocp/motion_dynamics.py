"""Check the ends of a motion, and that forces move it from node to node."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.motion_scan import Motion, QuantityRange
from uvms_ocp.ocp.problem import Integrator
from uvms_ocp.ocp.range_check import RangeCheck, RangeKind
from uvms_ocp.ocp.transcription.actuation import ActuationModel
from uvms_ocp.robot import Robot
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.robot.thrusters import AXES
from uvms_ocp.types import Array, Indices


def check_dynamics(motion: Motion) -> list[RangeCheck]:
    problem = motion.problem
    path = motion.trajectory
    robot = motion.robot
    state = axis_names(robot)
    speeds = tuple(f"velocity of {name}" for name in state)
    moved = _arrivals(motion)
    defects = np.array(
        [pin.difference(robot.model, *pair) for pair in zip(moved, path.q[1:], strict=True)]
    )
    gained = path.v[1:] - path.v[:-1] - motion.h[:, None] * path.a
    none = np.zeros(2 * robot.n_v)
    law = QuantityRange(
        kind=RangeKind.MOTION,
        name="motion",
        unit="m, rad, m/s, rad/s",
        quantities=(*state, *speeds),
        lower=none,
        upper=none,
    )
    forces = QuantityRange(
        kind=RangeKind.FORCES,
        name="forces",
        unit="N, N m",
        quantities=state,
        lower=none[: robot.n_v],
        upper=none[: robot.n_v],
    )
    h = motion.h[:, None]
    if problem.integrator is Integrator.EULER:
        q = path.q[:-1]
        v = path.v[:-1]
    else:
        middle = h / 2 * path.v[:-1] + h**2 / 8 * path.a + _bracket(motion, h / 2)
        q = np.array(
            [pin.integrate(robot.model, *pair) for pair in zip(path.q, middle, strict=False)]
        )
        v = path.v[:-1] + h / 2 * path.a
    lacking = required_forces(motion, np.arange(motion.N), q, v) - given_forces(motion)
    times = path.t[1:]
    return [
        law.of_nodes(motion, np.hstack([defects.reshape(gained.shape), gained]), times),
        forces.of_nodes(motion, lacking, path.t[:-1] + motion.h / 2),
    ]


def _arrivals(motion: Motion) -> list[Array]:
    """(N, n_q) Where the integrator of the problem leads from every node."""
    path = motion.trajectory
    h = motion.h[:, None]
    share = 1.0 if motion.problem.integrator is Integrator.EULER else 0.5
    ways = h * path.v[:-1] + share * h**2 * path.a + _bracket(motion, h)
    return [
        pin.integrate(motion.robot.model, *pair) for pair in zip(path.q[:-1], ways, strict=True)
    ]


def _bracket(motion: Motion, h: Array) -> Array:
    """(N, n_v) What `Integrator.MAGNUS` adds to a step of h (N, 1) [s]."""
    path = motion.trajectory
    result = np.zeros_like(path.a)
    if motion.problem.integrator is Integrator.MAGNUS and motion.robot.n_vehicle:
        v = path.v[:-1, :6]
        a = path.a[:, :6]
        linear = np.cross(v[:, 3:], a[:, :3]) + np.cross(v[:, :3], a[:, 3:])
        result[:, :6] = h**3 / 12 * np.hstack([linear, np.cross(v[:, 3:], a[:, 3:])])
    return result


def required_forces(motion: Motion, steps: Indices, q: Array, v: Array) -> Array:
    """(n, n_v) [N, N m] Forces that the accelerations of steps (n,) take at q (n, n_q), v (n, n_v)."""
    problem = motion.problem
    function = _inverse_dynamics(problem.robot, problem.water)
    n_links = function.size2_in(3)
    water = np.repeat(problem.currents[steps], n_links, axis=0).T
    forces = function(q.T, v.T, motion.trajectory.a[steps].T, water, np.zeros_like(water))
    return np.asarray(forces.full().T)


@lru_cache(maxsize=8)
def _inverse_dynamics(robot: Robot, water: bool) -> ca.Function:
    if water:
        model = cached_dynamics(robot).symbolic
    else:
        model = SymbolicDynamics(model=robot.model)
    return model.function("inverse_dynamics")


def given_forces(motion: Motion) -> Array:
    """(N, n_v) [N, N m]"""
    path = motion.trajectory
    actuators = ActuationModel(motion.robot, motion.problem.actuation)
    return np.hstack([path.thrust @ actuators.matrix.T, path.torque])


def axis_names(robot: Robot) -> tuple[str, ...]:
    joints = [
        joint.name if joint.n_v == 1 else f"{joint.name}[{i}]"
        for joint in robot.joints
        for i in range(joint.n_v)
    ]
    return (*AXES[: robot.n_vehicle], *joints)


def check_ends(motion: Motion) -> list[RangeCheck]:
    problem = motion.problem
    path = motion.trajectory
    model = motion.robot.model
    state = (*(f"axis {i}" for i in range(2 * motion.robot.n_v)),)
    freedom = problem.start_freedom
    if freedom is None:
        width = np.zeros(len(state))
    else:
        width = np.asarray(freedom, dtype=float)
    first = (path.q[0], path.v[0])
    given = (problem.start.q, problem.start.v)
    start = QuantityRange(
        kind=RangeKind.START,
        name="start",
        unit="m, rad, m/s, rad/s",
        quantities=state,
        lower=-width,
        upper=width,
    )
    checks = [start.of_nodes(motion, _difference(model, given, first)[None], path.t[:1])]
    if problem.periodic:
        none = np.zeros(len(state))
        closed = QuantityRange(
            kind=RangeKind.PERIODIC,
            name="periodic",
            unit="m, rad, m/s, rad/s",
            quantities=state,
            lower=none,
            upper=none,
        )
        last = (path.q[-1], path.v[-1])
        checks.append(closed.of_nodes(motion, _difference(model, first, last)[None], path.t[-1:]))
    return [*checks, _durations(motion)]


def _difference(model: pin.Model, one: tuple[Array, Array], other: tuple[Array, Array]) -> Array:
    """(2 n_v,) from one state to another."""
    return np.concatenate([pin.difference(model, one[0], other[0]), other[1] - one[1]])


def _durations(motion: Motion) -> RangeCheck:
    problem = motion.problem
    t = motion.trajectory.t
    lengths = np.diff(t[problem.starts_of_phases()])
    lower, upper = np.transpose([phase.range for phase in problem.phases])
    scope = QuantityRange(
        kind=RangeKind.DURATION,
        name="duration",
        unit="s",
        quantities=(*(phase.name for phase in problem.phases), "all phases"),
        lower=np.append(lower, 0.0),
        upper=np.append(upper, problem.longest if problem.free_time else np.inf),
    )
    return scope.of_nodes(motion, np.append(lengths, t[-1] - t[0])[None], t[-1:])

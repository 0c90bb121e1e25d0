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
    """Check that every node is where the one before leads, and that thrust and torque are the
    forces that the motion takes.
    """
    path = motion.trajectory
    n_v = motion.robot.n_v
    axes = axis_names(motion.robot)
    law_of_motion = QuantityRange(
        kind=RangeKind.MOTION,
        name="motion",
        unit="m, rad, m/s, rad/s",
        quantities=(*axes, *(f"velocity of {name}" for name in axes)),
        lower=np.zeros(2 * n_v),
        upper=np.zeros(2 * n_v),
    )
    balance_of_forces = QuantityRange(
        kind=RangeKind.FORCES,
        name="forces",
        unit="N, N m",
        quantities=axes,
        lower=np.zeros(n_v),
        upper=np.zeros(n_v),
    )
    middles = path.t[:-1] + motion.h / 2
    return [
        law_of_motion.of_nodes(motion, _defects(motion), path.t[1:]),
        balance_of_forces.of_nodes(motion, _missing_forces(motion), middles),
    ]


def _defects(motion: Motion) -> Array:
    """Return by how much each node is off where the one before leads (N, 2 n_v)."""
    path = motion.trajectory
    model = motion.robot.model
    pairs = zip(_arrivals(motion), path.q[1:], strict=True)
    q_defects = np.array([pin.difference(model, arrival, q) for arrival, q in pairs])
    v_defects = path.v[1:] - path.v[:-1] - motion.h[:, None] * path.a
    return np.hstack([q_defects.reshape(v_defects.shape), v_defects])


def _missing_forces(motion: Motion) -> Array:
    """Return the forces (N, n_v) [N, N m] that the motion takes beyond those of the actuators."""
    path = motion.trajectory
    h = motion.h[:, None]
    if motion.problem.integrator is Integrator.EULER:
        q = path.q[:-1]
        v = path.v[:-1]
    else:
        half_ways = h / 2 * path.v[:-1] + h**2 / 8 * path.a + _bracket(motion, h / 2)
        q = _moved(motion, half_ways)
        v = path.v[:-1] + h / 2 * path.a
    return required_forces(motion, np.arange(motion.N), q, v) - given_forces(motion)


def _arrivals(motion: Motion) -> Array:
    """Return the configurations (N, n_q) to which the integrator of the problem leads from every
    node.
    """
    path = motion.trajectory
    h = motion.h[:, None]
    share = 1.0 if motion.problem.integrator is Integrator.EULER else 0.5
    return _moved(motion, h * path.v[:-1] + share * h**2 * path.a + _bracket(motion, h))


def _moved(motion: Motion, ways: Array) -> Array:
    """Return the configurations (N, n_q) at the end of ways (N, n_v) from the nodes."""
    model = motion.robot.model
    starts = motion.trajectory.q[:-1]
    return np.array([pin.integrate(model, q, way) for q, way in zip(starts, ways, strict=True)])


def _bracket(motion: Motion, h: Array) -> Array:
    """Return what `Integrator.MAGNUS` adds (N, n_v) to a step of h (N, 1) [s]."""
    path = motion.trajectory
    result = np.zeros_like(path.a)
    if motion.problem.integrator is Integrator.MAGNUS and motion.robot.n_vehicle:
        v = path.v[:-1, :6]
        a = path.a[:, :6]
        linear = np.cross(v[:, 3:], a[:, :3]) + np.cross(v[:, :3], a[:, 3:])
        result[:, :6] = h**3 / 12 * np.hstack([linear, np.cross(v[:, 3:], a[:, 3:])])
    return result


def required_forces(motion: Motion, steps: Indices, q: Array, v: Array) -> Array:
    """Return the forces (n, n_v) [N, N m] that the accelerations of steps (n,) take at q (n, n_q) and
    v (n, n_v).
    """
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
    """Return the forces (N, n_v) [N, N m] of thrust and torque."""
    path = motion.trajectory
    actuators = ActuationModel(motion.robot, motion.problem.actuation)
    return np.hstack([path.thrust @ actuators.matrix.T, path.torque])


def axis_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of all axes (n_v,): those of the vehicle, then joints."""
    names = [*AXES[: robot.n_vehicle]]
    for joint in robot.joints:
        if joint.n_v == 1:
            names.append(joint.name)
        else:
            names += [f"{joint.name}[{i}]" for i in range(joint.n_v)]
    return tuple(names)


def check_ends(motion: Motion) -> list[RangeCheck]:
    """Check the first and the last state, and durations."""
    problem = motion.problem
    path = motion.trajectory
    model = motion.robot.model
    state = tuple(f"axis {i}" for i in range(2 * motion.robot.n_v))
    freedom = problem.start_freedom
    if freedom is None:
        width = np.zeros(len(state))
    else:
        width = np.asarray(freedom, dtype=float)
    first = (path.q[0], path.v[0])
    required_first = (problem.start.q, problem.start.v)
    start = QuantityRange(
        kind=RangeKind.START,
        name="start",
        unit="m, rad, m/s, rad/s",
        quantities=state,
        lower=-width,
        upper=width,
    )
    checks = [start.of_nodes(motion, _difference(model, required_first, first)[None], path.t[:1])]
    if problem.periodic:
        zeros = np.zeros(len(state))
        closed = QuantityRange(
            kind=RangeKind.PERIODIC,
            name="periodic",
            unit="m, rad, m/s, rad/s",
            quantities=state,
            lower=zeros,
            upper=zeros,
        )
        last = (path.q[-1], path.v[-1])
        checks.append(closed.of_nodes(motion, _difference(model, first, last)[None], path.t[-1:]))
    return [*checks, _durations(motion)]


def _difference(model: pin.Model, first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Return the way (2 n_v,) from one state, q and v, to another."""
    first_q, first_v = first
    second_q, second_v = second
    return np.concatenate([pin.difference(model, first_q, second_q), second_v - first_v])


def _durations(motion: Motion) -> RangeCheck:
    """Check how long phases last, and all of them together."""
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

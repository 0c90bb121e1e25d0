"""Trajectories of states and inputs, and guesses for the optimiser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_dataclass, replace_unchecked, unchecked_constructor
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.problem import Actuation, OcpProblem
from uvms_ocp.robot import State, Water, thrusters
from uvms_ocp.robot.dynamics import Dynamics, cached_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.types import Indices, Shape, read_only

COARSE_STEPS = 8
_POSTURES = 16  # postures from which a search begins, beside that of the start

TOLERANCE = 1e-4
"""[m, rad] violation of limits of positions that counts as none: ten times that of solvers."""


@checked_dataclass(eq=False)
class Trajectory:
    """States at nodes and inputs of steps."""

    t: np.ndarray
    """(N + 1,) [s] times of the nodes."""
    q: np.ndarray
    """(N + 1, n_q) [m, rad] configurations at the nodes."""
    v: np.ndarray
    """(N + 1, n_v) [m/s, rad/s] velocities at the nodes."""
    a: np.ndarray
    """(N, n_v) [m/s2, rad/s2] constant over each step."""
    thrust: np.ndarray
    """(N, n_thrusters) [N] thrust at the middle of each step; with `Actuation.WRENCH` the wrench
    (N, n_vehicle) [N, N m].
    """
    torque: np.ndarray
    """(N, n_joints) [N m or N] torques of the joints over each step."""
    of_wrench: bool = False
    """`thrust` is the wrench of `Actuation.WRENCH`, whose electrical power no one knows."""

    @property
    def has_wrench(self) -> bool:
        """Check whether a wrench pushes; none pushes a fixed base, whatever its actuation."""
        return self.of_wrench and self.thrust.shape[1] > 0

    def state_at(self, model: pin.Model, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q, v and a at time t [s]; the end is held. Every step ends in the configuration of
        the next node.
        """
        if t >= self.t[-1]:
            return self.q[-1], self.v[-1], np.zeros_like(self.v[-1])
        k = int(intervals_of(self.t, t))
        s = t - self.t[k]
        a = self.a[k]
        way = s * self.leaving(model, k) + s * s / 2 * a
        return pin.integrate(model, self.q[k], way), self.v[k] + s * a, a

    def leaving(self, model: pin.Model, k: int) -> np.ndarray:
        """Return the velocity (n_v,) [m/s, rad/s] at the beginning of step k with which it ends at
        the next node.

        That of the node with `Integrator.MIDPOINT`; others make something else of it. Raises
        `InvalidInput` for no step.
        """
        if not 0 <= k < len(self.a):
            raise InvalidInput(f"k = {k}; give a step of this trajectory, 0 to {len(self.a) - 1}")
        h = self.t[k + 1] - self.t[k]
        way = pin.difference(model, self.q[k], self.q[k + 1])
        return _leaving(h, way, self.a[k])

    def states_at(
        self, model: pin.Model, t: Annotated[np.ndarray, Shape("n")]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q (n, n_q) and v (n, n_v) at times t (n,) [s], and the steps that hold them (n,);
        the end is held.
        """
        steps = intervals_of(self.t, t)
        s = (t - self.t[steps])[:, None]
        v = self.v[steps]
        a = self.a[steps]
        h = (self.t[steps + 1] - self.t[steps])[:, None]
        ways = []
        for k in steps.tolist():
            ways.append(pin.difference(model, self.q[k], self.q[k + 1]))
        leaving = _leaving(h, np.array(ways).reshape(v.shape), a)
        ways_so_far = s * leaving + s * s / 2 * a
        q = self.q[steps]
        reached = [pin.integrate(model, *pair) for pair in zip(q, ways_so_far, strict=True)]
        q = np.array(reached).reshape(q.shape)
        v = v + s * a
        is_over = t >= self.t[-1]
        q[is_over] = self.q[-1]
        v[is_over] = self.v[-1]
        return q, v, steps


unchecked_trajectory = unchecked_constructor(Trajectory)
"""Construct a `Trajectory` without a look at its arguments, of arrays that belong to it."""


def _leaving(h: float | np.ndarray, way: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return the velocity with which the constant acceleration a leads along a way in the time
    h.
    """
    return np.asarray(way / h - h / 2 * a)


def intervals_of(times: np.ndarray, t: np.ndarray | float) -> Indices:
    """Return the interval between times (m + 1,) [s] that holds each time t (n,) [s], or one of
    them; the first or last outside.
    """
    return np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)


@checked
def hold_guess(problem: OcpProblem, start: State | None = None) -> Trajectory:
    """Guess: stay at the start of the problem or at another one, at rest."""
    robot = problem.robot
    t = problem.nominal_times()
    state = start or problem.start
    n = len(t)
    n_thrust = len(robot.description.thrusters) if has_thrusters(problem) else robot.n_vehicle
    return Trajectory(
        t=t,
        q=np.tile(state.q, (n, 1)),
        v=np.zeros((n, robot.n_v)),
        a=np.zeros((n - 1, robot.n_v)),
        thrust=np.zeros((n - 1, n_thrust)),
        torque=np.zeros((n - 1, robot.n_joints)),
        of_wrench=not has_thrusters(problem),
    )


def shift_guess(problem: OcpProblem, last: Trajectory, delay: float, start: State) -> Trajectory:
    """Guess from a solution that is `delay` [s] old: the same motion seen from `start`, its end
    held.
    """
    t = problem.nominal_times()
    q, v, steps = last.states_at(problem.robot.model, t + delay)
    q[0] = start.q
    v[0] = start.v
    steps = steps[:-1]
    return Trajectory(
        t=t,
        q=q,
        v=v,
        a=last.a[steps],
        thrust=last.thrust[steps],
        torque=last.torque[steps],
        of_wrench=last.of_wrench,
    )


@checked
def guess_through(
    problem: OcpProblem,
    times: Annotated[np.ndarray, Shape("n")],
    configurations: Annotated[np.ndarray, Shape("n", "problem.robot.n_q")],
) -> Trajectory:
    """Guess through configurations (n, n_q) [m, rad] at `times` (n,) [s]: a rollout of the
    hierarchy, or a minimum-snap path.

    Resampled at the nodes on the manifold, with velocities by differences and the forces that the
    motion takes. Of the two quaternions of an attitude each node has the one nearer to that before
    it, from the start of the problem on: solvers that work on their four numbers would turn by 360
    deg between the two. Raises `InvalidInput` for times that do not increase.
    """
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise InvalidInput("guess: times must increase and number at least two")
    model = problem.robot.model
    t = problem.nominal_times()
    q = np.array([_between(model, times, configurations, moment) for moment in t])
    if problem.robot.n_vehicle:
        quaternion_before = problem.start.q[3:7]
        for configuration in q:
            quaternion = configuration[3:7]
            if quaternion_before @ quaternion < 0.0:
                quaternion *= -1.0
            quaternion_before = quaternion
    h = np.diff(t)
    mean_velocities = []
    for k in range(len(h)):
        mean_velocities.append(pin.difference(model, q[k], q[k + 1]) / h[k])
    mean = np.array(mean_velocities)
    v = np.vstack([problem.start.v, (mean[:-1] + mean[1:]) / 2, mean[-1]])
    a = np.diff(v, axis=0) / h[:, None]
    forces = _forces(problem, q, v, a)
    n = problem.robot.n_vehicle
    return Trajectory(
        t=t,
        q=q,
        v=v,
        a=a,
        thrust=_thrust(problem, forces[:, :n]),
        torque=forces[:, n:],
        of_wrench=not has_thrusters(problem),
    )


def _between(
    model: pin.Model, times: np.ndarray, configurations: np.ndarray, t: float
) -> np.ndarray:
    """Return the configuration (n_q,) at time t [s] between those at times (n,) [s]."""
    k = int(intervals_of(times, t))
    share = float(np.clip((t - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0))
    return np.asarray(pin.interpolate(model, configurations[k], configurations[k + 1], share))


def _forces(problem: OcpProblem, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return the generalised forces (N, n_v) [N, N m] that a motion takes."""
    # With memory that it shares with no other, as threads plan at a time.
    dynamics = Dynamics(cached_dynamics(problem.robot).symbolic)
    forces = []
    for k in range(len(a)):
        water = Water(velocity=problem.currents[k])
        forces.append(dynamics.inverse_dynamics(q[k], v[k], a[k], water))
    return np.array(forces)


def _thrust(problem: OcpProblem, wrench: np.ndarray) -> np.ndarray:
    """Allocate a wrench (N, n_vehicle) [N, N m] to thrusters within their limits."""
    if not has_thrusters(problem):
        return wrench
    lower, upper = thrusters.thrust_limits(problem.robot)
    allocation = np.linalg.pinv(thrusters.thruster_matrix(problem.robot))
    return np.clip(wrench @ allocation.T, lower, upper)


def has_thrusters(problem: OcpProblem) -> bool:
    """Check whether `thrust` is that of thrusters; else it is a wrench on the vehicle, or nothing
    on a fixed base.
    """
    return bool(problem.robot.n_vehicle) and problem.actuation is Actuation.THRUSTERS


def coarse_problem(problem: OcpProblem) -> OcpProblem:
    """Return the same problem over a few steps, in the mean of its currents.

    Over a few steps motions take little time, and which of them costs least there mostly does so
    over many.
    """
    share = COARSE_STEPS / problem.n_steps
    phases = []
    for phase in problem.phases:
        n_steps = max(1, round(share * phase.n_steps))
        phases.append(replace(phase, n_steps=n_steps))
    return replace(problem, phases=tuple(phases), current=problem.mean_current)


def coarse_guesses(problem: OcpProblem) -> Iterator[Trajectory]:
    """Guess where a search begins: hold the start, then move the joints straight to postures that
    fill their ranges evenly, by a Kronecker sequence.

    Arms reach a goal in several postures, and no descent leads from one to another. Every second
    guess goes half the way: most goals are reached in a posture near that of the start.
    """
    hold = hold_guess(problem)
    robot = problem.robot
    lower, upper = robot.configuration_bounds
    joints = np.flatnonzero(np.isfinite(upper - lower))
    yield hold
    n = len(joints)
    if n == 0:
        return
    along = np.linspace(0.0, 1.0, problem.n_steps + 1)
    ratio = np.roots([1.0, *np.zeros(n - 1), -1.0, -1.0]).real.max()
    for k in range(1, 1 + _POSTURES):
        q = problem.start.q.copy()
        shares = (0.5 + k * ratio ** -np.arange(1.0, 1 + n)) % 1.0
        target = lower[joints] + shares * (upper - lower)[joints]
        part_of_way = 1.0 if k % 2 else 0.5
        q[joints] += part_of_way * (target - q[joints])
        path = [pin.interpolate(robot.model, hold.q[0], q, share) for share in along]
        yield replace(hold, q=np.array(path))


def admissible(trajectory: Trajectory, robot: Robot) -> Trajectory:
    """Normalise quaternions and put joints inside their limits, where an optimiser has kept these
    to its tolerance.

    Numbers that are not finite stay so, and joints that are farther outside.
    """
    q = admissible_configurations(robot, trajectory.q, TOLERANCE)
    return replace_unchecked(trajectory, q=read_only(q))


def admissible_configurations(robot: Robot, q: np.ndarray, tolerance: float = np.inf) -> np.ndarray:
    """Return q (n, n_q) [m, rad] with unit quaternions, and joints inside limits that they pass by
    `tolerance` [m, rad] or less.
    """
    rows = []
    for row in q:
        is_finite = bool(np.isfinite(row).all())
        rows.append(pin.normalize(robot.model, row) if is_finite else row)
    unit = np.array(rows)
    with np.errstate(invalid="ignore"):  # rows that are not finite
        inside = np.clip(unit, *robot.configuration_bounds)
        return np.where(np.abs(inside - unit) <= tolerance, inside, unit)

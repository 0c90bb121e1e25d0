"""Check a motion against its problem, at the nodes and between them, by these two alone.

Nothing of a solver is known here: no transcription, planes, scalings or multipliers. What the
motion is between nodes is what `Trajectory.state_at` says. Of each kind of range it is found by how
much it is left, where and when:

- joint positions are parabolas over a step and velocities straight lines: their peaks are exact;
- forces are those of inverse dynamics at the state between the nodes, and rows of terms those of
  the term there: looked at densely, and more closely where they come near their range;
- shapes and the links among themselves are measured by coal, and no point of them moves faster than
  its reach: intervals are halved until that excludes more than `FINE`, or are too short.

What a start that is given breaks by itself is no fault of the motion: in the first step only what
goes beyond it counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property, lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import unchecked_method
from uvms_ocp.ocp.clearance_certificate import SteppedMotion
from uvms_ocp.ocp.problem import Integrator, OcpPhase, OcpProblem, counts
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.ocp.trajectory import Trajectory, has_thrusters
from uvms_ocp.ocp.transcription.stage import ActuationModel, altimeter_range
from uvms_ocp.robot import Robot, SymbolicModel
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.kinematics import largest_change
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.tasks.task import Residual, TickSymbols
from uvms_ocp.types import Array, Indices

FINE = 2e-4
"""[unit of the quantity] By how much more a range may be left unseen before a step is looked at more
closely.
"""
_LOOKS = 4  # at each step, at least, to begin with
_ALL_LOOKS = 128  # at all steps together, at least, to begin with
_CLOSER = (1, 4, 16)  # times as many looks, where the range is near
_SHORTEST = 128  # share of a step below which an interval is not halved, for shapes


class RangeKind(Enum):
    """What has a range."""

    START = "start"
    PERIODIC = "periodic"
    DURATION = "duration"
    MOTION = "motion"
    """The next node is where the acceleration leads."""
    FORCES = "forces"
    """Thrust and torque at the middle of a step are those that the motion takes."""
    POSITION = "position limits"
    VELOCITY = "velocity limits"
    ACCELERATION = "acceleration limits"
    THRUST = "thrust limits"
    TORQUE = "torque limits"
    TERM = "constraint"
    CLEARANCE = "clearance of shapes"


@dataclass(frozen=True, kw_only=True, slots=True)
class Peak:
    """The largest amount by which ranges of one kind are left."""

    amount: float
    """[unit of the quantity] 0 where none is left, infinite where a number is none."""
    time: float
    """[s] since the first node."""
    quantity: str
    """Which of the quantities; empty where none is left."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RangeCheck:
    """By how much the quantities of one kind leave their ranges."""

    kind: RangeKind
    term: Term | None = None
    """Constraint whose rows these are."""
    name: str
    unit: str
    quantities: tuple[str, ...]
    """(m,) names."""
    at_nodes: Peak
    """At nodes; of thrust, torque and forces at the middle of the steps, where they are given."""
    between: Peak
    """Anywhere else."""
    resolution: float
    """[unit of the quantity] By how much more than `between` it may be where nobody looked: 0 where
    peaks are exact, a bound for shapes that nothing else moves, else an estimate by curvature.
    """
    below: Array
    """(N, m) [unit of the quantity] the largest amount below the range inside each step."""
    above: Array
    """(N, m) [unit of the quantity]"""
    times: Array
    """(N, m) [s] since the first node, of the larger of the two."""
    slack: Array
    """(N + 1, m) [unit of the quantity] how far inside it is at the nodes, negative outside;
    infinite at those where it does not count.
    """
    lower: Array
    """(m,) [unit of the quantity]"""
    upper: Array
    """(m,) [unit of the quantity]"""

    @property
    def worst(self) -> Peak:
        """The larger of the two peaks."""
        return max(self.at_nodes, self.between, key=lambda peak: peak.amount)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MotionCheck:
    """Result of the check."""

    ranges: tuple[RangeCheck, ...]
    """One for each kind that the problem has, and for each constraint."""

    def of(self, *kinds: RangeKind) -> tuple[RangeCheck, ...]:
        """Select those of the given kinds."""
        return tuple(item for item in self.ranges if item.kind in kinds)

    def beyond(self, tolerance: float) -> tuple[RangeCheck, ...]:
        """Select those that are left by more than a tolerance [unit of the quantity] anywhere."""
        return tuple(item for item in self.ranges if not item.worst.amount <= tolerance)


def motion_check(problem: OcpProblem, trajectory: Trajectory, *, t0: float = 0.0) -> MotionCheck:
    """Check a trajectory of as many steps as the problem has; t0 [s] is the time of its first node,
    for goals and obstacles that move.
    """
    motion = _Motion(problem=problem, trajectory=trajectory, t0=t0)
    ranges = [*_boundary(motion), *_dynamics(motion)]
    if problem.limited:
        ranges += [_positions(motion), _velocities(motion), _accelerations(motion)]
        ranges += _forces(motion)
    return MotionCheck(ranges=(*ranges, *constraint_checks(problem, trajectory, t0=t0)))


def between_checks(
    problem: OcpProblem, trajectory: Trajectory, *, t0: float = 0.0
) -> tuple[RangeCheck, ...]:
    """Check what may be left between nodes though it is kept at them: positions, forces and
    constraints; see `motion_check`.
    """
    motion = _Motion(problem=problem, trajectory=trajectory, t0=t0)
    limits = [_positions(motion), *_forces(motion)] if problem.limited else []
    return (*limits, *constraint_checks(problem, trajectory, t0=t0))


def constraint_checks(
    problem: OcpProblem, trajectory: Trajectory, *, t0: float = 0.0
) -> tuple[RangeCheck, ...]:
    """Check the constraints alone; see `motion_check`."""
    motion = _Motion(problem=problem, trajectory=trajectory, t0=t0)
    return tuple(
        _shapes(motion, term) if isinstance(term, ShapeClearance) else _term(motion, term)
        for term in problem.constraints
    )


# --- samples ------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Samples:
    """States at n_s moments of each of n steps, from its beginning to its end."""

    steps: Indices
    """(n,)"""
    t: Array
    """(n, n_s) [s] since the first node."""
    q: Array
    """(n, n_s, n_q) [m, rad]"""
    v: Array
    """(n, n_s, n_v) [m/s, rad/s]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motion:
    """A trajectory, with what its problem says of it."""

    problem: OcpProblem
    trajectory: Trajectory
    t0: float
    _kept: dict[tuple[int, ...], _Samples] = field(default_factory=dict)

    @property
    def robot(self) -> Robot:
        return self.problem.robot

    @property
    def N(self) -> int:
        return len(self.trajectory.a)

    @cached_property
    def h(self) -> Array:
        """(N,) [s]"""
        return np.diff(self.trajectory.t)

    @cached_property
    def leaving(self) -> Array:
        """(N, n_v) [m/s, rad/s] see `Trajectory.leaving`."""
        path = self.trajectory
        model = self.robot.model
        return np.array([path.leaving(model, k) for k in range(self.N)])

    @property
    def looks(self) -> int:
        """At each step to begin with; even, so that the middle is among them."""
        return max(_LOOKS, 2 * (_ALL_LOOKS // (2 * self.N)))

    def reference_times(self, t: Array) -> Array:
        """Times [s] that references of terms are asked for: nominal, where durations are free."""
        return self.t0 + np.interp(t, self.trajectory.t, self.problem.nominal_times())

    def samples(self, steps: Indices, looks: int) -> _Samples:
        """Both ends of each step, and looks - 1 moments between them."""
        key = (looks, *steps.tolist())
        if key not in self._kept:
            s = np.arange(looks + 1) / looks * self.h[steps, None]
            self._kept[key] = self._states(steps, s)
        return self._kept[key]

    def _states(self, steps: Indices, s: Array) -> _Samples:
        """At times s (n, n_s) [s] since the beginning of the steps."""
        path = self.trajectory
        model = self.robot.model
        moment = s[:, :, None]
        a = path.a[steps, None]
        ways = moment * self.leaving[steps, None] + moment**2 / 2 * a
        q = [
            [pin.integrate(model, path.q[k], way) for way in own]
            for k, own in zip(steps.tolist(), ways, strict=True)
        ]
        return _Samples(
            steps=steps,
            t=path.t[steps, None] + s,
            q=np.array(q).reshape(*s.shape, self.robot.n_q),
            v=path.v[steps, None] + moment * a,
        )


_Rows = Callable[[_Samples], Array]
"""Quantities (n, n_s, m) of samples."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Range:
    """Names and ends of quantities."""

    kind: RangeKind
    name: str
    unit: str
    quantities: tuple[str, ...]
    lower: Array
    """(m,)"""
    upper: Array
    """(m,)"""
    term: Term | None = None

    def beyond(self, values: Array) -> tuple[Array, Array]:
        """Amounts (..., m) below and above at values (..., m), negative inside; no number is
        infinitely outside.
        """
        wrong = np.isnan(values)
        below = np.where(wrong, np.inf, self.lower - values)
        above = np.where(wrong, np.inf, values - self.upper)
        return below, above

    def excess(self, values: Array) -> Array:
        """(..., m) by which values (..., m) are outside, 0 inside."""
        return np.asarray(np.maximum(np.maximum(*self.beyond(values)), 0.0))

    def peak(self, amounts: Array, times: Array) -> Peak:
        """The largest of amounts (..., m), at times (...) or (..., m) [s]."""
        if not amounts.size or not amounts.max() > 0.0:
            return _NO_PEAK
        at = np.unravel_index(int(amounts.argmax()), amounts.shape)
        when = np.broadcast_to(
            times[..., None] if times.ndim < amounts.ndim else times, amounts.shape
        )
        return Peak(
            amount=float(amounts[at]), time=float(when[at]), quantity=self.quantities[int(at[-1])]
        )

    def checked(
        self,
        *,
        nodes: Peak,
        below: Array,
        above: Array,
        times: Array,
        slack: Array | None = None,
        resolution: float = 0.0,
    ) -> RangeCheck:
        """Check of quantities with these amounts (N, m) inside the steps."""
        below = np.maximum(below, 0.0)
        above = np.maximum(above, 0.0)
        return RangeCheck(
            kind=self.kind,
            term=self.term,
            name=self.name,
            unit=self.unit,
            quantities=self.quantities,
            at_nodes=nodes,
            between=self.peak(np.maximum(below, above), times),
            resolution=resolution,
            below=below,
            above=above,
            times=times,
            slack=np.full((len(below) + 1, len(self.lower)), np.inf) if slack is None else slack,
            lower=self.lower,
            upper=self.upper,
        )

    def inside(self, motion: _Motion, nodes: Indices, values: Array) -> Array:
        """(N + 1, m) How far values (n, m) at nodes (n,) are inside; infinite at others."""
        slack = np.full((motion.N + 1, len(self.lower)), np.inf)
        slack[nodes] = -np.maximum(*self.beyond(values))
        return slack

    def of_nodes(self, motion: _Motion, values: Array, times: Array) -> RangeCheck:
        """Of values (n, m) at times (n,) [s], with nothing between them."""
        none = np.zeros((motion.N, len(self.quantities)))
        nodes = self.peak(self.excess(values), times)
        return self.checked(nodes=nodes, below=none, above=none, times=none)


_NO_PEAK = Peak(amount=0.0, time=0.0, quantity="")


def _scanned(
    motion: _Motion,
    scope: _Range,
    rows: _Rows,
    nodes: Peak,
    steps: Indices,
    *,
    inputs: bool,
    slack: Array | None = None,
) -> RangeCheck:
    """Look at quantities inside steps, more closely where they come near their range.

    inputs: they jump where a step begins, so that its end is inside as well. nodes: the peak there.
    """
    m = len(scope.quantities)
    below = np.zeros((motion.N, m))
    above = np.zeros((motion.N, m))
    times = np.zeros((motion.N, m))
    unseen = np.zeros((motion.N, m))
    inner = slice(0, None) if inputs else slice(1, -1)
    allowed = _given_by_start(motion, scope, rows)
    for times_as_many in _CLOSER:
        samples = motion.samples(steps, times_as_many * motion.looks)
        values = rows(samples)
        under, over = scope.beyond(values)
        first = (steps == 0)[:, None, None]
        under = np.where(first, under - allowed[0], under)
        over = np.where(first, over - allowed[1], over)
        amounts = np.maximum(under, over)
        when = amounts[:, inner].argmax(axis=1)
        below[steps] = under[:, inner].max(axis=1)
        above[steps] = over[:, inner].max(axis=1)
        times[steps] = np.take_along_axis(samples.t[:, inner, None], when[:, None], axis=1)[:, 0]
        found = np.maximum(np.maximum(below[steps], above[steps]), 0.0)
        possible = amounts.max(axis=1) + _bend(values) / 2
        unseen[steps] = np.maximum(possible - found, 0.0)
        steps = steps[(unseen[steps] > FINE).any(axis=1)]
        if not len(steps):
            break
    return scope.checked(
        nodes=nodes,
        below=below,
        above=above,
        times=times,
        slack=slack,
        resolution=float(np.nan_to_num(unseen, nan=np.inf).max(initial=0.0)),
    )


def _bend(values: Array) -> Array:
    """(n, m) Largest second difference of values (n, n_s, m), by which they may rise between two of
    them.
    """
    with np.errstate(invalid="ignore"):
        return np.abs(np.diff(values, n=2, axis=1)).max(axis=1)


def _given_by_start(motion: _Motion, scope: _Range, rows: _Rows) -> tuple[Array, Array]:
    """(m,) Amounts below and above that a start which is given has by itself."""
    m = len(scope.quantities)
    if not motion.problem.fixed_start or not motion.N:
        return np.zeros(m), np.zeros(m)
    begin = motion.samples(np.array([0]), motion.looks)
    below, above = scope.beyond(rows(begin)[0, 0])
    return np.maximum(below, 0.0), np.maximum(above, 0.0)


# --- ends of the horizon ------------------------------------------------------------------------------


def _boundary(motion: _Motion) -> list[RangeCheck]:
    problem = motion.problem
    path = motion.trajectory
    model = motion.robot.model
    state = (*(f"axis {i}" for i in range(2 * motion.robot.n_v)),)
    freedom = problem.start_freedom
    width = np.zeros(len(state)) if freedom is None else np.asarray(freedom, dtype=float)
    first = (path.q[0], path.v[0])
    given = (problem.start.q, problem.start.v)
    start = _Range(
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
        closed = _Range(
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


def _durations(motion: _Motion) -> RangeCheck:
    problem = motion.problem
    t = motion.trajectory.t
    lengths = np.diff(t[problem.starts_of_phases()])
    lower, upper = np.transpose([phase.range for phase in problem.phases])
    scope = _Range(
        kind=RangeKind.DURATION,
        name="duration",
        unit="s",
        quantities=(*(phase.name for phase in problem.phases), "all phases"),
        lower=np.append(lower, 0.0),
        upper=np.append(upper, problem.longest if problem.free_time else np.inf),
    )
    return scope.of_nodes(motion, np.append(lengths, t[-1] - t[0])[None], t[-1:])


# --- dynamics -----------------------------------------------------------------------------------------


def _dynamics(motion: _Motion) -> list[RangeCheck]:
    problem = motion.problem
    path = motion.trajectory
    robot = motion.robot
    state = _axes(robot)
    speeds = tuple(f"velocity of {name}" for name in state)
    moved = _arrivals(motion)
    defects = np.array(
        [pin.difference(robot.model, *pair) for pair in zip(moved, path.q[1:], strict=True)]
    )
    gained = path.v[1:] - path.v[:-1] - motion.h[:, None] * path.a
    none = np.zeros(2 * robot.n_v)
    law = _Range(
        kind=RangeKind.MOTION,
        name="motion",
        unit="m, rad, m/s, rad/s",
        quantities=(*state, *speeds),
        lower=none,
        upper=none,
    )
    forces = _Range(
        kind=RangeKind.FORCES,
        name="forces",
        unit="N, N m",
        quantities=state,
        lower=none[: robot.n_v],
        upper=none[: robot.n_v],
    )
    h = motion.h[:, None]
    if problem.integrator is Integrator.EULER:
        q, v = path.q[:-1], path.v[:-1]
    else:
        middle = h / 2 * path.v[:-1] + h**2 / 8 * path.a + _bracket(motion, h / 2)
        q = np.array(
            [pin.integrate(robot.model, *pair) for pair in zip(path.q, middle, strict=False)]
        )
        v = path.v[:-1] + h / 2 * path.a
    lacking = _required(motion, np.arange(motion.N), q, v) - _given_forces(motion)
    times = path.t[1:]
    return [
        law.of_nodes(motion, np.hstack([defects.reshape(gained.shape), gained]), times),
        forces.of_nodes(motion, lacking, path.t[:-1] + motion.h / 2),
    ]


def _arrivals(motion: _Motion) -> list[Array]:
    """(N, n_q) Where the integrator of the problem leads from every node."""
    path = motion.trajectory
    h = motion.h[:, None]
    share = 1.0 if motion.problem.integrator is Integrator.EULER else 0.5
    ways = h * path.v[:-1] + share * h**2 * path.a + _bracket(motion, h)
    return [
        pin.integrate(motion.robot.model, *pair) for pair in zip(path.q[:-1], ways, strict=True)
    ]


def _bracket(motion: _Motion, h: Array) -> Array:
    """(N, n_v) What `Integrator.MAGNUS` adds to a step of h (N, 1) [s]."""
    path = motion.trajectory
    result = np.zeros_like(path.a)
    if motion.problem.integrator is Integrator.MAGNUS and motion.robot.n_vehicle:
        v = path.v[:-1, :6]
        a = path.a[:, :6]
        linear = np.cross(v[:, 3:], a[:, :3]) + np.cross(v[:, :3], a[:, 3:])
        result[:, :6] = h**3 / 12 * np.hstack([linear, np.cross(v[:, 3:], a[:, 3:])])
    return result


def _required(motion: _Motion, steps: Indices, q: Array, v: Array) -> Array:
    """(n, n_v) [N, N m] Forces that the accelerations of steps (n,) take at q (n, n_q), v (n, n_v)."""
    problem = motion.problem
    function = _inverse_dynamics(problem.robot, problem.water)
    n_links = function.size2_in(3)
    water = np.repeat(problem.currents[steps], n_links, axis=0).T
    forces = function(q.T, v.T, motion.trajectory.a[steps].T, water, np.zeros_like(water))
    return np.asarray(forces.full().T)


@lru_cache(maxsize=8)
def _inverse_dynamics(robot: Robot, water: bool) -> ca.Function:
    model = cached_dynamics(robot).symbolic if water else SymbolicDynamics(model=robot.model)
    return model.function("inverse_dynamics")


def _given_forces(motion: _Motion) -> Array:
    """(N, n_v) [N, N m]"""
    path = motion.trajectory
    actuators = ActuationModel(motion.robot, motion.problem.actuation)
    return np.hstack([path.thrust @ actuators.matrix.T, path.torque])


def _axes(robot: Robot) -> tuple[str, ...]:
    vehicle = ("surge", "sway", "heave", "roll", "pitch", "yaw")[: robot.n_vehicle]
    joints = [
        joint.name if joint.n_v == 1 else f"{joint.name}[{i}]"
        for joint in robot.joints
        for i in range(joint.n_v)
    ]
    return (*vehicle, *joints)


# --- limits of the robot ------------------------------------------------------------------------------


def _positions(motion: _Motion) -> RangeCheck:
    """Parabolas: their peaks are at their vertices."""
    robot = motion.robot
    path = motion.trajectory
    lower, upper = robot.configuration_bounds
    joints = [joint for joint in robot.joints if joint.n_q == joint.n_v]
    places = robot.limited_positions
    axes = np.array([i for joint in joints for i in range(*joint.v.indices(robot.n_v))], dtype=int)
    names = _axes(robot)
    scope = _Range(
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
    own = _less_start(motion, scope, nodes)
    under[:1] -= own[0]
    over[:1] -= own[1]
    return scope.checked(
        nodes=scope.peak(_of_nodes(motion, scope, nodes), path.t),
        slack=scope.inside(motion, np.arange(motion.N + 1), nodes),
        below=np.where(inside, under, 0.0),
        above=np.where(inside, over, 0.0),
        times=path.t[:-1, None] + turn,
    )


def _less_start(motion: _Motion, scope: _Range, nodes: Array) -> tuple[Array, Array]:
    """(m,) What a given start breaks by itself, below and above."""
    below, above = scope.beyond(nodes[0])
    given = float(motion.problem.fixed_start)
    return given * np.maximum(below, 0.0), given * np.maximum(above, 0.0)


def _of_nodes(motion: _Motion, scope: _Range, nodes: Array) -> Array:
    """(N + 1, m) Excess at the nodes, of a given start none."""
    excess = scope.excess(nodes)
    if motion.problem.fixed_start:
        excess[0] = 0.0
    return excess


def _velocities(motion: _Motion) -> RangeCheck:
    """Straight lines: their peaks are at the ends of steps."""
    path = motion.trajectory
    limit = motion.robot.limits.velocity
    scope = _Range(
        kind=RangeKind.VELOCITY,
        name="velocity limits",
        unit="m/s, rad/s",
        quantities=_axes(motion.robot),
        lower=-limit,
        upper=limit,
    )
    under, over = scope.beyond(path.v[:-1] + motion.h[:, None] * path.a)
    return scope.checked(
        nodes=scope.peak(_of_nodes(motion, scope, path.v), path.t),
        slack=scope.inside(motion, np.arange(motion.N + 1), path.v),
        below=under,
        above=over,
        times=np.broadcast_to(path.t[1:, None], under.shape),
    )


def _accelerations(motion: _Motion) -> RangeCheck:
    """Constant over each step."""
    limit = motion.robot.limits.acceleration
    scope = _Range(
        kind=RangeKind.ACCELERATION,
        name="acceleration limits",
        unit="m/s2, rad/s2",
        quantities=_axes(motion.robot),
        lower=-limit,
        upper=limit,
    )
    return scope.of_nodes(motion, motion.trajectory.a, motion.trajectory.t[:-1])


def _forces(motion: _Motion) -> list[RangeCheck]:
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
    thrusters = (
        tuple(thruster.name for thruster in robot.description.thrusters)
        if has_thrusters(motion.problem)
        else _axes(robot)[:n]
    )
    thrust = _Range(
        kind=RangeKind.THRUST,
        name="thrust limits",
        unit="N",
        quantities=thrusters,
        lower=actuators.thrust_lower * actuators.thrust_unit,
        upper=actuators.thrust_upper * actuators.thrust_unit,
    )
    effort = robot.limits.effort
    torque = _Range(
        kind=RangeKind.TORQUE,
        name="torque limits",
        unit="N m, N",
        quantities=_axes(robot)[n:],
        lower=-effort,
        upper=effort,
    )
    planned = _given_forces(motion)

    @lru_cache(maxsize=4)
    def required(samples: _Samples) -> Array:
        shape = samples.t.shape
        own = np.repeat(samples.steps, shape[1])
        states = (samples.q.reshape(len(own), -1), samples.v.reshape(len(own), -1))
        return _required(motion, own, *states).reshape(*shape, -1)

    def thrusts(samples: _Samples) -> Array:
        more = required(samples)[..., :n] - planned[samples.steps, None, :n]
        return np.asarray(path.thrust[samples.steps, None] + more @ spread.T)

    def torques(samples: _Samples) -> Array:
        return required(samples)[..., n:]

    return [
        _scanned(
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


# --- constraints --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _TermFunction:
    """Rows of a term in numbers."""

    function: ca.Function
    """``q, v, a, thrust, torque, parameters -> rows``, of one sample a column."""
    residual: Residual


@lru_cache(maxsize=64)
def _term_function(term: Term, shape: tuple[object, ...], problem: _Same) -> _TermFunction:
    stage, arguments = _stage_symbols(problem.value)
    parameters = ca.SX.sym("parameters", term.n_parameters(problem.value.robot))
    residual = term.residual(stage, parameters)
    function = ca.Function("rows", [*arguments, parameters], [ca.densify(residual.value)])
    return _TermFunction(function=function, residual=residual)


@dataclass(frozen=True, slots=True)
class _Same:
    """A problem that stands for all of its shape, which is the key."""

    value: OcpProblem = field(compare=False)


def _stage_symbols(problem: OcpProblem) -> tuple[StageSymbols, list[ca.SX]]:
    """Symbols that terms are written in, then state and inputs [m, rad, s, N] as they are."""
    robot = problem.robot
    actuators = ActuationModel(robot, problem.actuation)
    q = ca.SX.sym("q", robot.n_q)
    v = ca.SX.sym("v", robot.n_v)
    a = ca.SX.sym("a", robot.n_v)
    thrust = ca.SX.sym("thrust", len(actuators.thrust_unit))
    torque = ca.SX.sym("torque", robot.n_joints)
    kinematics = SymbolicModel(robot.model).forward_kinematics(q)
    tick = TickSymbols(
        robot=robot,
        kinematics=kinematics,
        q=q,
        velocity=v,
        altimeter_range=altimeter_range(problem, kinematics),
        dt=float("nan"),
    )
    stage = StageSymbols(
        tick=tick,
        acceleration=a,
        thrust=thrust,
        thrust_share=thrust / ca.DM(actuators.thrust_unit),
        torque=torque,
        torque_share=torque / ca.DM(actuators.torque_unit),
    )
    return stage, [q, v, a, thrust, torque]


def _term(motion: _Motion, term: Term) -> RangeCheck:
    problem = motion.problem
    path = motion.trajectory
    shape = (problem.robot, problem.actuation, problem.floor, problem.altimeter_frame)
    rows = _term_function(term, shape, _Same(problem))
    m = rows.residual.n_rows
    scope = _Range(
        kind=RangeKind.TERM,
        term=term,
        name=term.name,
        unit="unit of the row",
        quantities=tuple(f"row {i}" for i in range(m)),
        lower=rows.residual.lower,
        upper=rows.residual.upper,
    )

    def values(t: Array, states: tuple[Array, Array], steps: Indices) -> Array:
        """(n, m) at times (n,) [s]; step N has no inputs."""
        times = motion.reference_times(t).tolist()
        reference = unchecked_method(term.reference)
        parameters = np.array([reference(moment) for moment in times]).reshape(len(t), -1)
        inputs = [_with_none(part)[steps] for part in (path.a, path.thrust, path.torque)]
        columns = [np.ascontiguousarray(part.T) for part in (*states, *inputs, parameters)]
        return np.asarray(rows.function(*columns).full().T).reshape(len(t), m)

    def inside(samples: _Samples) -> Array:
        own = np.repeat(samples.steps, samples.t.shape[1])
        states = (samples.q.reshape(len(own), -1), samples.v.reshape(len(own), -1))
        return values(samples.t.ravel(), states, own).reshape(*samples.t.shape, m)

    nodes = _nodes_of(problem, term)
    at_nodes = values(path.t[nodes], (path.q[nodes], path.v[nodes]), nodes)
    excess = scope.excess(at_nodes)
    if problem.fixed_start and term.state_only:
        excess[nodes == 0] = 0.0
    peak = scope.peak(excess, path.t[nodes])
    steps = _steps_of(problem, term)
    if not len(steps):
        none = np.zeros((motion.N, m))
        return scope.checked(nodes=peak, below=none, above=none, times=none)
    slack = scope.inside(motion, nodes, at_nodes)
    inputs = not term.state_only
    return _scanned(motion, scope, inside, peak, steps, inputs=inputs, slack=slack)


def _with_none(inputs: Array) -> Array:
    """(N + 1, n) with zeros for the last node."""
    return np.pad(inputs, ((0, 1), (0, 0)))


def _nodes_of(problem: OcpProblem, term: Term) -> Indices:
    """Nodes at which a term counts."""
    chosen: list[int] = []
    for phase, span in _spans(problem):
        if counts(problem, term, phase, at_end=False):
            chosen += span[:-1]
        if counts(problem, term, phase, at_end=True):
            chosen.append(span[-1])
    return np.array(chosen, dtype=int)


def _steps_of(problem: OcpProblem, term: Term) -> Indices:
    """Steps along which a term counts."""
    chosen: list[int] = []
    for phase, span in _spans(problem):
        if term.at is At.PATH and counts(problem, term, phase, at_end=False):
            chosen += span[:-1]
    return np.array(chosen, dtype=int)


def _spans(problem: OcpProblem) -> list[tuple[OcpPhase, list[int]]]:
    """Every phase with its nodes, the first of the next one among them."""
    starts = problem.starts_of_phases().tolist()
    return [
        (phase, list(range(first, last + 1)))
        for phase, (first, last) in zip(problem.phases, pairwise(starts), strict=True)
    ]


# --- shapes -------------------------------------------------------------------------------------------


def _shapes(motion: _Motion, term: ShapeClearance) -> RangeCheck:
    """Halve intervals until no pair can miss its margin by more than is known, or they are too
    short.
    """
    path = motion.trajectory
    problem = motion.problem
    scope = _Range(
        kind=RangeKind.CLEARANCE,
        term=term,
        name=term.name,
        unit="m",
        quantities=tuple(pair.name for pair in term.scene.pairs),
        lower=term.margins,
        upper=np.full(len(term.margins), np.inf),
    )
    m = len(term.margins)
    nodes = _nodes_of(problem, term)
    times = motion.reference_times(path.t[nodes]).tolist()
    at_nodes = term.margins - term.distances(times, path.q[nodes])
    slack = np.full((motion.N + 1, m), np.inf)
    slack[nodes] = -at_nodes
    own = np.zeros(m)
    if problem.fixed_start and len(nodes) and nodes[0] == 0:
        own = np.maximum(at_nodes[0], 0.0)
        at_nodes[0] = 0.0
    peak = scope.peak(np.maximum(at_nodes, 0.0), path.t[nodes])
    steps = _steps_of(problem, term)
    below = np.zeros((motion.N, m))
    moments = np.zeros((motion.N, m))
    unseen = 0.0
    stepped = SteppedMotion(term=term, trajectory=path)
    parts = max(1, motion.looks // 2)
    of = np.repeat(steps, parts)
    half = np.repeat(motion.h[steps] / (2 * parts), parts)
    middle = path.t[of] + (2 * np.tile(np.arange(parts), len(steps)) + 1) * half
    open_ = np.ones((len(of), m), dtype=bool)
    while len(of):
        clock = motion.reference_times(middle)
        lack = term.margins - term.distances(
            clock.tolist(), stepped.configurations(middle), chosen=open_
        )
        lack -= np.where((of == 0)[:, None], own, 0.0)
        lack = np.where(open_, lack, -np.inf)
        place = of[:, None] * m + np.arange(m)
        np.maximum.at(below.reshape(-1), place, lack)
        row, pair = np.nonzero(lack == below.reshape(-1)[place])
        moments[of[row], pair] = middle[row]
        reach = largest_change(term.scene.reach, stepped.bounds(middle, half))
        possible = lack + reach + term.obstacle_motion(clock, half)
        more = possible - np.maximum(below[of], 0.0)
        open_ = open_ & ~(more <= FINE)
        short = half * _SHORTEST < motion.h[of]
        unseen = max(unseen, float(more[short[:, None] & open_].max(initial=0.0)))
        kept = open_.any(axis=1) & ~short
        of = np.tile(of[kept], 2)
        half = np.tile(half[kept] / 2, 2)
        open_ = np.tile(open_[kept], (2, 1))
        sides = np.repeat([-1.0, 1.0], kept.sum())
        middle = np.tile(middle[kept], 2) + sides * half
    return scope.checked(
        nodes=peak,
        below=below,
        above=np.zeros((motion.N, m)),
        times=moments,
        slack=slack,
        resolution=max(unseen, FINE if len(steps) and m else 0.0),
    )

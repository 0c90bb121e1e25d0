"""Check the constraints of a problem along a motion: rows of terms, and true shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np

from uvms_ocp.checks import unchecked_method
from uvms_ocp.ocp.clearance_certificate import SteppedMotion
from uvms_ocp.ocp.motion_scan import FINE, Motion, QuantityRange, Samples, finite_excess, scanned
from uvms_ocp.ocp.problem import OcpPhase, OcpProblem, counts
from uvms_ocp.ocp.range_check import RangeCheck, RangeKind
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.ocp.transcription.actuation import ActuationModel
from uvms_ocp.ocp.transcription.stage import altimeter_range
from uvms_ocp.robot import SymbolicModel
from uvms_ocp.robot.kinematics import largest_change
from uvms_ocp.tasks.task import Residual, TickSymbols
from uvms_ocp.types import Array, Indices

_FINEST_SHARE = 128  # parts of a step of which an interval is one that is not halved any more


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _TermFunction:
    """Rows of a term in numbers."""

    function: ca.Function
    """``q, v, a, thrust, torque, parameters -> rows``, each with one sample in a column."""
    residual: Residual
    """Expressions and ranges of the rows."""


@lru_cache(maxsize=64)
def _term_function(
    term: Term, shape: tuple[object, ...], problem: _ProblemOfShape
) -> _TermFunction:
    """Build the rows of a term, once for all problems of a shape."""
    stage, arguments = _stage_symbols(problem.value)
    parameters = ca.SX.sym("parameters", term.n_parameters(problem.value.robot))
    residual = term.residual(stage, parameters)
    function = ca.Function("rows", [*arguments, parameters], [ca.densify(residual.value)])
    return _TermFunction(function=function, residual=residual)


@dataclass(frozen=True, slots=True)
class _ProblemOfShape:
    """A problem that is equal to any other: the shape beside it is the key of a cache."""

    value: OcpProblem = field(compare=False)


def _stage_symbols(problem: OcpProblem) -> tuple[StageSymbols, list[ca.SX]]:
    """Return the symbols that terms are written in, and those of state and inputs in their units [m,
    rad, s, N] of which they are made.
    """
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


def check_term(motion: Motion, term: Term) -> RangeCheck:
    """Check the rows of a constraint at nodes and inside steps."""
    problem = motion.problem
    path = motion.trajectory
    shape = (problem.robot, problem.actuation, problem.floor, problem.altimeter_frame)
    rows = _term_function(term, shape, _ProblemOfShape(problem))
    m = rows.residual.n_rows
    scope = QuantityRange(
        kind=RangeKind.TERM,
        term=term,
        name=term.name,
        unit="unit of the row",
        quantities=tuple(f"row {i}" for i in range(m)),
        lower=rows.residual.lower,
        upper=rows.residual.upper,
    )

    def values(t: Array, states: Sequence[Array], steps: Indices) -> Array:
        """Return the rows (n, m) at times (n,) [s]; step N has no inputs."""
        times = motion.reference_times(t).tolist()
        reference = unchecked_method(term.reference)
        parameters = np.array([reference(moment) for moment in times]).reshape(len(t), -1)
        inputs = [_with_last(part)[steps] for part in (path.a, path.thrust, path.torque)]
        columns = [np.ascontiguousarray(part.T) for part in (*states, *inputs, parameters)]
        return np.asarray(rows.function(*columns).full().T).reshape(len(t), m)

    def inside(samples: Samples) -> Array:
        """Return the rows at samples inside steps."""
        steps, q, v = samples.flat
        return values(samples.t.ravel(), (q, v), steps).reshape(*samples.t.shape, m)

    nodes = _nodes_of(problem, term)
    at_nodes = values(path.t[nodes], (path.q[nodes], path.v[nodes]), nodes)
    excess = scope.excess(at_nodes)
    if problem.fixed_start and term.state_only:
        excess[nodes == 0] = 0.0
    peak = scope.peak(excess, path.t[nodes])
    steps = _steps_of(problem, term)
    if not len(steps):
        zeros = np.zeros((motion.N, m))
        return scope.checked(nodes=peak, below=zeros, above=zeros, times=zeros)
    slack = scope.inside(motion, nodes, at_nodes)
    inputs = not term.state_only
    return scanned(motion, scope, inside, peak, steps, inputs=inputs, slack=slack)


def _with_last(inputs: Array) -> Array:
    """Return inputs (N + 1, n) with zeros for the last node."""
    return np.pad(inputs, ((0, 1), (0, 0)))


def _nodes_of(problem: OcpProblem, term: Term) -> Indices:
    """Return the nodes at which a term counts."""
    chosen: list[int] = []
    for phase, span in _spans(problem):
        if counts(problem, term, phase, at_end=False):
            chosen += span[:-1]
        if counts(problem, term, phase, at_end=True):
            chosen.append(span[-1])
    return np.array(chosen, dtype=int)


def _steps_of(problem: OcpProblem, term: Term) -> Indices:
    """Return the steps along which a term counts."""
    chosen: list[int] = []
    for phase, span in _spans(problem):
        if term.at is At.PATH and counts(problem, term, phase, at_end=False):
            chosen += span[:-1]
    return np.array(chosen, dtype=int)


def _spans(problem: OcpProblem) -> list[tuple[OcpPhase, list[int]]]:
    """Return every phase with its nodes, the first of the next one among them."""
    starts = problem.starts_of_phases().tolist()
    spans = []
    for i, phase in enumerate(problem.phases):
        nodes = list(range(starts[i], starts[i + 1] + 1))
        spans.append((phase, nodes))
    return spans


def check_shapes(motion: Motion, term: ShapeClearance) -> RangeCheck:
    """Check the distances of shapes: intervals are halved until no pair can miss its margin by more
    than it does at samples, or they are too short.
    """
    path = motion.trajectory
    problem = motion.problem
    scope = QuantityRange(
        kind=RangeKind.CLEARANCE,
        term=term,
        name=term.name,
        unit="m",
        quantities=tuple(pair.name for pair in term.scene.pairs),
        lower=term.margins,
        upper=np.full(len(term.margins), np.inf),
    )
    n_pairs = len(term.margins)
    nodes = _nodes_of(problem, term)
    node_times = motion.reference_times(path.t[nodes]).tolist()
    lack_at_nodes = term.margins - term.distances(node_times, path.q[nodes])
    slack = np.full((motion.N + 1, n_pairs), np.inf)
    slack[nodes] = -lack_at_nodes
    lack_at_start = np.zeros(n_pairs)
    if problem.fixed_start and len(nodes) and nodes[0] == 0:
        lack_at_start = finite_excess(lack_at_nodes[0])
        lack_at_nodes[0] = 0.0
    peak = scope.peak(np.maximum(lack_at_nodes, 0.0), path.t[nodes])
    steps = _steps_of(problem, term)
    below, times, unseen = _halve_intervals(motion, term, steps, lack_at_start)
    return scope.checked(
        nodes=peak,
        below=below,
        above=np.zeros((motion.N, n_pairs)),
        times=times,
        slack=slack,
        resolution=max(unseen, FINE if len(steps) and n_pairs else 0.0),
    )


def _halve_intervals(
    motion: Motion, term: ShapeClearance, steps: Indices, lack_at_start: Array
) -> tuple[Array, Array, float]:
    """Compute distances in the middle of intervals, and halve those in which more may be missing.

    Returns the largest lack (N, n_pairs) [m] of distance at samples in every step, its times (N,
    n_pairs) [s], and a bound [m] on the lack beyond it between samples. lack_at_start (n_pairs,)
    [m]: allowed in the first step.
    """
    path = motion.trajectory
    n_pairs = len(term.margins)
    below = np.zeros((motion.N, n_pairs))
    times = np.zeros((motion.N, n_pairs))
    unseen = 0.0
    stepped = SteppedMotion(term=term, trajectory=path)
    n_parts = max(1, motion.looks // 2)
    # One interval a row: its step, the time of its middle, half its length, and pairs to look at.
    step = np.repeat(steps, n_parts)
    half = np.repeat(motion.h[steps] / (2 * n_parts), n_parts)
    middle = path.t[step] + (2 * np.tile(np.arange(n_parts), len(steps)) + 1) * half
    is_open = np.ones((len(step), n_pairs), dtype=bool)
    while len(step):
        reference_times = motion.reference_times(middle)
        q = stepped.configurations(middle)
        lack = term.margins - term.distances(reference_times.tolist(), q, chosen=is_open)
        lack -= np.where((step == 0)[:, None], lack_at_start, 0.0)
        lack = np.where(is_open, lack, -np.inf)
        place = step[:, None] * n_pairs + np.arange(n_pairs)
        np.maximum.at(below.reshape(-1), place, lack)
        row, pair = np.nonzero(lack == below.reshape(-1)[place])
        times[step[row], pair] = middle[row]
        reach = largest_change(term.scene.reach, stepped.bounds(middle, half))
        possible = lack + reach + term.obstacle_motion(reference_times, half)
        with np.errstate(invalid="ignore"):  # overlaps whose depth coal cannot tell
            unseen_lack = possible - np.maximum(below[step], 0.0)
        is_open = is_open & ~(unseen_lack <= FINE)
        is_short = half * _FINEST_SHARE < motion.h[step]
        unseen = max(unseen, float(unseen_lack[is_short[:, None] & is_open].max(initial=0.0)))
        is_halved = is_open.any(axis=1) & ~is_short
        step = np.tile(step[is_halved], 2)
        half = np.tile(half[is_halved] / 2, 2)
        is_open = np.tile(is_open[is_halved], (2, 1))
        sides = np.repeat([-1.0, 1.0], is_halved.sum())
        middle = np.tile(middle[is_halved], 2) + sides * half
    return below, times, unseen

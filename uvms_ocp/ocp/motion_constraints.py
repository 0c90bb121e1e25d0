"""Check the constraints of a problem along a motion: rows of terms, and true shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

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

_SHORTEST = 128  # share of a step below which an interval is not halved, for shapes


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


def check_term(motion: Motion, term: Term) -> RangeCheck:
    problem = motion.problem
    path = motion.trajectory
    shape = (problem.robot, problem.actuation, problem.floor, problem.altimeter_frame)
    rows = _term_function(term, shape, _Same(problem))
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
        """(n, m) at times (n,) [s]; step N has no inputs."""
        times = motion.reference_times(t).tolist()
        reference = unchecked_method(term.reference)
        parameters = np.array([reference(moment) for moment in times]).reshape(len(t), -1)
        inputs = [_with_none(part)[steps] for part in (path.a, path.thrust, path.torque)]
        columns = [np.ascontiguousarray(part.T) for part in (*states, *inputs, parameters)]
        return np.asarray(rows.function(*columns).full().T).reshape(len(t), m)

    def inside(samples: Samples) -> Array:
        own, *states = samples.flat
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
    return scanned(motion, scope, inside, peak, steps, inputs=inputs, slack=slack)


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


def check_shapes(motion: Motion, term: ShapeClearance) -> RangeCheck:
    """Halve intervals until no pair can miss its margin by more than is known, or they are too
    short.
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
    m = len(term.margins)
    nodes = _nodes_of(problem, term)
    times = motion.reference_times(path.t[nodes]).tolist()
    at_nodes = term.margins - term.distances(times, path.q[nodes])
    slack = np.full((motion.N + 1, m), np.inf)
    slack[nodes] = -at_nodes
    own = np.zeros(m)
    if problem.fixed_start and len(nodes) and nodes[0] == 0:
        own = finite_excess(at_nodes[0])
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
        with np.errstate(invalid="ignore"):  # overlaps whose depth coal cannot tell
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

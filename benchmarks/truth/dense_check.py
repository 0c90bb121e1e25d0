"""Judge a motion at its nodes and between them, from the statement of its problem alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from truth.planes import Distances
from truth.statement import PathRows, Statement, n_thrust_of, node_symbols, units_of_problem
from uvms_ocp.ocp import OcpProblem, Trajectory
from uvms_ocp.robot import Robot
from uvms_ocp.robot.dynamics import cached_dynamics

CLEARANCE = "clearance"
FORCES = "forces in a step"
LOOKS = 600
"""Times at which a motion is looked at, at least."""
_FEWEST = 6  # in a step
_CLOSER = 40  # in each of the steps in which a row is worst


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """The worst violation of one kind of limit, and where it is."""

    name: str
    excess: float
    """[unit of the row], negative where there is room."""
    time: float
    """[s]"""
    at_node: bool

    def __str__(self) -> str:
        where = "at a node" if self.at_node else "between nodes"
        return f"{self.name} by {self.excess:.2g} {where} at {self.time:.3g} s"


def worst_of_limits(
    problem: OcpProblem, statement: Statement, trajectory: Trajectory
) -> list[Finding]:
    """Look along a motion for the worst of every limit, at nodes and between them: two findings
    each.
    """
    per_step = max(_FEWEST, -(-LOOKS // len(trajectory.a)))
    steps = np.arange(len(trajectory.a) * per_step + 1) / per_step
    t = np.interp(steps, np.arange(len(trajectory.t)), trajectory.t)
    findings = _looked(problem, statement, trajectory, t, np.arange(len(t)) % per_step == 0)
    closer = []
    for finding in findings:
        if not finding.at_node:
            gap = float(np.diff(trajectory.t).max()) / per_step
            closer.append(finding.time + np.linspace(-gap, gap, _CLOSER))
    if closer:
        t = np.clip(np.concatenate(closer), 0.0, trajectory.t[-1])
        nodes = np.zeros(len(t), dtype=bool)
        findings += _looked(problem, statement, trajectory, t, nodes)
    worst: dict[tuple[str, bool], Finding] = {}
    for finding in findings:
        key = finding.name, finding.at_node
        if key not in worst or finding.excess > worst[key].excess:
            worst[key] = finding
    return list(worst.values())


def _looked(
    problem: OcpProblem,
    statement: Statement,
    trajectory: Trajectory,
    t: np.ndarray,
    nodes: np.ndarray,
) -> list[Finding]:
    """Worst of every limit at times t (n,) [s], of which some are `nodes` (n,)."""
    robot = problem.robot
    q, v, steps = trajectory.states_at(robot.model, t)
    of_steps = np.minimum(steps, len(trajectory.a) - 1)
    excess: dict[str, np.ndarray] = {}
    if problem.limited:
        lower, upper = robot.configuration_bounds
        excess["joint limits"] = np.maximum(lower - q, q - upper).max(axis=1)
        excess["velocity limits"] = (np.abs(v) - robot.limits.velocity).max(axis=1)
        excess[FORCES] = _excess_of_forces(problem, trajectory, (q, v, of_steps))
    nominal = _nominal_times(problem, trajectory, t)
    for rows in statement.path:
        excess[rows.name] = _excess_of(problem, rows, trajectory, (q, v, of_steps, nominal))
    if statement.shapes is not None:
        distances = Distances(robot, statement.shapes)
        pairs = zip(q, nominal, strict=True)
        measured = np.array([distances.measure(row, moment) for row, moment in pairs])
        if measured.size:
            excess[CLEARANCE] = (statement.shapes.margins - measured).max(axis=1)
            excess["touching"] = -measured.min(axis=1)
    findings = []
    for name, values in excess.items():
        for at_node in (True, False):
            is_node = nodes
            if name == FORCES:
                # What they are stated to be is that at the middle of the steps, which is elsewhere.
                is_node = np.zeros(len(t), dtype=bool)
            chosen = np.flatnonzero(is_node == at_node)
            if problem.fixed_start:
                chosen = chosen[t[chosen] > 0.0]  # of which nobody is free to choose
            if len(chosen):
                k = chosen[int(np.argmax(values[chosen]))]
                findings.append(
                    Finding(name=name, excess=float(values[k]), time=float(t[k]), at_node=at_node)
                )
    return findings


def _nominal_times(problem: OcpProblem, trajectory: Trajectory, t: np.ndarray) -> np.ndarray:
    """Times (n,) [s] with nominal durations, by which things move, at times t (n,) [s]."""
    return np.asarray(np.interp(t, trajectory.t, problem.nominal_times()))


def _excess_of_forces(
    problem: OcpProblem,
    trajectory: Trajectory,
    states: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """(n,) in shares of limits, of inputs that the motion takes in its steps: those of the middle,
    with the least change that makes up for the difference.
    """
    robot = problem.robot
    units = units_of_problem(problem)
    q, v, steps = states
    water = problem.currents[steps]
    needed = np.array(_forces_of(robot).map(len(q))(q.T, v.T, trajectory.a[steps].T, water.T)).T
    n = robot.n_vehicle
    per_share = units.matrix * units.thrust
    share = trajectory.thrust[steps] / units.thrust
    missing = needed[:, :n] - share @ per_share.T
    share = share + missing @ np.linalg.pinv(per_share, rcond=1e-9).T
    torque = np.abs(needed[:, n:]) / units.torque - units.torque_limit
    beyond = np.maximum(units.thrust_lower - share, share - units.thrust_upper)
    excess = np.hstack([beyond, torque])
    return np.asarray(excess.max(axis=1, initial=-np.inf))


@lru_cache(maxsize=4)
def _forces_of(robot: Robot) -> ca.Function:
    """``q, v, a, water (3,) -> generalised forces (n_v,)``"""
    dynamics = cached_dynamics(robot).symbolic
    q = ca.SX.sym("q", robot.n_q)
    v = ca.SX.sym("v", robot.n_v)
    a = ca.SX.sym("a", robot.n_v)
    water = ca.SX.sym("water", 3)
    waters = ca.repmat(water, 1, len(dynamics.links))
    forces = dynamics.inverse_dynamics(q, v, a, waters, ca.SX(*waters.shape))
    return ca.Function("forces", [q, v, a, water], [ca.densify(forces)], {"cse": True})


def _excess_of(
    problem: OcpProblem,
    rows: PathRows,
    trajectory: Trajectory,
    states: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """(n,) by which rows leave their range."""
    units = units_of_problem(problem)
    node = node_symbols(problem.robot, n_thrust_of(problem))
    value = rows.rows(node)
    inputs = [node.q, node.v, node.a, node.thrust, node.torque, node.t]
    function = ca.Function("rows", inputs, [ca.densify(value)])
    q, v, steps, t = states
    arguments = (
        q.T,
        v.T,
        trajectory.a[steps].T,
        (trajectory.thrust / units.thrust)[steps].T,
        (trajectory.torque / units.torque)[steps].T,
        t[None],
    )
    values = np.array(function.map(len(t))(*arguments))
    return np.asarray(np.maximum(rows.lower - values, values - rows.upper).max(axis=0))

"""Random tool reaches by optimal control: ``python benchmarks/ocp_random_reach.py``.

Start, goal and current are drawn; every outcome is counted. Writes ocp_random_reach.csv and
ocp_random_reach.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
from horizon.problems import tool_reach
from recording.processes import hide_compiler
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, count_where
from recording.timing import once

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem
from uvms_ocp.ocp.terms import TaskTerm
from uvms_ocp.ocp.trajectory import COARSE_STEPS
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks.pose import ToolPose

DRAWN = 200
SEED = 1
STEPS = 40
WAY = 1.5  # [m] of the tool at most
TURN = 0.6  # [rad] in roll, pitch and yaw at most
CURRENT = 0.3  # [m/s] at most
OPTIONS = NlpOptions(plugin="stagewise")
PEER = "ipopt"
NEAR = 0.01
EDGES = (0, 5, 10, 20, 40, 80, 160, 1000)  # of the histogram of iterations
PROSE = """
{drawn} reaches of {dofs} degrees of freedom in water, within the limits of thrusters and joints,
{steps} steps in {duration:g} s: the vehicle's yaw, the posture of the arm within half of its
ranges, the way of the tool (up to {way:g} m), its turn (up to {turn:g} rad about every axis) and
the current (up to {current:g} m/s) are drawn with seed {seed}. From rest to rest, first the pose of
the tool, below it least effort and acceleration, cold and without a second try.

{solved} of {drawn} are solved stage by stage ({share:.1%}), from the best of seventeen motions over
{coarse} steps towards postures of the arm, as `Planner.plan` does where it is given no guess.
Processor time, these included: {median:.0f} ms at the median, {most:.0f} ms at most. IPOPT, from a
guess that stays where it is: {peer_solved} solved, {peer_median:.0f} ms and {peer_most:.0f} ms; it
is the faster one in {slower}. Where both are solved, they end in the same minimum, or in another
one, as arms reach a pose in several postures: `to_ipopt` is the cost over IPOPT's. Stage by stage
it is lower by more than {near:.0%} in {lower} and higher in {higher}; the median is {middle:.4f},
the mean {mean:.3f}, the most {worst:.3f}.

Reaches by outcome: {outcomes}. By iterations: {histogram}.
"""
FORMATS = {
    "reach": "",
    "way_m": ".3f",
    "current_mps": ".3f",
    "status": "",
    "reason": "",
    "iterations": "",
    "cpu_ms": ".1f",
    "goal": ".1e",
    "ipopt_status": "",
    "ipopt_ms": ".1f",
    "to_ipopt": ".4f",
}


def drawn(base: OcpProblem, rng: np.random.Generator) -> tuple[OcpProblem, float]:
    """A reach, and how far its tool moves [m]."""
    robot = base.robot
    q = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, rng.uniform(-np.pi, np.pi))).copy()
    low = robot.limits.position_lower
    up = robot.limits.position_upper
    change = rng.uniform(-0.25, 0.25, robot.n_joints) * (up - low)
    q[7:] = np.clip(q[7:] + change, low + 0.05, up - 0.05)
    way = rng.uniform(-1.0, 1.0, 3) * WAY / np.sqrt(3)
    turn = pin.rpy.rpyToMatrix(*rng.uniform(-TURN, TURN, 3))
    levels = (_tool_level(base, _moved(robot, q, way, turn)), *base.levels[1:])
    current = rng.uniform(-1.0, 1.0, 3) * CURRENT / np.sqrt(3)
    start = State(q=q, v=np.zeros(robot.n_v))
    return replace(base, start=start, levels=levels, current=current), float(np.linalg.norm(way))


def _moved(robot: Robot, q: np.ndarray, way: np.ndarray, turn: np.ndarray) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    X_WT = data.oMf[robot.frame_id("tool")]
    return pin.SE3(turn @ X_WT.rotation, X_WT.translation + way)


def _tool_level(base: OcpProblem, goal: pin.SE3) -> OcpLevel:
    level = base.levels[0]
    return replace(level, terms=(TaskTerm(task=ToolPose(goal=goal)),))


def row(planner: Planner, peer: Planner, problem: OcpProblem, number: int, way: float) -> Row:
    """Plan a reach by ours and by the peer."""
    ours = once(partial(planner.plan, problem, diagnose=False))
    theirs = once(partial(peer.plan, problem, diagnose=False))
    plan = ours.value
    peer_plan = theirs.value
    to_ipopt = None
    if plan.status.value == peer_plan.status.value == "solved":
        to_ipopt = (plan.levels[-1].residual / peer_plan.levels[-1].residual) ** 2
    return {
        "reach": number,
        "way_m": way,
        "current_mps": float(np.linalg.norm(problem.current)),
        "status": plan.status.value,
        "reason": plan.reason,
        "iterations": plan.iterations,
        "cpu_ms": 1e3 * ours.cpu,
        "goal": plan.levels[0].residual if plan.levels else None,
        "ipopt_status": peer_plan.status.value,
        "ipopt_ms": 1e3 * theirs.cpu,
        "to_ipopt": to_ipopt,
    }


def histogram(rows: Sequence[Row]) -> str:
    """Reaches by iterations."""
    iterations = [row["iterations"] for row in rows]
    counts, _ = np.histogram(iterations, bins=EDGES)
    pairs = zip(EDGES[:-1], EDGES[1:], counts.tolist(), strict=True)
    return ", ".join(f"{low} to {high - 1} in {n}" for low, high, n in pairs if n)


def prose(problem: OcpProblem, rows: Sequence[Row]) -> str:
    """Fill in the figures of all reaches."""
    outcomes = Counter(column(rows, "status"))
    times = column(rows, "cpu_ms")
    peer_times = column(rows, "ipopt_ms")
    ratios = np.array([row["to_ipopt"] or np.nan for row in rows])
    return PROSE.format(
        coarse=COARSE_STEPS,
        drawn=len(rows),
        dofs=problem.robot.n_v,
        steps=problem.n_steps,
        duration=problem.nominal_times()[-1],
        way=WAY,
        turn=TURN,
        current=CURRENT,
        seed=SEED,
        solved=outcomes["solved"],
        share=outcomes["solved"] / len(rows),
        median=np.median(times),
        most=np.max(times),
        peer_solved=count_where(rows, "ipopt_status", "solved"),
        peer_median=np.median(peer_times),
        peer_most=np.max(peer_times),
        near=NEAR,
        lower=int((ratios < 1.0 - NEAR).sum()),
        higher=int((ratios > 1.0 + NEAR).sum()),
        middle=np.nanmedian(ratios),
        worst=np.nanmax(ratios),
        slower=int((np.array(times) > peer_times).sum()),
        mean=np.nanmean(ratios),
        outcomes=", ".join(f"{n} {status}" for status, n in outcomes.most_common()),
        histogram=histogram(rows),
    )


def main() -> None:
    """Draw and solve."""
    _, run = begin(parser_of(__doc__))
    if run.quick:
        hide_compiler()
        n = 2
        steps = 3
        options = replace(OPTIONS, max_iterations=3)
    else:
        n = DRAWN
        steps = STEPS
        options = OPTIONS
    base = tool_reach(steps)
    rng = np.random.default_rng(SEED)
    planner = Planner(base, options)
    peer = Planner(base, replace(options, plugin=PEER))
    rows = []
    for number in range(n):
        problem, way = drawn(base, rng)
        rows.append(row(planner, peer, problem, number, way))
    table = Table(rows=rows, columns=FORMATS)
    run.write(
        Report(
            name="ocp_random_reach", title="Random reaches", prose=prose(base, rows), tables=[table]
        )
    )


if __name__ == "__main__":
    main()

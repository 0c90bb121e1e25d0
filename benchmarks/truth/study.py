"""Plan a drawn problem, plan again from the result, solve it with IPOPT by another transcription,
and compare what is said with what is so.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from recording.rows import column, count_where, rows_where
from studies.study import Study, seeds_from

from truth.collocation import Collocation, Way
from truth.dense_check import CLEARANCE, FORCES, Finding, worst_of_limits
from truth.drawing import GOALS, SURROUNDINGS, DrawnProblem, drawn_problem
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.errors import UvmsError, plain_line
from uvms_ocp.ocp import OcpStatus, Plan, Planner, Trajectory, hold_guess
from uvms_ocp.ocp.verdict import judge_motion
from uvms_ocp.solvers import NlpOptions
from uvms_ocp.types import Count

NEAR = 0.01
"""Share of a cost within which two are one."""
_NOTHING = 1e-6  # cost below which differences say nothing: thrusts of a thousandth of their limits
AT_NODES = 5e-4
"""[unit of the row] by which a limit may be broken at a node; plans state 3e-4."""
BETWEEN = 1.5e-3
"""[unit of the row] by which a limit may be broken between nodes; plans state 1e-3 for shapes."""
OF_FORCES = 1.5e-2
"""[share] by which a force may exceed its limit inside a step; plans state 1e-2."""
OF_GOALS = 1.5e-3
"""[m, rad] by which a goal may be missed; plans state 1e-3 for all of a level."""
TIME_LIMIT = 120.0
"""[s] of a plan."""
SOLVED = "solved"
WRONGS = (
    "dearer than planning again",
    "broken at nodes",
    "broken between nodes",
    "certified and touching",
    "not seen by the judge",
    "fault",
)
"""What must not be. Not seen by the judge: `judge_motion` calls nothing broken where the dense look
does.
"""
NOTES = (
    "no minimum by IPOPT",
    "another minimum is cheaper",
    "a way is known",
    "a way is known at nodes only",
    "as good as solved",
)
"""What is told beside: IPOPT goes on from the result and gets more than 1 % cheaper; it does so
from elsewhere; the plan is not solved, and IPOPT or another guess comes to a motion that keeps
everything, or keeps it at the nodes; or it is itself one that keeps everything, and IPOPT finds
nothing that is more than 1 % cheaper.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Kept:
    """Violations of limits and goals by one motion."""

    nodes: Finding
    """The worst at a node, as shares of what is allowed go."""
    between: Finding | None
    """The worst between nodes; None where nothing is limited there."""
    limits: float
    """Share of what is allowed, the worst anywhere, goals aside."""
    touching: float
    """[m] the deepest overlap, negative for a distance."""

    @property
    def at_nodes(self) -> bool:
        return allowed_share(self.nodes) <= 1.0

    @property
    def in_steps(self) -> bool:
        return self.between is None or allowed_share(self.between) <= 1.0

    @property
    def everywhere(self) -> bool:
        return self.at_nodes and self.in_steps

    @property
    def what(self) -> str:
        """Describe what is broken; empty where all is kept."""
        words = []
        if not self.at_nodes:
            words.append(str(self.nodes))
        if not self.in_steps:
            words.append(str(self.between))
        return "; ".join(words)


def allowed_share(finding: Finding) -> float:
    """Compute by how many times what is allowed a limit is broken."""
    if finding.name == FORCES:
        allowed = OF_FORCES
    elif finding.name == CLEARANCE or not finding.at_node:
        allowed = BETWEEN
    elif finding.name in GOALS:
        allowed = OF_GOALS
    else:
        allowed = AT_NODES
    return finding.excess / allowed


class Court:
    """Judges of one drawn problem."""

    def __init__(self, drawn: DrawnProblem) -> None:
        self.drawn = drawn
        problem = drawn.problem
        self.hold = hold_guess(problem)
        guesses = [drawn.straight, self.hold]
        self.collocation = Collocation(problem, drawn.statement, guesses)

    def kept(self, trajectory: Trajectory) -> Kept:
        """Look at a motion at its nodes and between them."""
        _, violations = self.collocation.judge(trajectory)
        at_nodes = []
        for name, excess in violations.items():
            at_nodes.append(Finding(name=name, excess=excess, time=0.0, at_node=True))
        between = []
        touching = -np.inf
        for finding in worst_of_limits(self.drawn.problem, self.drawn.statement, trajectory):
            if finding.name == "touching":
                touching = max(touching, finding.excess)
            elif finding.at_node:
                at_nodes.append(finding)
            else:
                between.append(finding)
        limits = [finding for finding in (*at_nodes, *between) if finding.name not in GOALS]
        return Kept(
            nodes=max(at_nodes, key=allowed_share),
            between=max(between, key=allowed_share, default=None),
            limits=max(allowed_share(finding) for finding in limits),
            touching=touching,
        )

    def costs(self, trajectory: Trajectory) -> np.ndarray:
        """(n_levels,) of a motion."""
        return self.collocation.judge(trajectory)[0]

    def ways(self, result: Trajectory | None) -> dict[str, Way]:
        """Solve by IPOPT from the straight way, from the start held, and from a result."""
        ways = {
            "straight": self.collocation.solve(self.drawn.straight),
            "hold": self.collocation.solve(self.hold),
        }
        if result is not None:
            ways["result"] = self.collocation.solve(result, from_optimum=True)
        return ways


def ratio_of(costs: np.ndarray, best: np.ndarray) -> float:
    """How many times the best a cost is, in the first level in which they differ."""
    ratio = 1.0
    for cost, best_cost in zip(costs.tolist(), best.tolist(), strict=True):
        ratio = (cost + _NOTHING) / (best_cost + _NOTHING)
        if abs(ratio - 1.0) > NEAR:
            break
    return ratio


# One problem.


def run_problem(case: dict[str, Any]) -> Row:
    """Plan, judge, and compare."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = drawn_problem(case["seed"], Path(folder))
        row = {**case, **_description(drawn), **_blank()}
        try:
            row |= _outcome(drawn)
        except UvmsError as error:
            row |= {"status": "refused", "reason": plain_line(str(error), 300)}
        except Exception as error:
            text = plain_line(f"{type(error).__name__}: {error}", 300)
            row |= {"status": "fault", "reason": text, "wrong": "fault"}
    row["completed"] = not row["wrong"]
    return row


def _description(drawn: DrawnProblem) -> dict[str, Any]:
    problem = drawn.problem
    return {
        "robot": drawn.robot_name,
        "dof": problem.robot.n_v,
        "steps": problem.n_steps,
        "surroundings": drawn.surroundings,
        "guess": drawn.guess_name,
        "levels": len(problem.levels),
        "traits": ", ".join(drawn.traits),
    }


def _blank() -> dict[str, Any]:
    """Columns of what is not known."""
    return {
        "status": "",
        "reason": "",
        "cost": None,
        "again": "",
        "to_again": None,
        "ipopt": "",
        "to_ipopt": None,
        "to_ipopt_from_result": None,
        "at_nodes": None,
        "between": None,
        "broken": "",
        "judged": "",
        "certified": False,
        "nearest_m": None,
        "way": "",
        "plan_s": None,
        "ipopt_s": None,
        "wrong": "",
        "note": "",
    }


def _outcome(drawn: DrawnProblem) -> dict[str, Any]:
    problem = drawn.problem
    planner = Planner(problem, NlpOptions(time_limit=TIME_LIMIT))
    began = process_time()
    plan = planner.plan(guess=drawn.guess, diagnose=False)
    took = process_time() - began
    court = Court(drawn)
    row: dict[str, Any] = {
        "status": plan.status.value,
        "reason": plain_line(plan.reason, 300),
        "plan_s": round(took, 2),
        "certified": plan.certified_free,
    }
    finite = bool(np.isfinite(plan.trajectory.q).all())
    judged = bool(plan.levels) and finite
    wrong: list[str] = []
    notes: list[str] = []
    if judged:
        limits_kept = court.kept(plan.trajectory)
        row |= {
            "cost": float(court.costs(plan.trajectory)[-1]),
            "at_nodes": limits_kept.nodes.excess,
            "between": None if limits_kept.between is None else limits_kept.between.excess,
            "broken": limits_kept.what,
            "nearest_m": -limits_kept.touching if np.isfinite(limits_kept.touching) else None,
        }
        verdict = judge_motion(problem, plan.trajectory)
        row["judged"] = f"{verdict.status.value}: {plain_line(verdict.reason, 200)}"
        if limits_kept.limits > 1.0 and verdict.status is not OcpStatus.BROKEN:
            wrong.append("not seen by the judge")
        if plan.certified_free and limits_kept.touching > 0.0:
            wrong.append("certified and touching")
    began = process_time()
    ways = court.ways(plan.trajectory if judged and plan.status.usable else None)
    row["ipopt_s"] = round(process_time() - began, 2)
    row["ipopt"] = ", ".join(f"{name}: {_word(way)}" for name, way in ways.items())
    if plan.status.value == SOLVED:
        row |= _compared(court, planner, plan, ways, wrong, notes)
    else:
        row |= _known_way(court, planner, plan if judged else None, ways, notes)
    return {**row, "wrong": ", ".join(wrong), "note": ", ".join(notes)}


def _word(way: Way) -> str:
    if way.status == "Solve_Succeeded" and way.kept:
        return "solved"
    return way.status


def _compared(
    court: Court,
    planner: Planner,
    plan: Plan,
    ways: dict[str, Way],
    wrong: list[str],
    notes: list[str],
) -> dict[str, Any]:
    """Compare a plan that is called solved with others: is it kept, and is there anything cheaper?"""
    limits_kept = court.kept(plan.trajectory)
    costs = court.costs(plan.trajectory)
    if not limits_kept.at_nodes:
        wrong.append("broken at nodes")
    if not limits_kept.in_steps:
        wrong.append("broken between nodes")
    again = planner.plan(guess=plan.trajectory, diagnose=False)
    row: dict[str, Any] = {"again": again.status.value}
    if again.status.usable and court.kept(again.trajectory).everywhere:
        row["to_again"] = ratio_of(costs, court.costs(again.trajectory))
        if row["to_again"] > 1.0 + NEAR:
            wrong.insert(0, "dearer than planning again")
    ratios = _ratios(court, costs, ways)
    if ratios:
        row["to_ipopt"] = max(ratios.values())
        row["to_ipopt_from_result"] = ratios.get("result")
    if ratios.get("result", 1.0) > 1.0 + NEAR:
        notes.append("no minimum by IPOPT")
    elif max(ratios.values(), default=1.0) > 1.0 + NEAR:
        notes.append("another minimum is cheaper")
    return row


def _ratios(court: Court, costs: np.ndarray, ways: dict[str, Way]) -> dict[str, float]:
    """How many times those of IPOPT's motions that keep everything the costs (n_levels,) are."""
    ratios = {}
    for name, way in ways.items():
        if court.kept(way.trajectory).everywhere:
            ratios[name] = ratio_of(costs, way.costs)
    return ratios


def _known_way(
    court: Court, planner: Planner, plan: Plan | None, ways: dict[str, Way], notes: list[str]
) -> dict[str, Any]:
    """Look for a motion that keeps everything where a plan is not solved."""
    if plan is not None and court.kept(plan.trajectory).everywhere:
        ratios = _ratios(court, court.costs(plan.trajectory), ways)
        best = max(ratios.values(), default=1.0)
        if best <= 1.0 + NEAR:
            notes.append("as good as solved")
            return {"to_ipopt": best}
    good = []
    good_at_nodes = []
    for name, way in ways.items():
        limits_kept = court.kept(way.trajectory)
        if limits_kept.everywhere:
            good.append(f"ipopt from {name}")
        if limits_kept.at_nodes:
            good_at_nodes.append(f"ipopt from {name}, at nodes")
    if not good:
        guesses = {"default": None, "hold": court.hold, "straight": court.drawn.straight}
        guesses.pop(court.drawn.guess_name, None)
        for name, guess in guesses.items():
            plan = planner.plan(guess=guess, diagnose=False)
            if plan.status.value == SOLVED and court.kept(plan.trajectory).everywhere:
                good.append(f"{name} guess")
                break
    if good:
        notes.append("a way is known")
    elif good_at_nodes:
        notes.append("a way is known at nodes only")
        good = good_at_nodes
    return {"way": ", ".join(good)}


# All of them.


def ocp_truth(*, n: int = 400, seed: Count = 0) -> Study:
    """`n` drawn problems with the seeds `seed`, `seed` + 1, ...

    Raises `InvalidInput` for no problems or a negative seed.
    """
    cases = [{"seed": drawn} for drawn in seeds_from(seed, n)]
    return Study(
        name="ocp_truth",
        title=f"{n} drawn problems of optimal control",
        cases=cases,
        run_case=run_problem,
        summarize=totals,
    )


def totals(rows: Sequence[Row]) -> list[Row]:
    """How the problems fared, by what is around the robot."""
    table = []
    for name in dict.fromkeys(SURROUNDINGS):
        table.append(_total(name, rows_where(rows, "surroundings", name)))
    return [*table, _total("all", rows)]


def _total(surroundings: str, rows: Sequence[Row]) -> Row:
    notes = Counter[str]()
    for note in column(rows, "note"):
        notes.update(str(note).split(", "))
    total: dict[str, Any] = {"surroundings": surroundings, "problems": len(rows)}
    total[SOLVED] = count_where(rows, "status", SOLVED)
    for kind in WRONGS:
        total[kind] = sum(kind in wrong for wrong in column(rows, "wrong"))
    for kind in NOTES:
        total[kind] = notes[kind]
    return total

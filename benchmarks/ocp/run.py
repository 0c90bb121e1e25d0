"""Times and costs of optimal control: one row per problem, solver and setting, failures included.

python benchmarks/ocp/run.py results.json
"""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from time import process_time
from typing import Any

from problems import tool_reach

from uvms_ocp.control.plan_tracking import PlanTracker, carry_out
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.planning import HessianKind, OcpProblem, Plan, Planner
from uvms_ocp.sim import DynamicPlant, Environment, FlatSeafloor
from uvms_ocp.solvers.lexicographic import NlpOptions

REPEATS = 3
Row = dict[str, Any]


def timed(solve: Callable[[], Plan]) -> tuple[Plan, float, float]:
    """The plan, and the smallest wall and processor time [s] of `REPEATS` solves."""
    walls, cpus, plan = [], [], solve()
    for _ in range(REPEATS):
        begin = process_time()
        plan = solve()
        cpus.append(process_time() - begin)
        walls.append(plan.solve_time)
    return plan, min(walls), min(cpus)


def rows(name: str, problem: OcpProblem, options: NlpOptions) -> list[Row]:
    """Cold and warm solve of one problem."""
    planner = Planner(problem, options)
    result = []
    cold, wall, cpu = timed(lambda: planner.plan(diagnose=False))
    result.append(row(name, "cold", options, cold, wall, cpu))
    warm, wall, cpu = timed(lambda: planner.plan(guess=cold, diagnose=False))
    result.append(row(name, "warm", options, warm, wall, cpu))
    return result


def row(name: str, start: str, options: NlpOptions, plan: Plan, wall: float, cpu: float) -> Row:
    return {
        "problem": name,
        "start": start,
        "solver": options.plugin,
        "status": plan.status.value,
        "wall": wall,
        "cpu": cpu,
        "iterations": plan.iterations,
        "residuals": [level.residual for level in plan.levels],
        "cost": 0.5 * plan.levels[-1].residual ** 2 if plan.levels else None,
    }


def simulated() -> Row:
    """The plan of `tool_reach` carried out on the physical plant."""
    problem = tool_reach()
    plan, dynamics = Planner(problem).plan(), robot_dynamics(problem.robot)
    environment = Environment(seafloor=FlatSeafloor(z=-40))
    plant = DynamicPlant(problem.robot, problem.start.q, dynamics=dynamics, environment=environment)
    tracker = PlanTracker(problem.robot, dynamics, dt=1 / 200)
    mismatch = carry_out(plan.trajectory, plant, tracker, robot=problem.robot, frame="tool")
    return {
        "problem": "tool reach, simulated",
        "largest_mismatch": mismatch.position,
        "end_position_error": mismatch.end_position,
        "end_orientation_error": mismatch.end_orientation,
    }


def machine() -> Row:
    packages = {name: version(name) for name in ("casadi", "pin", "numpy")}
    return {"machine": platform.processor() or platform.machine(), "python": platform.python_version(), **packages}


def main(target: Path) -> None:
    table: list[Row] = []
    for part in parts():
        table += part()
        target.write_text(json.dumps(table, indent=1), encoding="utf-8")


def parts() -> list[Callable[[], list[Row]]]:
    """What to measure, in order; results are written after each."""
    reaches: list[Callable[[], list[Row]]] = [
        lambda n=n, plugin=plugin: rows(f"tool reach N={n}", tool_reach(n), NlpOptions(plugin=plugin))  # type: ignore[misc]
        for n in (40, 20, 80)
        for plugin in ("ipopt", "fatrop")
    ]
    newton = tool_reach(hessian=HessianKind.GAUSS_NEWTON)
    gauss_newton = [lambda: rows("tool reach N=40, Gauss-Newton", newton, NlpOptions())]
    return [lambda: [machine()], *reaches, *gauss_newton, lambda: [simulated()]]


if __name__ == "__main__":
    main(Path(sys.argv[1]))

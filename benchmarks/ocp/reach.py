"""Times of the tool reach, cold and warm: one row per solver and setting, failures included.

python benchmarks/ocp/reach.py [RESULTS]
"""

from __future__ import annotations

import csv
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pinocchio as pin
from problems import tool_reach

from uvms_ocp.control.navigation.estimator import PassThrough
from uvms_ocp.control.receding.plan_tracking import Mismatch, PlanTracker, mismatch
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.sensing import IDEAL_SENSORS
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.loop import simulate
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.solvers.nlp.lexicographic_nlp import NlpOptions

HERE = Path(__file__).parent
REPEATS = 3
STEPS = (20, 40, 80)
COLUMNS = ("steps", "solver", "setting", "start", "status", "iterations", "cpu_ms", "wall_ms", "goal", "cost")
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


def rows(setting: str, problem: OcpProblem, options: NlpOptions) -> list[Row]:
    """Cold solve from rest, and warm solves from its solution: the same problem again, and one whose start has moved."""
    planner = Planner(problem, options)
    cold, wall, cpu = timed(lambda: planner.plan(diagnose=False))
    found = [row(planner, setting, "cold", cold, wall, cpu)]
    for start, again in (("warm", problem), ("moved", moved(problem))):
        plan, wall, cpu = timed(partial(planner.plan, again, guess=cold, diagnose=False))
        found.append(row(planner, setting, start, plan, wall, cpu))
    return found


def moved(problem: OcpProblem) -> OcpProblem:
    """With a start 2 cm and 0.02 rad away, as a measurement would have it."""
    tangent = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.02, *np.zeros(problem.robot.n_v - 6)])
    return replace(
        problem, start=replace(problem.start, q=pin.integrate(problem.robot.model, problem.start.q, tangent))
    )


def row(planner: Planner, setting: str, start: str, plan: Plan, wall: float, cpu: float) -> Row:
    assert plan.result is not None
    *_, last = planner.transcription.program.nlps
    cost = last.functions["nlp_f"](plan.result.x, planner.transcription.parameters())
    return {
        "steps": planner.problem.n_steps,
        "solver": planner.options.plugin,
        "setting": setting,
        "start": start,
        "status": plan.result.status.value,
        "iterations": plan.iterations,
        "cpu_ms": f"{1e3 * cpu:.1f}",
        "wall_ms": f"{1e3 * wall:.1f}",
        "goal": f"{plan.levels[0].residual:.1e}",
        "cost": f"{float(cost):.9f}",
    }


def all_rows() -> list[Row]:
    """Every size with both solvers, and Gauss and Newton's Hessian."""
    found = []
    for n_steps in STEPS:
        for plugin in ("ipopt", "fatrop"):
            found += rows("exact", tool_reach(n_steps), NlpOptions(plugin=plugin))
            loose = NlpOptions(plugin=plugin, convergence=1e-6)
            found += rows("Gauss-Newton, 1e-06", tool_reach(n_steps, hessian=HessianKind.GAUSS_NEWTON), loose)
    return found


def uncompiled() -> list[Row]:
    """The same for the middle size where no compiler is found, in another process."""
    command = [sys.executable, str(Path(__file__)), "--uncompiled"]
    environment = {**os.environ, "PATH": "", "CC": ""}
    done = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
    found: list[Row] = json.loads(done.stdout)
    return [row | {"setting": f"{row['setting']}, virtual machine"} for row in found]


def carried_out(problem: OcpProblem, plan: Plan) -> Mismatch:
    """How the physical plant departs from a plan that it tracks."""
    robot, dynamics, dt = problem.robot, robot_dynamics(problem.robot), 1 / 200
    environment = Environment(seafloor=FlatSeafloor(z=-40))
    record = simulate(
        plant=DynamicPlant(robot, problem.start.q, dynamics=dynamics, environment=environment),
        sensors=SensorSuite(robot, environment.seafloor, IDEAL_SENSORS).read,
        estimator=PassThrough(robot),
        controller=PlanTracker(plan.trajectory, robot, dynamics, dt=dt),
        dt=dt,
        duration=plan.duration,
    ).series()
    return mismatch(plan.trajectory, record["t"], record["q"], robot=robot, frame="tool")


def shown_mismatch() -> str:
    """The plan of the middle size, carried out on the physical plant."""
    problem = tool_reach(STEPS[1])
    found = carried_out(problem, Planner(problem).plan())
    return (
        f"Carried out on the physical plant, N = {STEPS[1]}: tool off by {1e3 * found.end_position:.2f} mm and "
        f"{1e3 * found.end_orientation:.2f} mrad at the end, {1e3 * found.position:.2f} mm at most on the way."
    )


def main(results: Path) -> None:
    before = os.getloadavg()[0]
    found = [*all_rows(), *uncompiled()]
    departure = shown_mismatch()
    with (results / "ocp_reach.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        table.writerows(found)
    packages = ", ".join(f"{name} {version(name)}" for name in ("casadi", "pin", "numpy"))
    load = f"{before:.1f} at the start, {os.getloadavg()[0]:.1f} at the end"
    lines = [
        "# Optimal control: the tool reach",
        "",
        (HERE / "reach.md").read_text(encoding="utf-8").strip(),
        "",
        departure,
        "",
        f"{platform.machine()}, Python {platform.python_version()}, {packages}; load average {load}.",
        "",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
        *("| " + " | ".join(str(row[column]) for column in COLUMNS) + " |" for row in found),
        "",
    ]
    (results / "ocp_reach.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    given = sys.argv[1:]
    if given == ["--uncompiled"]:
        middle = tool_reach(STEPS[1])
        print(
            json.dumps(
                [row for plugin in ("ipopt", "fatrop") for row in rows("exact", middle, NlpOptions(plugin=plugin))]
            )
        )
    else:
        main(Path(given[0]) if given else HERE.parent / "results")

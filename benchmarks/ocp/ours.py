"""Our side of the comparison with the peers: one problem in all settings.

python benchmarks/ocp/ours.py shooting|quickest STEPS result.json [trajectory.json]

With an empty PATH no compiler is found, and step functions run in CasADi's virtual machine. `trajectory.json`, what a
peer has found, is put into our cost and our equations of motion.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from peer_problems import quickest_problem, shooting_problem

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.lexicographic_nlp import NlpOptions

REPEATS = 10
CONVERGENCE = (1e-6, 1e-8)


def settings(kind: str, n_steps: int) -> Iterator[tuple[str, str, OcpProblem]]:
    """Solver, setting and problem."""
    for plugin in ("fatrop", "ipopt"):
        if kind == "quickest":
            yield plugin, "exact", quickest_problem(n_steps)
        else:
            yield plugin, "Gauss-Newton", shooting_problem(n_steps)
            yield plugin, "exact", shooting_problem(n_steps, exact=True)


def solve(kind: str, n_steps: int) -> list[dict[str, Any]]:
    """One row per setting: times of whole calls of `Planner.plan`, cold and from the solution."""
    rows = []
    for plugin, setting, problem in settings(kind, n_steps):
        transcription = Transcription(problem, plugin=plugin)
        for convergence in CONVERGENCE:
            planner = Planner(problem, NlpOptions(plugin=plugin, convergence=convergence), transcription=transcription)
            found = {"plugin": plugin, "setting": setting, "convergence": convergence}
            rows.append(found | measured(planner))
    return rows


def measured(planner: Planner) -> dict[str, Any]:
    walls, cpus, warm_cpus = [], [], []
    for _ in range(REPEATS):
        begin = process_time()
        plan = planner.plan(diagnose=False)
        cpus.append(process_time() - begin)
        walls.append(plan.solve_time)
        begin = process_time()
        again = planner.plan(guess=plan, diagnose=False)
        warm_cpus.append(process_time() - begin)
    assert plan.result is not None
    return {
        "wall": min(walls),
        "cpu": min(cpus),
        "warm_cpu": min(warm_cpus),
        "iterations": plan.iterations,
        "warm_iterations": again.iterations,
        "status": plan.result.status.value,
        "cost": cost(planner.transcription, plan.result.x),
        "duration": plan.duration,
    }


def cost(transcription: Transcription, x: np.ndarray) -> float:
    """Of the only level."""
    (level,) = transcription.program.nlps
    return float(level.functions["nlp_f"](x, transcription.parameters()))


def judged(found: dict[str, Any], n_steps: int) -> dict[str, float]:
    """Cost and largest violation, in our terms, of states and controls that a peer has found."""
    problem = shooting_problem(n_steps)
    transcription = Transcription(problem)
    q, v, u = (np.array(found[name]) for name in ("q", "v", "u"))
    t, n = problem.nominal_times(), problem.robot.n_vehicle
    a = np.diff(v, axis=0) / np.diff(t)[:, None]
    given = Trajectory(t=t, q=q, v=v, a=a, thrust=u[:, :n], torque=u[:, n:])
    x = transcription.pack(given)
    ours = transcription.unpack(x)
    units = transcription.model.actuators
    forces = np.hstack(
        [(ours.thrust - given.thrust) / units.thrust_unit, (ours.torque - given.torque) / units.torque_unit]
    )
    violations = [abs(value) for value in transcription.violations(x, transcription.parameters()).values()]
    return {"cost": cost(transcription, x), "violation": max(*violations, float(np.abs(forces).max()))}


if __name__ == "__main__":
    kind, n_steps, target = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    result: dict[str, Any] = {"rows": solve(kind, n_steps)}
    if len(sys.argv) > 4:
        result["judged"] = judged(json.loads(Path(sys.argv[4]).read_text()), n_steps)
    target.write_text(json.dumps(result))

"""The quickest motion with Drake's KinematicTrajectoryOptimization; run in its own environment.

python peer_drake.py problem.json result.json
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from pydrake.planning import KinematicTrajectoryOptimization
from pydrake.solvers import IpoptSolver, SnoptSolver

REPEATS = 5
CONTROL_POINTS = (12, 24)


def build(given: dict[str, Any], n_points: int) -> KinematicTrajectoryOptimization:
    """Bounds on the control points of velocity and acceleration imply bounds on the curves."""
    start, goal = np.array(given["start"]), np.array(given["goal"])
    rest = np.zeros(len(start))
    problem = KinematicTrajectoryOptimization(len(start), n_points, spline_order=4, duration=4.0)
    problem.AddDurationCost(1.0)
    problem.AddDurationConstraint(0.5, 10.0)
    problem.AddPositionBounds(np.array(given["position_lower"]), np.array(given["position_upper"]))
    problem.AddVelocityBounds(-np.array(given["velocity"]), np.array(given["velocity"]))
    problem.AddAccelerationBounds(-np.array(given["acceleration"]), np.array(given["acceleration"]))
    for where, q in ((0.0, start), (1.0, goal)):
        problem.AddPathPositionConstraint(q, q, where)
        problem.AddPathVelocityConstraint(rest, rest, where)
    points = np.linspace(start, goal, n_points).T
    problem.get_mutable_prog().SetInitialGuess(problem.control_points(), points)
    return problem


def solve(given: dict[str, Any]) -> list[dict[str, Any]]:
    runs = []
    for solver in (SnoptSolver(), IpoptSolver()):
        for n_points in CONTROL_POINTS:
            problem = build(given, n_points)
            walls, cpus = [], []
            for _ in range(REPEATS):
                begin, begin_cpu = perf_counter(), process_time()
                result = solver.Solve(problem.prog())
                walls.append(perf_counter() - begin)
                cpus.append(process_time() - begin_cpu)
            curve = problem.ReconstructTrajectory(result)
            runs.append(
                {
                    "setting": f"{solver.solver_id().name()}, {n_points} control points",
                    "wall": min(walls),
                    "cpu": min(cpus),
                    "converged": bool(result.is_success()),
                    "duration": float(curve.end_time() - curve.start_time()),
                }
            )
    return runs


if __name__ == "__main__":
    found = {"versions": {"drake": version("drake")}, "runs": solve(json.loads(Path(sys.argv[1]).read_text()))}
    Path(sys.argv[2]).write_text(json.dumps(found))

"""The quickest motion with PyRoboPlan's cubic trajectory optimisation; run in its own environment.

python peer_pyroboplan.py problem.json result.json
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
import pinocchio as pin
from pyroboplan.trajectory.trajectory_optimization import (
    CubicTrajectoryOptimization,
    CubicTrajectoryOptimizationOptions,
)

REPEATS = 1
WAYPOINTS = (3, 6)  # SNOPT takes half a minute for six


def solve(given: dict[str, Any]) -> list[dict[str, Any]]:
    """Build and solve: its interface has one call for both."""
    model = pin.buildModelFromUrdf(given["urdf"])
    start, goal = np.array(given["start"]), np.array(given["goal"])
    v, a = np.array(given["velocity"]), np.array(given["acceleration"])
    runs = []
    for n_points in WAYPOINTS:
        options = CubicTrajectoryOptimizationOptions(
            num_waypoints=n_points, min_vel=-v, max_vel=v, min_accel=-a, max_accel=a
        )
        planner = CubicTrajectoryOptimization(model, pin.GeometryModel(), options)
        walls, cpus = [], []
        for _ in range(REPEATS):
            begin, begin_cpu = perf_counter(), process_time()
            curve = planner.plan([start, goal])
            walls.append(perf_counter() - begin)
            cpus.append(process_time() - begin_cpu)
        runs.append(
            {
                "setting": f"SNOPT, {n_points} way points",
                "wall": min(walls),
                "cpu": min(cpus),
                "converged": curve is not None,
                "duration": None if curve is None else float(np.max(curve.segment_times)),
            }
        )
    return runs


if __name__ == "__main__":
    found = {
        "versions": {"pyroboplan": version("pyroboplan"), "drake": version("drake")},
        "runs": solve(json.loads(Path(sys.argv[1]).read_text())),
    }
    Path(sys.argv[2]).write_text(json.dumps(found))

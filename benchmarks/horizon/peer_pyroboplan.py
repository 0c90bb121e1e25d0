"""The quickest motion with PyRoboPlan: ``python peer_pyroboplan.py PROBLEM.json RESULT.json
--repeats N [--quick]``.

By its cubic trajectory optimisation, whose only call builds and solves. Run in an environment of
its own.
"""

from __future__ import annotations

import argparse
import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from pyroboplan.trajectory.trajectory_optimization import (
    CubicTrajectoryOptimization,
    CubicTrajectoryOptimizationOptions,
)
from recording.timing import LONG, timed

WAYPOINTS = (3, 6)
"""SNOPT takes half a minute for six."""


def solve(numbers: dict[str, Any], repeats: int, quick: bool) -> list[dict[str, Any]]:
    """One row per number of way points."""
    sizes = WAYPOINTS[:1] if quick else WAYPOINTS
    return [_row(numbers, n_points, repeats) for n_points in sizes]


def _row(numbers: dict[str, Any], n_points: int, repeats: int) -> dict[str, Any]:
    v = np.array(numbers["velocity"])
    a = np.array(numbers["acceleration"])
    options = CubicTrajectoryOptimizationOptions(
        num_waypoints=n_points, min_vel=-v, max_vel=v, min_accel=-a, max_accel=a
    )
    model = pin.buildModelFromUrdf(numbers["urdf"])
    planner = CubicTrajectoryOptimization(model, pin.GeometryModel(), options)
    ends = [np.array(numbers["start"]), np.array(numbers["goal"])]
    solving = timed(lambda: planner.plan(ends), repeats, LONG)
    curve = solving.value
    return {
        "setting": f"SNOPT, {n_points} way points",
        "build_s": None,
        "wall": solving.wall,
        "cpu": solving.cpu,
        "converged": curve is not None,
        "duration": None if curve is None else float(np.max(curve.segment_times)),
    }


def main() -> None:
    """Solve the problem of a file into another."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problem", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--repeats", type=int, required=True)
    parser.add_argument("--quick", action="store_true", help="the least number of way points only")
    arguments = parser.parse_args()
    runs = solve(json.loads(arguments.problem.read_text()), arguments.repeats, arguments.quick)
    versions = {name: version(name) for name in ("pyroboplan", "drake")}
    arguments.result.write_text(json.dumps({"versions": versions, "runs": runs}))


if __name__ == "__main__":
    main()

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


def solve(given: dict[str, Any], repeats: int, quick: bool) -> list[dict[str, Any]]:
    """One row per number of way points."""
    return [_row(given, n_points, repeats) for n_points in (WAYPOINTS[:1] if quick else WAYPOINTS)]


def _row(given: dict[str, Any], n_points: int, repeats: int) -> dict[str, Any]:
    v, a = np.array(given["velocity"]), np.array(given["acceleration"])
    options = CubicTrajectoryOptimizationOptions(
        num_waypoints=n_points, min_vel=-v, max_vel=v, min_accel=-a, max_accel=a
    )
    model = pin.buildModelFromUrdf(given["urdf"])
    planner = CubicTrajectoryOptimization(model, pin.GeometryModel(), options)
    ends = [np.array(given["start"]), np.array(given["goal"])]
    found = timed(lambda: planner.plan(ends), repeats, LONG)
    curve = found.value
    return {
        "setting": f"SNOPT, {n_points} way points",
        "build_s": None,
        "wall": found.wall,
        "cpu": found.cpu,
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
    given = parser.parse_args()
    runs = solve(json.loads(given.problem.read_text()), given.repeats, given.quick)
    versions = {name: version(name) for name in ("pyroboplan", "drake")}
    given.result.write_text(json.dumps({"versions": versions, "runs": runs}))


if __name__ == "__main__":
    main()

"""The quickest motion with Drake: ``python peer_drake.py PROBLEM.json RESULT.json --repeats N``.

By its KinematicTrajectoryOptimization. Run in an environment of its own.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np
from pydrake.planning import KinematicTrajectoryOptimization
from pydrake.solvers import IpoptSolver, SnoptSolver
from recording.peer import run_peer
from recording.timing import once, timed

CONTROL_POINTS = (12, 24)


def build(numbers: dict[str, Any], n_points: int) -> KinematicTrajectoryOptimization:
    """Bounds on the control points of velocity and acceleration imply bounds on the curves."""
    start = np.array(numbers["start"])
    goal = np.array(numbers["goal"])
    zero = np.zeros(len(start))
    problem = KinematicTrajectoryOptimization(len(start), n_points, spline_order=4, duration=4.0)
    problem.AddDurationCost(1.0)
    problem.AddDurationConstraint(0.5, 10.0)
    problem.AddPositionBounds(
        np.array(numbers["position_lower"]), np.array(numbers["position_upper"])
    )
    problem.AddVelocityBounds(-np.array(numbers["velocity"]), np.array(numbers["velocity"]))
    problem.AddAccelerationBounds(
        -np.array(numbers["acceleration"]), np.array(numbers["acceleration"])
    )
    for where, q in ((0.0, start), (1.0, goal)):
        problem.AddPathPositionConstraint(q, q, where)
        problem.AddPathVelocityConstraint(zero, zero, where)
    points = np.linspace(start, goal, n_points).T
    problem.get_mutable_prog().SetInitialGuess(problem.control_points(), points)
    return problem


def solve(numbers: dict[str, Any], repeats: int) -> list[dict[str, Any]]:
    """One row per solver and number of control points."""
    rows = []
    for solver in (SnoptSolver(), IpoptSolver()):
        for n_points in CONTROL_POINTS:
            rows.append(_row(solver, numbers, n_points, repeats))
    return rows


def _row(solver: Any, numbers: dict[str, Any], n_points: int, repeats: int) -> dict[str, Any]:
    building = once(lambda: build(numbers, n_points))
    solving = timed(lambda: solver.Solve(building.value.prog()), repeats)
    curve = building.value.ReconstructTrajectory(solving.value)
    return {
        "setting": f"{solver.solver_id().name()}, {n_points} control points",
        "build_s": building.wall,
        "wall": solving.wall,
        "cpu": solving.cpu,
        "converged": bool(solving.value.is_success()),
        "duration": float(curve.end_time() - curve.start_time()),
    }


if __name__ == "__main__":
    run_peer(
        __doc__,
        lambda problem, n: {"versions": {"drake": version("drake")}, "runs": solve(problem, n)},
    )

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


def solve(given: dict[str, Any], repeats: int) -> list[dict[str, Any]]:
    """One row per solver and number of control points."""
    return [
        _row(solver, given, n_points, repeats)
        for solver in (SnoptSolver(), IpoptSolver())
        for n_points in CONTROL_POINTS
    ]


def _row(solver: Any, given: dict[str, Any], n_points: int, repeats: int) -> dict[str, Any]:
    made = once(lambda: build(given, n_points))
    found = timed(lambda: solver.Solve(made.value.prog()), repeats)
    curve = made.value.ReconstructTrajectory(found.value)
    return {
        "setting": f"{solver.solver_id().name()}, {n_points} control points",
        "build_s": made.wall,
        "wall": found.wall,
        "cpu": found.cpu,
        "converged": bool(found.value.is_success()),
        "duration": float(curve.end_time() - curve.start_time()),
    }


if __name__ == "__main__":
    run_peer(
        __doc__,
        lambda problem, n: {"versions": {"drake": version("drake")}, "runs": solve(problem, n)},
    )

"""A shooting problem with hard limits by mim-solvers' CSQP: ``python peer_mim_solvers.py
PROBLEM.json RESULT.json --repeats N``.

Run in the environment of crocoddyl, whose models it solves.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import crocoddyl
import mim_solvers
import numpy as np
from recording.peer import run_peer
from recording.timing import LONG, once, timed

from horizon.peer_crocoddyl import costs, weightless

MAX_ITERATIONS = 200


def build(given: dict[str, Any]) -> tuple[Any, np.ndarray]:
    """The shooting problem and its first state."""
    model = weightless(given)
    state = crocoddyl.StateMultibody(model)
    actuation = crocoddyl.ActuationModelFull(state)
    x0 = np.concatenate([given["q"], np.zeros(model.nv)])
    h = given["duration"] / given["n_steps"]
    limits = [constraints(given, state, x0, torques=torques) for torques in (True, False)]
    steps = [
        crocoddyl.IntegratedActionModelEuler(
            crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, cost, limit), step
        )
        for cost, limit, step in zip(costs(given, state, x0), limits, (h, 0.0), strict=True)
    ]
    problem = crocoddyl.ShootingProblem(x0, [steps[0]] * given["n_steps"], steps[1])
    problem.nthreads = 1
    return problem, x0


def constraints(given: dict[str, Any], state: Any, x0: np.ndarray, *, torques: bool) -> Any:
    """Limits on joint positions, all velocities and joint torques; the wrench on the vehicle has
    none.
    """
    found = crocoddyl.ConstraintModelManager(state, state.nv)
    n = state.nv
    inner = x0[7 : 7 + n - 6]
    lower = np.concatenate(
        [np.full(6, -np.inf), given["position_lower"] - inner, -np.array(given["velocity"])]
    )
    upper = np.concatenate([np.full(6, np.inf), given["position_upper"] - inner, given["velocity"]])
    away = crocoddyl.ResidualModelState(state, x0, n)
    found.addConstraint("state", crocoddyl.ConstraintModelResidual(state, away, lower, upper))
    if torques:
        most = np.concatenate([np.full(6, np.inf), given["effort"]])
        control = crocoddyl.ResidualModelControl(state, n)
        found.addConstraint(
            "torque", crocoddyl.ConstraintModelResidual(state, control, -most, most)
        )
    return found


def solve(given: dict[str, Any], repeats: int) -> dict[str, Any]:
    """Cold from rest with zero forces."""
    made = once(lambda: build(given))
    problem, x0 = made.value
    xs = [x0] * (problem.T + 1)
    us = [np.zeros(problem.runningModels[0].nu)] * problem.T

    def call() -> tuple[bool, Any]:
        solver = mim_solvers.SolverCSQP(problem)
        solver.termination_tolerance = given["tolerance"]
        solver.eps_abs = 1e-8
        solver.eps_rel = 0.0
        solver.max_qp_iters = 1000
        return bool(solver.solve(xs, us, MAX_ITERATIONS, False)), solver

    found = timed(call, repeats, LONG)
    converged, solver = found.value
    versions = (
        f"{version('mim-solvers')} with crocoddyl {version('crocoddyl')} and pin {version('pin')}"
    )
    return {
        "versions": {"mim-solvers": versions},
        "build_s": made.wall,
        "wall": found.wall,
        "cpu": found.cpu,
        "iterations": solver.iter,
        "converged": converged,
        "cost": solver.cost,
    }


if __name__ == "__main__":
    run_peer(__doc__, solve)

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


def build(numbers: dict[str, Any]) -> tuple[Any, np.ndarray]:
    """Build the shooting problem and its first state."""
    model = weightless(numbers)
    state = crocoddyl.StateMultibody(model)
    actuation = crocoddyl.ActuationModelFull(state)
    x0 = np.concatenate([numbers["q"], np.zeros(model.nv)])
    h = numbers["duration"] / numbers["n_steps"]
    dynamics = crocoddyl.DifferentialActionModelFreeFwdDynamics
    running, terminal = costs(numbers, state, x0)
    limits = constraints(numbers, state, x0, torques=True)
    end_limits = constraints(numbers, state, x0, torques=False)
    step = crocoddyl.IntegratedActionModelEuler(dynamics(state, actuation, running, limits), h)
    end = crocoddyl.IntegratedActionModelEuler(
        dynamics(state, actuation, terminal, end_limits), 0.0
    )
    problem = crocoddyl.ShootingProblem(x0, [step] * numbers["n_steps"], end)
    problem.nthreads = 1
    return problem, x0


def constraints(numbers: dict[str, Any], state: Any, x0: np.ndarray, *, torques: bool) -> Any:
    """Build limits on joint positions, all velocities and joint torques; the wrench on the vehicle has
    none.
    """
    manager = crocoddyl.ConstraintModelManager(state, state.nv)
    n = state.nv
    inner = x0[7 : 7 + n - 6]
    lower = np.concatenate(
        [np.full(6, -np.inf), numbers["position_lower"] - inner, -np.array(numbers["velocity"])]
    )
    upper = np.concatenate(
        [np.full(6, np.inf), numbers["position_upper"] - inner, numbers["velocity"]]
    )
    away = crocoddyl.ResidualModelState(state, x0, n)
    manager.addConstraint("state", crocoddyl.ConstraintModelResidual(state, away, lower, upper))
    if torques:
        effort = np.concatenate([np.full(6, np.inf), numbers["effort"]])
        control = crocoddyl.ResidualModelControl(state, n)
        manager.addConstraint(
            "torque", crocoddyl.ConstraintModelResidual(state, control, -effort, effort)
        )
    return manager


def solve(numbers: dict[str, Any], repeats: int) -> dict[str, Any]:
    """Solve cold from rest with zero forces."""
    building = once(lambda: build(numbers))
    problem, x0 = building.value
    xs = [x0] * (problem.T + 1)
    us = [np.zeros(problem.runningModels[0].nu)] * problem.T

    def call() -> tuple[bool, Any]:
        solver = mim_solvers.SolverCSQP(problem)
        solver.termination_tolerance = numbers["tolerance"]
        solver.eps_abs = 1e-8
        solver.eps_rel = 0.0
        solver.max_qp_iters = 1000
        return bool(solver.solve(xs, us, MAX_ITERATIONS, False)), solver

    solving = timed(call, repeats, LONG)
    converged, solver = solving.value
    versions = (
        f"{version('mim-solvers')} with crocoddyl {version('crocoddyl')} and pin {version('pin')}"
    )
    return {
        "versions": {"mim-solvers": versions},
        "build_s": building.wall,
        "wall": solving.wall,
        "cpu": solving.cpu,
        "iterations": solver.iter,
        "converged": converged,
        "cost": solver.cost,
    }


if __name__ == "__main__":
    run_peer(__doc__, solve)

"""A shooting problem with crocoddyl; run in its own environment.

python peer_crocoddyl.py problem.json result.json
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import crocoddyl
import numpy as np
import pinocchio as pin

REPEATS = 10
MAX_ITERATIONS = 200


def build(given: dict[str, Any]) -> tuple[crocoddyl.ShootingProblem, np.ndarray]:
    model = pin.buildModelFromUrdf(given["urdf"], pin.JointModelFreeFlyer())
    for i, body in enumerate(given["inertias"]):
        model.inertias[i] = pin.Inertia(body["mass"], np.array(body["lever"]), np.array(body["inertia"]))
    model.gravity.linear = np.zeros(3)
    state = crocoddyl.StateMultibody(model)
    actuation = crocoddyl.ActuationModelFull(state)  # every velocity has a force of its own
    x0 = np.concatenate([given["q"], np.zeros(model.nv)])
    running, terminal = costs(given, state, x0)
    h = given["duration"] / given["n_steps"]
    steps = [
        crocoddyl.IntegratedActionModelEuler(
            crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, cost), step
        )
        for cost, step in ((running, h), (terminal, 0.0))
    ]
    problem = crocoddyl.ShootingProblem(x0, [steps[0]] * given["n_steps"], steps[1])
    problem.nthreads = 1
    return problem, x0


def costs(given: dict[str, Any], state: Any, x0: np.ndarray) -> tuple[Any, Any]:
    """Running and terminal costs; residuals are those of the other side, weights are theirs squared."""
    w, T, n_u = given["weights"], given["duration"], state.nv
    running, terminal = crocoddyl.CostModelSum(state, n_u), crocoddyl.CostModelSum(state, n_u)
    units = crocoddyl.ActivationModelWeightedQuad(1.0 / np.array(given["control_unit"]) ** 2)
    control = crocoddyl.CostModelResidual(state, units, crocoddyl.ResidualModelControl(state, n_u))
    stay = crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelState(state, x0, n_u))
    running.addCost("control", control, w["control"] ** 2 / T)
    running.addCost("state", stay, w["state"] ** 2 / T)
    tool = state.pinocchio.getFrameId("tool")
    position = crocoddyl.ResidualModelFrameTranslation(state, tool, np.array(given["goal_position"]), n_u)
    turn = crocoddyl.ResidualModelFrameRotation(state, tool, np.array(given["goal_rotation"]), n_u)
    terminal.addCost("position", crocoddyl.CostModelResidual(state, position), w["tool"] ** 2)
    terminal.addCost("turn", crocoddyl.CostModelResidual(state, turn), w["tool"] ** 2)
    terminal.addCost("state", stay, w["end_state"] ** 2)
    return running, terminal


def solve(given: dict[str, Any]) -> dict[str, Any]:
    problem, x0 = build(given)
    xs, us = [x0] * (problem.T + 1), [np.zeros(problem.runningModels[0].nu)] * problem.T
    cold = timed(problem, xs, us)
    solver = cold.pop("solver")
    warm = timed(problem, list(solver.xs), list(solver.us))
    warm.pop("solver")
    n_q = len(given["q"])
    x = np.array(solver.xs)
    return {
        "versions": {"crocoddyl": version("crocoddyl"), "pin": version("pin")},
        "cold": cold,
        "warm": warm,
        "cost": solver.cost,
        "q": x[:, :n_q].tolist(),
        "v": x[:, n_q:].tolist(),
        "u": np.array(solver.us).tolist(),
    }


def timed(problem: Any, xs: list[np.ndarray], us: list[np.ndarray]) -> dict[str, Any]:
    walls, cpus = [], []
    for _ in range(REPEATS):
        solver = crocoddyl.SolverFDDP(problem)
        begin, begin_cpu = perf_counter(), process_time()
        converged = solver.solve(xs, us, MAX_ITERATIONS, False)
        walls.append(perf_counter() - begin)
        cpus.append(process_time() - begin_cpu)
    return {
        "wall": min(walls),
        "cpu": min(cpus),
        "iterations": solver.iter,
        "converged": bool(converged),
        "solver": solver,
    }


if __name__ == "__main__":
    result = solve(json.loads(Path(sys.argv[1]).read_text()))
    Path(sys.argv[2]).write_text(json.dumps(result))

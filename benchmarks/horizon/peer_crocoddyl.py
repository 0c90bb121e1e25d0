"""A shooting problem with crocoddyl: ``python peer_crocoddyl.py PROBLEM.json RESULT.json --repeats
N``.

Run in an environment of its own.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import crocoddyl
import numpy as np
import pinocchio as pin
from recording.peer import run_peer
from recording.timing import once, timed

MAX_ITERATIONS = 200


def build(given: dict[str, Any]) -> tuple[Any, np.ndarray]:
    """The shooting problem and its first state."""
    model = weightless(given)
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


def weightless(given: dict[str, Any]) -> Any:
    """The robot with its trim bodies, without gravity."""
    model = pin.buildModelFromUrdf(given["urdf"], pin.JointModelFreeFlyer())
    for i, body in enumerate(given["inertias"]):
        model.inertias[i] = pin.Inertia(
            body["mass"], np.array(body["lever"]), np.array(body["inertia"])
        )
    model.gravity.linear = np.zeros(3)
    return model


def costs(given: dict[str, Any], state: Any, x0: np.ndarray) -> tuple[Any, Any]:
    """Running and terminal costs; residuals and the weights of their squares are those of the other
    side.
    """
    w = given["weights"]
    T = given["duration"]
    n_u = state.nv
    running, terminal = crocoddyl.CostModelSum(state, n_u), crocoddyl.CostModelSum(state, n_u)
    units = crocoddyl.ActivationModelWeightedQuad(1.0 / np.array(given["control_unit"]) ** 2)
    control = crocoddyl.CostModelResidual(state, units, crocoddyl.ResidualModelControl(state, n_u))
    stay = crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelState(state, x0, n_u))
    running.addCost("control", control, w["control"] / T)
    running.addCost("state", stay, w["state"] / T)
    tool = state.pinocchio.getFrameId("tool")
    position = crocoddyl.ResidualModelFrameTranslation(
        state, tool, np.array(given["goal_position"]), n_u
    )
    turn = crocoddyl.ResidualModelFrameRotation(state, tool, np.array(given["goal_rotation"]), n_u)
    terminal.addCost("position", crocoddyl.CostModelResidual(state, position), w["tool"])
    terminal.addCost("turn", crocoddyl.CostModelResidual(state, turn), w["tool"])
    terminal.addCost("state", stay, w["end_state"])
    return running, terminal


def solve(given: dict[str, Any], repeats: int) -> dict[str, Any]:
    """Cold from rest with zero forces, and warm from the solution."""
    made = once(lambda: build(given))
    problem, x0 = made.value
    xs = [x0] * (problem.T + 1)
    us = [np.zeros(problem.runningModels[0].nu)] * problem.T
    cold, solver = calls(problem, xs, us, repeats)
    warm, _ = calls(problem, list(solver.xs), list(solver.us), repeats)
    n_q = len(given["q"])
    x = np.array(solver.xs)
    return {
        "versions": {"crocoddyl": f"{version('crocoddyl')} with pin {version('pin')}"},
        "build_s": made.wall,
        "cold": cold,
        "warm": warm,
        "cost": solver.cost,
        "q": x[:, :n_q].tolist(),
        "v": x[:, n_q:].tolist(),
        "u": np.array(solver.us).tolist(),
    }


def calls(
    problem: Any, xs: list[np.ndarray], us: list[np.ndarray], repeats: int
) -> tuple[dict[str, Any], Any]:
    """Times and outcome of solves from states and forces; and the solver of the last."""

    def call() -> tuple[bool, Any]:
        solver = crocoddyl.SolverFDDP(problem)
        return bool(solver.solve(xs, us, MAX_ITERATIONS, False)), solver

    found = timed(call, repeats)
    converged, solver = found.value
    return {
        "wall": found.wall,
        "cpu": found.cpu,
        "iterations": solver.iter,
        "converged": converged,
    }, solver


if __name__ == "__main__":
    run_peer(__doc__, solve)

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


def build(numbers: dict[str, Any]) -> tuple[Any, np.ndarray]:
    """Build the shooting problem and its first state."""
    model = weightless(numbers)
    state = crocoddyl.StateMultibody(model)
    actuation = crocoddyl.ActuationModelFull(state)  # every velocity has a force of its own
    x0 = np.concatenate([numbers["q"], np.zeros(model.nv)])
    running, terminal = costs(numbers, state, x0)
    h = numbers["duration"] / numbers["n_steps"]
    dynamics = crocoddyl.DifferentialActionModelFreeFwdDynamics
    step = crocoddyl.IntegratedActionModelEuler(dynamics(state, actuation, running), h)
    end = crocoddyl.IntegratedActionModelEuler(dynamics(state, actuation, terminal), 0.0)
    problem = crocoddyl.ShootingProblem(x0, [step] * numbers["n_steps"], end)
    problem.nthreads = 1
    return problem, x0


def weightless(numbers: dict[str, Any]) -> Any:
    """Build the robot with its trim bodies, without gravity."""
    model = pin.buildModelFromUrdf(numbers["urdf"], pin.JointModelFreeFlyer())
    for i, body in enumerate(numbers["inertias"]):
        model.inertias[i] = pin.Inertia(
            body["mass"], np.array(body["lever"]), np.array(body["inertia"])
        )
    model.gravity.linear = np.zeros(3)
    return model


def costs(numbers: dict[str, Any], state: Any, x0: np.ndarray) -> tuple[Any, Any]:
    """Build running and terminal costs; residuals and the weights of their squares are those of the other
    side.
    """
    w = numbers["weights"]
    T = numbers["duration"]
    n_u = state.nv
    running = crocoddyl.CostModelSum(state, n_u)
    terminal = crocoddyl.CostModelSum(state, n_u)
    units = crocoddyl.ActivationModelWeightedQuad(1.0 / np.array(numbers["control_unit"]) ** 2)
    control = crocoddyl.CostModelResidual(state, units, crocoddyl.ResidualModelControl(state, n_u))
    stay = crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelState(state, x0, n_u))
    running.addCost("control", control, w["control"] / T)
    running.addCost("state", stay, w["state"] / T)
    tool = state.pinocchio.getFrameId("tool")
    position = crocoddyl.ResidualModelFrameTranslation(
        state, tool, np.array(numbers["goal_position"]), n_u
    )
    turn = crocoddyl.ResidualModelFrameRotation(
        state, tool, np.array(numbers["goal_rotation"]), n_u
    )
    terminal.addCost("position", crocoddyl.CostModelResidual(state, position), w["tool"])
    terminal.addCost("turn", crocoddyl.CostModelResidual(state, turn), w["tool"])
    terminal.addCost("state", stay, w["end_state"])
    return running, terminal


def solve(numbers: dict[str, Any], repeats: int) -> dict[str, Any]:
    """Solve cold from rest with zero forces, and warm from the solution."""
    building = once(lambda: build(numbers))
    problem, x0 = building.value
    xs = [x0] * (problem.T + 1)
    us = [np.zeros(problem.runningModels[0].nu)] * problem.T
    cold, solver = calls(problem, xs, us, repeats)
    warm, _ = calls(problem, list(solver.xs), list(solver.us), repeats)
    n_q = len(numbers["q"])
    x = np.array(solver.xs)
    return {
        "versions": {"crocoddyl": f"{version('crocoddyl')} with pin {version('pin')}"},
        "build_s": building.wall,
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
    """Measure solves from states and forces; returns times, the outcome and the last solver."""

    def call() -> tuple[bool, Any]:
        solver = crocoddyl.SolverFDDP(problem)
        return bool(solver.solve(xs, us, MAX_ITERATIONS, False)), solver

    solving = timed(call, repeats)
    converged, solver = solving.value
    return {
        "wall": solving.wall,
        "cpu": solving.cpu,
        "iterations": solver.iter,
        "converged": converged,
    }, solver


if __name__ == "__main__":
    run_peer(__doc__, solve)

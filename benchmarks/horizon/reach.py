"""Times of the tool reach, cold and warm, in a process of its own: ``python reach.py STEPS
RESULT.json --repeats N``.

Writes the rows of the exact Hessian with both solvers; without a compiler step functions run in
CasADi's virtual machine.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from recording.timing import Timed, built, timed

from horizon.ours import sparse_program
from horizon.problems import tool_reach
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.solvers.nlp.options import NlpOptions

PLUGINS = ("stagewise", "ipopt")
LOOSE = 1e-6
"""Convergence tolerance with Gauss and Newton's Hessian."""
# By which a start has moved, as a measurement would have it
SHIFT = 0.02  # [m]
TURN = 0.02  # [rad]


def exact_rows(n_steps: int, repeats: int, *, cold: bool) -> list[dict[str, Any]]:
    """Measure both solvers with the exact Hessian; cold: built from an empty cache of compiled
    code.
    """
    problem = tool_reach(n_steps)
    table = []
    for plugin in PLUGINS:
        table += rows("exact", problem, NlpOptions(plugin=plugin), repeats, cold)
    return table


def gauss_newton_rows(n_steps: int, repeats: int) -> list[dict[str, Any]]:
    """Measure both solvers with Gauss and Newton's Hessian."""
    problem = tool_reach(n_steps, hessian=HessianKind.GAUSS_NEWTON)
    setting = f"Gauss-Newton, {LOOSE:g}"
    table = []
    for plugin in PLUGINS:
        options = NlpOptions(plugin=plugin, convergence=LOOSE)
        table += rows(setting, problem, options, repeats, True)
    return table


def rows(
    setting: str, problem: OcpProblem, options: NlpOptions, repeats: int, cold: bool
) -> list[dict[str, Any]]:
    """A solve from rest, and two from its solution: the same problem again, and one whose start has
    moved.
    """
    build = built(partial(Planner, problem, options), cold=cold)
    planner = build.value
    from_rest = timed(lambda: planner.plan(guess=hold_guess(problem), diagnose=False), repeats)
    solves = {"cold": from_rest}
    for start, again in (("warm", problem), ("moved", moved(problem))):
        call = partial(planner.plan, again, guess=from_rest.value, diagnose=False)
        solves[start] = timed(call, repeats)
    head = {"steps": problem.n_steps, "solver": options.plugin, "setting": setting}
    return [
        head | {"build_s": build.wall, "start": start} | _row(planner, solve)
        for start, solve in solves.items()
    ]


def moved(problem: OcpProblem) -> OcpProblem:
    """Move the start of a problem by what a measurement may be off."""
    tangent = np.array([SHIFT, 0.0, 0.0, 0.0, 0.0, TURN, *np.zeros(problem.robot.n_v - 6)])
    q = pin.integrate(problem.robot.model, problem.start.q, tangent)
    return replace(problem, start=replace(problem.start, q=q))


def _row(planner: Planner, solve: Timed[Plan]) -> dict[str, Any]:
    plan = solve.value
    assert plan.result is not None
    *_, last = sparse_program(planner).program.nlps
    cost = last.functions["nlp_f"](plan.result.x, planner.transcription.parameters())
    return {
        "status": plan.result.status.value,
        "iterations": plan.iterations,
        "cpu_ms": 1e3 * solve.cpu,
        "wall_ms": 1e3 * solve.wall,
        "goal": plan.levels[0].residual,
        "cost": float(cost),
    }


def main() -> None:
    """Write the rows of one size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", type=int)
    parser.add_argument("result", type=Path)
    parser.add_argument("--repeats", type=int, required=True)
    arguments = parser.parse_args()
    arguments.result.write_text(
        json.dumps(exact_rows(arguments.steps, arguments.repeats, cold=True))
    )


if __name__ == "__main__":
    main()

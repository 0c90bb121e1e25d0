"""Our side of the comparison with the peers, one problem in all settings, in a process of its own.

    python ours.py shooting|limited|quickest STEPS RESULT.json --repeats N [--peer RESULT.json] [--quick]

Without a compiler step functions run in CasADi's virtual machine. What a peer has found is put into
our cost and our equations of motion. Quick: one setting, and a build that may take compiled code
from the cache.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from recording.timing import LONG, built, timed

from horizon.peer_problems import limited_problem, quickest_problem, shooting_problem
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, hold_guess
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.level_solver import NlpOptions

CONVERGENCE = (1e-6, 1e-8)
GAUSS_NEWTON = "Gauss-Newton"
EXACT = "exact"


def settings(kind: str, n_steps: int) -> Iterator[tuple[str, str, OcpProblem]]:
    """Solver, Hessian and problem."""
    for plugin in ("stagewise", "ipopt"):
        if kind == "limited":
            yield plugin, GAUSS_NEWTON, limited_problem(n_steps)
        elif kind == "quickest":
            yield plugin, EXACT, quickest_problem(n_steps)
        elif plugin == "stagewise":
            yield plugin, GAUSS_NEWTON, shooting_problem(n_steps)
        else:
            yield plugin, GAUSS_NEWTON, shooting_problem(n_steps)
            yield plugin, EXACT, shooting_problem(n_steps, exact=True)


def solve(kind: str, n_steps: int, repeats: int, quick: bool) -> list[dict[str, Any]]:
    """One row per setting: times of solves, cold and from the solution, and of `Planner.plan`."""
    chosen = list(settings(kind, n_steps))
    rows = []
    for plugin, hessian, problem in chosen[:1] if quick else chosen:
        first, *others = (
            NlpOptions(plugin=plugin, convergence=convergence) for convergence in CONVERGENCE
        )
        made = built(partial(Planner, problem, first), cold=not quick)
        shared = made.value.transcription
        planners = [
            made.value,
            *(Planner(problem, options, transcription=shared) for options in others),
        ]
        for planner in planners[:1] if quick else planners:
            found = {
                "plugin": plugin,
                "hessian": hessian,
                "convergence": planner.options.convergence,
            }
            rows.append(found | {"build_s": made.wall} | measured(planner, repeats))
    return rows


def measured(planner: Planner, repeats: int) -> dict[str, Any]:
    """Times and outcome of cold and warm solves, and of a whole plan: refined between nodes, and
    judged.
    """
    rest = hold_guess(planner.problem)
    parameters = planner.transcription.parameters()
    cold = timed(lambda: planner.solve(parameters, rest), repeats, LONG)
    result = cold.value
    warm = timed(lambda: planner.solve(parameters, result), repeats, LONG)
    whole = timed(lambda: planner.plan(guess=rest, diagnose=False), repeats, LONG)
    return {
        "wall": cold.wall,
        "cpu": cold.cpu,
        "warm_cpu": warm.cpu,
        "plan_cpu": whole.cpu,
        "iterations": sum(result.iterations),
        "warm_iterations": sum(warm.value.iterations),
        "status": result.status.value,
        "cost": cost(sparse_program(planner), result.x),
        "duration": float(planner.transcription.unpack(result.x).t[-1]),
    }


def sparse_program(planner: Planner) -> Transcription:
    """The sparse program of a planner, whose cost is that of every plugin."""
    own = planner.transcription
    return own if isinstance(own, Transcription) else Transcription(planner.problem)


def cost(transcription: Transcription, x: np.ndarray) -> float:
    """Of the only level, at the variables x (n_x,)."""
    (level,) = transcription.program.nlps
    return float(level.functions["nlp_f"](x, transcription.parameters()))


def judged(found: dict[str, Any], n_steps: int) -> dict[str, float]:
    """Cost and largest violation, in our terms, of states and controls that a peer has found."""
    problem = shooting_problem(n_steps)
    transcription = Transcription(problem)
    q, v, u = (np.array(found[name]) for name in ("q", "v", "u"))
    t = problem.nominal_times()
    n = problem.robot.n_vehicle
    a = np.diff(v, axis=0) / np.diff(t)[:, None]
    given = Trajectory(t=t, q=q, v=v, a=a, thrust=u[:, :n], torque=u[:, n:])
    x = transcription.pack(given)
    ours = transcription.unpack(x)
    units = transcription.model.actuators
    forces = np.hstack(
        [
            (ours.thrust - given.thrust) / units.thrust_unit,
            (ours.torque - given.torque) / units.torque_unit,
        ]
    )
    violations = [
        abs(value) for value in transcription.violations(x, transcription.parameters()).values()
    ]
    return {
        "cost": cost(transcription, x),
        "violation": max(*violations, float(np.abs(forces).max())),
    }


def main() -> None:
    """Write all rows, and what the peer's result is worth."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=("shooting", "limited", "quickest"))
    parser.add_argument("steps", type=int)
    parser.add_argument("result", type=Path)
    parser.add_argument("--repeats", type=int, required=True)
    parser.add_argument("--peer", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    result: dict[str, Any] = {"rows": solve(given.kind, given.steps, given.repeats, given.quick)}
    if given.peer:
        result["judged"] = judged(json.loads(given.peer.read_text()), given.steps)
    given.result.write_text(json.dumps(result))


if __name__ == "__main__":
    main()

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
from uvms_ocp.solvers.nlp.options import NlpOptions

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
    if quick:
        chosen = chosen[:1]
    rows = []
    for plugin, hessian, problem in chosen:
        options = [NlpOptions(plugin=plugin, convergence=value) for value in CONVERGENCE]
        build = built(partial(Planner, problem, options[0]), cold=not quick)
        transcription = build.value.transcription
        planners = [build.value]
        if not quick:
            planners += [Planner(problem, o, transcription=transcription) for o in options[1:]]
        for planner in planners:
            row = {
                "plugin": plugin,
                "hessian": hessian,
                "convergence": planner.options.convergence,
                "build_s": build.wall,
            }
            rows.append(row | measured(planner, repeats))
    return rows


def measured(planner: Planner, repeats: int) -> dict[str, Any]:
    """Times and outcome of cold and warm solves, and of a whole plan: refined between nodes, and
    judged.
    """
    at_rest = hold_guess(planner.problem)
    parameters = planner.transcription.parameters()
    cold = timed(lambda: planner.solve(parameters, at_rest), repeats, LONG)
    result = cold.value
    warm = timed(lambda: planner.solve(parameters, result), repeats, LONG)
    whole = timed(lambda: planner.plan(guess=at_rest, diagnose=False), repeats, LONG)
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
    if isinstance(planner.transcription, Transcription):
        return planner.transcription
    return Transcription(planner.problem)


def cost(transcription: Transcription, x: np.ndarray) -> float:
    """Evaluate the cost of the only level at the variables x (n_x,)."""
    (level,) = transcription.program.nlps
    return float(level.functions["nlp_f"](x, transcription.parameters()))


def judged(solution: dict[str, Any], n_steps: int) -> dict[str, float]:
    """Cost and largest violation, in our terms, of states and controls that a peer has found."""
    problem = shooting_problem(n_steps)
    transcription = Transcription(problem)
    q = np.array(solution["q"])
    v = np.array(solution["v"])
    u = np.array(solution["u"])
    t = problem.nominal_times()
    n = problem.robot.n_vehicle
    a = np.diff(v, axis=0) / np.diff(t)[:, None]
    by_peer = Trajectory(t=t, q=q, v=v, a=a, thrust=u[:, :n], torque=u[:, n:])
    x = transcription.pack(by_peer)
    ours = transcription.unpack(x)
    units = transcription.model.actuators
    thrust_gap = (ours.thrust - by_peer.thrust) / units.thrust_unit
    torque_gap = (ours.torque - by_peer.torque) / units.torque_unit
    force_gap = float(np.abs(np.hstack([thrust_gap, torque_gap])).max())
    violations = transcription.violations(x, transcription.parameters()).values()
    largest_violation = max(abs(value) for value in violations)
    return {"cost": cost(transcription, x), "violation": max(largest_violation, force_gap)}


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
    arguments = parser.parse_args()
    result: dict[str, Any] = {
        "rows": solve(arguments.kind, arguments.steps, arguments.repeats, arguments.quick)
    }
    if arguments.peer:
        result["judged"] = judged(json.loads(arguments.peer.read_text()), arguments.steps)
    arguments.result.write_text(json.dumps(result))


if __name__ == "__main__":
    main()

"""The same problems with the peers and with ours: rows of all of them."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from peer_environments import interpreter
from recording.processes import run_script
from recording.report import Row

from horizon.peer_problems import (
    least_time,
    limited_numbers,
    limited_problem,
    quickest_numbers,
    quickest_problem,
    shooting_numbers,
    shooting_problem,
    write,
)

FOLDER = Path(__file__).parent
LIMITED_TOLERANCE = 1e-6
COMPILED = "compiled"
INTERPRETED = "virtual machine"
SIDES = ("crocoddyl FDDP", "uvms_ocp stagewise")
QUICKEST = {"peer_drake": "Drake KTO", "peer_pyroboplan": "PyRoboPlan"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """Folders of the peers, and how much is measured."""

    peers: Path | None
    """Folder of their environments; None leaves them out."""
    scratch: Path
    repeats: int
    """Number of times that every call is made, theirs and ours, after one to warm up."""
    quick: bool

    def run_peer(
        self, environment: str, script: str, numbers: Mapping[str, Any], *words: object
    ) -> dict[str, Any]:
        """Solve a problem by a peer, in its own environment."""
        assert self.peers is not None
        problem = write(numbers, self.scratch / "problem.json")
        result = self.scratch / f"{script}.json"
        python = interpreter(self.peers, environment)
        program = FOLDER / f"{script}.py"
        run_script(python, program, problem, result, "--repeats", self.repeats, *words)
        outcome: dict[str, Any] = json.loads(result.read_text())
        return outcome

    def run_ours(
        self,
        kind: str,
        n_steps: int,
        how: str,
        judge: str | None = None,
        *,
        first_setting: bool = False,
    ) -> dict[str, Any]:
        """Solve a problem by ours, and judge the peer's solution; first_setting: alone, and built
        from what was compiled before.
        """
        result = self.scratch / "ours.json"
        words: list[object] = [kind, n_steps, result, "--repeats", self.repeats]
        if self.quick or first_setting:
            words.append("--quick")
        if judge is not None:
            words += ["--peer", self.scratch / f"{judge}.json"]
        run_script(sys.executable, FOLDER / "ours.py", *words, compiler=how == COMPILED)
        outcome: dict[str, Any] = json.loads(result.read_text())
        return outcome

    @property
    def ways(self) -> tuple[str, ...]:
        """Ways in which our functions run; the solution of a peer is judged in the first."""
        return (INTERPRETED,) if self.quick else (COMPILED, INTERPRETED)


def shooting_rows(comparison: Comparison, n_steps: int) -> tuple[list[Row], dict[str, str]]:
    """crocoddyl first: ratios are to its time, and `off` is the share by which a cost differs from
    its.
    """
    name = f"shooting, N = {n_steps}"
    judge = "peer_crocoddyl" if comparison.peers else None
    peer: dict[str, Any] = {}
    if judge:
        peer = comparison.run_peer("crocoddyl", judge, shooting_numbers(shooting_problem(n_steps)))
    reference = peer.get("cold", {}).get("cpu")
    cost = peer.get("cost")
    rows: list[Row] = []
    for how in comparison.ways:
        ours = comparison.run_ours("shooting", n_steps, how, judge)
        if judge and how == comparison.ways[0]:
            rows.append(_crocoddyl_row(name, peer, ours["judged"]))
        rows += [our_row(name, row, how, reference, (row["cost"], cost)) for row in ours["rows"]]
    return rows, peer.get("versions", {})


def turns(comparison: Comparison, n_steps: int, rounds: int) -> list[Row]:
    """crocoddyl and ours, with its Hessian and the first tolerance, one after the other several
    times: least times and medians.

    So both have the same of a machine that others use as well. Ratios are of the least times, and
    the median of all rounds.
    """
    if not comparison.peers:
        return []
    numbers = shooting_numbers(shooting_problem(n_steps))
    how = comparison.ways[0]
    peer_times = []
    our_times = []
    for _ in range(rounds):
        peer = comparison.run_peer("crocoddyl", "peer_crocoddyl", numbers)
        peer_times.append(peer["cold"]["cpu"])
        ours = comparison.run_ours("shooting", n_steps, how, first_setting=True)
        our_times.append(ours["rows"][0]["cpu"])
    rows: list[Row] = []
    for side, seconds in zip(SIDES, (peer_times, our_times), strict=True):
        ratios = np.array(seconds) / np.array(peer_times)
        rows.append(
            {
                "problem": f"shooting, N = {n_steps}",
                "solver": side,
                "least_ms": 1e3 * min(seconds),
                "median_ms": 1e3 * float(np.median(seconds)),
                "ratio": min(seconds) / min(peer_times),
                "median_ratio": float(np.median(ratios)),
            }
        )
    return rows


def _crocoddyl_row(name: str, peer: Mapping[str, Any], judged: Mapping[str, float]) -> Row:
    cold = peer["cold"]
    status = "converged" if cold["converged"] else "not converged"
    return {
        "problem": name,
        "solver": "crocoddyl FDDP",
        "setting": "Gauss-Newton",
        **times(peer | cold, cold["cpu"]),
        "warm_cpu_ms": 1e3 * peer["warm"]["cpu"],
        "iterations": cold["iterations"],
        "result": judged["cost"],
        "off": off(judged["cost"], peer["cost"]),
        "status": f"{status}; breaks our equations by {judged['violation']:.1e}",
    }


def limited_rows(comparison: Comparison, n_steps: int) -> tuple[list[Row], dict[str, str]]:
    """mim-solvers first: ratios are to its time; `off` is the share by which a cost differs from
    that of mim-solvers.
    """
    name = f"limited, N = {n_steps}"
    peer: dict[str, Any] = {}
    if comparison.peers:
        numbers = limited_numbers(limited_problem(n_steps), LIMITED_TOLERANCE)
        peer = comparison.run_peer("crocoddyl", "peer_mim_solvers", numbers)
    rows: list[Row] = []
    if peer:
        status = "converged" if peer["converged"] else "not converged"
        rows.append(
            {
                "problem": name,
                "solver": "mim-solvers CSQP",
                "setting": f"Gauss-Newton, {LIMITED_TOLERANCE:g}",
                **times(peer, peer["cpu"]),
                "iterations": peer["iterations"],
                "result": peer["cost"],
                "status": status,
            }
        )
    best = peer.get("cost") if peer.get("converged") else None
    how = comparison.ways[0]
    for row in comparison.run_ours("limited", n_steps, how)["rows"]:
        rows.append(our_row(name, row, how, peer.get("cpu"), (row["cost"], best)))
    return rows, peer.get("versions", {})


def quickest_rows(
    comparison: Comparison, sizes: tuple[int, ...]
) -> tuple[list[Row], dict[str, str]]:
    """Ratios are to the fastest peer; `off` is the share by which a duration exceeds the known
    optimum.
    """
    problem = quickest_problem(sizes[0])
    best = least_time(problem)
    peers = _quickest_peers(comparison, quickest_numbers(problem))
    peer_times = list[float]()
    versions: dict[str, str] = {}
    for peer in peers.values():
        peer_times += [run["cpu"] for run in peer["runs"]]
        versions |= peer["versions"]
    reference = min(peer_times, default=None)
    rows = [*_quickest_peer_rows(peers, reference, best)]
    for n_steps in sizes:
        for how in comparison.ways:
            for outcome in comparison.run_ours("quickest", n_steps, how)["rows"]:
                row = our_row("quickest", outcome, how, reference, (outcome["duration"], best))
                rows.append({**row, "setting": f"N = {n_steps}, {row['setting']}"})
    return rows, versions


def _quickest_peers(
    comparison: Comparison, numbers: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    if comparison.peers is None:
        return {}
    words = ["--quick"] if comparison.quick else []
    return {
        "peer_drake": comparison.run_peer("drake", "peer_drake", numbers),
        "peer_pyroboplan": comparison.run_peer("drake", "peer_pyroboplan", numbers, *words),
    }


def _quickest_peer_rows(
    peers: Mapping[str, Any], reference: float | None, best: float
) -> Iterator[Row]:
    for script, peer in peers.items():
        for run in peer["runs"]:
            yield {
                "problem": "quickest",
                "solver": QUICKEST[script],
                "setting": run["setting"],
                **times(run, reference),
                "result": run["duration"],
                "off": off(run["duration"], best),
                "status": "converged" if run["converged"] else "failed",
            }


def our_row(
    problem: str,
    row: Mapping[str, Any],
    how: str,
    reference: float | None,
    result: tuple[float, float | None],
) -> Row:
    """A row of ours; result: what was found, and what it is compared with."""
    return {
        "problem": problem,
        "solver": f"uvms_ocp {row['plugin']}",
        "setting": f"{row['hessian']}, {row['convergence']:g}, {how}",
        **times(row, reference),
        "warm_cpu_ms": 1e3 * row["warm_cpu"],
        "iterations": row["iterations"],
        "result": result[0],
        "off": off(*result),
        "status": row["status"],
    }


def times(outcome: Mapping[str, Any], reference: float | None) -> dict[str, float | None]:
    """Return the times of the build and of a cold call, and the ratio of its processor time to the
    reference [s].
    """
    ratio = None if reference is None else outcome["cpu"] / reference
    cpu_ms = 1e3 * outcome["cpu"]
    wall_ms = 1e3 * outcome["wall"]
    return {"build_s": outcome["build_s"], "cpu_ms": cpu_ms, "wall_ms": wall_ms, "ratio": ratio}


def off(value: float | None, best: float | None) -> float | None:
    """share by which a value exceeds the best; None where either is not known."""
    if value is None or best is None:
        return None
    return value / best - 1.0

"""The same problems with the peers and with ours; one row per solver and setting.

python benchmarks/ocp/environments.py FOLDER
python benchmarks/ocp/peers.py FOLDER [RESULTS]
"""

from __future__ import annotations

import csv
import json
import os
import platform
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from environments import PEERS, interpreter
from peer_problems import (
    least_time,
    quickest_numbers,
    quickest_problem,
    shooting_numbers,
    shooting_problem,
    write,
)

HERE = Path(__file__).parent
STEPS = (20, 40, 100)
Row = dict[str, Any]
TIMES = ("cpu_ms", "wall_ms", "ratio", "warm_cpu_ms", "iterations")
COLUMNS = ("problem", "solver", "setting", *TIMES, "result", "off", "status")


def run_peer(folder: Path, environment: str, script: str, numbers: Row, scratch: Path) -> Row:
    problem, result = write(numbers, scratch / "problem.json"), scratch / f"{script}.json"
    subprocess.run([interpreter(folder, environment), HERE / f"{script}.py", problem, result], check=True)
    found: Row = json.loads(result.read_text())
    return found


def run_ours(kind: str, n_steps: int, scratch: Path, *, compiled: bool, judge: str | None = None) -> Row:
    result = scratch / "ours.json"
    more = [] if judge is None else [str(scratch / f"{judge}.json")]
    environment = os.environ if compiled else {**os.environ, "PATH": "", "CC": ""}
    command = [sys.executable, str(HERE / "ours.py"), kind, str(n_steps), str(result), *more]
    subprocess.run(command, check=True, env=environment)
    found: Row = json.loads(result.read_text())
    return found


def shooting_rows(folder: Path, n_steps: int, scratch: Path) -> list[Row]:
    """crocoddyl first: ratios are to its time, and `off` is the share by which a cost differs from its."""
    name = f"shooting, N = {n_steps}"
    numbers = shooting_numbers(shooting_problem(n_steps))
    peer = run_peer(folder, "crocoddyl", "peer_crocoddyl", numbers, scratch)
    cold = peer["cold"]
    reference, cost = cold["cpu"], peer["cost"]
    rows = []
    for compiled in (True, False):
        found = run_ours("shooting", n_steps, scratch, compiled=compiled, judge="peer_crocoddyl")
        if compiled:
            judged = found["judged"]
            rows.append(
                {
                    "problem": name,
                    "solver": "crocoddyl FDDP",
                    "setting": "Gauss-Newton",
                    **times(cold["cpu"], cold["wall"], reference),
                    "warm_cpu_ms": f"{1e3 * peer['warm']['cpu']:.2f}",
                    "iterations": cold["iterations"],
                    "result": f"{judged['cost']:.9f}",
                    "off": f"{judged['cost'] / cost - 1:.1e}",
                    "status": "converged" if cold["converged"] else "not converged",
                }
            )
            rows[-1]["status"] += f"; breaks our equations by {judged['violation']:.1e}"
        rows += [our_row(name, row, compiled, reference, "cost", cost) for row in found["rows"]]
    return rows


def quickest_rows(folder: Path, scratch: Path) -> list[Row]:
    """Ratios are to the fastest peer; `off` is the share by which a duration exceeds the known optimum."""
    problem = quickest_problem(STEPS[0])
    numbers, best = quickest_numbers(problem), least_time(problem)
    peers = {
        script: run_peer(folder, "drake", script, numbers, scratch) for script in ("peer_drake", "peer_pyroboplan")
    }
    names = {"peer_drake": "Drake KTO", "peer_pyroboplan": "PyRoboPlan"}
    reference = min(run["cpu"] for peer in peers.values() for run in peer["runs"])
    rows = []
    for script, peer in peers.items():
        for run in peer["runs"]:
            end = run["duration"]
            rows.append(
                {
                    "problem": "quickest",
                    "solver": names[script],
                    "setting": run["setting"],
                    **times(run["cpu"], run["wall"], reference),
                    "result": "" if end is None else f"{end:.6f}",
                    "off": "" if end is None else f"{end / best - 1:.1e}",
                    "status": "converged" if run["converged"] else "failed",
                }
            )
    for n_steps in STEPS[:2]:
        for compiled in (True, False):
            found = run_ours("quickest", n_steps, scratch, compiled=compiled)
            for row in found["rows"]:
                made = our_row("quickest", row, compiled, reference, "duration", best)
                rows.append(made | {"setting": f"N = {n_steps}, {made['setting']}"})
    return rows


def our_row(problem: str, row: Row, compiled: bool, reference: float, figure: str, best: float) -> Row:
    how = "compiled" if compiled else "virtual machine"
    return {
        "problem": problem,
        "solver": f"uvms_ocp {row['plugin']}",
        "setting": f"{row['setting']}, {row['convergence']:g}, {how}",
        **times(row["cpu"], row["wall"], reference),
        "warm_cpu_ms": f"{1e3 * row['warm_cpu']:.2f}",
        "iterations": row["iterations"],
        "result": f"{row[figure]:.9f}" if figure == "cost" else f"{row[figure]:.6f}",
        "off": f"{row[figure] / best - 1:.1e}",
        "status": row["status"],
    }


def times(cpu: float, wall: float, reference: float) -> Row:
    return {"cpu_ms": f"{1e3 * cpu:.2f}", "wall_ms": f"{1e3 * wall:.2f}", "ratio": f"{cpu / reference:.2f}"}


def markdown(rows: list[Row], load: str) -> str:
    packages = ", ".join(f"{name} {version(name)}" for name in ("casadi", "pin", "numpy"))
    peers = "; ".join(" ".join(wanted) for wanted in PEERS.values())
    head = [
        "# Optimal control: the peers",
        "",
        (HERE / "peers.md").read_text(encoding="utf-8").strip(),
        "",
        f"{platform.machine()}, Python {platform.python_version()}, {packages}; the peers with {peers}.",
        f"Load average {load}.",
        "",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
    ]
    return "\n".join([*head, *("| " + " | ".join(str(row.get(c, "")) for c in COLUMNS) + " |" for row in rows), ""])


def main(folder: Path, results: Path) -> None:
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        rows = [row for n in STEPS for row in shooting_rows(folder, n, scratch)]
        rows += quickest_rows(folder, scratch)
    load = f"{before:.1f} at the start, {os.getloadavg()[0]:.1f} at the end"
    with (results / "ocp_peers.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, restval="")
        table.writeheader()
        table.writerows(rows)
    (results / "ocp_peers.md").write_text(markdown(rows, load), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else HERE.parent / "results")

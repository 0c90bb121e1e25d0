"""Problems x hierarchy solvers -> results/hierarchy.csv and .md.

``python hierarchy.py [--daqp PYTHON] [--pink PYTHON] [--random N]``: PYTHON is the interpreter of an environment in which
that peer is installed.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import casadi as ca
import numpy as np
from hierarchy_problems import Problem, exactness_problems, problems, random_states, recorded_ticks

from uvms_ocp.solvers.hierarchy.active_set.fallbacks import ActiveSetTick
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade.solver import LexicographicQp
from uvms_ocp.solvers.hierarchy.certificate import certificate
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.hierarchy.tick import LEVEL_OUTPUTS, Tick

HERE = Path(__file__).parent
SOLVERS = {
    "lexls in C": LexicographicActiveSet(),
    "lexls in NumPy": LexicographicActiveSet(compiled=False),
    "qpOASES cascade": LexicographicQp(),
    "iCAT in NumPy": Icat(),
}
# Relative difference of level residuals that counts. At its optimum the norm of a level is flat: a solver that misses rows
# by d changes it by d squared only, which rounding hides up to 1e-8, and gains as much as d at the next level.
EXCESS = 1e-8
PASSES = 3
# Whose certificate is larger may have gained at one level what it lost, unseen, above: it is no measure for others.
CERTIFIED = 1e-9
Row = dict[str, str | float | int]


def bound_to_matrices(solver: LexicographicActiveSet | LexicographicQp | Icat, problem: Problem) -> Tick:
    """A tick whose inputs are the stacked levels themselves."""
    n = problem.sets[0][0].n_velocities
    symbols = [ca.MX.sym(name, sum(problem.sizes), n if name == "J" else 1) for name in LEVEL_OUTPUTS]
    function = ca.Function("levels", symbols, symbols, [f"{x}_in" for x in LEVEL_OUTPUTS], list(LEVEL_OUTPUTS))
    return solver.bind(function, problem.sizes)


def stacked(levels: Sequence[Level]) -> list[np.ndarray]:
    """The six inputs of a tick."""
    fields = ("jacobian", "lower", "upper", "rate", "activation", "gate")
    return [np.concatenate([getattr(level, name) for level in levels]) for name in fields]


def run(solver: LexicographicActiveSet | LexicographicQp | Icat, problem: Problem) -> tuple[np.ndarray, ...]:
    """v, exact and time [s] of every problem of the set."""
    tick, results = bound_to_matrices(solver, problem), []
    given = [stacked(levels) for levels in problem.sets]
    tick(*given[0])
    for inputs in given:
        if isinstance(tick, ActiveSetTick) and not problem.warm:
            tick.reset()
        start = time.perf_counter()
        result = tick(*inputs)
        results.append((result.v, result.status.exact, time.perf_counter() - start))
    return tuple(np.array(column) for column in zip(*results, strict=True))


def level_norms(problem: Problem, v: np.ndarray) -> np.ndarray:
    """(problems, levels) norm of what each level misses."""
    return np.array(
        [
            [np.linalg.norm(y - np.clip(y, lv.lower, lv.upper)) for lv in levels for y in [lv.jacobian @ x]]
            for levels, x in zip(problem.sets, v, strict=True)
        ]
    )


def certificates_of(problem: Problem, v: np.ndarray) -> np.ndarray:
    """(problems,)"""
    return np.array([certificate(levels, x) for levels, x in zip(problem.sets, v, strict=True)])


def first_difference(mine: np.ndarray, other: np.ndarray) -> float:
    """mine - other at the first level where they differ; 0 where none does."""
    for a, b in zip(mine, other, strict=True):
        if abs(a - b) > EXCESS * (1.0 + abs(b)):
            return float(a - b)
    return 0.0


def excesses(norms: dict[str, np.ndarray], certificates: dict[str, np.ndarray]) -> dict[str, float]:
    """Largest lexicographic excess of each solver over the best of all that are certified."""
    worst = dict.fromkeys(norms, 0.0)
    for index in range(len(next(iter(norms.values())))):
        best = None
        for name, table in norms.items():
            good = certificates[name][index] <= CERTIFIED
            if good and (best is None or first_difference(table[index], best) < 0.0):
                best = table[index]
        if best is None:
            continue
        for name, table in norms.items():
            worst[name] = max(worst[name], first_difference(table[index], best))
    return worst


def times_us(seconds: np.ndarray) -> dict[str, float]:
    """Percentiles [us]."""
    names = ("p50_us", "p99_us", "max_us")
    return {
        name: round(float(x), 1) for name, x in zip(names, np.percentile(seconds * 1e6, [50, 99, 100]), strict=True)
    }


def rows_of(problem: Problem, found: dict[str, tuple[np.ndarray, ...]]) -> list[Row]:
    """One row per solver."""
    norms = {name: level_norms(problem, v) for name, (v, _, _) in found.items()}
    certificates = {name: certificates_of(problem, v) for name, (v, _, _) in found.items()}
    worst = excesses(norms, certificates)
    rows: list[Row] = []
    for name, (v, exact, seconds) in found.items():
        checked = certificates[name][exact.astype(bool)]
        rows.append(
            {
                "problem": problem.name,
                "solver": name,
                "problems": len(v),
                **times_us(seconds),
                "not exact": int((~exact.astype(bool)).sum()),
                "largest certificate where exact": f"{max(checked, default=float('nan')):.1e}",
                "largest excess": f"{worst[name]:.1e}",
            }
        )
    return rows


def daqp_results(python: str, sets: list[Problem]) -> dict[str, tuple[np.ndarray, ...]]:
    """v, exact and time of daqp for every problem set."""
    dump = {}
    for problem in sets:
        J, lower, upper, *_ = zip(*(stacked(levels) for levels in problem.sets), strict=True)
        ends = np.cumsum([0, *problem.sizes])
        parts = {"J": J, "lower": lower, "upper": upper, "ends": ends}
        dump |= {f"{problem.name}/{part}": np.array(value) for part, value in parts.items()}
    with tempfile.TemporaryDirectory() as folder:
        given, result = Path(folder) / "problems.npz", Path(folder) / "result.npz"
        np.savez(given, **dump)
        _run(python, "hierarchy_daqp.py", given, result)
        found = np.load(result)
        return {p.name: (found[f"{p.name}/v"], found[f"{p.name}/flag"] > 0, found[f"{p.name}/time"]) for p in sets}


def _run(python: str, script: str, *arguments: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    subprocess.run([python, str(HERE / script), *map(str, arguments)], check=True, env=environment)


def pink_rows(python: str) -> list[Row]:
    """Time of pink on its own, weighted task set, with every QP solver that its environment has."""
    urdf = files("uvms_ocp").parent / "robots" / "girona_maris7_full" / "robot.urdf"
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.npz"
        _run(python, "hierarchy_pink.py", Path(str(urdf)), result)
        found = dict(np.load(result))
    rows: list[Row] = []
    for name in [key.removesuffix("/time") for key in found if key.endswith("/time")]:
        seconds, failed = found[f"{name}/time"], int(found[f"{name}/failed"])
        row = {"problem": "whole tick", "solver": f"pink ({name}), weights", "problems": len(seconds)}
        rows.append(row | times_us(seconds) | {"not exact": failed})
    return rows


def whole_tick_rows() -> list[Row]:
    """Case 1, kinematics included, as the controller calls it."""
    problem, inputs = recorded_ticks()
    rows: list[Row] = []
    for name, solver in SOLVERS.items():
        tick = solver.bind(problem.function, problem.sizes)
        tick(*inputs[0])
        passes = [one_pass(tick, inputs) for _ in range(PASSES)]
        # The same tick takes the same work every time: what is longer than the shortest is other programs.
        seconds = np.min([seconds for seconds, _ in passes], axis=0)
        row = {"problem": "whole tick", "solver": name, "problems": len(inputs), **times_us(seconds)}
        rows.append(row | {"not exact": passes[-1][1]})
    return rows


def cold_rows() -> list[Row]:
    """Case 1 at random states, each from a cold start."""
    problem, inputs = recorded_ticks()
    states, rows = random_states(inputs), []
    for name in ("lexls in C", "lexls in NumPy"):
        tick = SOLVERS[name].bind(problem.function, problem.sizes)
        assert isinstance(tick, ActiveSetTick)
        passes = [one_pass(tick, states, cold=True) for _ in range(PASSES)]
        seconds = np.min([seconds for seconds, _ in passes], axis=0)
        row = {"problem": "random states, cold", "solver": name, "problems": len(states), **times_us(seconds)}
        rows.append(row | {"not exact": passes[-1][1]})
    return rows


def exactness_rows(count: int) -> list[Row]:
    """Certificates of many random hierarchies, all of them checked."""
    rows = []
    for problem in exactness_problems(count):
        v, exact, seconds = run(SOLVERS["lexls in C"], problem)
        worst = certificates_of(problem, v).max()
        row = {"problem": problem.name, "solver": "lexls in C", "problems": len(v), **times_us(seconds)}
        rows.append(
            row | {"not exact": int((~exact.astype(bool)).sum()), "largest certificate where exact": f"{worst:.1e}"}
        )
    return rows


def one_pass(tick: Tick, inputs: Sequence[tuple[np.ndarray, ...]], cold: bool = False) -> tuple[np.ndarray, int]:
    """Times [s] of all ticks in sequence, and the number that are not exact."""
    seconds, inexact = [], 0
    for given in inputs:
        if cold:
            tick.reset()
        start = time.perf_counter()
        result = tick(*given)
        seconds.append(time.perf_counter() - start)
        inexact += not result.status.exact
    return np.array(seconds), inexact


def write(rows: list[Row]) -> None:
    """CSV and Markdown."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with (HERE / "results" / "hierarchy.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)
    lines = ["# Hierarchy solvers", "", NOTES, "", f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    lines += [f"| {' | '.join(str(row.get(key, '')) for key in columns)} |" for row in rows]
    (HERE / "results" / "hierarchy.md").write_text(
        "\n".join(
            [*lines, "", f"load (mean of the last minute) {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors", ""]
        ),
        encoding="utf-8",
    )


NOTES = """`python benchmarks/hierarchy.py --daqp PYTHON --pink PYTHON`, one thread, all rows from one run on one machine.
PYTHON: of environments made with `pip install daqp numpy`, and `pip install pin-pink daqp quadprog osqp proxsuite piqp`.

- *whole tick*: all ticks of Case 1, kinematics included, called from Python, the shortest of three passes.
  pink: kinematics and `solve_ik` of what the phases of Case 1 ask for, in its own terms (`hierarchy_pink.py`): weights, no
  strict levels; not exact: ticks that its solver refused.
- *random states, cold*: Case 1 at random states, no active set to start from.
- Other problems: matrices given, from Python. *case1*: every recorded tick, in sequence (warm). The rest is cold.
- *load*: other programs' share of the machine, see the last line; where it is above 1, p99 and max are mostly theirs.
- *not exact*: results that the solver itself does not call exact; daqp: exit flag below 1. iCAT is regularised by design.
- *largest excess*: of a level's residual norm over the best certified to 1e-9, at the first level that differs by more than
  1e-8; below that, rounding cannot tell who is better, because the norm of a level is flat at its optimum.
- *dependent to 1e-6* has rows between dependent and independent: only a truthful status is asked for there.
- *exactness*: every one of the hierarchies certified, rows dependent exactly or separated by 1e-4 and more."""


def main() -> None:
    """Run everything and write the results."""
    parser = argparse.ArgumentParser(description="Benchmark of hierarchy solvers.")
    parser.add_argument("--daqp", metavar="PYTHON")
    parser.add_argument("--pink", metavar="PYTHON")
    parser.add_argument("--random", type=int, default=200, metavar="N", help="problems of each random set")
    parser.add_argument("--exactness", type=int, default=10000, metavar="N", help="hierarchies to certify")
    options = parser.parse_args()
    rows = [*whole_tick_rows(), *cold_rows()] + (pink_rows(options.pink) if options.pink else [])
    sets = problems(options.random)
    peers = daqp_results(options.daqp, sets) if options.daqp else {}
    for problem in sets:
        found = {name: run(solver, problem) for name, solver in SOLVERS.items()}
        if problem.name in peers:
            found["daqp, native"] = peers[problem.name]
        rows += rows_of(problem, found)
    write(rows + exactness_rows(options.exactness))


if __name__ == "__main__":
    sys.exit(main())

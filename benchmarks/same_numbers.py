"""Do two versions of the code compute the same numbers? Records Case 1 and a plan of each method, and compares records.

    python benchmarks/same_numbers.py record DIR        with the interpreter of one version, then of the other
    python benchmarks/same_numbers.py compare DIR DIR   largest difference of every array; times of computation aside

Both on one machine and with OMP_NUM_THREADS=1: the last bits of a sum depend on the processor and on threads.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

SOLVERS = {"lexls": "LexicographicActiveSet", "lexqp": "LexicographicQp", "icat": "Icat"}
PLANTS = ("kinematic", "dynamic")
PLANS = {
    "curve": ("--sphere", "11.8,37.2,-38.9,0.1"),
    "ocp": (),
}
GOAL = ("--tool", "12.2", "37.4", "-39.5", "--position", "11", "37", "-38.5")
CLOCKS = ("tick_time", "solve_time", "viable_time", "controller_time")


def record(folder: Path, quick: bool) -> None:
    """Write one record for every plant and solver, and the files of both plans; quick: a moment of each, and no plan."""
    import uvms_ocp as uo

    folder.mkdir(parents=True, exist_ok=True)
    for plant in PLANTS:
        for name, solver in SOLVERS.items():
            options: dict[str, Any] = {"duration": 0.1} if quick else {}
            run = uo.scenarios.case1(plant=plant, solver=getattr(uo, solver)(), **options).run()
            run.save(folder / f"{plant}-{name}.npz")
            print(f"{plant}-{name}: {len(run)} ticks", flush=True)
    for method, more in () if quick else PLANS.items():
        words = [*_plan_command(method), *GOAL, *more, "--out", str(folder / f"plan-{method}")]
        subprocess.run([sys.executable, "-m", "uvms_ocp", *words], check=True, stdout=subprocess.DEVNULL)
        print(f"plan {method}", flush=True)


def _plan_command(method: str) -> list[str]:
    """Both forms of the command: one command with a method, or one command each."""
    words = [sys.executable, "-m", "uvms_ocp", "plan", "--help"]
    told = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    return ["plan", "--method", method] if "--method" in told else ["plan", method]


def compare(first: Path, second: Path) -> bool:
    """Print the largest difference of every array that differs; true if none does."""
    files = sorted(path.relative_to(first) for path in first.rglob("*.npz"))
    equal = True
    for file in files:
        differences = list(_differences(first / file, second / file))
        equal &= not differences
        print(f"{file}: {'; '.join(differences) or 'equal to the last bit'}")
    return equal and bool(files)


def _differences(first: Path, second: Path) -> Iterator[str]:
    if not second.is_file():
        yield "missing"
        return
    with np.load(first) as a, np.load(second) as b:
        for name in a.files:
            if a[name].dtype.kind == "U" or name in CLOCKS:
                continue
            if name not in b.files or a[name].shape != b[name].shape:
                yield f"{name} has another shape"
            elif not np.array_equal(a[name], b[name], equal_nan=True):
                yield f"{name} differs by {np.nanmax(np.abs(a[name] - b[name])):.3g}"


def main() -> None:
    """Record, or compare and exit with 1 where anything differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--quick", action="store_true", help="a moment of Case 1 instead of all, and no plan")
    given = parser.parse_args()
    if given.action == "record":
        record(given.folders[0], given.quick)
    elif not compare(*given.folders[:2]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()

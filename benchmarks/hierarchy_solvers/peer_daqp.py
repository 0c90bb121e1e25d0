"""Native hierarchies of daqp on dumped problems: ``python peer_daqp.py PROBLEMS.npz RESULT.npz``.

Needs only daqp and numpy, so that it runs in an environment of its own.
"""

from __future__ import annotations

import argparse
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import daqp
import numpy as np

EQUALITY = 5


def solve(
    J: np.ndarray, lower: np.ndarray, upper: np.ndarray, ends: np.ndarray
) -> tuple[np.ndarray, int, float]:
    """v, exit flag and time [s]; the matrices are ready, only the call is timed."""
    n = J.shape[1]
    low = np.maximum(lower, -1e30)
    up = np.minimum(upper, 1e30)
    sense = np.where(lower >= upper, EQUALITY, 0).astype(np.intc)
    start = time.perf_counter()
    v, _, flag, _ = daqp.solve(np.eye(n), np.zeros(n), J, up, low, sense, break_points=ends)
    return np.asarray(v), int(flag), time.perf_counter() - start


def main() -> None:
    """Write v, flag and time of every problem under the same names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", type=Path)
    parser.add_argument("result", type=Path)
    arguments = parser.parse_args()
    problems = np.load(arguments.problems)
    results: dict[str, Any] = {"version": version("daqp")}
    for name in sorted({key.rsplit("/", 1)[0] for key in problems}):
        J = problems[f"{name}/J"]
        lower = problems[f"{name}/lower"]
        upper = problems[f"{name}/upper"]
        breaks = problems[f"{name}/ends"].astype(np.intc)
        solve(J[0], lower[0], upper[0], breaks)  # to warm up, as ours
        solved = [solve(*matrices, breaks) for matrices in zip(J, lower, upper, strict=True)]
        for part, values in zip(("v", "flag", "time"), zip(*solved, strict=True), strict=True):
            results[f"{name}/{part}"] = np.array(values)
    np.savez(arguments.result, **results)


if __name__ == "__main__":
    main()

"""Native hierarchies of daqp on dumped problems: ``python hierarchy_daqp.py PROBLEMS.npz RESULT.npz``.

Needs only daqp and numpy, so that it runs in an environment of its own.
"""

from __future__ import annotations

import sys
import time

import daqp
import numpy as np

EQUALITY = 5


def solve(J: np.ndarray, lower: np.ndarray, upper: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, int, float]:
    """v, exit flag and time [s]; the matrices are ready, only the call is timed."""
    n = J.shape[1]
    low, up = np.maximum(lower, -1e30), np.minimum(upper, 1e30)
    sense = np.where(lower >= upper, EQUALITY, 0).astype(np.intc)
    start = time.perf_counter()
    v, _, flag, _ = daqp.solve(np.eye(n), np.zeros(n), J, up, low, sense, break_points=ends)
    return np.asarray(v), int(flag), time.perf_counter() - start


def main(problems: str, result: str) -> None:
    """Write v, flag and time of every problem under the same names."""
    found, results = np.load(problems), {}
    for name in sorted({key.rsplit("/", 1)[0] for key in found}):
        J, lower, upper, ends = (found[f"{name}/{part}"] for part in ("J", "lower", "upper", "ends"))
        solved = [solve(*given, ends.astype(np.intc)) for given in zip(J, lower, upper, strict=True)]
        for part, values in zip(("v", "flag", "time"), zip(*solved, strict=True), strict=True):
            results[f"{name}/{part}"] = np.array(values)
    np.savez(result, **results)


if __name__ == "__main__":
    main(*sys.argv[1:3])

"""What a solver has found, and how exact it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from recording.report import Row

from hierarchy_solvers.problems import Problem
from uvms_ocp.solvers.hierarchy.certificate import certificate
from uvms_ocp.solvers.hierarchy.level import Level

# Relative difference of level residuals that counts. At its optimum the norm of a level is flat: a
# solver that misses rows by d changes it by d squared only, which rounding hides up to this, and
# gains as much as d at the next level.
EXCESS = 1e-8
# Whose certificate is larger may have gained at one level what it lost, unseen, above: it is no
# measure for others.
CERTIFIED = 1e-9


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Found:
    """Velocities, statuses and times of a solver for every problem of a set."""

    v: np.ndarray
    """(problems, n)"""
    exact: np.ndarray
    """(problems,) whether the solver calls its result exact."""
    seconds: np.ndarray
    """(problems,) [s]"""

    @property
    def inexact(self) -> int:
        return int((~self.exact.astype(bool)).sum())


def rows_of(problem: Problem, results: Mapping[str, Found]) -> list[Row]:
    """One row per solver."""
    norms = {}
    certificates = {}
    for solver, result in results.items():
        norms[solver] = level_norms(problem, result.v)
        certificates[solver] = certificates_of(problem, result.v)
    worst = excesses(norms, certificates)
    rows: list[Row] = []
    for solver, result in results.items():
        row = timed_row(problem.name, solver, result.seconds, result.inexact)
        where_exact = certificates[solver][result.exact.astype(bool)]
        row["largest certificate where exact"] = max(where_exact, default=None)
        row["largest excess"] = worst[solver]
        rows.append(row)
    return rows


def timed_row(problem: str, solver: str, seconds: np.ndarray, inexact: int) -> dict[str, object]:
    """Percentiles of times (n,) [s], in us."""
    p50, p99, largest = np.percentile(seconds * 1e6, [50, 99, 100]).tolist()
    return {
        "problem": problem,
        "solver": solver,
        "problems": len(seconds),
        "p50_us": p50,
        "p99_us": p99,
        "max_us": largest,
        "not exact": inexact,
    }


def level_norms(problem: Problem, v: np.ndarray) -> np.ndarray:
    """(problems, levels) norm of what each level misses at v (problems, n)."""
    norms = []
    for levels, x in zip(problem.sets, v, strict=True):
        norms.append([_missed(level, x) for level in levels])
    return np.array(norms)


def _missed(level: Level, x: np.ndarray) -> float:
    y = level.jacobian @ x
    return float(np.linalg.norm(y - np.clip(y, level.lower, level.upper)))


def certificates_of(problem: Problem, v: np.ndarray) -> np.ndarray:
    """(problems,) at v (problems, n)."""
    return np.array([certificate(levels, x) for levels, x in zip(problem.sets, v, strict=True)])


def excesses(
    norms: Mapping[str, np.ndarray], certificates: Mapping[str, np.ndarray]
) -> dict[str, float]:
    """Largest lexicographic excess of each solver over the best of all that are certified."""
    worst = dict.fromkeys(norms, 0.0)
    for index in range(len(next(iter(norms.values())))):
        best = _best(norms, certificates, index)
        if best is not None:
            for name, table in norms.items():
                worst[name] = max(worst[name], first_difference(table[index], best))
    return worst


def _best(
    norms: Mapping[str, np.ndarray], certificates: Mapping[str, np.ndarray], index: int
) -> np.ndarray | None:
    best: np.ndarray | None = None
    for name, table in norms.items():
        good = certificates[name][index] <= CERTIFIED
        if good and (best is None or first_difference(table[index], best) < 0.0):
            best = table[index]
    return best


def first_difference(first: np.ndarray, second: np.ndarray) -> float:
    """first - second (levels,) at the first level where they differ; 0 where none does."""
    for a, b in zip(first, second, strict=True):
        if abs(a - b) > EXCESS * (1.0 + abs(b)):
            return float(a - b)
    return 0.0

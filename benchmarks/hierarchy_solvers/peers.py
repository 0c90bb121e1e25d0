"""Peers of the hierarchy solvers, each in its own environment and its own process."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from recording.processes import run_script
from recording.report import Row

from hierarchy_solvers.found import Found, timed_row
from hierarchy_solvers.ours import stacked
from hierarchy_solvers.problems import Problem
from uvms_ocp.robot.loading import robot_folder

_FOLDER = Path(__file__).parent


def daqp_results(python: Path, sets: list[Problem]) -> tuple[dict[str, Found], str]:
    """Solve every problem set by daqp; returns its results and its version."""
    with tempfile.TemporaryDirectory() as folder:
        problems = Path(folder) / "problems.npz"
        result = Path(folder) / "result.npz"
        np.savez(problems, **_dumped(sets))
        run_script(python, _FOLDER / "peer_daqp.py", problems, result)
        with np.load(result) as file:
            results = {problem.name: _found(file, problem.name) for problem in sets}
            return results, str(file["version"])


def _dumped(sets: list[Problem]) -> dict[str, Any]:
    dump: dict[str, Any] = {}
    for problem in sets:
        inputs = [stacked(levels) for levels in problem.sets]
        J, lower, upper, *_ = map(np.array, zip(*inputs, strict=True))
        dump[f"{problem.name}/J"] = J
        dump[f"{problem.name}/lower"] = lower
        dump[f"{problem.name}/upper"] = upper
        dump[f"{problem.name}/ends"] = np.cumsum([0, *problem.sizes])
    return dump


def _found(file: np.lib.npyio.NpzFile, name: str) -> Found:
    return Found(v=file[f"{name}/v"], exact=file[f"{name}/flag"] > 0, seconds=file[f"{name}/time"])


_FAR = 1e10
"""What stands for infinite bounds in files for LexLS."""


def lexls_results(program: Path, sets: list[Problem], passes: int) -> dict[str, Found]:
    """Solve every problem set by a program that uses LexLS: ``PROGRAM IN OUT WARM PASSES``.

    IN: int32 numbers of hierarchies N, of unknowns n and of levels p, int32 rows of each level;
    then hierarchy by hierarchy, level by level, float64 rows of Jacobian, lower and upper bound,
    infinite ones `_FAR`. OUT: float64 solutions (N, n), least seconds of all passes (N,), statuses
    (N,), 0 where solved, and factorisations (N,). WARM is 1 where each starts from the one before.
    """
    results: dict[str, Found] = {}
    for problem in sets:
        N = len(problem.sets)
        n = problem.sets[0][0].jacobian.shape[1]
        head = np.array([N, n, len(problem.sizes), *problem.sizes], dtype=np.int32)
        rows = []
        for levels in problem.sets:
            J, lower, upper, *_ = stacked(levels)
            rows.append(np.column_stack([J, lower, upper]).clip(-_FAR, _FAR).ravel())
        with tempfile.TemporaryDirectory() as folder:
            hierarchies = Path(folder) / "in"
            result = Path(folder) / "out"
            hierarchies.write_bytes(head.tobytes() + np.concatenate(rows).tobytes())
            subprocess.run(
                [program, hierarchies, result, str(int(problem.warm)), str(passes)], check=True
            )
            v, seconds, status, _ = np.split(np.fromfile(result), N * (n + np.arange(3)))
        results[problem.name] = Found(v=v.reshape(N, n), exact=status == 0, seconds=seconds)
    return results


def pink_rows(python: Path, *, passes: int, ticks: int) -> tuple[list[Row], str]:
    """Time of pink on its own, weighted task set, with every QP solver that its environment has;
    and its version.
    """
    urdf = robot_folder("girona_maris7_full") / "robot.urdf"
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.npz"
        words = ("--passes", passes, "--ticks", ticks)
        run_script(python, _FOLDER / "peer_pink.py", urdf, result, *words)
        with np.load(result) as file:
            results = dict(file)
    rows: list[Row] = []
    for key, seconds in results.items():
        if key.endswith("/time"):
            solver = key.removesuffix("/time")
            failed = int(results[f"{solver}/failed"])
            rows.append(timed_row("whole tick", f"pink ({solver}), weights", seconds, failed))
    return rows, str(results["version"])

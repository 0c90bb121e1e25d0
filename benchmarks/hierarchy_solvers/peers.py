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

_HERE = Path(__file__).parent


def daqp_results(python: Path, sets: list[Problem]) -> tuple[dict[str, Found], str]:
    """What daqp finds for every problem set, and its version."""
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "problems.npz"
        result = Path(folder) / "result.npz"
        np.savez(given, **_dumped(sets))
        run_script(python, _HERE / "peer_daqp.py", given, result)
        with np.load(result) as found:
            return {p.name: _found(found, p.name) for p in sets}, str(found["version"])


def _dumped(sets: list[Problem]) -> dict[str, Any]:
    dump: dict[str, Any] = {}
    for problem in sets:
        J, lower, upper, *_ = (
            np.array(part) for part in zip(*(stacked(s) for s in problem.sets), strict=True)
        )
        parts = {"J": J, "lower": lower, "upper": upper, "ends": np.cumsum([0, *problem.sizes])}
        dump |= {f"{problem.name}/{part}": value for part, value in parts.items()}
    return dump


def _found(found: np.lib.npyio.NpzFile, name: str) -> Found:
    return Found(
        v=found[f"{name}/v"], exact=found[f"{name}/flag"] > 0, seconds=found[f"{name}/time"]
    )


_FAR = 1e10
"""What stands for infinite bounds in files for LexLS."""


def lexls_results(program: Path, sets: list[Problem], passes: int) -> dict[str, Found]:
    """What a program that solves hierarchies by LexLS finds for every problem set: ``PROGRAM IN OUT
    WARM PASSES``.

    IN: int32 numbers of hierarchies N, of unknowns n and of levels p, int32 rows of each level;
    then hierarchy by hierarchy, level by level, float64 rows of Jacobian, lower and upper bound,
    infinite ones `_FAR`. OUT: float64 solutions (N, n), least seconds of all passes (N,), statuses
    (N,), 0 where solved, and factorisations (N,). WARM is 1 where each starts from the one before.
    """
    found: dict[str, Found] = {}
    for problem in sets:
        N = len(problem.sets)
        n = problem.sets[0][0].jacobian.shape[1]
        head = np.array([N, n, len(problem.sizes), *problem.sizes], dtype=np.int32)
        rows = [
            np.column_stack(stacked(levels)[:3]).clip(-_FAR, _FAR).ravel()
            for levels in problem.sets
        ]
        with tempfile.TemporaryDirectory() as folder:
            given = Path(folder) / "in"
            result = Path(folder) / "out"
            given.write_bytes(head.tobytes() + np.concatenate(rows).tobytes())
            subprocess.run(
                [program, given, result, str(int(problem.warm)), str(passes)], check=True
            )
            v, seconds, status, _ = np.split(np.fromfile(result), N * (n + np.arange(3)))
        found[problem.name] = Found(v=v.reshape(N, n), exact=status == 0, seconds=seconds)
    return found


def pink_rows(python: Path, *, passes: int, ticks: int) -> tuple[list[Row], str]:
    """Time of pink on its own, weighted task set, with every QP solver that its environment has;
    and its version.
    """
    urdf = robot_folder("girona_maris7_full") / "robot.urdf"
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.npz"
        run_script(
            python, _HERE / "peer_pink.py", urdf, result, "--passes", passes, "--ticks", ticks
        )
        with np.load(result) as file:
            found = dict(file)
    names = [key.removesuffix("/time") for key in found if key.endswith("/time")]
    rows: list[Row] = [
        timed_row(
            "whole tick",
            f"pink ({name}), weights",
            found[f"{name}/time"],
            int(found[f"{name}/failed"]),
        )
        for name in names
    ]
    return rows, str(found["version"])

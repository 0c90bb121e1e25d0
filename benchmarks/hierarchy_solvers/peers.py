"""Peers of the hierarchy solvers, each in its own environment and its own process."""

from __future__ import annotations

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
        given, result = Path(folder) / "problems.npz", Path(folder) / "result.npz"
        np.savez(given, **_dumped(sets))
        run_script(python, _HERE / "peer_daqp.py", given, result)
        with np.load(result) as found:
            return {p.name: _found(found, p.name) for p in sets}, str(found["version"])


def _dumped(sets: list[Problem]) -> dict[str, Any]:
    dump: dict[str, Any] = {}
    for problem in sets:
        J, lower, upper, *_ = (np.array(part) for part in zip(*(stacked(s) for s in problem.sets), strict=True))
        parts = {"J": J, "lower": lower, "upper": upper, "ends": np.cumsum([0, *problem.sizes])}
        dump |= {f"{problem.name}/{part}": value for part, value in parts.items()}
    return dump


def _found(found: np.lib.npyio.NpzFile, name: str) -> Found:
    return Found(v=found[f"{name}/v"], exact=found[f"{name}/flag"] > 0, seconds=found[f"{name}/time"])


def pink_rows(python: Path, *, passes: int, ticks: int) -> tuple[list[Row], str]:
    """Time of pink on its own, weighted task set, with every QP solver that its environment has; and its version."""
    urdf = robot_folder("girona_maris7_full") / "robot.urdf"
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.npz"
        run_script(python, _HERE / "peer_pink.py", urdf, result, "--passes", passes, "--ticks", ticks)
        with np.load(result) as file:
            found = dict(file)
    names = [key.removesuffix("/time") for key in found if key.endswith("/time")]
    rows: list[Row] = [
        timed_row("whole tick", f"pink ({name}), weights", found[f"{name}/time"], int(found[f"{name}/failed"])) for name in names
    ]
    return rows, str(found["version"])

"""Write and read plans of missions as ``.npz`` files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp import Trajectory, plan_file

_KEY = "mission_plan"
_NO_PLAN = "no plan of a mission"
_ARRAYS = {"t": 0, "q": 0, "v": 0, "a": 1, "thrust": 1, "torque": 1}
"""Arrays, with the number of rows by which each is shorter than there are times."""


def write_plan(path: Path | str, trajectory: Trajectory, summary: dict[str, Any]) -> Path:
    """Write the arrays as they are, the summary as text. Raises `OutputError`."""
    return plan_file.write_arrays(
        Path(path), _KEY, json.dumps(summary), plan_file.trajectory_arrays(trajectory)
    )


def read_plan(path: Path | str) -> tuple[Trajectory, dict[str, Any]]:
    """Read a file that anyone may have written. Raises `InvalidInput`."""
    summary, arrays = plan_file.from_arrays(Path(path), _KEY, _NO_PLAN)
    if not set(_ARRAYS) <= arrays.keys():
        raise InvalidInput(_NO_PLAN)
    series = {name: arrays[name] for name in _ARRAYS}
    _check(series)
    return Trajectory(**series, of_wrench=False), summary


def _check(arrays: plan_file.Arrays) -> None:
    n = arrays["t"].size
    for name, array in arrays.items():
        flat = array.ndim == 1 + (name != "t") and array.dtype.kind == "f"
        if not flat or len(array) != n - _ARRAYS[name] or not np.isfinite(array).all():
            raise InvalidInput(
                f"{name} of shape {array.shape} does not fit {n} times, or is not finite"
            )
    if n < 2 or not (np.diff(arrays["t"]) > 0).all():
        raise InvalidInput("its times do not increase")

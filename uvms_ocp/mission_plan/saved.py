"""Plans of missions as files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput, OutputError
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.untrusted.array_file import read_arrays
from uvms_ocp.validation import shown

_KEY = "mission_plan"
_ARRAYS = ("t", "q", "v", "a", "thrust", "torque")


def write_plan(path: Path | str, trajectory: Trajectory, summary: dict[str, Any]) -> Path:
    """Arrays as they are, the summary as text. Raises `OutputError`."""
    target = Path(path).with_suffix(".npz")
    arrays = {name: getattr(trajectory, name) for name in _ARRAYS}
    try:
        with target.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **{_KEY: np.array(json.dumps(summary))}, **arrays)
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}; choose another place") from error
    return target


def read_plan(path: Path | str) -> tuple[Trajectory, dict[str, Any]]:
    """Of a file that anyone may have written. Raises `InvalidInput`."""
    try:
        arrays = dict(read_arrays(path))
        if _KEY not in arrays or not set(_ARRAYS) <= arrays.keys():
            raise InvalidInput("no plan of a mission; give the plan.npz that `plan mission` wrote")
        told = json.loads(str(arrays[_KEY]))
        return _trajectory({name: arrays[name] for name in _ARRAYS}), told
    except (InvalidInput, ValueError) as error:
        raise InvalidInput(f"{shown(path)}: {error}") from error


def _trajectory(arrays: dict[str, np.ndarray]) -> Trajectory:
    n = arrays["t"].size
    rows = {"t": n, "q": n, "v": n, "a": n - 1, "thrust": n - 1, "torque": n - 1}
    for name, array in arrays.items():
        if len(array) != rows[name] or array.ndim != 1 + (name != "t") or not np.isfinite(array).all():
            raise InvalidInput(f"{name} of shape {array.shape} does not fit {n} times, or is not finite")
    if n < 2 or not (np.diff(arrays["t"]) > 0).all():
        raise InvalidInput("its times do not increase")
    return Trajectory(**arrays)

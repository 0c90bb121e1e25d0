"""Read from a `Record` what figures and scenes draw: labels with units, thresholds, rows of tasks,
names of axes, heights of the floor.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.record import run_meta, tables
from uvms_ocp.record.record import Record, quantity as quantity

_LONGEST = 60  # letters of what is written on a line


def axis_label(text: str, name: str, part: str = "", prefix: str = "", meta: Any = None) -> str:
    """Return the label of an axis: a text, and the unit of a series, of one of its parts, or of a
    quantity; prefix: such as m.

    meta: of the record, as in `unit_of`.
    """
    units = tables.unit_of(name, part, meta).split(" or ")
    return f"{text} [{' or '.join(prefix + unit for unit in units)}]"


def estimate_suffix(record: Record) -> str:
    """Return the suffix of a measured quantity's name: with noisy sensors it is an estimate."""
    if record.meta.kind == "run" and record.meta.noise:
        return " (estimated)"
    return ""


def require_rows(record: Record) -> None:
    """Raise `InvalidInput` where there is nothing to draw."""
    if len(record) < 2:
        raise InvalidInput(f"record has {len(record)} rows; at least 2 are needed to draw it")


def thresholds(record: Record, name: str) -> tuple[float, ...]:
    """Return limits that transitions set on a quantity, each once."""
    return tuple(sorted({item.limit for item in record.meta.thresholds if item.quantity == name}))


def threshold_text(record: Record, name: str, limit: float) -> str:
    """Say what a limit [unit of the quantity] on a quantity is for: the phases that it ends, and
    which of them is the abort.
    """
    meta = record.meta
    ended_phases = set()
    for item in meta.thresholds:
        if item.quantity == name and item.limit == limit:
            ended_phases.add(item.phase)
    phases = [phase.name for phase in meta.phases if phase.name in ended_phases]
    abort = meta.abort_phase if meta.kind == "run" else None
    names = []
    for phase in phases:
        names.append("abort" if phase == abort else f"phase {phase}")
    if names:
        return plain_line(f"threshold {limit:g}, {', '.join(names)}", _LONGEST)
    return f"threshold {limit:g}"


def task_gate(record: Record, task: str) -> np.ndarray | None:
    """Return the external activation (n,) of a task; `None` for an unknown one."""
    names = [item.name for item in record.meta.tasks]
    if task in names:
        return record["activations"][:, names.index(task)]
    return None


def task_activity(record: Record, task: str) -> np.ndarray | None:
    """Return the activation (n, rows) of a task's rows; `None` where the task has no level."""
    for name, rows in run_meta.level_rows(record.meta):
        if name == task:
            return record["activity"][:, rows]
    return None


def axis_names(record: Record, n: int) -> list[str]:
    """Return names of n rows or axes: the joints where there is one for each, which a joint of
    several axes has not.
    """
    joints = record.meta.joints
    if n == len(joints):
        return list(joints)
    return [str(k + 1) for k in range(n)]


def has_vehicle(record: Record) -> bool:
    """Tell whether the robot is a free-flyer (q then begins with p_WB and a quaternion)."""
    return run_meta.is_floating(record.series, record.meta)


def floor_heights(record: Record, points: np.ndarray) -> np.ndarray | None:
    """Return the height (n,) [m] of the floor at points (n, 2) [m] in W; `None` where the record
    knows no floor.
    """
    relief = record.meta.surroundings.floor
    plane = record.meta.surroundings.floor_z
    if relief is not None:
        from scipy.interpolate import RegularGridInterpolator

        grid = RegularGridInterpolator((relief.x, relief.y), np.transpose(relief.z))
        lowest_corner = (relief.x[0], relief.y[0])
        highest_corner = (relief.x[-1], relief.y[-1])
        return np.asarray(grid(np.clip(points, lowest_corner, highest_corner)))
    if plane is None:
        return None
    return np.full(len(points), plane)

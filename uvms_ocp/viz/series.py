"""What figures and scenes read from a `Record`: phases, quantities, rows of tasks, vehicle and joint parts.

Entries of `Record.meta` that add to a figure or scene where they exist:
``thresholds`` list of {quantity, limit}; ``limits`` {position_lower, position_upper, velocity} as lists, joints last;
``frames`` {name: [p_WF (3), quaternion xyzw (4)]} drawn as triads; ``markers`` {name: point (3)}; ``floor_z``; ``dt``;
``obstacles`` list of `uvms_ocp.collision.ObstacleData` as JSON; ``floor`` {x (n), y (m), z (m, n)} of a floor that is not flat,
as `uvms_ocp.sim.floor_relief` gives it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.record import Record
from uvms_ocp.record import quantity as quantity

_N_VEHICLE = 6  # velocity degrees of freedom of a free-flyer


@dataclass(frozen=True, kw_only=True, slots=True)
class PhaseSpan:
    """One stay in one phase, from `start` to `end` [s]."""

    index: int
    name: str
    title: str
    start: float
    end: float

    @property
    def label(self) -> str:
        return f"{self.name} {self.title}" if self.title else self.name


def require_rows(record: Record) -> None:
    """Raises `InvalidInput` where there is nothing to draw."""
    if len(record) < 2:
        raise InvalidInput(f"record has {len(record)} rows; at least 2 are needed to draw it")


def phase_spans(record: Record) -> tuple[PhaseSpan, ...]:
    """Stays in phases in order of time; a phase that the mission went back to comes again."""
    t, phase = record["t"], _phase_series(record)
    first = np.flatnonzero(np.diff(phase, prepend=phase[0] - 1))
    last = [*first[1:], len(t) - 1]
    return tuple(_span(record.meta, int(phase[i]), t[i], t[j]) for i, j in zip(first, last, strict=True))


def _phase_series(record: Record) -> np.ndarray:
    return record["phase"] if "phase" in record.series else np.zeros(len(record), dtype=int)


def _span(meta: Mapping[str, Any], index: int, start: float, end: float) -> PhaseSpan:
    phases = meta.get("phases", ())
    known = phases[index] if index < len(phases) else {"name": str(index), "title": ""}
    return PhaseSpan(index=index, name=known["name"], title=known["title"], start=float(start), end=float(end))


def thresholds(record: Record, name: str) -> tuple[float, ...]:
    """Limits that transitions set on a quantity, each once."""
    known = record.meta.get("thresholds", ())
    return tuple(sorted({entry["limit"] for entry in known if entry["quantity"] == name}))


def task_gate(record: Record, task: str) -> np.ndarray | None:
    """External activation (n,) of a task; `None` for an unknown one."""
    names = [entry["name"] for entry in record.meta.get("tasks", ())]
    return record["gates"][:, names.index(task)] if task in names else None


def task_activity(record: Record, task: str) -> np.ndarray | None:
    """Activation (n, rows) of a task's rows; `None` where the task has no level."""
    start = 0
    for level in record.meta.get("levels", ()):
        if level["name"] == task:
            return record["activity"][:, start : start + level["rows"]]
        start += level["rows"]
    return None


def n_joints(record: Record) -> int:
    """Velocity degrees of freedom of the joints."""
    n_v = record["v"].shape[1]
    return n_v - _N_VEHICLE if has_vehicle(record) else n_v


def has_vehicle(record: Record) -> bool:
    """Tell whether the robot is a free-flyer (q then begins with p_WB and a quaternion)."""
    return record["v"].shape[1] - len(record.meta.get("joints", ())) == _N_VEHICLE


def joint_limits(record: Record, name: str) -> np.ndarray | None:
    """One of ``position_lower``, ``position_upper``, ``velocity`` (n_joints,) from ``meta["limits"]``."""
    values = record.meta.get("limits", {}).get(name)
    return None if values is None else np.asarray(values, dtype=float)[-n_joints(record) :]


def floor_heights(record: Record, points: np.ndarray) -> np.ndarray | None:
    """Height (n,) [m] of the floor at points (n, 2) [m] in W; `None` where the record knows no floor."""
    relief = record.meta.get("floor")
    if relief is not None:
        grid = RegularGridInterpolator((relief["x"], relief["y"]), np.transpose(relief["z"]))
        return np.asarray(grid(np.clip(points, *_corners(relief))))
    return None if "floor_z" not in record.meta else np.full(len(points), float(record.meta["floor_z"]))


def _corners(relief: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    return [relief["x"][0], relief["y"][0]], [relief["x"][-1], relief["y"][-1]]

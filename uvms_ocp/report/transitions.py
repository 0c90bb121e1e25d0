"""How smoothly a run changes from phase to phase, and what the higher levels pay for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.record import Record

WINDOW = 1.0  # [s] after a phase change that belongs to it

_NOT_ABOVE = (",AD]", ",O]")  # labels of actions and of what is optimised


@checked
def transition_series(record: Record) -> dict[str, np.ndarray]:
    """Series over time ``t`` (n,) [s] of the commanded velocity, and the times ``changes`` (k,) [s] of phase changes.

    ``step`` (n,): largest change of any axis since the tick before, as a share of its acceleration limit times dt.
    ``jerk`` (n,) [m/s3, rad/s3]: largest second difference of any axis. ``lost`` (n,) [m/s, rad/s]: largest norm, over
    the tasks that are fully on and of a class above the actions, of what the task misses of the rate that the
    acceleration limits let it reach. Raises `InvalidInput` for a plan, or without limits.
    """
    dt, limits = record.run_meta.dt, _acceleration(record)
    change = np.diff(record["command"], axis=0, prepend=0.0)
    limited = limits > 0.0  # what may not move at all has no share
    second = np.diff(change, axis=0, prepend=0.0)
    starts = np.flatnonzero(np.diff(record["phase"])) + 1
    return {
        "t": record["t"],
        "step": (np.abs(change[:, limited]) / dt / limits[limited]).max(axis=1, initial=0.0),
        "jerk": np.abs(second).max(axis=1, initial=0.0) / dt**2,
        "lost": _lost(record),
        "changes": record["t"][starts],
    }


def _acceleration(record: Record) -> np.ndarray:
    if record.meta.limits is None:
        raise InvalidInput("this record tells no limits; shares of the acceleration limits need them")
    return np.array(record.meta.limits.acceleration)


@checked
def transition_table(records: Mapping[str, Record]) -> list[dict[str, Any]]:
    """One row per run and phase change, and one per run for all ticks: largest step, jerk and loss, root mean square jerk.

    A change lasts `WINDOW`; its time, like that of the whole run, is in the column ``t_s``.
    """
    return [row for name, record in records.items() for row in _rows(name, record)]


def _rows(name: str, record: Record) -> list[dict[str, Any]]:
    series, phases = transition_series(record), [phase.name for phase in record.meta.phases]
    t = series["t"]
    windows = [(float(start), (t >= start) & (t < start + WINDOW)) for start in series["changes"]]
    first = [int(np.argmax(rows)) for _, rows in windows]
    labels = ["-".join(phases[record["phase"][row]] for row in (start - 1, start)) for start in first]
    spans = [*zip(labels, windows, strict=True), ("all", (float(t[-1]), np.full(len(t), True)))]
    return [
        {
            "run": name,
            "change": label,
            "t_s": time,
            "step": float(series["step"][rows].max()),
            "jerk": float(series["jerk"][rows].max()),
            "jerk_rms": float(np.sqrt(np.mean(series["jerk"][rows] ** 2))),
            "lost": float(series["lost"][rows].max()),
        }
        for label, (time, rows) in spans
    ]


def _lost(record: Record) -> np.ndarray:
    above = {task.name: k for k, task in enumerate(record.meta.tasks) if not task.label.endswith(_NOT_ABOVE)}
    lost, start = np.zeros(len(record)), 0
    for level in record.meta.levels:
        end = start + level.rows
        if level.name in above:
            on = record["gates"][:, above[level.name]] >= 1.0
            lost = np.maximum(lost, np.where(on, np.linalg.norm(record["residual"][:, start:end], axis=1), 0.0))
        start = end
    return lost

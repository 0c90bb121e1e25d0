"""Compare two runs or two plans, and the smoothness of phase changes of several runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import TableRows
from uvms_ocp.record.record import Record, require_every_tick
from uvms_ocp.record.run_meta import level_rows
from uvms_ocp.report import metrics

WINDOW = 1.0  # [s] after a phase change that belongs to it

_NOT_ABOVE = (",AD]", ",O]")  # labels of actions and of what is optimised


# Two runs, or two plans, side by side.


@checked
def compare(first: Record, second: Record) -> TableRows:
    """Return rows with the keys ``figure``, ``first``, ``second`` and ``change`` [%], `None` where
    one record lacks it.

    Raises `InvalidInput` for a run against a plan.
    """
    kinds = first.meta.kind, second.meta.kind
    if kinds[0] != kinds[1]:
        raise InvalidInput(
            f"the first is a {kinds[0]}, the second a {kinds[1]}; give two runs or two plans"
        )
    figures = _run_figures if kinds[0] == "run" else _plan_figures
    first_figures = dict(figures(first))
    second_figures = dict(figures(second))
    rows = (
        (name, first_figures.get(name), second_figures.get(name))
        for name in first_figures | second_figures
    )
    return TableRows(
        {"figure": name, "first": a, "second": b, "change": _change(a, b)} for name, a, b in rows
    )


def _run_figures(record: Record) -> Iterator[tuple[str, Any]]:
    meta = record.run_meta
    yield "completed", meta.completed
    yield "phases", " ".join(row["phase"] for row in metrics.resources(record)[:-1])
    yield from (
        (name, value) for name, value in metrics.resources(record)[-1].items() if name != "phase"
    )
    yield (
        "tool_position_error_m",
        metrics.none_if_nan(meta.true_quantity(f"{meta.tool_task}.position_error")),
    )
    estimated = metrics.quantities_at(record, float(record["t"][-1]))
    yield (
        "estimated_tool_position_error_m",
        metrics.none_if_nan(estimated.get(f"{meta.tool_task}.position_error")),
    )
    yield "tool_position_bound_m", metrics.error_bound(record, f"{meta.tool_task}.position_error")
    yield "sensors_allow_tool_position_m", meta.allowance.get(f"{meta.tool_task}.position_error")
    yield "largest_tilt_rad", metrics.largest_tilt(record)
    yield "max_velocity_step", metrics.max_velocity_step(record)


def _plan_figures(record: Record) -> Iterator[tuple[str, Any]]:
    yield "plan", record.meta.scenario
    yield "duration_s", float(record["t"][-1] - record["t"][0])
    axes = [i for i, name in enumerate(record.plan_meta.axes) if name in ("x", "y", "z")]
    yield "path_length_m", metrics.path_length(record["x"][:, axes])
    spent = (
        np.sum(record[e][-1]) if e in record.series else np.nan
        for e in ("thruster_energy", "joint_energy")
    )
    thrusters, joints = (metrics.none_if_nan(float(total)) for total in spent)
    yield "thruster_energy_j", thrusters
    yield "joint_energy_j", joints
    yield "energy_j", None if thrusters is None or joints is None else thrusters + joints
    yield "peak_thrust_n", metrics.largest_thrust(record)
    nearest = record.plan_meta.min_clearance
    yield "min_clearance_m", None if nearest is None else nearest.distance


def _change(a: Any, b: Any) -> float | None:
    if isinstance(a, (bool, str)) or a is None or b is None or a == 0:
        return None
    return 100.0 * (b - a) / abs(a)


# How smoothly a run changes from phase to phase, and what the higher levels pay for it.


@checked
def transition_series(record: Record) -> dict[str, np.ndarray]:
    """Series over time ``t`` (n,) [s] of the commanded velocity, and the times ``changes`` (k,) [s]
    of phase changes.

    ``step`` (n,): largest change of any axis since the tick before, as a share of its acceleration
    limit times dt. ``jerk`` (n,) [m/s3, rad/s3]: largest second difference of any axis. ``lost``
    (n,) [m/s, rad/s]: largest norm, over the tasks that are fully on and of a class above the
    actions, of what the task misses of the rate that the acceleration limits let it reach. Raises
    `InvalidInput` for a plan, without limits, or with fewer rows than ticks.
    """
    if record.meta.limits is None:
        raise InvalidInput(
            "this record tells no limits; shares of the acceleration limits need them"
        )
    dt = require_every_tick(record).dt
    limits = np.array(record.meta.limits.acceleration)
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


@checked
def transition_table(records: Mapping[str, Record]) -> list[dict[str, Any]]:
    """One row per run and phase change, and one per run for all ticks: largest step, jerk and loss,
    root mean square jerk.

    A change lasts `WINDOW`; its time, like that of the whole run, is in the column ``t_s``.
    """
    return [row for name, record in records.items() for row in _rows(name, record)]


def _rows(name: str, record: Record) -> list[dict[str, Any]]:
    series = transition_series(record)
    phases = [phase.name for phase in record.meta.phases]
    t = series["t"]
    windows = [(float(start), (t >= start) & (t < start + WINDOW)) for start in series["changes"]]
    start_rows = [int(np.argmax(rows)) for _, rows in windows]
    phase = record["phase"]
    labels = [f"{phases[phase[start - 1]]}-{phases[phase[start]]}" for start in start_rows]
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
    above = {
        task.name: k
        for k, task in enumerate(record.meta.tasks)
        if not task.label.endswith(_NOT_ABOVE)
    }
    lost = np.zeros(len(record))
    for name, rows in level_rows(record.meta):
        if name in above:
            on = record["activations"][:, above[name]] >= 1.0
            lost = np.maximum(
                lost, np.where(on, np.linalg.norm(record["residual"][:, rows], axis=1), 0.0)
            )
    return lost

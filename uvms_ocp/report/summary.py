"""The report of one run."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.mission.conditions import ABORT, DONE
from uvms_ocp.record import Record
from uvms_ocp.report.cause import cause_of_end
from uvms_ocp.report.estimate import error_bound, estimate_table
from uvms_ocp.report.goals import ended_too_early, goal_table
from uvms_ocp.report.load import learnt_load
from uvms_ocp.report.resources import figures_between, resources
from uvms_ocp.report.sensor_health import sensor_health
from uvms_ocp.report.series import known, largest_tilt, max_velocity_step, quantities_at
from uvms_ocp.run_meta import versions

_SETTLING = 0.5  # [s] after the start of a phase, before its drift counts


@checked
def summarize(record: Record) -> dict[str, Any]:
    """The content of ``report.json``; `None` where a figure does not apply to the run or is not known. Tool errors are
    true ones, with what the mission went by beside them.

    Lengths in m, angles in rad, times in s unless the key says otherwise. Raises `InvalidInput` for the record of a plan.
    """
    meta, task = record.run_meta, record.run_meta.tool_task
    estimated = _known(quantities_at(record, float(record["t"][-1])))
    return {
        **{name: getattr(meta, name) for name in ("scenario", "robot", "plant", "solver")},
        **{part: getattr(meta, part) or None for part in ("controller", "estimator", "sensors")},
        "completed": meta.completed,
        "pending": meta.pending,
        "cause": cause_of_end(record),
        "ended_too_early": sorted({row["phase"] for row in ended_too_early(record)}) if meta.completed else [],
        "goals": goal_table(record),
        "phases": phase_table(record),
        "resources": resources(record),
        "seed": meta.seed,
        "noise": meta.noise,
        "faults": [fault.model_dump() for fault in meta.faults],
        "sensor_health": sensor_health(record),
        "load": learnt_load(record),
        "alarms": [alarm.model_dump() for alarm in meta.alarms],
        "tool_position_error_m": known(meta.true_quantity(f"{task}.position_error")),
        "tool_orientation_error_rad": known(meta.true_quantity(f"{task}.orientation_error")),
        "estimated_tool_position_error_m": estimated.get(f"{task}.position_error"),
        "estimated_tool_orientation_error_rad": estimated.get(f"{task}.orientation_error"),
        "tool_position_bound_m": error_bound(record, f"{task}.position_error"),
        "tool_orientation_bound_rad": error_bound(record, f"{task}.orientation_error"),
        "sensors_allow_tool_position_m": meta.allowance.get(f"{task}.position_error"),
        "sensors_allow_tool_orientation_rad": meta.allowance.get(f"{task}.orientation_error"),
        "estimate": estimate_table(record),
        "vehicle_drift_in_last_phase_m": _drift_in_last_phase(record),
        "largest_tilt_rad": largest_tilt(record),
        "min_altimeter_m": _smallest(record["altimeter_range"]),
        "max_velocity_step": max_velocity_step(record),
        "failed_ticks": _failed_ticks(record),
        "tick_us": _percentiles_us(record["tick_time"]),
        "controller_us": _percentiles_us(record["controller_time"]) if "controller_time" in record.series else None,
        "wall_s": meta.wall_s,
        "simulated_s": float(record["t"][-1]),
        "versions": versions(meta.packages),
    }


@checked
def phase_table(record: Record) -> list[dict[str, Any]]:
    """One row per phase that was entered, in order of time: name, title, start, end, reason, errors at its end.

    ``final_errors`` are those that the mission went by, ``true_errors`` the true ones, empty in older records.
    """
    meta = record.run_meta
    entered = [event for event in meta.events if event.target not in (DONE, ABORT)]
    starts = [0.0, *(event.t for event in entered)]
    names = [meta.phases[0].name, *(event.target for event in entered)]
    ends = [*(event.t for event in meta.events), float(record["t"][-1])]
    truths = [*(event.truth for event in meta.events), {item.name: item.value for item in meta.true_quantities}]
    reasons = [*(event.reason for event in meta.events), f"time is over, waiting for: {meta.pending}"]
    phases = {phase.name: phase for phase in meta.phases}
    return [
        {
            "name": name,
            "title": phases[name].title,
            "tasks": list(phases[name].tasks),
            "start_s": start,
            "end_s": end,
            "reason": reason,
            "final_errors": _known(quantities_at(record, end)),
            "true_errors": _known(truth),
            "sensors_allow": meta.allowance,
            **figures_between(record, start, end),
        }
        for name, start, end, reason, truth in zip(names, starts, ends, reasons, truths, strict=False)
    ]


def _known(quantities: dict[str, float]) -> dict[str, float | None]:
    return {name: known(value) for name, value in quantities.items()}


def _drift_in_last_phase(record: Record) -> float | None:
    phase = record["phase"]
    start = len(phase) - int(np.argmax(phase[::-1] != phase[-1])) if (phase != phase[-1]).any() else 0
    t = record["t"]
    settled = t >= t[start] + _SETTLING
    if not settled.any():
        return None
    if not record.run_meta.floating:
        return None
    positions = record["q"][settled, :3]
    return float(np.linalg.norm(positions - positions[0], axis=1).max())


def _failed_ticks(record: Record) -> dict[str, int]:
    codes, counts = np.unique(record["status"], return_counts=True)
    names = [record.run_meta.statuses[code] for code in codes]
    return {name: int(count) for name, count in zip(names, counts, strict=True) if name != "solved"}


def _smallest(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.min()) if known.size else None


def _percentiles_us(seconds: np.ndarray) -> dict[str, float]:
    p50, p99, top = np.percentile(seconds * 1e6, [50, 99, 100])
    return {"p50": float(p50), "p99": float(p99), "max": float(top)}

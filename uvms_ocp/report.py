"""Figures of merit of one run, read from its `Record` alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.record import Record

_SETTLING = 0.5  # [s] after the start of a phase, before its drift counts


def summarize(record: Record) -> dict[str, Any]:
    """The content of ``report.json``; `None` where a figure does not apply to the run. Tool errors are true ones.

    Lengths in m, angles in rad, times in s unless the key says otherwise.
    """
    meta = record.meta
    tool = meta["tool_task"]
    return {
        "scenario": meta["scenario"],
        "robot": meta["robot"],
        "plant": meta["plant"],
        "solver": meta["solver"],
        "completed": meta["completed"],
        "pending": meta["pending"],
        "phases": phase_table(record),
        "seed": meta["seed"],
        "noise": meta["noise"],
        "alarms": meta["alarms"],
        "tool_position_error_m": meta["true_quantities"].get(f"{tool}.position_error"),
        "tool_orientation_error_rad": meta["true_quantities"].get(f"{tool}.orientation_error"),
        "vehicle_drift_in_last_phase_m": _drift_in_last_phase(record),
        "min_altimeter_m": float(np.nanmin(record["altimeter_range"])),
        "max_velocity_step": max_velocity_step(record),
        "failed_ticks": _failed_ticks(record),
        "tick_us": _percentiles_us(record["tick_time"]),
        "wall_s": meta["wall_s"],
        "simulated_s": float(record["t"][-1]),
        "versions": meta["versions"],
    }


def quantity(record: Record, name: str) -> np.ndarray | None:
    """The series (n,) of a measured quantity such as ``T.position_error``; `None` where no task measures it."""
    names = record.meta["quantities"]
    return record["quantities"][:, names.index(name)] if name in names else None


def phase_table(record: Record) -> list[dict[str, Any]]:
    """One row per phase that was entered, in order of time: name, title, start, end, reason, errors at its end."""
    events = record.meta["events"]
    starts = [0.0, *(event["t"] for event in events if event["target"] != "done")]
    names = [
        record.meta["phases"][0]["name"],
        *(event["target"] for event in events if event["target"] != "done"),
    ]
    ends = [event["t"] for event in events] + [float(record["t"][-1])]
    reasons = [event["reason"] for event in events] + [f"time is over, waiting for: {record.meta['pending']}"]
    phases = {phase["name"]: phase for phase in record.meta["phases"]}
    return [
        {
            "name": name,
            "title": phases[name]["title"],
            "tasks": phases[name]["tasks"],
            "start_s": start,
            "end_s": end,
            "reason": reason,
            "final_errors": _quantities_at(record, end),
            **_resources(record, start, end),
        }
        for name, start, end, reason in zip(names, starts, ends, reasons, strict=False)
    ]


def _resources(record: Record, start: float, end: float) -> dict[str, float]:
    """What a phase cost: path of the vehicle, and on a plant with thrusters energy, peak thrust and saturation."""
    rows = slice(*np.searchsorted(record["t"], [start - 1e-9, end + 1e-9]))
    steps = np.diff(record["q"][rows, :3], axis=0) if record.meta["floating"] else np.zeros((0, 3))
    resources = {"path_length_m": float(np.linalg.norm(steps, axis=1).sum())}
    if "thrust" not in record.series:
        return resources
    thrusters, joints = record["thruster_energy"][rows], record["joint_energy"][rows]
    return resources | {
        "thruster_energy_j": float((thrusters[-1] - thrusters[0]).sum()),
        "joint_energy_j": float(joints[-1] - joints[0]),
        "energy_j": float((thrusters[-1] - thrusters[0]).sum() + joints[-1] - joints[0]),
        "peak_thrust_n": float(np.abs(record["thrust"][rows]).max(initial=0.0)),
        "saturation_time_s": float(np.count_nonzero(record["saturated"][rows]) * record.meta["dt"]),
    }


def max_velocity_step(record: Record) -> float:
    """Largest change of any component of the command in one tick, from rest at the start."""
    steps = np.diff(record["command"], axis=0, prepend=np.zeros((1, record["command"].shape[1])))
    return float(np.abs(steps).max())


def _quantities_at(record: Record, t: float) -> dict[str, float]:
    row = record["quantities"][min(int(np.searchsorted(record["t"], t - 1e-9)), len(record) - 1)]
    return dict(zip(record.meta["quantities"], row.tolist(), strict=True))


def _drift_in_last_phase(record: Record) -> float | None:
    phase = record["phase"]
    start = len(phase) - int(np.argmax(phase[::-1] != phase[-1])) if (phase != phase[-1]).any() else 0
    t = record["t"]
    settled = t >= t[start] + _SETTLING
    if not settled.any():
        return None
    if not record.meta["floating"]:
        return None
    positions = record["q"][settled, :3]
    return float(np.linalg.norm(positions - positions[0], axis=1).max())


def _failed_ticks(record: Record) -> dict[str, int]:
    codes, counts = np.unique(record["status"], return_counts=True)
    names = [record.meta["statuses"][code] for code in codes]
    return {name: int(count) for name, count in zip(names, counts, strict=True) if name != "solved"}


def _percentiles_us(seconds: np.ndarray) -> dict[str, float]:
    p50, p99, top = np.percentile(seconds * 1e6, [50, 99, 100])
    return {"p50": float(p50), "p99": float(p99), "max": float(top)}

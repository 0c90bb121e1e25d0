"""Resource allocation: what each phase takes in time, energy, thrust and room to the limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.record import Record
from uvms_ocp.report.series import visits


def resources(record: Record) -> list[dict[str, Any]]:
    """One row per visit to a phase and a last row ``total``; `None` where a plant does not tell.

    Keys: phase, start_s, duration_s, thruster_energy_J, joint_energy_J, path_m of the vehicle, joint_path_rad summed
    over the joints, peak_thrust_N, saturated_s with thrusters at their limits, joint_margin_rad to the nearest position
    limit, velocity_share of the largest velocity in its limit, torque_share of the largest torque in its limit.
    """
    parts = visits(record)
    rows = [{"phase": name, **_figures(record, rows)} for name, rows in parts]
    return [*rows, {"phase": "total", **_figures(record, slice(0, len(record)))}]


def _figures(record: Record, rows: slice) -> dict[str, Any]:
    t = record["t"]
    end = min(rows.stop, len(t) - 1)
    return {
        "start_s": float(t[rows.start]),
        "duration_s": float(t[end] - t[rows.start]),
        "thruster_energy_J": _gain(record, "thruster_energy", rows),
        "joint_energy_J": _gain(record, "joint_energy", rows),
        "path_m": _length(record["q"][rows.start : end + 1, :3]),
        "joint_path_rad": _joint_path(record, slice(rows.start, end + 1)),
        "peak_thrust_N": _peak(record, "thrust", rows),
        "saturated_s": _saturated(record, rows),
        "joint_margin_rad": _joint_margin(record, rows),
        "velocity_share": _share(record, "v", "velocity", rows),
        "torque_share": _share(record, "torque", "effort", rows),
    }


def _gain(record: Record, name: str, rows: slice) -> float | None:
    """Increase of a running total; the row after the last is where the phase ends."""
    if name not in record.series:
        return None
    total = record[name] if record[name].ndim == 1 else record[name].sum(axis=1)
    return float(total[min(rows.stop, len(total) - 1)] - total[rows.start])


def _length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _joint_path(record: Record, rows: slice) -> float:
    rates = record["v"][rows, -len(record.meta["limits"]["position_lower"]) :]
    return float(np.abs(rates).sum() * record.meta["dt"])


def _peak(record: Record, name: str, rows: slice) -> float | None:
    return float(np.abs(record[name][rows]).max(initial=0.0)) if name in record.series else None


def _saturated(record: Record, rows: slice) -> float | None:
    if "saturated" not in record.series:
        return None
    return float(record["saturated"][rows].sum() * record.meta["dt"])


def _joint_margin(record: Record, rows: slice) -> float | None:
    limits = record.meta["limits"]
    lower, upper = np.array(limits["position_lower"]), np.array(limits["position_upper"])
    joints = record["q"][rows, -len(lower) :] if record["q"].shape[1] - 7 == len(lower) else None
    if joints is None or not len(lower):
        return None
    margin = float(np.minimum(joints - lower, upper - joints).min())
    return margin if np.isfinite(margin) else None


def _share(record: Record, name: str, limit: str, rows: slice) -> float | None:
    """The largest value in units of its limit."""
    if name not in record.series or limit not in record.meta["limits"]:
        return None
    return float((np.abs(record[name][rows]) / np.array(record.meta["limits"][limit])).max(initial=0.0))

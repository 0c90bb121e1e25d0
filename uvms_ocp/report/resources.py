"""Resource allocation: what each phase takes in time, energy, thrust and room to the limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.mission.conditions import ABORT, DONE
from uvms_ocp.record import Record

_N_VEHICLE = 6  # velocity degrees of freedom of a free-flyer


@checked
def resources(record: Record) -> list[dict[str, Any]]:
    """One row per visit to a phase, in order of time, and a last row ``total``: `phase` and `figures_between`.

    Raises `InvalidInput` for the record of a plan.
    """
    t, meta = record["t"], record.run_meta
    ends = [*(event.t for event in meta.events), float(t[-1])]
    names = [meta.phases[0].name, *(event.target for event in meta.events)]
    spans = [span for span in zip(names, [0.0, *ends], ends, strict=False) if span[0] not in (ABORT, DONE)]
    rows = [{"phase": name, **figures_between(record, start, end)} for name, start, end in spans]
    return [*rows, {"phase": "total", **figures_between(record, 0.0, float(t[-1]))}]


def figures_between(record: Record, start: float, end: float) -> dict[str, Any]:
    """What the time from `start` to `end` [s] took; `None` where the plant does not tell or the robot's file does not.

    Path of the vehicle and of the joints, energy of thrusters and joints, peak thrust, time with thrusters at their
    limits, least distance of a joint to its limits, largest velocity and torque in units of their limits.
    """
    first, last = (int(np.searchsorted(record["t"], t - 1e-9)) for t in (start, end))
    rows = slice(first, min(last, len(record) - 1) + 1)
    limits = record.meta.limits
    thrusters, joints = _gain(record, "thruster_energy", rows), _gain(record, "joint_energy", rows)
    return {
        "duration_s": end - start,
        "path_length_m": _length(record["q"][rows, :3]) if record.run_meta.floating else 0.0,
        "joint_path_rad": _joint_path(record, rows),
        "thruster_energy_j": thrusters,
        "joint_energy_j": joints,
        "energy_j": None if thrusters is None or joints is None else thrusters + joints,
        "peak_thrust_n": _peak(record, "thrust", rows),
        "saturation_time_s": _saturated(record, rows),
        "joint_margin_rad": _joint_margin(record, rows),
        "velocity_share": _share(record, "v", None if limits is None else limits.velocity, rows),
        "torque_share": _share(record, "torque", None if limits is None else limits.effort, rows),
    }


def _gain(record: Record, name: str, rows: slice) -> float | None:
    """Increase of a running total; of thrusters only where the power of each is known."""
    if name not in record.series:
        return None
    total = record[name] if record[name].ndim == 1 else record[name].sum(axis=1)
    gain = float(total[rows.stop - 1] - total[rows.start])
    return None if np.isnan(gain) else gain


def _length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _joint_path(record: Record, rows: slice) -> float:
    meta = record.run_meta
    rates = record["v"][rows, _N_VEHICLE if meta.floating else 0 :]
    return float(np.abs(rates[:-1]).sum() * meta.dt)


def _peak(record: Record, name: str, rows: slice) -> float | None:
    return float(np.abs(record[name][rows]).max(initial=0.0)) if name in record.series else None


def _saturated(record: Record, rows: slice) -> float | None:
    if "saturated" not in record.series:
        return None
    return float(np.count_nonzero(record["saturated"][rows][:-1]) * record.run_meta.dt)


def _joint_margin(record: Record, rows: slice) -> float | None:
    meta = record.run_meta
    if meta.limits is None:
        return None
    lower, upper = np.array(meta.limits.position_lower), np.array(meta.limits.position_upper)
    n_vehicle = 7 if meta.floating else 0
    if record["q"].shape[1] - n_vehicle != len(lower) or not len(lower):
        return None  # joints that turn without end have two entries in q
    joints = record["q"][rows, n_vehicle:]
    margin = float(np.minimum(joints - lower, upper - joints).min())
    return margin if np.isfinite(margin) else None


def _share(record: Record, name: str, limits: tuple[float, ...] | None, rows: slice) -> float | None:
    """The largest value in units of its limit; what may not move at all has no unit."""
    if name not in record.series or limits is None:
        return None
    bounds = np.array(limits)
    limited = bounds > 0.0
    with np.errstate(over="ignore"):  # a limit may be as small as it likes
        return float((np.abs(record[name][rows][:, limited]) / bounds[limited]).max(initial=0.0))

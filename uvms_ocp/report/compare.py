"""Two runs, or two plans, side by side."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.record import Record
from uvms_ocp.report.estimate import error_bound
from uvms_ocp.report.resources import resources
from uvms_ocp.report.series import known, largest_tilt, max_velocity_step, quantities_at


@checked
def compare(first: Record, second: Record) -> list[dict[str, Any]]:
    """Rows with the keys ``figure``, ``first``, ``second`` and ``change`` [%], `None` where one record lacks it.

    Raises `InvalidInput` for a run against a plan.
    """
    kinds = first.meta.kind, second.meta.kind
    if kinds[0] != kinds[1]:
        raise InvalidInput(f"the first is a {kinds[0]}, the second a {kinds[1]}; give two runs or two plans")
    figures = _run_figures if kinds[0] == "run" else _plan_figures
    pairs = zip(figures(first), figures(second), strict=True)
    return [{"figure": name, "first": a, "second": b, "change": _change(a, b)} for (name, a), (_, b) in pairs]


def _run_figures(record: Record) -> Iterator[tuple[str, Any]]:
    meta = record.run_meta
    yield "completed", meta.completed
    yield "phases", " ".join(row["phase"] for row in resources(record)[:-1])
    yield from ((name, value) for name, value in resources(record)[-1].items() if name != "phase")
    yield "tool_position_error_m", known(meta.true_quantity(f"{meta.tool_task}.position_error"))
    estimated = quantities_at(record, float(record["t"][-1]))
    yield "estimated_tool_position_error_m", known(estimated.get(f"{meta.tool_task}.position_error"))
    yield "tool_position_bound_m", error_bound(record, f"{meta.tool_task}.position_error")
    yield "sensors_allow_tool_position_m", meta.allowance.get(f"{meta.tool_task}.position_error")
    yield "largest_tilt_rad", largest_tilt(record)
    yield "max_velocity_step", max_velocity_step(record)


def _plan_figures(record: Record) -> Iterator[tuple[str, Any]]:
    yield "plan", record.meta.scenario
    yield "duration_s", float(record["t"][-1] - record["t"][0])
    yield "path_length_m", _path_length(record)
    thrusters, joints = (_last(record, name) for name in ("thruster_energy", "joint_energy"))
    yield "thruster_energy_j", thrusters
    yield "joint_energy_j", joints
    yield "energy_j", None if thrusters is None or joints is None else thrusters + joints
    yield "peak_thrust_n", float(np.abs(record["thrust"]).max(initial=0.0)) if "thrust" in record.series else None
    nearest = record.plan_meta.min_clearance
    yield "min_clearance_m", None if nearest is None else nearest.distance


def _path_length(record: Record) -> float:
    """Way of the vehicle; 0 where it is not planned."""
    axes = [i for i, name in enumerate(record.plan_meta.axes) if name in ("x", "y", "z")]
    return float(np.linalg.norm(np.diff(record["x"][:, axes], axis=0), axis=1).sum())


def _last(record: Record, name: str) -> float | None:
    """The total at the end; `None` where it is not known."""
    total = float(np.sum(record[name][-1])) if name in record.series else np.nan
    return None if np.isnan(total) else total


def _change(a: Any, b: Any) -> float | None:
    if isinstance(a, (bool, str)) or a is None or b is None or a == 0:
        return None
    return 100.0 * (b - a) / abs(a)

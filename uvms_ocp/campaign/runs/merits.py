"""Figures of merit of one run, a number each: what a campaign has distributions of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uvms_ocp.record import Record
from uvms_ocp.report.resources import figures_between
from uvms_ocp.report.series import known, largest, quantity
from uvms_ocp.scenario import Scenario
from uvms_ocp.sim.closest_approach import closest_approach

MERITS: Mapping[str, str] = {
    "duration_s": "simulated time until the run ended [s]",
    "tool_position_error_m": "true distance of the tool from its goal at the end [m]",
    "tool_orientation_error_rad": "true angle of the tool from its goal at the end [rad]",
    "energy_j": "electrical energy of thrusters and joints [J]",
    "clearance_m": "least distance from any obstacle; nothing without obstacles [m]",
    "min_altimeter_m": "least reading of the altimeter [m]",
    "path_length_m": "way of the vehicle [m]",
    "joint_margin_rad": "least distance of a joint from its limits [rad]",
    "saturation_time_s": "time with a thruster at its limit [s]",
    "peak_thrust_n": "largest thrust [N]",
    "tilt_rad": "largest tilt of the vehicle [rad]",
    "alarms": "number of alarms [-]",
    "failed_ticks": "ticks that the solver did not solve [-]",
}
"""What each is, with its unit."""
_TOLD = ("energy_j", "path_length_m", "joint_margin_rad", "saturation_time_s", "peak_thrust_n")
_LOOKS = 200  # configurations at which the clearance is measured


def merits(scenario: Scenario, record: Record) -> dict[str, float | None]:
    """By name, as `MERITS`; `None` where a run has no such figure."""
    meta, task, end = record.run_meta, record.run_meta.tool_task, float(record["t"][-1])
    spent, ranges = figures_between(record, 0.0, end), record["altimeter_range"]
    seen = ranges[np.isfinite(ranges)]
    return {
        "duration_s": end,
        "tool_position_error_m": known(meta.true_quantity(f"{task}.position_error")),
        "tool_orientation_error_rad": known(meta.true_quantity(f"{task}.orientation_error")),
        **{name: spent[name] for name in _TOLD},
        "clearance_m": _clearance(scenario, record),
        "min_altimeter_m": float(seen.min()) if seen.size else None,
        "tilt_rad": largest(quantity(record, "HA.tilt")),
        "alarms": float(len(meta.alarms)),
        "failed_ticks": _failed(record),
    }


def _clearance(scenario: Scenario, record: Record) -> float | None:
    if not scenario.environment.obstacles:
        return None
    q: Any = record["q"][:: max(1, len(record) // _LOOKS)]
    if not np.isfinite(q).all():
        return None
    return closest_approach(scenario.robot, scenario.environment, q, floor=False).distance


def _failed(record: Record) -> float:
    codes, counts = np.unique(record["status"], return_counts=True)
    return float(sum(n for code, n in zip(codes, counts, strict=True) if record.run_meta.statuses[code] != "solved"))

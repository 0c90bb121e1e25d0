"""Figures of merit of one run, a number each, and their distributions over a campaign."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from uvms_ocp.record.record import Record, quantity
from uvms_ocp.report import metrics
from uvms_ocp.report.phase_resources import figures_between
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.nearest_passage import closest_approach

_TABLE = (files("uvms_ocp.campaign") / "metrics.csv").read_text(encoding="utf-8").splitlines()
METRICS: Mapping[str, str] = {row["metric"]: row["meaning"] for row in csv.DictReader(_TABLE)}
"""Metrics of a run, with unit and meaning."""
OF_EACH_TOOL = ("tool_position_error_m", "tool_orientation_error_rad", "clearance_m")
"""Metrics that a robot with several tools has of each, such as ``clearance_m[port_tool]``, the
clearance of the arm with that tool.
"""
_FROM_RESOURCES = (
    "energy_j",
    "path_length_m",
    "joint_margin_rad",
    "joint_margin_m",
    "saturation_time_s",
    "peak_thrust_n",
)
"""Metrics that `figures_between` computes, under the same names."""
_CLEARANCE_SAMPLES = 200  # configurations at which the clearance is measured

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
"""Quantiles of a metric over the runs of a campaign."""
_QUANTILE_NAMES = ("least", "5 %", "25 %", "median", "75 %", "95 %", "largest")


def tool_metrics(robot: Robot) -> dict[str, str]:
    """Return the metrics of single tools, each with its tool; none for a robot with one tool."""
    if len(robot.tools) <= 1:
        return {}
    tools = {}
    for tool in robot.tools:
        for name in OF_EACH_TOOL:
            tools[f"{name}[{tool}]"] = tool
    return tools


def metrics_among(columns: Iterable[str]) -> dict[str, str]:
    """Return `METRICS` and the metrics of single tools among columns of a campaign, with their
    meanings.
    """
    meanings = dict(METRICS)
    for name in columns:
        kind = kind_of(name)
        if name != kind and kind in METRICS:
            meanings[name] = f"{METRICS[kind]}, of {name}"
    return meanings


def kind_of(name: str) -> str:
    """Return the metric in a column, without its tool."""
    return name.partition("[")[0]


def run_metrics(scenario: Scenario, record: Record) -> dict[str, float | None]:
    """Compute the metrics of a run by name, as in `METRICS` and `tool_metrics`; `None` where a run
    has no such figure.
    """
    meta = record.run_meta
    task = record.run_meta.tool_task
    end = float(record["t"][-1])
    spent = figures_between(record, 0.0, end)
    tilt = quantity(record, "HA.tilt", metrics.extremes_of(record, "quantities")[-1])
    if tilt is None:
        largest_tilt = metrics.largest_tilt(record)
    else:
        largest_tilt = metrics.largest_or_none(tilt)
    failed = metrics.failed_ticks(record)
    n_failed = None
    if failed is not None:
        n_failed = float(sum(failed.values()))
    figures = {
        "duration_s": end,
        "tool_position_error_m": meta.true_quantity(f"{task}.position_error"),
        "tool_orientation_error_rad": meta.true_quantity(f"{task}.orientation_error"),
        **{name: spent.get(name) for name in _FROM_RESOURCES},
        "clearance_m": _clearance(scenario, record, None),
        "min_altimeter_m": metrics.smallest_altimeter_range(record),
        "tilt_rad": largest_tilt,
        "alarms": float(len(meta.alarms)),
        "failed_ticks": n_failed,
    }
    for name, tool in tool_metrics(scenario.robot).items():
        kind = kind_of(name)
        if kind == "clearance_m":
            figures[name] = _clearance(scenario, record, tool)
            continue
        tasks_of_tool = [task_meta.name for task_meta in meta.tasks if task_meta.tool == tool]
        task_name = tasks_of_tool[0] if tasks_of_tool else ""
        error = kind.removeprefix("tool_").rpartition("_")[0]  # without its unit
        figures[name] = meta.true_quantity(f"{task_name}.{error}")
    return {name: _finite_or_none(figure) for name, figure in figures.items()}


def _finite_or_none(figure: float | None) -> float | None:
    if figure is None or not np.isfinite(figure):
        return None
    return float(figure)


def _clearance(scenario: Scenario, record: Record, tool: str | None) -> float | None:
    """Compute the least distance [m] to obstacles along a run, of the whole robot or of the arm
    that moves the tool.
    """
    if not scenario.environment.obstacles:
        return None
    q: Any = record["q"][:: max(1, len(record) // _CLEARANCE_SAMPLES)]
    if not np.isfinite(q).all():
        return None
    if tool is None:
        links = None
    else:
        links = scenario.robot.arm_shapes(tool)
    return closest_approach(
        scenario.robot, scenario.environment, q, floor=False, links=links
    ).distance


def metric_values(table: Any, name: str) -> np.ndarray:
    """Return a metric (n,) [its unit] of all runs of a table, NaN where a run has none, as in a
    campaign of a version that did not compute it.
    """
    return np.asarray(table.reindex(columns=[name])[name].to_numpy(dtype=float, na_value=np.nan))


def distribution_table(table: Any) -> list[dict[str, Any]]:
    """Return one row per metric that some run has, with quantiles over those runs, failed ones
    among them.
    """
    rows = []
    for name, meaning in metrics_among(table).items():
        values = metric_values(table, name)
        finite_values = values[np.isfinite(values)]
        if finite_values.size:
            row = {"figure": name, "meaning": meaning, "runs": int(finite_values.size)}
            quantiles = np.quantile(finite_values, QUANTILES)
            for quantile_name, quantile in zip(_QUANTILE_NAMES, quantiles, strict=True):
                row[quantile_name] = float(quantile)
            rows.append(row)
    return rows

"""Report of one run: its phases, goals, load, sensor health, and why it ended."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.display import SmallTable, TableDisplay, cell
from uvms_ocp.record.meta_values import ABORT, DONE
from uvms_ocp.record.record import Record, keeps_every_tick
from uvms_ocp.record.run_meta import RunMeta, versions
from uvms_ocp.report import metrics, phase_resources
from uvms_ocp.report.end_of_run import cause_of_end, ended_prematurely, goal_table

_SUSPECT = 1  # codes of the health of a channel
_LOST = 2
_SETTLING = 0.5  # [s] after the start of a phase, before its drift counts
_PHASE_COLUMNS = ("name", "start_s", "end_s", "energy_j", "path_length_m", "reason")
"""Columns of the table of phases where none is repeated."""


class RunSummary(TableDisplay, dict[str, Any]):
    """Figures of a run by name, as in ``report.json``; shown as one page: how it ended, its phases,
    errors and alarms.
    """

    __slots__ = ()

    def _table(self) -> SmallTable:
        if self["repeated"]:
            columns = tuple(self["repeated"][0])
            phase_rows = self["repeated"]
        else:
            columns = _PHASE_COLUMNS
            phase_rows = self["phases"]
        rows = list[tuple[str, ...]]()
        for row in phase_rows:
            rows.append(tuple(cell(row[name]) for name in columns))
        shown = ("energy_", "tool_", "largest_", "min_")
        for name, value in self.items():
            if name.startswith(shown) and value is not None:
                rows.append((name, cell(value)))
        if len(self["tools"]) > 1:
            for tool, errors in self["tools"].items():
                for kind, error in errors.items():
                    rows.append((f"{tool}: {kind} error", cell(error)))
        for alarm in self["alarms"]:
            rows.append(("alarm", cell(alarm["t"]), alarm["text"]))
        title = f"{self['scenario']}, {self['robot']}: {self['cause']['kind']}"
        head = ("phase", *columns[1:])
        return SmallTable(title=title, words=self["cause"]["text"], head=head, rows=tuple(rows))


@checked
def summarize(record: Record) -> RunSummary:
    """Return the content of ``report.json``; `None` where a figure does not apply to the run or is
    not known.

    Tool errors are true ones, with the estimates that the mission went by beside them: those of the
    first tool, and of all tools in ``tools`` by name. Lengths in m, angles in rad, times in s
    unless the key says otherwise. Raises `InvalidInput` for the record of a plan, and for one
    without a series that is needed.
    """
    try:
        return RunSummary(_figures(record))
    except NameNotFound as error:
        raise InvalidInput(
            f"part of a record: no series {error.given!r}; give one with all series"
        ) from None


def _figures(record: Record) -> dict[str, Any]:
    meta = record.run_meta
    estimated = _none_if_nan(metrics.quantities_at(record, float(record["t"][-1])))
    too_early = []
    if meta.completed:
        too_early = sorted({row["phase"] for row in ended_prematurely(record)})
    figures: dict[str, Any] = {
        "scenario": meta.scenario,
        "robot": meta.robot,
        "plant": meta.plant,
        "solver": meta.solver,
        "controller": meta.controller or None,
        "estimator": meta.estimator or None,
        "sensors": meta.sensors or None,
        "completed": meta.completed,
        "pending": meta.pending,
        "cause": cause_of_end(record),
        "ended_too_early": too_early,
        "goals": goal_table(record),
        "swings": [asdict(swing) for swing in metrics.swings(record)],
        "passed_rates": metrics.passed_rates(record),
        "pressed_stops": metrics.pressed_stops(record),
        "phases": phase_table(record),
    }
    resources = phase_resources.resources(record)
    figures |= {
        "resources": resources,
        "repeated": phase_resources.repeated_phases(resources),
        "energy_j": resources[-1]["energy_j"],
        "energy_planned_j": meta.planned_energy,
        "energy_of_quick_thrust_j": phase_resources.energy_of_quick_thrust(record),
        "seed": meta.seed,
        "noise": meta.noise,
        "faults": [fault.model_dump() for fault in meta.faults],
        "sensor_health": sensor_health(record),
    }
    loads = load_estimates(record)
    figures |= {
        "load": next(iter(loads.values()), None),
        "loads": loads,
        "alarms": [alarm.model_dump() for alarm in meta.alarms],
        **_tool_figures(record, estimated),
        "estimate": metrics.estimate_table(record),
        "vehicle_drift_in_last_phase_m": _drift_in_last_phase(record),
        "largest_tilt_rad": metrics.largest_tilt(record),
        "min_altimeter_m": metrics.smallest_altimeter_range(record),
        "max_velocity_step": metrics.max_velocity_step(record),
        "failed_ticks": metrics.failed_ticks(record),
        "tick_us": _percentiles_us(record, "tick_time"),
    }
    controller_times = None
    if "controller_time" in record.series:
        controller_times = _percentiles_us(record, "controller_time")
    figures |= {
        "controller_us": controller_times,
        "wall_s": meta.wall_s,
        "simulated_s": float(record["t"][-1]),
        "versions": versions(meta.packages),
    }
    return figures


def _tool_figures(record: Record, estimated: dict[str, float | None]) -> dict[str, Any]:
    """Return errors of the first tool at the end, true, estimated, bounded and allowed by the
    sensors, and true ones of all tools.

    estimated: quantities at the end [in their units], by name.
    """
    meta = record.run_meta
    true_errors = {}
    estimates = {}
    bounds = {}
    allowances = {}
    for kind, unit in (("position", "m"), ("orientation", "rad")):
        name = f"{meta.tool_task}.{kind}_error"
        true_errors[f"tool_{kind}_error_{unit}"] = metrics.none_if_nan(meta.true_quantity(name))
        estimates[f"estimated_tool_{kind}_error_{unit}"] = estimated.get(name)
        bounds[f"tool_{kind}_bound_{unit}"] = metrics.error_bound(record, name)
        allowances[f"sensors_allow_tool_{kind}_{unit}"] = meta.allowance.get(name)
    tools = {}
    for task in meta.tasks:
        if task.tool:
            tools[task.tool] = {
                kind: metrics.none_if_nan(meta.true_quantity(f"{task.name}.{kind}_error"))
                for kind in ("position", "orientation")
            }
    return true_errors | estimates | bounds | allowances | {"tools": tools}


@checked
def phase_table(record: Record) -> list[dict[str, Any]]:
    """Return one row per phase that was entered, in order of time: name, title, start, end, reason,
    errors at its end.

    ``final_errors`` are those that the mission went by, ``true_errors`` the true ones, empty in
    older records.
    """
    meta = record.run_meta
    end_time = float(record["t"][-1])
    end_truth = {item.name: item.value for item in meta.true_quantities}
    endings = [(event.t, event.reason, event.truth) for event in meta.events]
    endings.append((end_time, f"time is over, waiting for: {meta.pending}", end_truth))
    entered = [event for event in meta.events if event.target not in (DONE, ABORT)]
    starts = [(meta.phases[0].name, 0.0), *((event.target, event.t) for event in entered)]
    phases = {phase.name: phase for phase in meta.phases}
    rows = []
    for (name, start), (end, reason, truth) in zip(starts, endings, strict=False):
        rows.append(
            {
                "name": name,
                "title": phases[name].title,
                "tasks": list(phases[name].tasks),
                "start_s": start,
                "end_s": end,
                "reason": reason,
                "final_errors": _none_if_nan(metrics.quantities_at(record, end)),
                "true_errors": _none_if_nan(truth),
                "sensors_allow": meta.allowance,
                **phase_resources.figures_between(record, start, end),
            }
        )
    return rows


def _none_if_nan(quantities: dict[str, float]) -> dict[str, float | None]:
    return {name: metrics.none_if_nan(value) for name, value in quantities.items()}


def _drift_in_last_phase(record: Record) -> float | None:
    """Return how far [m] the vehicle moved at most in the last phase, once it has settled."""
    phase = record["phase"]
    t = record["t"]
    is_earlier = phase != phase[-1]
    start = 0
    if is_earlier.any():
        start = len(phase) - int(np.argmax(is_earlier[::-1]))
    settled = t >= t[start] + _SETTLING
    if not settled.any() or not record.run_meta.floating or not keeps_every_tick(record):
        return None
    positions = record["q"][settled, :3]
    return float(np.linalg.norm(positions - positions[0], axis=1).max())


def _percentiles_us(record: Record, name: str) -> dict[str, float]:
    """Return percentiles [us] of the rows of a time [s], and the largest of all ticks."""
    p50, p99 = np.percentile(record[name], [50, 99])
    largest = record[metrics.extremes_of(record, name)[-1]].max()
    return {"p50": 1e6 * float(p50), "p99": 1e6 * float(p99), "max": 1e6 * float(largest)}


@checked
def sensor_health(record: Record) -> list[dict[str, Any]]:
    """Return one row per channel: ``channel``, ``suspect_s``, ``lost_s``, ``first_s`` and ``why``,
    the first alarm about it.

    The last two are `None` and empty where it was always good. Empty for records without the series
    ``health``. Raises `InvalidInput` for the record of a plan.
    """
    meta = record.run_meta
    if "health" not in record.series:
        return []
    rows = []
    for channel, codes in zip(meta.channels, record["health"].T, strict=True):
        first_time = None
        reason = ""
        if codes.any():
            first_time = float(record["t"][np.argmax(codes != 0)])
            reason = _first_reason(meta, channel, first_time)
        rows.append(
            {
                "channel": channel,
                "suspect_s": meta.dt * int((codes == _SUSPECT).sum()),
                "lost_s": meta.dt * int((codes == _LOST).sum()),
                "first_s": first_time,
                "why": reason,
            }
        )
    return rows


def _first_reason(meta: RunMeta, channel: str, first_time: float) -> str:
    """Return what the first alarm about a channel, from a time [s] on, says against it."""
    for alarm in meta.alarms:
        if alarm.t >= first_time - 1e-9 and alarm.text.startswith(f"{channel} "):
            return alarm.text.partition(": ")[2]
    return ""


def load_estimates(record: Record) -> dict[str, dict[str, float | None]]:
    """Return by tool, at the end of a run, net weight [N] and mass [kg], with standard errors;
    empty where nothing was to be learnt.

    The mass is `None` while it is undetermined.
    """
    if "load_weight" not in record.series:
        return {}
    weights = _last_row(record, "load_weight")
    weight_errors = _last_row(record, "load_weight_error")
    masses = _last_row(record, "load_mass")
    mass_errors = _last_row(record, "load_mass_error")
    tools = record.meta.tools or ("tool",)
    estimates = {}
    for tool, weight, weight_error, mass, mass_error in zip(
        tools, weights, weight_errors, masses, mass_errors, strict=False
    ):
        estimates[tool] = {
            "weight_n": metrics.none_if_nan(weight),
            "weight_error_n": metrics.none_if_nan(weight_error),
            "mass_kg": metrics.none_if_nan(mass),
            "mass_error_kg": metrics.none_if_nan(mass_error),
        }
    return estimates


def _last_row(record: Record, name: str) -> list[float]:
    values: list[float] = np.atleast_1d(record[name][-1]).tolist()
    return values


def format_load(load: dict[str, float | None], tool: str) -> str:
    """Describe a load in words; load [N, kg]: one of `load_estimates`."""
    if load["mass_kg"] is None:
        mass = "undetermined"
    else:
        mass = f"{load['mass_kg']:.2f} kg +- {load['mass_error_kg']:.2f}"
    weight = f"{load['weight_n']:.1f} N +- {load['weight_error_n']:.1f}"
    return f"load at {tool}: net weight {weight}, mass {mass}"

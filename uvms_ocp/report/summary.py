"""Report of one run: its phases, goals, load, sensor health, and why it ended."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.display import SmallTable, TableDisplay, cell
from uvms_ocp.record.meta_values import (
    ABORT,
    DONE,
    OWN_QUANTITIES,
    EventMeta,
    MetConditionMeta,
    ThresholdMeta,
)
from uvms_ocp.record.record import Record, keeps_every_tick, quantity
from uvms_ocp.record.run_meta import RunMeta, level_rows, versions
from uvms_ocp.report import metrics
from uvms_ocp.solvers.hierarchy.solution import Status

_WINDOW = 5.0  # [s] at the end of the run over which progress is judged
_PROGRESS = 0.02  # share of what is missing that must have been gained in the window

_CUT_OFF = "the program ended before the run, of which later rows are missing"
_STOPPED = {
    "stopped": "by hand",
    "diverged": "the plant's motion grew beyond what a record holds",
    "cut off": _CUT_OFF,
}
ENDS = (
    "completed",
    "ended too early",
    "truth unknown",
    "aborted",
    "given up",
    "swinging",
    "slow",
    "stalled",
    *_STOPPED,
)
"""Kinds of ends of a mission."""

_SUSPECT = 1
_LOST = 2

_OF_A_TOOL = ("position", "orientation")
_SETTLING = 0.5  # [s] after the start of a phase, before its drift counts


# What phases ended on: the estimate that they went by, the truth, and what the sensors allow to
# know.


def goal_table(record: Record) -> list[dict[str, Any]]:
    """One row per measured quantity that ended a phase on its side of a limit, in order of time.

    That is every one that had to fall below a limit, and those that had to rise above one on the
    way forward; not time, load and energy (`OWN_QUANTITIES`), which no goal is made of.

    ``estimated`` and ``true`` at that moment, `None` where not known, the ``sign`` (< or >) and the
    ``limit`` [m] or [rad]; ``sensors_allow`` is the standard deviation of the estimate that the
    sensors allow, `None` where they are ideal or it is not known; ``met`` is judged by the truth,
    `None` where that is not known. No rows of older records, which do not tell what ended a phase.
    """
    rows = []
    for event in record.run_meta.events:
        if event.target != ABORT:
            rows += _rows(record.run_meta, event)
    return rows


def _rows(meta: RunMeta, event: EventMeta) -> list[dict[str, Any]]:
    rows = []
    for item in event.conditions:
        if item.quantity in OWN_QUANTITIES:
            continue
        if item.sign == ">" and not _leads_forward(meta, event):
            continue
        true_value = metrics.none_if_nan(event.truth.get(item.quantity))
        rows.append(
            {
                "phase": event.source,
                "t": event.t,
                "quantity": item.quantity,
                "sign": item.sign,
                "limit": item.limit,
                "estimated": metrics.none_if_nan(item.estimated),
                "true": true_value,
                "sensors_allow": meta.allowance.get(item.quantity),
                "met": None if true_value is None else _is_true_of(item, true_value),
            }
        )
    return rows


def _leads_forward(meta: RunMeta, event: EventMeta) -> bool:
    """Tell a phase that came to its end from one that was left to try again."""
    names = [phase.name for phase in meta.phases]
    return event.target == DONE or names.index(event.target) > names.index(event.source)


def _is_true_of(condition: MetConditionMeta, value: float) -> bool:
    """Judge a value by the limit, or by the release that stands in for it once a condition holds."""
    limit = condition.limit if condition.release is None else condition.release
    if condition.sign == "<":
        return value < limit
    return value > limit


def ended_prematurely(record: Record) -> list[dict[str, Any]]:
    """The rows of `goal_table` where the estimate was on its side of the limit and the truth was
    not.
    """
    return [row for row in goal_table(record) if row["met"] is False]


# Why a run ended as it did: complete, given up, still on its way, or stuck, and then on what.


@checked
def cause_of_end(record: Record) -> dict[str, str]:
    """``kind``: one of `ENDS`; ``text``: one sentence with the figures.

    A mission has ended too early where it is complete by the estimate and a true error is over its
    limit; of one whose true errors are not all in the record the truth is unknown. One that is
    aborted names what sent it into its abort phase, or ended it; one that swings by how much, how
    fast, and whether it grows; one that swings, is slow or stalled the last alarm, if there was
    any.

    Raises `InvalidInput` for the record of a plan.
    """
    meta = record.run_meta
    if meta.completed:
        return _completion(record)
    if meta.stopped:
        return {
            "kind": meta.stopped,
            "text": f"{_STOPPED[meta.stopped]}; {_unfinished(record)['text']}",
        }
    cause = _aborted(meta)
    if cause is not None:
        return cause
    if meta.events and meta.events[-1].target == ABORT:
        return {"kind": "given up", "text": meta.events[-1].reason}
    cause = _unfinished(record)
    swinging = metrics.swings(record)
    if swinging:
        kind = (
            "swinging" if _explains(record, {swing.what for swing in swinging}) else cause["kind"]
        )
        cause = {"kind": kind, "text": f"{cause['text']}; {', '.join(map(str, swinging))}"}
    alarms = [f"; last alarm at {alarm.t:.1f} s: {alarm.text}" for alarm in meta.alarms[-1:]]
    return {**cause, "text": "".join([cause["text"], *alarms])}


def _completion(record: Record) -> dict[str, str]:
    """Say whether a mission that is complete by the estimate is so in truth."""
    missed = ended_prematurely(record)
    if missed:
        limits = "; ".join(map(_missed, missed))
        return {"kind": "ended too early", "text": f"complete by the estimate; {limits}"}
    doubt = _doubt_of_completion(record)
    if doubt:
        return {"kind": "truth unknown", "text": f"complete by the estimate; {doubt}"}
    return {"kind": "completed", "text": "every phase came to its end"}


def _doubt_of_completion(record: Record) -> str:
    """Tell what the record lacks of a proof that a mission is complete; empty where it lacks
    nothing.
    """
    meta = record.run_meta
    for row in goal_table(record):
        if row["met"] is None:
            return f"true {row['quantity']} at the end of phase {row['phase']} is not known"
    is_mission = bool(meta.tasks)
    if is_mission and not meta.events:
        return "no event in the record ends it"
    return ""


def _aborted(meta: RunMeta) -> dict[str, str] | None:
    """Describe an abort phase that was entered, or could not be; `None` for other missions."""
    entered = next((event for event in meta.events if event.target == meta.abort_phase), None)
    last_event = meta.events[-1] if meta.events else None
    if entered is None:
        direct = (
            last_event is not None
            and meta.abort_phase
            and last_event.target == ABORT
            and not last_event.conditions
        )
        if last_event and direct:
            return {"kind": "aborted", "text": f"{last_event.reason}, too little is known to climb"}
        return None
    if last_event is not None and last_event.target == ABORT:
        ended = last_event.reason
    else:
        ended = f"time is over, {meta.pending}"
    return {"kind": "aborted", "text": f"{entered.reason}; phase {meta.abort_phase}: {ended}"}


def _missed(row: dict[str, Any]) -> str:
    if row["sensors_allow"] is None:
        allowed = ""
    else:
        allowed = f", and the sensors allow {row['sensors_allow']:.2g}"
    if row["estimated"] is None:
        estimated = "-"
    else:
        estimated = f"{row['estimated']:.3g}"
    values = f"estimated at {estimated} but truly {row['true']:.3g}"
    return (
        f"phase {row['phase']}: {row['quantity']} was {values} against a limit of"
        f" {row['limit']:g}{allowed}"
    )


def _unfinished(record: Record) -> dict[str, str]:
    """Describe what the last phase waited for, and whether it was coming."""
    phase = record.meta.phases[int(record["phase"][-1])].name
    waiting = _waiting(record, phase)
    if not waiting:
        return {
            "kind": "slow",
            "text": f"phase {phase}: its conditions hold, but not yet for long enough",
        }
    unknown = [item.quantity for item in waiting if np.isnan(_trend(record, item)[0])]
    if unknown:
        return {
            "kind": "stalled",
            "text": f"phase {phase}: {unknown[0]} is not known, and its condition not met",
        }
    item, last_value, gained = min(
        ((item, *_trend(record, item)) for item in waiting), key=lambda trend: trend[2]
    )
    state = f"phase {phase}: {item.quantity} = {last_value:.4g} against a limit of {item.limit:g}"
    if gained > _PROGRESS:
        return {
            "kind": "slow",
            "text": f"{state} was still improving, by {100 * gained:.0f} % in the last 5 s",
        }
    return {
        "kind": "stalled",
        "text": f"{state} has stopped improving; {_obstruction(record, item.quantity)}",
    }


def _explains(record: Record, swinging: set[str]) -> bool:
    """Judge whether swings keep a mission from its end: of the vehicle, or of every error that the
    last phase waits for.
    """
    phase = record.run_meta.phases[int(record["phase"][-1])].name
    waiting = {item.quantity for item in _waiting(record, phase)}
    return not swinging.isdisjoint({"roll", "pitch"}) or waiting <= swinging


def _waiting(record: Record, phase: str) -> list[ThresholdMeta]:
    """List the conditions of a phase that the end of the record does not meet."""
    thresholds = [item for item in record.meta.thresholds if item.phase == phase]
    forward = [item for item in thresholds if item.sign == "<" or item.quantity in OWN_QUANTITIES]
    series = {item.quantity: quantity(record, item.quantity) for item in forward}
    waiting = []
    for condition in forward:
        values = series[condition.quantity]
        if values is None or (values[-1] < condition.limit) != (condition.sign == "<"):
            waiting.append(condition)
    return waiting


def _trend(record: Record, condition: ThresholdMeta) -> tuple[float, float]:
    """Return the last value, and the share of the distance to the limit that the last seconds
    brought.
    """
    series = quantity(record, condition.quantity)
    if series is None:
        values = np.zeros(1)
    else:
        values = series
    n = min(len(values), max(2, round(_WINDOW / record.run_meta.dt)))
    earlier_value = float(values[-n])
    last_value = float(values[-1])
    falls = 1.0 if condition.sign == "<" else -1.0
    return last_value, falls * (earlier_value - last_value) / max(
        falls * (earlier_value - condition.limit), 1e-12
    )


def _obstruction(record: Record, name: str) -> str:
    """Name tasks that rank above the one that waits and are active, and drives at their limits."""
    tasks = [task.name for task in record.meta.tasks]
    waiting = name.rpartition(".")[0]
    if waiting not in tasks:
        return "no task of the record measures it"
    rank = tasks.index(waiting)
    activity = record["activity"][-1]
    levels = level_rows(record.meta)
    active = [
        task
        for task, rows in levels
        if task in tasks[:rank] and activity[rows].max(initial=0.0) > 0
    ]
    if active:
        above = f"active above it: {', '.join(active)}"
    else:
        above = "nothing above it is active"
    n = max(1, round(_WINDOW / record.run_meta.dt))
    if "saturated" in record.series:
        saturated_share = float(np.mean(metrics.mean_sizes(record, "saturated", slice(-n, None))))
    else:
        saturated_share = 0.0
    damped = record.run_meta.statuses[int(record["status"][-1])] == Status.REGULARISED.value
    limits = (
        f"; thrusters at their limits {100 * saturated_share:.0f} % of the time"
        if saturated_share > 0.05
        else ""
    )
    damping = ""
    if damped:
        damping = "; near a singularity Icat goes on with less damping and threshold"
    return above + limits + damping


# What the controller has learnt of the load at a tool.


def load_estimates(record: Record) -> dict[str, dict[str, float | None]]:
    """Return by tool, at the end of a run, net weight [N] and mass [kg], with standard errors;
    empty where nothing was to be learnt.

    The mass is `None` while it is undetermined.
    """
    if "load_weight" not in record.series:
        return {}
    units = {"weight": "n", "weight_error": "n", "mass": "kg", "mass_error": "kg"}
    last_row = {
        f"{name}_{unit}": np.atleast_1d(record[f"load_{name}"][-1]).tolist()
        for name, unit in units.items()
    }
    rows = zip(record.meta.tools or ("tool",), *last_row.values(), strict=False)
    return {
        tool: dict(zip(last_row, map(metrics.none_if_nan, values), strict=True))
        for tool, *values in rows
    }


def format_load(load: dict[str, float | None], tool: str) -> str:
    """Describe a load in words; load [N, kg]: one of `load_estimates`."""
    if load["mass_kg"] is None:
        mass = "undetermined"
    else:
        mass = f"{load['mass_kg']:.2f} kg +- {load['mass_error_kg']:.2f}"
    return (
        f"load at {tool}: net weight {load['weight_n']:.1f} N +- {load['weight_error_n']:.1f}, mass"
        f" {mass}"
    )


# How each sensor fared in a run.


@checked
def sensor_health(record: Record) -> list[dict[str, Any]]:
    """One row per channel: ``channel``, ``suspect_s``, ``lost_s``, ``first_s`` and ``why``, what
    was first said against it.

    The last two are `None` and empty where it was always good. Empty for records without the series
    ``health``. Raises `InvalidInput` for the record of a plan.
    """
    meta = record.run_meta
    if "health" not in record.series:
        return []
    rows = []
    for channel, codes in zip(meta.channels, record["health"].T, strict=True):
        suspect, lost = (meta.dt * int((codes == code).sum()) for code in (_SUSPECT, _LOST))
        if codes.any():
            first_time = float(record["t"][np.argmax(codes != 0)])
        else:
            first_time = None
        texts = [
            alarm.text
            for alarm in meta.alarms
            if first_time is not None and alarm.t >= first_time - 1e-9
        ]
        why = next((text for text in texts if text.startswith(f"{channel} ")), "").partition(": ")[
            2
        ]
        rows.append(
            {
                "channel": channel,
                "suspect_s": suspect,
                "lost_s": lost,
                "first_s": first_time,
                "why": why,
            }
        )
    return rows


# The report of one run.


class RunSummary(TableDisplay, dict[str, Any]):
    """Figures of a run by name, as in ``report.json``; shown as one page: how it ended, its phases,
    errors and alarms.
    """

    __slots__ = ()

    def _table(self) -> SmallTable:
        columns: tuple[str, ...] = (
            "name",
            "start_s",
            "end_s",
            "energy_j",
            "path_length_m",
            "reason",
        )
        rows = [tuple(cell(phase[name]) for name in columns) for phase in self["phases"]]
        if self["repeated"]:
            columns = tuple(self["repeated"][0])
            rows = [tuple(map(cell, phase.values())) for phase in self["repeated"]]
        shown = ("energy_", "tool_", "largest_", "min_")
        rows += [
            (name, cell(value))
            for name, value in self.items()
            if name.startswith(shown) and value is not None
        ]
        errors = [
            (f"{tool}: {kind} error", cell(error))
            for tool, tool_errors in self["tools"].items()
            for kind, error in tool_errors.items()
        ]
        if len(self["tools"]) > 1:
            rows += errors
        rows += [("alarm", cell(alarm["t"]), alarm["text"]) for alarm in self["alarms"]]
        title = f"{self['scenario']}, {self['robot']}: {self['cause']['kind']}"
        return SmallTable(
            title=title, words=self["cause"]["text"], head=("phase", *columns[1:]), rows=tuple(rows)
        )


@checked
def summarize(record: Record) -> RunSummary:
    """The content of ``report.json``; `None` where a figure does not apply to the run or is not
    known. Tool errors are true ones, with what the mission went by beside them: those of the first
    tool, and of all of them in ``tools`` by name.

    Lengths in m, angles in rad, times in s unless the key says otherwise. Raises `InvalidInput` for
    the record of a plan, and for one without a series that is needed.
    """
    try:
        return RunSummary(_figures(record))
    except NameNotFound as error:
        raise InvalidInput(
            f"part of a record: no series {error.given!r}; give one with all series"
        ) from None


def _figures(record: Record) -> dict[str, Any]:
    meta = record.run_meta
    task = record.run_meta.tool_task
    estimated = _none_if_nan(metrics.quantities_at(record, float(record["t"][-1])))
    errors = [
        (kind, unit, f"{task}.{kind}_error")
        for kind, unit in zip(_OF_A_TOOL, ("m", "rad"), strict=True)
    ]
    return {
        **{name: getattr(meta, name) for name in ("scenario", "robot", "plant", "solver")},
        **{part: getattr(meta, part) or None for part in ("controller", "estimator", "sensors")},
        "completed": meta.completed,
        "pending": meta.pending,
        "cause": cause_of_end(record),
        "ended_too_early": sorted({row["phase"] for row in ended_prematurely(record)})
        if meta.completed
        else [],
        "goals": goal_table(record),
        "swings": [asdict(swing) for swing in metrics.swings(record)],
        "passed_rates": metrics.passed_rates(record),
        "phases": phase_table(record),
        "resources": (visits := metrics.resources(record)),
        "repeated": metrics.repeated_phases(visits),
        "energy_j": visits[-1]["energy_j"],
        "energy_planned_j": meta.planned_energy,
        "energy_of_quick_thrust_j": metrics.energy_of_quick_thrust(record),
        "seed": meta.seed,
        "noise": meta.noise,
        "faults": [fault.model_dump() for fault in meta.faults],
        "sensor_health": sensor_health(record),
        "load": next(iter((loads := load_estimates(record)).values()), None),
        "loads": loads,
        "alarms": [alarm.model_dump() for alarm in meta.alarms],
        **{
            f"tool_{kind}_error_{unit}": metrics.none_if_nan(meta.true_quantity(error))
            for kind, unit, error in errors
        },
        **{
            f"estimated_tool_{kind}_error_{unit}": estimated.get(error)
            for kind, unit, error in errors
        },
        **{
            f"tool_{kind}_bound_{unit}": metrics.error_bound(record, error)
            for kind, unit, error in errors
        },
        **{
            f"sensors_allow_tool_{kind}_{unit}": meta.allowance.get(error)
            for kind, unit, error in errors
        },
        "tools": {
            task_meta.tool: {
                kind: metrics.none_if_nan(meta.true_quantity(f"{task_meta.name}.{kind}_error"))
                for kind in _OF_A_TOOL
            }
            for task_meta in meta.tasks
            if task_meta.tool
        },
        "estimate": metrics.estimate_table(record),
        "vehicle_drift_in_last_phase_m": _drift_in_last_phase(record),
        "largest_tilt_rad": metrics.largest_tilt(record),
        "min_altimeter_m": metrics.least_altimeter_range(record),
        "max_velocity_step": metrics.max_velocity_step(record),
        "failed_ticks": metrics.failed_ticks(record),
        "tick_us": _percentiles_us(record, "tick_time"),
        "controller_us": _percentiles_us(record, "controller_time")
        if "controller_time" in record.series
        else None,
        "wall_s": meta.wall_s,
        "simulated_s": float(record["t"][-1]),
        "versions": versions(meta.packages),
    }


@checked
def phase_table(record: Record) -> list[dict[str, Any]]:
    """One row per phase that was entered, in order of time: name, title, start, end, reason, errors
    at its end.

    ``final_errors`` are those that the mission went by, ``true_errors`` the true ones, empty in
    older records.
    """
    meta = record.run_meta
    entered = [event for event in meta.events if event.target not in (DONE, ABORT)]
    starts = [0.0, *(event.t for event in entered)]
    names = [meta.phases[0].name, *(event.target for event in entered)]
    ends = [*(event.t for event in meta.events), float(record["t"][-1])]
    truths = [
        *(event.truth for event in meta.events),
        {item.name: item.value for item in meta.true_quantities},
    ]
    reasons = [
        *(event.reason for event in meta.events),
        f"time is over, waiting for: {meta.pending}",
    ]
    phases = {phase.name: phase for phase in meta.phases}
    return [
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
            **metrics.figures_between(record, start, end),
        }
        for name, start, end, reason, truth in zip(
            names, starts, ends, reasons, truths, strict=False
        )
    ]


def _none_if_nan(quantities: dict[str, float]) -> dict[str, float | None]:
    return {name: metrics.none_if_nan(value) for name, value in quantities.items()}


def _drift_in_last_phase(record: Record) -> float | None:
    phase = record["phase"]
    t = record["t"]
    if (phase != phase[-1]).any():
        start = len(phase) - int(np.argmax(phase[::-1] != phase[-1]))
    else:
        start = 0
    settled = t >= t[start] + _SETTLING
    if not settled.any() or not record.run_meta.floating or not keeps_every_tick(record):
        return None
    positions = record["q"][settled, :3]
    return float(np.linalg.norm(positions - positions[0], axis=1).max())


def _percentiles_us(record: Record, name: str) -> dict[str, float]:
    """Percentiles of the rows, and the largest of all ticks."""
    (p50, p99) = np.percentile(record[name], [50, 99])
    top = record[metrics.extremes_of(record, name)[-1]].max()
    return {"p50": 1e6 * float(p50), "p99": 1e6 * float(p99), "max": 1e6 * float(top)}

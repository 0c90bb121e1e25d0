"""Why a run ended: complete, given up, still on its way, or stuck, and then on what; and whether the
truth agrees with the estimate on which its phases ended.
"""

from __future__ import annotations

from operator import itemgetter
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.record.meta_values import (
    ABORT,
    DONE,
    OWN_QUANTITIES,
    EventMeta,
    MetConditionMeta,
    ThresholdMeta,
)
from uvms_ocp.record.record import Record, quantity
from uvms_ocp.record.run_meta import RunMeta, level_rows
from uvms_ocp.record.swings import tilts_of
from uvms_ocp.report import metrics
from uvms_ocp.solvers.hierarchy.solution import Status

_WINDOW = 5.0  # [s] at the end of the run over which progress is judged
_PROGRESS = 0.02  # share of the way to the limit that must have been gained in the window

_LEVEL = np.deg2rad(15.0)  # of a vehicle that a task wants level
_SAME_ANGLE = 0.02  # [rad] between a tilt and the error of a task that has it

_STOPPED = {
    "stopped": "by hand",
    "diverged": "the plant's motion grew beyond what a record holds",
    "cut off": "the program ended before the run, of which later rows are missing",
}
ENDS = (
    "completed",
    "ended too early",
    "truth unknown",
    "tilted",
    "aborted",
    "given up",
    "swinging",
    "slow",
    "stalled",
    *_STOPPED,
)
"""Ways in which a run can end, by what is known of them."""


@checked
def cause_of_end(record: Record) -> dict[str, str]:
    """Return why a run ended: ``kind``, one of `ENDS`, and ``text``, one sentence with the figures.

    A mission has ended too early where it is complete by the estimate and a true error is over its
    limit; of one whose true errors are not all in the record the truth is unknown. One is tilted
    that is complete while the vehicle lies far from level, as an active task has it. One that is
    aborted names what sent it into its abort phase, or ended it; one that swings by how much, how
    fast, and whether it grows; one that swings, is slow or stalled the last alarm, if there was
    any.

    Raises `InvalidInput` for the record of a plan.
    """
    meta = record.run_meta
    if meta.completed:
        return _completion(record)
    if meta.stopped:
        unfinished = _unfinished(record)["text"]
        return {"kind": meta.stopped, "text": f"{_STOPPED[meta.stopped]}; {unfinished}"}
    cause = _aborted(meta)
    if cause is not None:
        return cause
    if meta.events and meta.events[-1].target == ABORT:
        return {"kind": "given up", "text": meta.events[-1].reason}
    cause = _unfinished(record)
    kind = cause["kind"]
    text = cause["text"]
    swinging = metrics.swings(record)
    if swinging:
        text += "; " + ", ".join(str(swing) for swing in swinging)
        if _explains(record, {swing.what for swing in swinging}):
            kind = "swinging"
    if meta.alarms:
        last_alarm = meta.alarms[-1]
        text += f"; last alarm at {last_alarm.t:.1f} s: {last_alarm.text}"
    return {"kind": kind, "text": text}


def _completion(record: Record) -> dict[str, str]:
    """Say whether a mission that is complete by the estimate is so in truth."""
    missed = ended_prematurely(record)
    if missed:
        limits = "; ".join(_describe_missed(row) for row in missed)
        return {"kind": "ended too early", "text": f"complete by the estimate; {limits}"}
    lacking = _lacking_proof(record)
    if lacking:
        return {"kind": "truth unknown", "text": f"complete by the estimate; {lacking}"}
    tilted = _unasked_tilt(record)
    if tilted:
        return {"kind": "tilted", "text": f"every phase came to its end; {tilted}"}
    return {"kind": "completed", "text": "every phase came to its end"}


def _unasked_tilt(record: Record) -> str:
    """Describe a tilt of the vehicle at the end that is the error of an active task; empty for
    none.
    """
    meta = record.run_meta
    if not meta.floating:
        return ""
    roll, pitch = tilts_of(record["q"][-1:]).values()
    tilt = float(np.arccos(np.cos(roll) * np.cos(pitch))[-1])
    if tilt <= _LEVEL:
        return ""
    for column, task in enumerate(meta.tasks):
        if task.tool is not None or not record["activations"][-1, column] > 0.0:
            continue
        for word in ("tilt", "orientation_error"):
            error = quantity(record, f"{task.name}.{word}")
            # A goal that is tilted itself leaves less of an error than the tilt.
            if error is not None and error[-1] > tilt - _SAME_ANGLE:
                return f"the vehicle lies at {np.rad2deg(tilt):.0f} deg, which {task.name} misses"
    return ""


def _lacking_proof(record: Record) -> str:
    """Describe what the record lacks of a proof that a mission is complete; empty where it lacks
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
    if not meta.events:
        return None
    last_event = meta.events[-1]
    was_ended = last_event.target == ABORT
    entered = next((event for event in meta.events if event.target == meta.abort_phase), None)
    if entered is None:
        # Only an abort without a condition of the mission is an emergency.
        if not was_ended or not meta.abort_phase or last_event.conditions:
            return None
        return {"kind": "aborted", "text": f"{last_event.reason}, too little is known to climb"}
    if was_ended:
        ending = last_event.reason
    else:
        ending = f"time is over, {meta.pending}"
    return {"kind": "aborted", "text": f"{entered.reason}; phase {meta.abort_phase}: {ending}"}


def _describe_missed(row: dict[str, Any]) -> str:
    """Describe a row of `goal_table` whose truth missed the limit."""
    estimated = "-" if row["estimated"] is None else f"{row['estimated']:.3g}"
    text = (
        f"phase {row['phase']}: {row['quantity']} was estimated at {estimated} but truly"
        f" {row['true']:.3g} against a limit of {row['limit']:g}"
    )
    if row["sensors_allow"] is not None:
        text += f", and the sensors allow {row['sensors_allow']:.2g}"
    return text


def _unfinished(record: Record) -> dict[str, str]:
    """Describe what the last phase waited for, and whether it was coming."""
    phase = record.meta.phases[int(record["phase"][-1])].name
    waiting = _waiting(record, phase)
    if not waiting:
        text = f"phase {phase}: its conditions hold, but not yet for long enough"
        return {"kind": "slow", "text": text}
    trends = [(condition, *_trend(record, condition)) for condition in waiting]
    for condition, last_value, _ in trends:
        if np.isnan(last_value):
            text = f"phase {phase}: {condition.quantity} is not known, and its condition not met"
            return {"kind": "stalled", "text": text}
    slowest, last_value, gained = min(trends, key=itemgetter(2))
    state = (
        f"phase {phase}: {slowest.quantity} = {last_value:.4g} against a limit of {slowest.limit:g}"
    )
    if gained > _PROGRESS:
        text = f"{state} was still improving, by {100 * gained:.0f} % in the last 5 s"
        return {"kind": "slow", "text": text}
    text = f"{state} has stopped improving; {_obstruction(record, slowest.quantity)}"
    return {"kind": "stalled", "text": text}


def _explains(record: Record, swinging: set[str]) -> bool:
    """Judge whether swings keep a mission from its end: of the vehicle, or of every error that the
    last phase waits for.
    """
    phase = record.run_meta.phases[int(record["phase"][-1])].name
    waiting = {item.quantity for item in _waiting(record, phase)}
    return not swinging.isdisjoint({"roll", "pitch"}) or waiting <= swinging


def _waiting(record: Record, phase: str) -> list[ThresholdMeta]:
    """List the conditions of a phase that the end of the record does not meet."""
    waiting = []
    for threshold in record.meta.thresholds:
        leads_forward = threshold.sign == "<" or threshold.quantity in OWN_QUANTITIES
        if threshold.phase != phase or not leads_forward:
            continue
        values = quantity(record, threshold.quantity)
        if values is None or (values[-1] < threshold.limit) != (threshold.sign == "<"):
            waiting.append(threshold)
    return waiting


def _trend(record: Record, condition: ThresholdMeta) -> tuple[float, float]:
    """Return the last value, and the share of the distance to the limit that the last seconds
    brought.
    """
    values = quantity(record, condition.quantity)
    if values is None:
        values = np.zeros(1)
    n_rows = min(len(values), max(2, round(_WINDOW / record.run_meta.dt)))
    earlier_value = float(values[-n_rows])
    last_value = float(values[-1])
    falls = 1.0 if condition.sign == "<" else -1.0
    gain = falls * (earlier_value - last_value)
    missing = falls * (earlier_value - condition.limit)
    return last_value, gain / max(missing, 1e-12)


def _obstruction(record: Record, name: str) -> str:
    """Describe what may stop the quantity of that name: active tasks that rank above its own, and
    drives at their limits.
    """
    tasks = [task.name for task in record.meta.tasks]
    waiting = name.rpartition(".")[0]
    if waiting not in tasks:
        return "no task of the record measures it"
    activity = record["activity"][-1]
    higher_tasks = tasks[: tasks.index(waiting)]
    active = []
    for task, rows in level_rows(record.meta):
        if task in higher_tasks and activity[rows].max(initial=0.0) > 0:
            active.append(task)
    text = "nothing above it is active"
    if active:
        text = f"active above it: {', '.join(active)}"
    n_rows = max(1, round(_WINDOW / record.run_meta.dt))
    saturated_share = 0.0
    if "saturated" in record.series:
        saturated = metrics.mean_sizes(record, "saturated", slice(-n_rows, None))
        saturated_share = float(np.mean(saturated))
    if saturated_share > 0.05:
        text += f"; thrusters at their limits {100 * saturated_share:.0f} % of the time"
    status = record.run_meta.statuses[int(record["status"][-1])]
    if status == Status.REGULARISED.value:
        text += "; near a singularity Icat goes on with less damping and threshold"
    return text


def goal_table(record: Record) -> list[dict[str, Any]]:
    """Return one row per measured quantity that ended a phase on its side of a limit, in order of
    time.

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
            rows += _goal_rows(record.run_meta, event)
    return rows


def _goal_rows(meta: RunMeta, event: EventMeta) -> list[dict[str, Any]]:
    """Return the rows of `goal_table` for one event that ended a phase."""
    rows = []
    for condition in event.conditions:
        if condition.quantity in OWN_QUANTITIES:
            continue
        if condition.sign == ">" and not _leads_forward(meta, event):
            continue
        true_value = metrics.none_if_nan(event.truth.get(condition.quantity))
        is_met = None
        if true_value is not None:
            is_met = _is_true_of(condition, true_value)
        rows.append(
            {
                "phase": event.source,
                "t": event.t,
                "quantity": condition.quantity,
                "sign": condition.sign,
                "limit": condition.limit,
                "estimated": metrics.none_if_nan(condition.estimated),
                "true": true_value,
                "sensors_allow": meta.allowance.get(condition.quantity),
                "met": is_met,
            }
        )
    return rows


def _leads_forward(meta: RunMeta, event: EventMeta) -> bool:
    """Tell a phase that came to its end from one that was left to try again."""
    names = [phase.name for phase in meta.phases]
    return event.target == DONE or names.index(event.target) > names.index(event.source)


def _is_true_of(condition: MetConditionMeta, value: float) -> bool:
    """Judge a value by the limit of a condition, or by its release, which counts once it holds."""
    limit = condition.limit
    if condition.release is not None:
        limit = condition.release
    if condition.sign == "<":
        return value < limit
    return value > limit


def ended_prematurely(record: Record) -> list[dict[str, Any]]:
    """Return the rows of `goal_table` where the estimate was on its side of the limit and the truth
    was not.
    """
    return [row for row in goal_table(record) if row["met"] is False]

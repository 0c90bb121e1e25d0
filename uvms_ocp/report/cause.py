"""Why a run ended as it did: complete, given up, still on its way, or stuck, and then on what."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.meta_values import ThresholdMeta
from uvms_ocp.mission.conditions import ABORT
from uvms_ocp.record import Record
from uvms_ocp.report.goals import ended_too_early
from uvms_ocp.report.series import quantity
from uvms_ocp.run_meta import RunMeta

_WINDOW = 5.0  # [s] at the end of the run over which progress is judged
_PROGRESS = 0.02  # share of what is missing that must have been gained in the window


@checked
def cause_of_end(record: Record) -> dict[str, str]:
    """``kind``: completed, ended too early, aborted, given up, slow, stalled; ``text``: one sentence with the figures.

    A mission has ended too early where it is complete by the estimate and a true error is over its limit. One that is aborted
    names what sent it into its abort phase, or ended it; one that is slow or stalled the last alarm, if there was any.

    Raises `InvalidInput` for the record of a plan.
    """
    meta = record.run_meta
    if meta.completed and (missed := ended_too_early(record)):
        return {"kind": "ended too early", "text": f"complete by the estimate; {'; '.join(map(_missed, missed))}"}
    if meta.completed:
        return {"kind": "completed", "text": "every phase came to its end"}
    if (cause := _aborted(meta)) is not None:
        return cause
    if meta.events and meta.events[-1].target == ABORT:
        return {"kind": "given up", "text": meta.events[-1].reason}
    cause = _unfinished(record)
    alarms = [f"; last alarm at {alarm.t:.1f} s: {alarm.text}" for alarm in meta.alarms[-1:]]
    return {**cause, "text": "".join([cause["text"], *alarms])}


def _aborted(meta: RunMeta) -> dict[str, str] | None:
    """Of a mission with an abort phase that was entered, or could not be; `None` otherwise."""
    entered = next((event for event in meta.events if event.target == meta.abort_phase), None)
    last = meta.events[-1] if meta.events else None
    if entered is None:
        direct = last is not None and meta.abort_phase and last.target == ABORT and not last.conditions
        return {"kind": "aborted", "text": f"{last.reason}, too little is known to climb"} if last and direct else None
    ended = last.reason if last is not None and last.target == ABORT else f"time is over, {meta.pending}"
    return {"kind": "aborted", "text": f"{entered.reason}; phase {meta.abort_phase}: {ended}"}


def _missed(row: dict[str, Any]) -> str:
    allowed = "" if row["sensors_allow"] is None else f", and the sensors allow {row['sensors_allow']:.2g}"
    estimated = "-" if row["estimated"] is None else f"{row['estimated']:.3g}"
    was = f"estimated at {estimated} but truly {row['true']:.3g}"
    return f"phase {row['phase']}: {row['quantity']} was {was} against a limit of {row['limit']:g}{allowed}"


def _unfinished(record: Record) -> dict[str, str]:
    """What the last phase waited for, and whether it was coming."""
    phase = record.meta.phases[int(record["phase"][-1])].name
    waiting = [item for item in _conditions(record, phase) if not _fulfilled(record, item)]
    if not waiting:
        return {"kind": "slow", "text": f"phase {phase}: its conditions hold, but not yet for long enough"}
    unknown = [item.quantity for item in waiting if np.isnan(_trend(record, item)[0])]
    if unknown:
        return {"kind": "stalled", "text": f"phase {phase}: {unknown[0]} is not known, and its condition not met"}
    trends = [(item, *_trend(record, item)) for item in waiting]
    item, now, gained = min(trends, key=lambda trend: trend[2])
    what = f"phase {phase}: {item.quantity} = {now:.4g} against a limit of {item.limit:g}"
    if gained > _PROGRESS:
        return {"kind": "slow", "text": f"{what} was still improving, by {100 * gained:.0f} % in the last 5 s"}
    return {"kind": "stalled", "text": f"{what} has stopped improving; {_obstruction(record, item.quantity)}"}


def _conditions(record: Record, phase: str) -> list[ThresholdMeta]:
    """Conditions of the forward transitions of a phase."""
    return [item for item in record.meta.thresholds if item.phase == phase and item.sign == "<"]


def _fulfilled(record: Record, condition: ThresholdMeta) -> bool:
    series = quantity(record, condition.quantity)
    return series is not None and bool(series[-1] < condition.limit)


def _trend(record: Record, condition: ThresholdMeta) -> tuple[float, float]:
    """The value now, and the share of the distance to the limit that the last seconds brought."""
    series = quantity(record, condition.quantity)
    values = np.zeros(1) if series is None else series
    n = min(len(values), max(2, round(_WINDOW / record.run_meta.dt)))
    before, now = float(values[-n]), float(values[-1])
    return now, (before - now) / max(before - condition.limit, 1e-12)


def _obstruction(record: Record, name: str) -> str:
    """Tasks that rank above the one that waits and are active, and drives at their limits."""
    tasks = [task.name for task in record.meta.tasks]
    waiting = name.rpartition(".")[0]
    if waiting not in tasks:
        return "no task of the record measures it"
    own = tasks.index(waiting)
    activity, active = record["activity"][-1], []
    ends = np.cumsum([level.rows for level in record.meta.levels])
    for level, end in zip(record.meta.levels, ends, strict=True):
        if level.name in tasks[:own] and activity[end - level.rows : end].max(initial=0.0) > 0:
            active.append(level.name)
    above = f"active above it: {', '.join(active)}" if active else "nothing above it is active"
    n = round(_WINDOW / record.run_meta.dt)
    full = float(np.mean(record["saturated"][-n:])) if "saturated" in record.series else 0.0
    return above + (f"; thrusters at their limits {100 * full:.0f} % of the time" if full > 0.05 else "")

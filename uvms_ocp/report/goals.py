"""What phases ended on: the estimate that they went by, the truth, and what the sensors allow to know."""

from __future__ import annotations

from typing import Any

from uvms_ocp.meta_values import EventMeta
from uvms_ocp.mission.conditions import ABORT
from uvms_ocp.record import Record
from uvms_ocp.report.series import known


def goal_table(record: Record) -> list[dict[str, Any]]:
    """One row per error that had to fall below a limit for a phase to end, in order of time.

    ``estimated`` and ``true`` at that moment, `None` where not known, and the ``limit`` [m] or [rad]; ``sensors_allow`` is the
    standard deviation of the estimate that the sensors allow, `None` where they are ideal or it is not known; ``met`` is judged
    by the truth, `None` where that is not known. No rows of older records, which do not tell what ended a phase.
    """
    return [row for event in record.run_meta.events if event.target != ABORT for row in _rows(record, event)]


def _rows(record: Record, event: EventMeta) -> list[dict[str, Any]]:
    return [
        {
            "phase": event.source,
            "t": event.t,
            "quantity": item.quantity,
            "limit": item.limit,
            "estimated": known(item.estimated),
            "true": known(event.truth.get(item.quantity)),
            "sensors_allow": record.run_meta.allowance.get(item.quantity),
            "met": _met(known(event.truth.get(item.quantity)), item.limit),
        }
        for item in event.conditions
        if item.sign == "<"
    ]


def _met(true: float | None, limit: float) -> bool | None:
    return None if true is None else true < limit


def ended_too_early(record: Record) -> list[dict[str, Any]]:
    """The rows of `goal_table` where the estimate was below the limit and the truth was not."""
    return [row for row in goal_table(record) if row["met"] is False]

"""What stands on the time line of the page: phases, faults, health of the sensors, alarms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from uvms_ocp.model.health import Trust
from uvms_ocp.record import Record
from uvms_ocp.viz.series import fault_spans, phase_spans, stays


def time_line(record: Record) -> dict[str, list[dict[str, Any]]]:
    """JSON values, times [s] since the record began."""
    start = float(record["t"][0])
    tasks = {phase.name: list(phase.tasks) for phase in record.meta.phases}
    return {
        "phases": [
            {"name": s.name, "title": s.title, "index": s.index, "tasks": tasks[s.name]} | _from(s.start, s.end, start)
            for s in phase_spans(record)
        ],
        "faults": [{"name": s.name, "ended": s.ended} | _from(s.start, s.end, start) for s in fault_spans(record)],
        "health": list(_ill_spells(record)),
        "alarms": [{"t": a.t - start, "text": a.text} for a in _alarms(record)],
    }


def _from(begin: float, end: float, start: float) -> dict[str, float]:
    return {"start": begin - start, "end": end - start}


def _alarms(record: Record) -> tuple[Any, ...]:
    return record.meta.alarms if record.meta.kind == "run" else ()


def _ill_spells(record: Record) -> Iterator[dict[str, Any]]:
    """Stays of a channel in a state that is not good."""
    if record.meta.kind != "run" or "health" not in record.series:
        return
    t = record["t"] - record["t"][0]
    for channel, codes in zip(record.meta.channels, record["health"].T, strict=True):
        for i, j, code in stays(codes):
            if code:
                yield {"channel": channel, "state": Trust(code).name.lower()} | _from(float(t[i]), float(t[j]), 0.0)

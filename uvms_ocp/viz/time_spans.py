"""Spans of time of a record: stays in phases, and faults from their onset to their end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import plain_line
from uvms_ocp.record.record import Record
from uvms_ocp.viz.series import require_rows


@dataclass(frozen=True, kw_only=True, slots=True)
class PhaseSpan:
    """One stay in one phase."""

    index: int
    """Position of the phase in the mission."""
    name: str
    """Short name of the phase."""
    title: str
    """Words beside the name."""
    start: float
    """Time at which it begins [s]."""
    end: float
    """Time at which it ends [s]."""

    @property
    def label(self) -> str:
        return plain_line(f"{self.name} {self.title}")


@dataclass(frozen=True, kw_only=True, slots=True)
class FaultSpan:
    """Time from the onset of an injected fault to its end."""

    name: str
    """The fault without its times, ``TARGET:KIND=VALUES``."""
    start: float
    """Time at which it begins [s]."""
    end: float
    """Time at which it ends [s], no later than the record."""
    ended: bool
    """True where the fault ended before the record did."""


@checked
def phase_spans(record: Record) -> tuple[PhaseSpan, ...]:
    """Return stays in phases in order of time; a phase that the mission goes back to has several.

    Raises `InvalidInput` for a record without rows.
    """
    require_rows(record)
    t = record["t"]
    if "phase" in record.series:
        codes = record["phase"]
    else:
        codes = np.zeros(len(record), dtype=int)
    spans = list[PhaseSpan]()
    for first, last, code in intervals_of(codes):
        phase = record.meta.phases[code]
        spans.append(
            PhaseSpan(
                index=code,
                name=phase.name,
                title=phase.title,
                start=float(t[first]),
                end=float(t[last]),
            )
        )
    return tuple(spans)


def fault_spans(record: Record) -> tuple[FaultSpan, ...]:
    """Return the faults of a run that began before its end; a plan has none."""
    last = float(record["t"][-1])
    spans = list[FaultSpan]()
    for fault in getattr(record.meta, "faults", ()):
        if fault.t > last:
            continue
        if fault.end is None:
            end = last
        else:
            end = min(fault.end, last)
        name = fault.text.partition("@")[0]
        spans.append(FaultSpan(name=name, start=fault.t, end=end, ended=end < last))
    return tuple(spans)


def intervals_of(codes: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Yield stretches of equal codes (n,): row at which each begins, row at which the next one
    begins or the last row of all, and the code.
    """
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    ends = [*starts[1:], len(codes) - 1]
    for start, end in zip(starts, ends, strict=True):
        yield int(start), int(end), int(codes[start])

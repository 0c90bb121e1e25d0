"""Read from a `Record` what figures and scenes draw: phases, faults, quantities, rows of tasks,
vehicle and joint parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.record import row_files, run_meta, tables
from uvms_ocp.record.record import Record, quantity as quantity

_LONGEST = 60  # letters of what is written on a line
RUN_NAMES = (
    "errors",
    "misalignment",
    "altitude",
    "tool_error",
    "activations",
    "quantities",
    "velocities",
    "joints",
    "path",
    "efforts",
    "tracking",
    "estimate",
    "health",
    "tick_time",
)
"""Names of all figures of a run, known before what draws them is loaded."""
PLAN_NAMES = ("vehicle_motion", "joint_motion", "clearance", "efforts")
"""Names of all figures of a plan, known before what draws them is loaded."""
_LONG = 50_000
"""Rows from which on not all are drawn; a page is 1,300 dots wide."""
_STRETCHES = 4096
"""Stretches of a long record, of each of which two rows are drawn."""
_AS_THEY_ARE = (
    "t",
    "phase",
    "q",
    "q_estimated",
    "q_std",
    "v",
    "v_estimated",
    "command",
    "tick_time",
    "tool",
)
"""Series of which rows of the record are drawn, not extremes: they are taken from one another."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PhaseSpan:
    """One stay in one phase."""

    index: int
    name: str
    title: str
    start: float
    """Time at which it begins [s]."""
    end: float
    """Time at which it ends [s]."""

    @property
    def label(self) -> str:
        return plain_line(f"{self.name} {self.title}")


@dataclass(frozen=True, kw_only=True, slots=True)
class FaultSpan:
    """How long something was wrong on purpose."""

    name: str
    """The fault without its times, ``TARGET:KIND=VALUES``."""
    start: float
    """Time at which it begins [s]."""
    end: float
    """Time at which it ends [s], no later than the record."""
    ended: bool
    """True where it was over before the record was."""


def fault_spans(record: Record) -> tuple[FaultSpan, ...]:
    """Return faults of a run that began before its end; none of a plan."""
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


def axis_label(text: str, name: str, part: str = "", prefix: str = "", meta: Any = None) -> str:
    """Return the label of an axis: a text, and the unit of a series, of one of its parts, or of a
    quantity; prefix: such as m.

    meta: of the record, as in `unit_of`.
    """
    units = tables.unit_of(name, part, meta).split(" or ")
    return f"{text} [{' or '.join(prefix + unit for unit in units)}]"


def estimate_suffix(record: Record) -> str:
    """Return the suffix of a measured quantity's name: with noisy sensors it is an estimate."""
    if record.meta.kind == "run" and record.meta.noise:
        return " (estimated)"
    return ""


def require_rows(record: Record) -> None:
    """Raise `InvalidInput` where there is nothing to draw."""
    if len(record) < 2:
        raise InvalidInput(f"record has {len(record)} rows; at least 2 are needed to draw it")


def thinned(record: Record) -> Record:
    """Return two rows for each of 4,096 stretches of a record that has very many: the least and the
    largest value of every column.

    Of what is taken from one another, or counted, they are rows of the record: of state, estimate,
    command and times. What is shorter than half a stretch, such as a short phase, is in none of
    them.
    """
    if len(record) <= _LONG:
        return record
    step = -(-len(record) // _STRETCHES)
    starts = np.arange(0, len(record), step)
    series = dict[str, np.ndarray]()
    rows = np.append(np.stack([starts, starts + step // 2], axis=1).ravel()[:-1], len(record) - 1)
    for name in record.series:
        if name in _AS_THEY_ARE:
            series[name] = record[name][rows]
        else:
            series[name] = _extremes(record[name], step)
    return Record(series=series, meta=record.meta)


def _extremes(values: np.ndarray, step: int) -> np.ndarray:
    """Return the least and the largest value of every column, for each stretch of `step` rows."""
    extremes = list[np.ndarray]()
    for (stretch,) in row_files.parts(values, rows=step):
        extremes += [np.fmin.reduce(stretch), np.fmax.reduce(stretch)]
    return np.stack(extremes)


@checked
def phase_spans(record: Record) -> tuple[PhaseSpan, ...]:
    """Return stays in phases in order of time; a phase that the mission went back to comes again.

    Raises `InvalidInput` where there is nothing to draw.
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


def intervals_of(codes: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Yield stretches of equal codes (n,): where each begins, where the next one does, or the last
    row, and its code.
    """
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    for i, j in zip(starts, [*starts[1:], len(codes) - 1], strict=True):
        yield int(i), int(j), int(codes[i])


def thresholds(record: Record, name: str) -> tuple[float, ...]:
    """Return limits that transitions set on a quantity, each once."""
    return tuple(sorted({item.limit for item in record.meta.thresholds if item.quantity == name}))


def threshold_text(record: Record, name: str, limit: float) -> str:
    """Say what a limit [unit of the quantity] on a quantity is for: the phases that it ends, and
    which of them is the abort.
    """
    meta = record.meta
    ended_phases = {
        item.phase for item in meta.thresholds if item.quantity == name and item.limit == limit
    }
    phases = [phase.name for phase in meta.phases if phase.name in ended_phases]
    abort = meta.abort_phase if meta.kind == "run" else None
    names = []
    for phase in phases:
        names.append("abort" if phase == abort else f"phase {phase}")
    if names:
        return plain_line(f"threshold {limit:g}, {', '.join(names)}", _LONGEST)
    return f"threshold {limit:g}"


def task_gate(record: Record, task: str) -> np.ndarray | None:
    """Return the external activation (n,) of a task; `None` for an unknown one."""
    names = [item.name for item in record.meta.tasks]
    if task in names:
        return record["activations"][:, names.index(task)]
    return None


def task_activity(record: Record, task: str) -> np.ndarray | None:
    """Return the activation (n, rows) of a task's rows; `None` where the task has no level."""
    for name, rows in run_meta.level_rows(record.meta):
        if name == task:
            return record["activity"][:, rows]
    return None


def axis_names(record: Record, n: int) -> list[str]:
    """Return names of n rows or axes: the joints where there is one for each, which a joint of
    several axes has not.
    """
    joints = record.meta.joints
    if n == len(joints):
        return list(joints)
    return [str(k + 1) for k in range(n)]


def has_vehicle(record: Record) -> bool:
    """Tell whether the robot is a free-flyer (q then begins with p_WB and a quaternion)."""
    return run_meta.is_floating(record.series, record.meta)


def floor_heights(record: Record, points: np.ndarray) -> np.ndarray | None:
    """Return the height (n,) [m] of the floor at points (n, 2) [m] in W; `None` where the record
    knows no floor.
    """
    relief = record.meta.surroundings.floor
    plane = record.meta.surroundings.floor_z
    if relief is not None:
        from scipy.interpolate import RegularGridInterpolator

        grid = RegularGridInterpolator((relief.x, relief.y), np.transpose(relief.z))
        lowest_corner = (relief.x[0], relief.y[0])
        highest_corner = (relief.x[-1], relief.y[-1])
        return np.asarray(grid(np.clip(points, lowest_corner, highest_corner)))
    if plane is None:
        return None
    return np.full(len(points), plane)

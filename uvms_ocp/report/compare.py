"""Two runs side by side."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from uvms_ocp.record import Record
from uvms_ocp.report.resources import resources
from uvms_ocp.report.series import max_velocity_step, quantity


def compare(first: Record, second: Record) -> list[dict[str, Any]]:
    """Rows with the keys ``figure``, ``first``, ``second`` and ``change`` [%], `None` where one run lacks it."""
    pairs = zip(_figures(first), _figures(second), strict=True)
    return [{"figure": name, "first": a, "second": b, "change": _change(a, b)} for (name, a), (_, b) in pairs]


def _figures(record: Record) -> Iterator[tuple[str, Any]]:
    yield "completed", record.meta["completed"]
    yield "phases", " ".join(row["phase"] for row in resources(record)[:-1])
    yield from ((name, value) for name, value in resources(record)[-1].items() if name != "phase")
    tool = record.meta["tool_task"]
    yield "tool_position_error_m", record.meta["true_quantities"].get(f"{tool}.position_error")
    tilt = quantity(record, "HA.tilt")
    yield "largest_tilt_rad", None if tilt is None else float(tilt.max())
    yield "max_velocity_step", max_velocity_step(record)


def _change(a: Any, b: Any) -> float | None:
    if isinstance(a, (bool, str)) or a is None or b is None or a == 0:
        return None
    return 100.0 * (b - a) / abs(a)

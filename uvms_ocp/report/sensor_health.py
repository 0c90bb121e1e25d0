"""How each sensor fared in a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.record import Record

_SUSPECT, _LOST = 1, 2


@checked
def sensor_health(record: Record) -> list[dict[str, Any]]:
    """One row per channel: ``channel``, ``suspect_s``, ``lost_s``, ``first_s`` and ``why``, what was first said against it.

    The last two are `None` and empty where it was always good. Empty for records without the series ``health``. Raises
    `InvalidInput` for the record of a plan.
    """
    meta = record.run_meta
    if "health" not in record.series:
        return []
    columns = zip(meta.channels, record["health"].T, strict=True)
    return [_row(record, channel, codes) for channel, codes in columns]


def _row(record: Record, channel: str, codes: np.ndarray) -> dict[str, Any]:
    dt, bad = record.run_meta.dt, np.flatnonzero(codes)
    first = float(record["t"][bad[0]]) if len(bad) else None
    return {
        "channel": channel,
        "suspect_s": dt * int((codes == _SUSPECT).sum()),
        "lost_s": dt * int((codes == _LOST).sum()),
        "first_s": first,
        "why": "" if first is None else _why(record, channel, first),
    }


def _why(record: Record, channel: str, since: float) -> str:
    """The first alarm on the channel."""
    told = (alarm.text for alarm in record.run_meta.alarms if alarm.t >= since - 1e-9)
    text = next((text for text in told if text.startswith(f"{channel} ")), "")
    return text.partition(": ")[2]

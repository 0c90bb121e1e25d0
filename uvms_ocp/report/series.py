"""Series and scalars that several reports need."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.record import Record
from uvms_ocp.record import quantity as quantity


@checked
def max_velocity_step(record: Record) -> float:
    """Largest change of any component of the command in one tick, from rest at the start."""
    steps = np.diff(record["command"], axis=0, prepend=np.zeros((1, record["command"].shape[1])))
    return float(np.abs(steps).max(initial=0.0))


def known(value: float | None) -> float | None:
    """The value [in its unit]; `None` for what is no number, such as an altitude without an echo."""
    return None if value is None or np.isnan(value) else value


def largest(values: np.ndarray | None) -> float | None:
    """Of the values (n,) [in their unit] that are known; `None` where none is."""
    return None if values is None or np.isnan(values).all() else float(np.nanmax(values))


def largest_tilt(record: Record) -> float | None:
    """[rad] while a task on it is on; `None` where none ever is."""
    meta = record.run_meta
    on = (
        np.where(record["gates"][:, k] > 0.0, tilt, np.nan)
        for k, task in enumerate(meta.tasks)
        if (tilt := quantity(record, f"{task.name}.tilt")) is not None
    )
    return max((value for series in on if (value := largest(series)) is not None), default=None)


def quantities_at(record: Record, t: float) -> dict[str, float]:
    """All quantities [in their units] at time t [s], as estimated."""
    row = record["quantities"][min(int(np.searchsorted(record["t"], t - 1e-9)), len(record) - 1)]
    return dict(zip(record.meta.quantities, row.tolist(), strict=True))

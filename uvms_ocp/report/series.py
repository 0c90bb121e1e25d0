"""Series and scalars that several reports need."""

from __future__ import annotations

import numpy as np

from uvms_ocp.record import Record


def quantity(record: Record, name: str) -> np.ndarray | None:
    """The series (n,) of a measured quantity such as ``T.position_error``; `None` where no task measures it."""
    names = record.meta["quantities"]
    return record["quantities"][:, names.index(name)] if name in names else None


def final_quantity(record: Record, name: str) -> float | None:
    """The last value of `quantity`."""
    series = quantity(record, name)
    return None if series is None else float(series[-1])


def max_velocity_step(record: Record) -> float:
    """Largest change of any component of the command in one tick, from rest at the start."""
    steps = np.diff(record["command"], axis=0, prepend=np.zeros((1, record["command"].shape[1])))
    return float(np.abs(steps).max())

"""What the page writes beside the picture: every measured quantity of the record, own ones too."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from uvms_ocp.record import Record
from uvms_ocp.tables.series_table import unit_of
from uvms_ocp.viz.scene.animation import Frames, rounded
from uvms_ocp.viz.series import quantity


def readouts(record: Record, frames: Frames) -> dict[str, Any]:
    """JSON values: ``times`` (n,) [s] of the frames and a row for each quantity; `None` where it is not known."""
    return {"times": frames.t.round(3).tolist(), "readouts": list(_rows(record, frames))}


def _rows(record: Record, frames: Frames) -> Iterator[dict[str, Any]]:
    for name in record.meta.quantities:
        values = quantity(record, name)
        if values is not None and np.isfinite(values).any():
            yield readout(name, values[frames.row])


def readout(name: str, values: np.ndarray) -> dict[str, Any]:
    """JSON values: the row of a quantity with its values (n,) [its unit]."""
    task, _, what = name.rpartition(".")
    label = f"{task} {what.replace('_', ' ')}".strip()
    return {"task": task, "label": label, "unit": unit_of(name).strip("-"), "values": rounded(values)}

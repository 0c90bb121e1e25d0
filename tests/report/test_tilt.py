"""The largest tilt of a run is that which a task was to prevent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.record.record import Record, quantity
from uvms_ocp.report.metrics import largest_tilt

STORED = Path(__file__).parents[1] / "records" / "run_v0_1.npz"


def with_gate(record: Record, gate: np.ndarray) -> Record:
    """With the task on tilt on where `gate` (n,) is above 0."""
    activations = record["activations"].copy()
    activations[:, [task.name for task in record.run_meta.tasks].index("HA")] = gate
    return Record(series={**record.series, "activations": activations}, meta=record.meta)


def test_the_largest_tilt_is_that_of_the_time_in_which_a_task_on_it_is_on() -> None:
    record = Record.load(STORED)
    tilt = quantity(record, "HA.tilt")
    assert tilt is not None
    late = np.arange(len(record)) > int(np.argmax(tilt))
    assert largest_tilt(with_gate(record, np.ones(len(record)))) == pytest.approx(float(tilt.max()))
    assert largest_tilt(with_gate(record, 1.0 * late)) == pytest.approx(float(tilt[late].max()))
    assert tilt[late].max() < tilt.max()
    assert largest_tilt(with_gate(record, np.zeros(len(record)))) is None


def test_without_a_task_on_it_the_largest_tilt_is_the_vehicles() -> None:
    """As of missions that `new-mission` writes for a vehicle whose pitch nobody drives: there it is
    the figure to look at.
    """
    record = Record.load(STORED)
    other_quantities = [name for name in record.run_meta.quantities if name != "HA.tilt"]
    columns = [record.run_meta.quantities.index(name) for name in other_quantities]
    series = {**record.series, "quantities": record["quantities"][:, columns]}
    meta = record.run_meta.model_copy(update={"quantities": tuple(other_quantities)})
    up = [pin.Quaternion(q[3:7]).matrix()[2, 2] for q in record["q"]]
    assert largest_tilt(Record(series=series, meta=meta)) == pytest.approx(
        float(np.arccos(min(up))), abs=1e-7
    )

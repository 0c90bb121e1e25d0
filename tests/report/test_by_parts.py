"""What is found some rows at a time is what is found of all of them."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_robots import TINY, robot_of, scenario_of

from uvms_ocp.record import row_files
from uvms_ocp.record.record import Record
from uvms_ocp.report.metrics import max_velocity_step
from uvms_ocp.report.summary import summarize


def test_a_summary_does_not_depend_on_how_many_rows_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    record = scenario_of(robot_of(TINY["one wet link"]), "kinematic", duration=0.5).run()
    whole = summarize(record)
    for size in (1, 300):
        monkeypatch.setattr(row_files, "_PART", size)
        assert summarize(record) == whole
        for rows in (1, 2, len(record)):
            some = Record(
                series={name: array[:rows] for name, array in record.series.items()},
                meta=record.meta,
            )
            command = some["command"]
            assert (
                max_velocity_step(some)
                == np.abs(np.diff(command, axis=0, prepend=0.0 * command[:1])).max()
            )
    assert whole["max_velocity_step"] > 0.0

"""What a report of a long record takes of memory beyond the record does not grow with all of its
columns at once.
"""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from uvms_ocp.record.record import Record
from uvms_ocp.report.metrics import estimate_table
from uvms_ocp.report.phase_resources import figures_between
from uvms_ocp.scenario import reach

ROWS = 600_000


@pytest.fixture(scope="module")
def short() -> Record:
    return reach(noise=True, duration=1.0).run()


@pytest.fixture(scope="module")
def long(short: Record) -> Record:
    """The same rows again and again."""
    names = ("q", "v", "q_estimated", "q_std")
    times = -(-ROWS // len(short))
    series = {name: np.tile(short[name], (times, 1))[:ROWS] for name in names}
    return Record(series={"t": np.arange(ROWS) * short.run_meta.dt, **series}, meta=short.meta)


def peak_of(call: object) -> float:
    """[MB]"""
    tracemalloc.start()
    try:
        call()  # type: ignore[operator]
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_margins_of_joints_are_found_part_by_part(short: Record, long: Record) -> None:
    figures = figures_between(long, 0.0, float(long["t"][-1]))
    assert (
        figures["joint_margin_rad"]
        == figures_between(short, 0.0, float(short["t"][-1]))["joint_margin_rad"]
    )
    columns = long["q"][:, :3].nbytes / 1e6
    assert peak_of(lambda: figures_between(long, 0.0, float(long["t"][-1]))) < 4.5 * columns


def test_errors_of_the_estimate_are_taken_of_the_half_that_counts(long: Record) -> None:
    joints = long.run_meta.joints
    whole = ROWS * len(joints) * 8 / 1e6
    assert peak_of(lambda: estimate_table(long)) < 3.5 * whole

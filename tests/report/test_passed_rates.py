"""Joints whose true velocity passes its limit are named, with a margin where a fault is new."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.record.meta_values import FaultMeta
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize

STORED = Path(__file__).parents[1] / "records" / "run_v0_2.npz"
FAULT = FaultMeta(text="thruster1:dead@1", target="thruster1", kind="dead", t=1.0)


def moved(joint: int, share: float, t: float, faults: tuple[FaultMeta, ...]) -> Record:
    """A stored run at rest, but for one joint at one moment [s] at this share of its limit."""
    stored = Record.load(STORED)
    meta = stored.run_meta.model_copy(update={"faults": faults, "completed": True, "events": ()})
    assert meta.limits is not None
    n = round(3.0 / meta.dt)
    first = len(meta.limits.velocity) - len(meta.limits.position_lower)
    series = {name: np.repeat(values[:1], n, axis=0) for name, values in stored.series.items()}
    series["t"] = meta.dt * np.arange(n)
    series["v"] = 0.0 * series["v"]
    series["v"][round(t / meta.dt), first + joint] = -share * meta.limits.velocity[first + joint]
    return Record(series=series, meta=meta)


@pytest.mark.parametrize("faults", [(), (FAULT,)])
@pytest.mark.parametrize(
    ("share", "t"), [(1.01, 2.0), (1.03, 2.0), (1.03, 1.2), (1.15, 1.2), (1.25, 1.2)]
)
def test_a_true_rate_beyond_its_limit_is_named(
    share: float, t: float, faults: tuple[FaultMeta, ...]
) -> None:
    rows = summarize(moved(1, share, t, faults))["passed_rates"]
    if share <= (1.2 if faults and 1.0 <= t <= 1.5 else 1.02):
        assert rows == []
    else:
        (row,) = rows
        assert (row["joint"], row["t"]) == ("joint2", pytest.approx(t))
        assert row["share"] == pytest.approx(share)
        assert row["rate"] == pytest.approx(share * row["limit"])


@pytest.mark.parametrize(
    ("plant", "excess", "end", "is_named"),
    [
        ("dynamic", 2e-4, 1.5, True),
        ("dynamic", -1e-4, 1.5, False),
        ("dynamic", 2e-4, 1.05, False),
        ("kinematic", 2e-4, 1.5, False),
    ],
)
def test_a_joint_that_lies_against_its_stop_is_named(
    plant: str, excess: float, end: float, is_named: bool
) -> None:
    """A joint lay 2 mm beyond its stop for 5.5 s, and no word was said; a touch is none."""
    stored = moved(1, 0.0, 1.0, ())
    limits = stored.meta.limits
    assert limits is not None
    q = np.array(stored["q"])
    pressed = (stored["t"] >= 1.0) & (stored["t"] < end)
    column = q.shape[1] - len(limits.position_lower) + 1
    q[pressed, column] = limits.position_upper[1] + excess
    meta = stored.run_meta.model_copy(update={"plant": plant})
    record = Record(series={**stored.series, "q": q}, meta=meta)
    rows = summarize(record)["pressed_stops"]
    if not is_named:
        assert rows == []
    else:
        (row,) = rows
        assert (row["joint"], row["unit"]) == ("joint2", "rad")
        assert row["t"] == pytest.approx(1.0)
        assert row["duration"] == pytest.approx(0.5, abs=2 * meta.dt)
        assert row["excess"] == pytest.approx(excess)

"""What thrust that changes within a second takes beyond its mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from uvms_ocp.record.record import Record
from uvms_ocp.report.phase_resources import energy_of_quick_thrust

SECONDS = 40.0
STORED = Path(__file__).parents[1] / "records" / "run_v0_2.npz"


@pytest.fixture(scope="module")
def stored() -> Record:
    record = Record.load(STORED)
    return Record(series=record.series, meta=record.run_meta.model_copy(update={"dt": 0.005}))


def flown(stored: Record, thrust: np.ndarray) -> Record:
    """With thrust (n,) [N] of the first thruster, each of which takes 2 |thrust|^1.5 [W]."""
    n = len(thrust)
    dt = stored.run_meta.dt
    series = {name: np.repeat(values[:1], n, axis=0) for name, values in stored.series.items()}
    series["t"] = dt * np.arange(n)
    series["thrust"] = np.column_stack([thrust, np.zeros(n)])
    power = 2.0 * np.abs(series["thrust"]) ** 1.5
    series["thruster_energy"] = cumulative_trapezoid(power, dx=dt, axis=0, initial=0.0)
    return Record(series=series, meta=stored.meta)


@pytest.mark.parametrize(("steady", "quick"), [(8.0, 0.0), (8.0, 3.0), (0.0, 3.0)])
def test_it_is_what_power_that_grows_faster_than_thrust_makes_of_its_changes(
    stored: Record, steady: float, quick: float
) -> None:
    t = np.arange(0.0, SECONDS, stored.run_meta.dt)
    thrust = steady + quick * np.sin(2.0 * np.pi * 2.0 * t)
    excess = energy_of_quick_thrust(flown(stored, thrust))
    assert excess == pytest.approx(
        2.0 * SECONDS * (np.mean(np.abs(thrust) ** 1.5) - steady**1.5), rel=0.05, abs=1.0
    )


def test_a_record_without_energy_or_shorter_than_a_second_does_not_tell_it(stored: Record) -> None:
    whole = flown(stored, np.ones(round(SECONDS / stored.run_meta.dt)))
    without = {name: values for name, values in whole.series.items() if name != "thruster_energy"}
    short = {name: values[:10] for name, values in whole.series.items()}
    for series in (without, short):
        assert energy_of_quick_thrust(Record(series=series, meta=whole.meta)) is None

"""Records of noisy runs hold every reading of every sensor, when it was taken, and whether the
brakes were locked.
"""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.record.record import Record
from uvms_ocp.record.series_checks import MEASURED, check_series
from uvms_ocp.scenario import reach
from uvms_ocp.sim.loop import simulate


@pytest.fixture(scope="module")
def sound() -> Record:
    return reach(noise=True, duration=2.0).run()


def test_records_of_noisy_runs_hold_every_reading_and_when_it_was_taken(sound: Record) -> None:
    for channel in sound.run_meta.channels:
        rows = sound[f"measured_{channel}"]
        assert f"measured_{channel}" in MEASURED
        new = np.isfinite(rows[:, -1])
        assert new.any()
        assert (np.diff(rows[new, -1]) > 0.0).all()
        assert (rows[new, -1] <= sound["t"][new] + 1e-9).all()


def test_joints_are_read_about_where_they_are(sound: Record) -> None:
    rows = sound["measured_joint_positions"]
    new = np.isfinite(rows[:, -1])
    assert np.abs(rows[new, :-1] - sound["q"][new, 7:]).max() < 5e-3


def test_readings_of_a_clock_that_fails_are_kept_too(sound: Record) -> None:
    run = reach(noise=True, duration=2.0, faults="attitude:late=0.2@1").run()
    has_reading, right = (
        np.isfinite(record["measured_attitude"][:, -1]) for record in (run, sound)
    )
    late = run["t"][has_reading] - run["measured_attitude"][has_reading, -1]
    assert late.max() == pytest.approx(0.2, abs=0.02)
    assert np.array_equal(has_reading[:200], right[:200])


def test_locked_brakes_are_in_the_record() -> None:
    run = reach(noise=True, duration=4.0, faults="joint_positions:lost@1").run()
    assert run["brakes"].any()
    assert not run["brakes"][: round(1.0 / run.run_meta.dt)].any()


@pytest.mark.parametrize(
    ("widths", "why"),
    [
        ({"foo": 3}, "unknown channel 'foo'"),
        ({"position": 2}, "position has 3 numbers, 2 are to be kept"),
        ({"position": -1}, "give a whole number >= 0"),
    ],
)
def test_what_is_to_be_kept_is_asked_for_by_channel_and_size(
    widths: dict[str, int], why: str
) -> None:
    scenario = reach(noise=True, duration=0.1)
    parts = {
        "plant": scenario._plant(),
        "sensors": scenario._sensors(),
        "estimator": scenario.estimator(),
    }
    with pytest.raises(UvmsError, match=why):
        simulate(
            **parts,
            controller=scenario.controller(),
            dt=scenario.dt,
            duration=0.1,
            kept_readings=widths,
        )


@pytest.mark.parametrize("name", ["measured_joint_positions", "brakes"])
def test_readings_of_joints_have_one_column_for_each_and_one_for_the_time(
    sound: Record, name: str
) -> None:
    wide = np.column_stack([sound[name], sound["t"]])
    check_series(sound.series, sound.run_meta)
    with pytest.raises(InvalidInput, match=f"series '{name}'"):
        check_series({**sound.series, name: wide}, sound.run_meta)


def test_records_of_ideal_sensors_have_none() -> None:
    run = reach(duration=0.05).run()
    assert not {*MEASURED, "brakes"} & run.series.keys()

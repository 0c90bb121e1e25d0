"""Laws of the estimator in simulations of its own model: it errs as much as it says, however late
its readings are.
"""

from __future__ import annotations

import numpy as np
import pytest
from estimation.consistency import APART, DELAYS, SPECS, consistency, late
from estimation.delays import CASES, WITH, rms_errors

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import CHANNELS, SensorSpecs


@pytest.mark.slow
@pytest.mark.parametrize("specs", [SPECS, late(SPECS, DELAYS)], ids=["in time", "late"])
def test_errors_and_innovations_are_as_large_as_their_covariances_say(specs: SensorSpecs) -> None:
    """The short form of `benchmarks/navigation.py`."""
    rows = consistency(load_robot("girona_maris7"), specs, seeds=4, duration=9.0)
    assert {f"NIS {name}" for name in CHANNELS} | {f"NEES {name}" for name in APART} <= {
        row["of"] for row in rows
    }
    assert [row for row in rows if not row["inside"]] == []


@pytest.mark.slow
def test_a_late_channel_costs_little_where_the_acceleration_is_measured() -> None:
    robot = load_robot("girona_maris7")
    exact = {}
    for case, delays in CASES.items():
        errors = rms_errors(robot, late(WITH, delays), seeds=range(3), duration=12.0)
        exact = exact or errors
        allowed = 1.5 if case != "all" else 2.0
        for name in ("position", "attitude", "altitude"):
            assert errors[name] < allowed * exact[name], (case, name)
        assert all(np.isfinite(list(errors.values())))

"""The linear motion is expected as lively as the innovations of the DVL show it, and the velocity
errs as much as it says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from compiler import long_without_compiler

from uvms_ocp.estimation.filter_memory import Part
from uvms_ocp.robot.signals import ACCELEROMETER, SensorSpec, SensorSpecs
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.scenario.cases.case1 import case1

SETTLED = 4.0  # [s] from which on errors are looked at
SPEED = slice(Part.SPEED, Part.SPEED + 3)


def flown(
    *,
    delay: float,
    rate: int = 20,
    force: SensorSpec | None = None,
    faults: tuple[str, ...] = (),
) -> tuple[float, float, float]:
    """Fly Case 1 with a DVL late by that delay [s], ticks at a rate [Hz].

    NEES of the velocity per degree of freedom, its root mean square error [m/s], and the share of
    the jerk at the end.
    """
    records: list[tuple[np.ndarray, np.ndarray, float]] = []
    dvl = replace(SensorSpecs().linear_velocity, delay=delay)
    sensors = SensorSpecs(linear_velocity=dvl, specific_force=force)
    scenario = replace(case1(noise=True, dt=1 / rate, seed=1, faults=faults), sensors=sensors)
    stepped = scenario.simulation()
    estimator = stepped._parts.estimator.estimator
    while not stepped.finished and stepped.t + scenario.dt <= scenario.duration:
        stepped.step()
        records.append(
            (
                estimator.memory.x[SPEED].copy(),
                estimator.covariance[SPEED, SPEED],
                float(estimator.structure.jerk_share),
            )
        )
    record = stepped.record
    squared = []
    errors = []
    for k in range(round(SETTLED * rate), len(record["t"])):
        error = records[k][0] - quaternion_to_matrix(record["q"][k, 3:7]) @ record["v"][k, :3]
        squared.append(error @ np.linalg.solve(records[k][1], error) / 3)
        errors.append(error @ error / 3)
    return (
        float(np.mean(squared)),
        float(np.sqrt(np.mean(errors))),
        records[len(record["t"]) - 1][2],
    )


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(
    ("delay", "rate", "force"),
    [
        (0.0, 20, None),
        (0.3, 20, None),
        pytest.param(0.1, 50, None, marks=pytest.mark.slow),
        pytest.param(0.3, 200, None, marks=pytest.mark.slow),
        pytest.param(0.5, 50, None, marks=pytest.mark.slow),
        pytest.param(0.3, 50, ACCELEROMETER, marks=pytest.mark.slow),
    ],
)
def test_the_velocity_of_a_mission_errs_as_much_as_it_says_however_late_the_dvl(
    delay: float, rate: int, force: SensorSpec | None
) -> None:
    """Taken to jerk as a vehicle may, not as one does that follows commands, it had variances six
    times too large at 0.3 s.
    """
    nees, error, share = flown(delay=delay, rate=rate, force=force)
    assert 0.5 < nees < 1.5
    assert error < 0.006
    assert 0.0 < share <= 1.0
    assert (share == 1.0) == (force is not None)


@pytest.mark.slow
@long_without_compiler
def test_without_a_dvl_the_vehicle_may_jerk_as_much_as_any() -> None:
    assert flown(delay=0.0, faults=("linear_velocity:lost@20",))[2] == 1.0

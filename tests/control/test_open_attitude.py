"""Where attitude and gyro drift apart, and nothing tells which of them is wrong, a vehicle does not
turn over.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from compiler import long_without_compiler
from test_doubted_encoders import hover

from uvms_ocp.estimation.fallbacks import level_attitude
from uvms_ocp.robot.signals import Trust

# [s]
ONSET = 5.0
END = 30.0
DURATION = 40.0
AXES = {"roll": (1.0, 0.0, 0.0), "pitch": (0.0, 1.0, 0.0), "yaw": (0.0, 0.0, 1.0)}
ROBOTS = ("bluerov2_six_alpha5", "bluerov2_two_alpha5", "girona_maris7_full", "girona_maris7")
DRIFTS = {
    "attitude:drift": (0.05, -0.15, 0.3),  # [rad/s]
    "angular_velocity:drift": (0.02, -0.2),  # [rad/s2]
    "attitude:bias": (0.3, -1.5, 3.0),  # [rad]
}
QUICK = {("bluerov2_six_alpha5", 0.05, "attitude:drift", -0.15)}


def cases() -> list[object]:
    """Robots by control periods [s] by faults; most are slow."""
    cases = list[object]()
    for name, dt, kind in product(ROBOTS, (0.01, 0.05), DRIFTS):
        for size in DRIFTS[kind]:
            is_quick = (name, dt, kind, size) in QUICK
            marks = [] if is_quick else [pytest.mark.slow]
            cases.append(pytest.param(name, dt, kind, size, marks=marks))
    return cases


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(("name", "dt", "kind", "size"), cases())
def test_no_drift_or_jump_of_attitude_or_gyro_turns_a_vehicle_over(
    name: str, dt: float, kind: str, size: float, axis: str
) -> None:
    """Held in an attitude that drifted by more than half a turn, vehicles tumbled with up to 6.9
    rad/s, arms were thrown at 10 times their limits, and sound sensors lost for 10 s.
    """
    error = ",".join(f"{size * component:g}" for component in AXES[axis])
    scenario = hover(name, dt, f"{kind}={error}", during=f"{ONSET:g}-{END:g}", end=DURATION)
    record = scenario.run()
    x, y = record["q"][:, 3:5].T
    tilt = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))
    assert tilt.max() <= 0.3
    assert np.abs(record["v"][:, 3:6]).max() <= 0.8
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    assert rates.max() <= 1.02
    faulty = kind.partition(":")[0]
    for k, channel in enumerate(record.run_meta.channels):
        if channel != faulty:
            assert dt * (record["health"][:, k] == Trust.LOST).sum() <= 2.0


@pytest.mark.parametrize("roll", [0.0, 0.4, 2.0, np.pi])
def test_a_level_attitude_keeps_place_heading_and_joints(roll: float) -> None:
    heading = 0.7
    q = [float(k) for k in range(9)]
    # Roll in B, after the heading about z.
    q[3:7] = [
        np.sin(roll / 2) * np.cos(heading / 2),
        np.sin(roll / 2) * np.sin(heading / 2),
        np.cos(roll / 2) * np.sin(heading / 2),
        np.cos(roll / 2) * np.cos(heading / 2),
    ]
    level_attitude(q)
    if roll == np.pi:
        heading = 0.0  # which a vehicle upside down does not have
    np.testing.assert_allclose(q[3:7], [0.0, 0.0, np.sin(heading / 2), np.cos(heading / 2)])
    assert q[:3] + q[7:] == [0.0, 1.0, 2.0, 7.0, 8.0]

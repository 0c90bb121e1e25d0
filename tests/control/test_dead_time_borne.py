"""How late a configuration may be known whose weight the loops carry: the border is where motions
in time stop to die out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uvms_ocp.control.force.velocity_law import DeadTimes, bandwidth_derating, largest_dead_time

BEHIND = 200
TIMES = 120
LOOP: dict[str, float] = {"bandwidth": 12.0, "reset": 3.0, "observer": 4.0}


def growth(stiffness: float, late: float) -> float:
    """Of one axis after a push: its largest velocity in the last of four quarters over that in the
    second.
    """
    share = bandwidth_derating(
        DeadTimes(joints=late), vehicle=1.0, joints=LOOP["bandwidth"], dt=0.0
    ).joints
    k, r, w = (share * LOOP[name] for name in ("bandwidth", "reset", "observer"))
    dt = late / BEHIND
    x = np.zeros(TIMES * BEHIND)
    v = np.zeros(TIMES * BEHIND)
    v[BEHIND] = 1.0
    total = 0.0
    d = 0.0
    expected = 0.0
    for i in range(BEHIND, len(v) - 1):
        delayed_v = v[i - BEHIND]
        total += dt * delayed_v
        command = -k * (delayed_v + r * total) - d
        missed = delayed_v - expected
        a = stiffness * (x[i - BEHIND] + late * delayed_v - x[i]) + command
        expected = expected + dt * (command + d + 2 * w * missed)
        d = d + dt * w**2 * missed
        v[i + 1] = v[i] + dt * a
        x[i + 1] = x[i] + dt * v[i + 1]
    quarters = np.abs(v).reshape(4, -1).max(axis=1)
    return float(quarters[3] / quarters[1])


@pytest.mark.parametrize("stiffness", [-14.0, -2.0, 30.0, 80.0])
def test_what_is_pushed_comes_to_rest_below_the_dead_time_borne_and_swings_beyond_it(
    stiffness: float,
) -> None:
    borne = largest_dead_time(np.array([[stiffness]]), **LOOP)
    assert growth(stiffness, 0.9 * borne) < 0.5
    assert growth(stiffness, 1.1 * borne) > 2.0


def test_of_many_axes_the_one_that_bears_least_counts() -> None:
    turn: Any = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    stiffness = turn @ np.diag([-14.0, 2.0, 30.0]) @ turn.T
    alone = [largest_dead_time(np.array([[stiffness]]), **LOOP) for stiffness in (-14.0, 2.0, 30.0)]
    assert largest_dead_time(stiffness, **LOOP) == pytest.approx(min(alone))


def test_what_carries_nothing_may_be_late_for_ever() -> None:
    assert largest_dead_time(np.zeros((3, 3)), **LOOP) == np.inf


def test_nothing_that_falls_is_caught_by_loops_that_swing_by_themselves() -> None:
    assert largest_dead_time(np.array([[-1.0]]), bandwidth=1.0, reset=10.0, observer=0.0) < 1e-3

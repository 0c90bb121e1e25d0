"""Fixes that drifted and are right again, DVLs that disagree with them, and what scales by a factor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from health_run import HealthRun, drifting, drifting_until, resting, swaying

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, Trust

# [s]
STEP = 0.05
ONSET = 8.0
END = 33.0
LOST = 0.5  # for which a sound channel may be


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.mark.sampled
@pytest.mark.parametrize("motion", ["sways", "rests"])
@pytest.mark.parametrize("rate", [(0.03, 0.0, 0.0), (0.0571, 0.0, 0.0), (0.1, 0.2, 0.0)])
def test_fixes_that_drifted_for_a_while_come_back_soon(
    rate: tuple[float, float, float], motion: str, robot: Robot
) -> None:
    """They were lost for 12 s, while the estimate went on with the drift; a sound DVL was lost for
    2 s after its end, and where they drifted quickly for as long as they did.
    """
    run = HealthRun(
        robot,
        duration=END + 12.0,
        spoil=drifting_until("position", np.array(rate), ONSET, END),
        motion=None if motion == "sways" else resting(robot),
        dt=STEP,
    )
    assert run.last_bad("position") < END + 4.0
    assert run.last_bad("linear_velocity") < END + 4.0
    assert STEP * (run.of("linear_velocity") == Trust.LOST).sum() <= LOST
    is_late = run.t > END + 8.0
    assert np.abs(run.q_estimated - run.q)[is_late, :3].max() < 0.15


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [0, 1])
def test_fixes_that_came_back_are_compared_on(seed: int, robot: Robot) -> None:
    """For 20 s after their end noise began comparisons anew, as if they came back again and again: a
    second drift was found after 16 s and more.
    """
    drift = drifting_until("position", np.array([0.1, 0.0, 0.0]), ONSET, END)
    again = drifting("position", np.array([0.03, 0.0, 0.0]), END + 6.0)
    run = HealthRun(
        robot,
        duration=END + 26.0,
        spoil=lambda readings, t: again(drift(readings, t), t),
        motion=resting(robot),
        dt=STEP,
        start_z=-37.0,
        seed=seed,
    )
    assert run.first_bad("position", END + 6.0) < 11.0


PAIR = {"position", "linear_velocity"}
SCALES = (  # channel, factor, how the robot moves, who is blamed
    ("linear_velocity", 1.1, "along", PAIR),
    ("linear_velocity", 1.3, "along", PAIR),
    ("linear_velocity", 1.3, "bobs", PAIR),
    ("depth", 1.1, "sways", {"depth"}),
    ("depth", 1.3, "bobs", {"depth"}),
    ("altimeter_range", 1.3, "bobs", {"altimeter_range"}),
    ("angular_velocity", 1.3, "sways", {"angular_velocity", "attitude"}),
)


@pytest.mark.sampled
@pytest.mark.parametrize(("channel", "factor", "motion", "blamed"), SCALES)
def test_what_reads_too_much_by_a_factor_is_blamed_alone_or_as_one_of_two(
    channel: str, factor: float, motion: str, blamed: set[str], robot: Robot
) -> None:
    def spoil(readings: Readings, t: float) -> Readings:
        reading = getattr(readings, channel)
        if reading is None or not ONSET <= reading.t < END:
            return readings
        value = factor * reading.value
        scaled: Any = Reading(value=float(value) if np.ndim(value) == 0 else value, t=reading.t)
        return replace(readings, **{channel: scaled})

    run = HealthRun(
        robot,
        duration=END,
        spoil=spoil,
        motion=_motions(robot)[motion],
        dt=STEP,
        start_z=-37.0,
    )
    bad = {name for name in run.guard.monitor.channels if (run.of(name) != Trust.GOOD).any()}
    assert bad == blamed
    for name in blamed - {channel}:
        assert STEP * (run.of(name) == Trust.LOST).sum() <= LOST


def _motions(robot: Robot) -> dict[str, Callable[[float], np.ndarray]]:
    def moved(x: float, z: float) -> np.ndarray:
        v = np.zeros(robot.n_v)
        v[[0, 2]] = x, z
        return v

    return {
        "sways": swaying(robot),
        "along": lambda t: moved(0.5 * min(t / 3.0, 1.0), 0.0),
        "bobs": lambda t: moved(0.2 * min(t / 3.0, 1.0), 0.2 * np.sin(0.4 * t)),
    }

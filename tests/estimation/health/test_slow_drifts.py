"""Drifts that no single reading shows are found by what another channel integrates to, and blamed
on the right one.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from health_run import HealthRun, drifting, resting

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, SensorSpec, SensorSpecs, Trust

# [s]
ONSET = 3.0
END = 28.0


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("channel", "rate", "within", "sound_channels"),
    [
        ("position", (0.05, 0.0, 0.0), 12.0, {"depth", "attitude", "angular_velocity"}),
        ("position", (0.0, 0.0, 0.05), 12.0, {"attitude", "angular_velocity"}),
        ("depth", 0.03, 6.0, {"position", "linear_velocity", "attitude", "angular_velocity"}),
        ("linear_velocity", (0.006, 0.0, 0.0), 18.0, {"depth", "attitude", "angular_velocity"}),
        ("attitude", (0.0, 0.0, 0.01), 20.0, {"depth"}),
    ],
)
def test_a_slow_drift_is_found(
    channel: str, rate: np.ndarray | float, within: float, sound_channels: set[str], robot: Robot
) -> None:
    """Before, only what drifts by more than a decimetre per second, or jumps, was."""
    run = HealthRun(
        robot,
        duration=END,
        spoil=drifting(channel, np.asarray(rate), ONSET),
        motion=resting(robot),
        dt=0.02,
    )
    assert run.first_bad(channel, ONSET) < within
    assert all((run.of(name) == Trust.GOOD).all() for name in sound_channels)
    assert run.last_bad(channel) > END - 0.1


@pytest.mark.sampled
@pytest.mark.parametrize("sways", [False, True])
@pytest.mark.parametrize(
    ("channel", "rate", "within"),
    [("joint_positions", 0.004, 5.0), ("joint_velocities", 4e-4, 16.0)],
)
def test_an_encoder_is_checked_by_the_rate_of_its_joint(
    channel: str, rate: float, within: float, sways: bool, robot: Robot
) -> None:
    """Where the robot has sensors of both: an encoder that drifted was the truth, and the tool
    ended 0.17 m off.
    """
    specs = replace(SensorSpecs(), joint_velocities=SensorSpec(rate=200.0, sigma=2e-3))
    run = HealthRun(
        robot,
        duration=24.0,
        spoil=drifting(channel, rate * (np.arange(robot.n_joints) == 2), ONSET),
        motion=None if sways else resting(robot),
        dt=0.02,
        specs=specs,
    )
    assert all(
        run.first_bad(name, ONSET) < within for name in ("joint_positions", "joint_velocities")
    )
    assert any(
        "encoder and rate of joint3 disagree" in text for _, text in run.guard.monitor.alarms
    )
    assert all(
        (run.of(name) == Trust.GOOD).all()
        for name in ("position", "attitude", "linear_velocity", "depth")
    )


RATES = {
    "late and 2 % off": SensorSpec(rate=50.0, sigma=0.01),
    "noisy": SensorSpec(rate=50.0, sigma=0.02),
    "seldom": SensorSpec(rate=5.0, sigma=0.005),
    "lost": SensorSpec(rate=10.0, sigma=0.01, dropout=0.5),
}


@pytest.mark.slow
@pytest.mark.parametrize("sways", [False, True])
@pytest.mark.parametrize("kind", RATES)
def test_sound_encoders_and_rates_are_believed(kind: str, sways: bool, robot: Robot) -> None:
    """What rates integrate to is known as well as they are: noise of 0.02 rad/s alone ended
    missions.
    """
    specs = replace(SensorSpecs(), joint_velocities=RATES[kind])
    before = deque(maxlen=2)

    def spoil(readings: Readings, t: float) -> Readings:
        rates = readings.joint_velocities
        if rates is None or kind != "late and 2 % off":
            return readings
        before.append(rates.value)
        return replace(readings, joint_velocities=Reading(value=1.02 * before[0], t=rates.t))

    for seed in range(2):
        motion = None if sways else resting(robot)
        run = HealthRun(
            robot, duration=42.0, dt=0.02, specs=specs, spoil=spoil, motion=motion, seed=seed
        )
        assert not any("encoder and rate" in text for _, text in run.guard.monitor.alarms)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(2))
def test_sound_sensors_of_a_robot_that_sways_are_believed(seed: int, robot: Robot) -> None:
    run = HealthRun(robot, duration=END, dt=0.02, seed=seed)
    assert (run.trust == Trust.GOOD).all()


def test_fixes_carry_the_height_while_depths_drift(robot: Robot) -> None:
    """Depths that the filter had refused for a while were taken for a surprise of the vehicle, and
    moved velocity and height.
    """
    run = HealthRun(
        robot, duration=END, spoil=drifting("depth", 0.03, ONSET), motion=resting(robot), dt=0.02
    )
    assert np.abs(run.q_estimated[:, 2] - run.q[:, 2]).max() < 0.15
    assert np.abs(run.v_estimated[run.t > 1.0, :3]).max() < 0.1

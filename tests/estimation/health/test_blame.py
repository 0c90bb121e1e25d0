"""Fixes, depths and the DVL all tell the height: the one that disagrees with both others is named,
and no sound one is lost.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import Any

import corruptors
import numpy as np
import pytest
from health_run import HealthRun, Spoil, drifting, resting

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.estimation.health.redundancy import Culprit, HeightPairs, culprit_of
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, SensorSpec, SensorSpecs, Trust

# [s]
STEP = 0.02
ONSET = 3.0
END = 28.0

DRIFTS = (
    ("position", (0.0, 0.0, 0.03)),
    ("position", (0.0, 0.0, -0.05)),
    ("position", (0.03, 0.03, 0.03)),
    ("position", (0.05, 0.0, 0.03)),
    ("position", (0.086, 0.05, -0.155)),
    ("linear_velocity", (0.0, 0.0, 0.006)),
    ("linear_velocity", (0.0, 0.0, -0.02)),
    ("linear_velocity", (0.02, 0.0, 0.02)),
    ("depth", 0.05),
    ("depth", -0.03),
    ("depth", 0.01),
)


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.mark.slow
@pytest.mark.parametrize("sways", [False, True])
@pytest.mark.parametrize(("channel", "rate"), DRIFTS)
def test_a_drift_along_z_is_blamed_on_the_channel_that_drifts(
    channel: str, rate: tuple[float, ...] | float, sways: bool, robot: Robot
) -> None:
    """A drift of the DVL named depth, lost for 2 s, and of a position depth, altimeter and DVL
    before it, which then were lost or doubted in its place.
    """
    run = HealthRun(
        robot,
        duration=END,
        spoil=drifting(channel, np.asarray(rate), ONSET),
        motion=None if sways else resting(robot),
        dt=STEP,
    )
    named_at = run.first_bad(channel, ONSET)
    assert named_at < 15.0
    for name in {"position", "linear_velocity", "depth", "altimeter_range"} - {channel}:
        assert run.first_bad(name, ONSET) >= named_at
        assert STEP * (run.of(name) == Trust.LOST).sum() <= 0.5
        assert STEP * (run.of(name) != Trust.GOOD).sum() <= 1.5
    assert np.abs(run.q_estimated - run.q)[:, :3].max() < 0.5


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(3))
def test_spikes_of_the_dvl_lose_neither_depth_nor_fixes(seed: int, robot: Robot) -> None:
    """A depth that agreed with fixes was lost while the DVL spoke up."""
    rng = np.random.default_rng(seed)
    spikes = dict[float, float]()

    def spoil(readings: Readings, t: float) -> Readings:
        velocity = readings.linear_velocity
        if velocity is None or velocity.t < ONSET:
            return readings
        is_new = velocity.t not in spikes
        if is_new:
            spikes[velocity.t] = rng.choice([-0.5, 0.5]) if rng.random() < 0.3 else 0.0
        value = velocity.value + np.array([0.0, 0.0, spikes[velocity.t]])
        return replace(readings, linear_velocity=Reading(value=value, t=velocity.t))

    run = HealthRun(robot, duration=END, spoil=spoil, motion=resting(robot), dt=STEP, seed=seed)
    assert run.first_bad("linear_velocity", ONSET) < 3.0
    for name in ("position", "depth", "altimeter_range"):
        assert not (run.of(name) == Trust.LOST).any()


@pytest.mark.sampled
@pytest.mark.parametrize("motion", ["sways", "rests"])
@pytest.mark.parametrize(
    ("dt", "size", "share", "axis"),
    [(0.05, 0.15, 0.3, 0), (0.05, 0.3, 0.3, 0), (0.05, 0.3, 0.5, 2), (0.01, 0.3, 0.3, 0)],
)
def test_spikes_of_the_dvl_below_its_gate_become_no_bias_that_fixes_are_lost_by(
    dt: float, size: float, share: float, axis: int, motion: str, robot: Robot
) -> None:
    """Fixes, which contradicted what spikes made of the velocity, made a bias of the DVL of 0.6 m/s
    of it: sound fixes were refused for 9 s, and the estimate went off by 6 m.
    """
    rng = np.random.default_rng(int(100 * size + 10 * share))
    spikes = dict[float, float]()

    def spoil(readings: Readings, t: float) -> Readings:
        velocity = readings.linear_velocity
        if velocity is None or not 5.0 <= velocity.t < 15.0:
            return readings
        is_new = velocity.t not in spikes
        if is_new:
            spikes[velocity.t] = rng.choice([-size, size]) if rng.random() < share else 0.0
        value = velocity.value + spikes[velocity.t] * np.eye(3)[axis]
        return replace(readings, linear_velocity=Reading(value=value, t=velocity.t))

    run = HealthRun(
        robot,
        duration=26.0,
        spoil=spoil,
        motion=None if motion == "sways" else resting(robot),
        dt=dt,
        seed=1,
    )
    for name in ("position", "depth", "altimeter_range"):
        assert dt * (run.of(name) == Trust.LOST).sum() <= 0.5
    assert np.abs(run.q_estimated - run.q)[:, :3].max() < 0.7
    assert run.last_bad("position") < 18.0


STEPS = (
    ("linear_velocity", (0.3, 0.0, 0.0)),
    ("linear_velocity", (0.0, 0.0, 0.15)),
    ("position", (1.0, 0.0, 0.0)),
    ("position", (0.0, 0.0, 0.4)),
    ("depth", 0.3),
    ("depth", 3.0),
)


@pytest.mark.sampled
@pytest.mark.parametrize("sways", [False, True])
@pytest.mark.parametrize(("channel", "step"), STEPS)
def test_what_was_wrong_for_five_seconds_is_trusted_again_and_so_is_all_else(
    channel: str, step: tuple[float, ...] | float, sways: bool, robot: Robot
) -> None:
    """It was doubted for 20 s, and so was a DVL from 11 s after the end of a jump of fixes on."""
    begin = 8.0
    end = begin + 5.0

    def spoil(readings: Readings, t: float) -> Readings:
        reading = getattr(readings, channel)
        if reading is None or not begin <= reading.t < end:
            return readings
        value = reading.value + np.asarray(step)
        spoilt: Any = Reading(value=float(value) if np.ndim(value) == 0 else value, t=reading.t)
        return replace(readings, **{channel: spoilt})

    run = HealthRun(
        robot, duration=34.0, spoil=spoil, motion=None if sways else resting(robot), dt=STEP
    )
    assert run.first_bad(channel, begin) < 4.0
    for name in ("position", "linear_velocity", "depth", "altimeter_range"):
        assert run.last_bad(name) < end + 6.0


@pytest.mark.sampled
@pytest.mark.parametrize(("bias", "end"), [(0.1, 10.0), (0.5, 8.0), (2.0, 7.0)])
def test_a_fault_of_the_gyro_that_is_over_blames_nobody_later(
    bias: float, end: float, robot: Robot
) -> None:
    """Attitudes, compared over 20 s, were suspect from 10 s after the end of the fault on, for 8 to
    10 s.
    """

    def spoil(readings: Readings, t: float) -> Readings:
        rate = readings.angular_velocity
        if rate is None or not ONSET <= rate.t < end:
            return readings
        return replace(readings, angular_velocity=Reading(value=rate.value + bias, t=rate.t))

    run = HealthRun(robot, duration=34.0, spoil=spoil, dt=STEP)
    assert run.first_bad("angular_velocity", ONSET) < 1.0
    assert run.last_bad("angular_velocity") < end + 3.0
    assert (run.of("attitude") == Trust.GOOD).all()


ATTITUDES = (  # [rad], [s], how the robot moves, axis, [s] of a tick
    (0.09, 5.0, "sways", 2, 0.02),
    (0.095, 5.0, "sways", 1, 0.02),
    (0.1, 9.0, "sways", 1, 0.02),
    (0.1, 9.0, "rests", 1, 0.02),
    (0.105, 9.0, "sways", 2, 0.02),
    (0.12, 5.0, "sways", 2, 0.05),
)


@pytest.mark.sampled
@pytest.mark.parametrize(("size", "lasts", "motion", "axis", "dt"), ATTITUDES)
def test_attitudes_that_were_off_for_a_while_come_back_soon(
    size: float, lasts: float, motion: str, axis: int, dt: float, robot: Robot
) -> None:
    """Believed at last, they were taken for a bias of the gyro: the estimate turned away from those
    that were right again, which were lost for good.
    """
    begin = 8.0
    end = begin + lasts
    off = size * np.eye(3)[axis]

    def spoil(readings: Readings, t: float) -> Readings:
        reading = readings.attitude
        if reading is None or not begin <= reading.t < end:
            return readings
        value = corruptors.added("attitude", reading.value, off)
        return replace(readings, attitude=Reading(value=value, t=reading.t))

    _check_attitude(robot, spoil, end, motion, dt)


@pytest.mark.sampled
@pytest.mark.parametrize("motion", ["sways", "rests"])
@pytest.mark.parametrize(
    ("rate", "lasts"), [(0.02, 5.0), (0.02, 10.0), (0.05, 10.0), (0.2, 4.0), (0.01, 25.0)]
)
def test_attitudes_that_drifted_for_a_while_come_back_soon(
    rate: float, lasts: float, motion: str, robot: Robot
) -> None:
    """The estimate went on with the drift, and was 0.5 rad off from then on."""
    begin = 8.0
    end = begin + lasts
    drift = drifting("attitude", np.array([0.0, rate, 0.0]), begin)

    def spoil(readings: Readings, t: float) -> Readings:
        reading = readings.attitude
        if reading is None or reading.t >= end:
            return readings
        return drift(readings, t)

    _check_attitude(robot, spoil, end, motion, STEP)


def _check_attitude(robot: Robot, spoil: Spoil, end: float, motion: str, dt: float) -> None:
    """Check that all is trusted, and true, soon after the end [s] of a fault."""
    run = HealthRun(
        robot,
        duration=end + 24.0,
        spoil=spoil,
        motion=None if motion == "sways" else resting(robot),
        dt=dt,
    )
    assert run.last_bad("attitude") < end + 4.0
    assert run.last_bad("angular_velocity") < end + 4.0
    turns = np.array(
        [
            angle(estimated, true)
            for estimated, true in zip(run.q_estimated[:, 3:7], run.q[:, 3:7], strict=True)
        ]
    )
    assert turns[run.t > end + 4.0].max() < 0.01
    spin = np.linalg.norm(run.v_estimated[:, 3:6] - run.v[:, 3:6], axis=1)
    assert spin[run.t > end + 4.0].max() < 0.03


TURNS = (  # how a channel is off [rad, rad/s], and who is blamed for it
    ("angular_velocity", "step", 0.1, {"angular_velocity"}),
    ("angular_velocity", "step", 0.33, {"angular_velocity"}),
    ("angular_velocity", "drift", 0.03, {"angular_velocity", "attitude"}),
    ("attitude", "step", 0.07, {"attitude"}),
    ("attitude", "drift", 0.06, {"angular_velocity", "attitude"}),
)


@pytest.mark.sampled
@pytest.mark.parametrize("dt", [0.01, 0.05])
@pytest.mark.parametrize("motion", ["sways", "rests"])
@pytest.mark.parametrize(("channel", "kind", "size", "blamed"), TURNS)
def test_of_gyro_and_attitude_the_one_that_has_changed_at_once_is_blamed_and_both_of_what_drifts(
    channel: str, kind: str, size: float, blamed: set[str], motion: str, dt: float, robot: Robot
) -> None:
    """A drift of attitudes was blamed on the gyro alone, and so was a jump of them by less than the
    gate.
    """

    def spoil(readings: Readings, t: float) -> Readings:
        reading = getattr(readings, channel)
        if reading is None or reading.t < ONSET:
            return readings
        grown = size if kind == "step" else size * (reading.t - ONSET)
        off = np.array([0.0, grown, 0.0])
        spoilt = Reading(value=corruptors.added(channel, reading.value, off), t=reading.t)
        return replace(readings, **{channel: spoilt})

    run = HealthRun(
        robot,
        duration=7.0,
        spoil=spoil,
        motion=None if motion == "sways" else resting(robot),
        dt=dt,
    )
    bad = {name for name in run.guard.monitor.channels if (run.of(name) != Trust.GOOD).any()}
    assert bad == blamed


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """[rad] between two quaternions (4,)."""
    return 2.0 * float(np.arccos(min(1.0, abs(a @ b))))


@pytest.mark.sampled
@pytest.mark.parametrize("motion", ["sways", "rests"])
def test_encoders_that_drifted_for_a_while_blame_no_rates_later(motion: str, robot: Robot) -> None:
    """Sound rates were suspect from 10 s after the end of the drift on."""
    end = 18.0
    drift = drifting("joint_positions", 0.03 * (np.arange(robot.n_joints) == 2), 8.0)

    def spoil(readings: Readings, t: float) -> Readings:
        reading = readings.joint_positions
        if reading is None or reading.t >= end:
            return readings
        return drift(readings, t)

    run = HealthRun(
        robot,
        duration=end + 24.0,
        spoil=spoil,
        motion=None if motion == "sways" else resting(robot),
        specs=replace(SensorSpecs(), joint_velocities=SensorSpec(rate=200.0, sigma=2e-3)),
        dt=STEP,
    )
    assert run.first_bad("joint_positions", 8.0) < 5.0
    assert run.last_bad("joint_positions") < end + 3.0
    assert run.last_bad("joint_velocities") < end + 3.0


@pytest.mark.parametrize("size", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_of_three_pairs_two_that_disagree_blame_what_they_share(
    size: float, order: tuple[int, ...]
) -> None:
    shared = {
        frozenset({0, 1}): Culprit.VELOCITY,
        frozenset({0, 2}): Culprit.FIXES,
        frozenset({1, 2}): Culprit.DEPTHS,
    }
    ratios = np.zeros(3)
    ratios[list(order)] = [size, 0.9 * size, 0.1 * size]
    pairs = structure_of(HeightPairs)()
    pairs.fixes_and_velocity, pairs.depths_and_velocity, pairs.fixes_and_depths = ratios
    assert culprit_of(pairs) == shared[frozenset(order[:2])]


@pytest.mark.parametrize(
    "ratios", [(0.2, 0.2, 0.0), (1.0, 0.9, 0.8), (2.0, 1.0, 0.9), (2.0, 2.0, -1.0)]
)
def test_noise_alone_or_pairs_that_all_disagree_or_are_unknown_blame_nobody(
    ratios: tuple[float, float, float],
) -> None:
    pairs = structure_of(HeightPairs)()
    pairs.fixes_and_velocity, pairs.depths_and_velocity, pairs.fixes_and_depths = ratios
    assert culprit_of(pairs) == Culprit.UNKNOWN

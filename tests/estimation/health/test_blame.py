"""Fixes, depths and the DVL all tell the height: the one that disagrees with both others is named,
and no sound one is lost.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from health_run import HealthRun, drifting

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.estimation.health.redundancy import Culprit, HeightPairs, culprit_of
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Reading, Readings, Trust

# [s]
STEP = 0.02
ONSET = 3.0
END = 28.0

DRIFTS = (
    ("position", (0.0, 0.0, 0.03)),
    ("position", (0.0, 0.0, -0.05)),
    ("position", (0.03, 0.03, 0.03)),
    ("position", (0.05, 0.0, 0.03)),
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


@pytest.mark.parametrize("sways", [False, True])
@pytest.mark.parametrize(("channel", "rate"), DRIFTS)
def test_a_drift_along_z_is_blamed_on_the_channel_that_drifts(
    channel: str, rate: tuple[float, ...] | float, sways: bool, robot: Robot
) -> None:
    """A drift of the DVL named depth, lost for 2 s, and of a position depth, altimeter and DVL
    before it, which then were lost or doubted in its place.
    """
    still = np.zeros(robot.n_v)
    run = HealthRun(
        robot,
        duration=END,
        spoil=drifting(channel, np.asarray(rate), ONSET),
        motion=None if sways else lambda t: still,
        dt=STEP,
    )
    named_at = run.first_bad(channel, ONSET)
    assert named_at < 15.0
    for name in {"position", "linear_velocity", "depth", "altimeter_range"} - {channel}:
        assert run.first_bad(name, ONSET) >= named_at
        assert STEP * (run.of(name) == Trust.LOST).sum() <= 0.5
        assert STEP * (run.of(name) != Trust.GOOD).sum() <= 1.5
    assert np.abs(run.q_estimated - run.q)[:, :3].max() < 0.5


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
        fields = {name: getattr(readings, name) for name in Readings.__dataclass_fields__}
        fields["linear_velocity"] = Reading(value=value, t=velocity.t)
        return Readings(**fields)

    still = np.zeros(robot.n_v)
    run = HealthRun(robot, duration=END, spoil=spoil, motion=lambda t: still, dt=STEP, seed=seed)
    assert run.first_bad("linear_velocity", ONSET) < 3.0
    for name in ("position", "depth", "altimeter_range"):
        assert not (run.of(name) == Trust.LOST).any()


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

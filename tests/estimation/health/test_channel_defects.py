"""Every way to fail, of every channel: seen soon, named, harmless for the rest, and over when it is
over.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from corruptors import DEFECTS, STEPS
from health_run import HealthRun, between

from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpecs, Trust

# [s]
START = 4.0
END = 6.5
DURATION = 10.0
PERIODS = {name: 1.0 / getattr(SensorSpecs(), name).rate for name in STEPS}
SEEN = {name: max(0.1, 6.5 * period) for name, period in PERIODS.items()}
"""[s] in which a defect is seen: six readings, or a tenth of a second."""
# [s] after a sound reading in which a channel is good again: a second to agree, one without
# complaint
OVER = 2.0


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.fixture(
    scope="module", params=[(name, defect) for name in STEPS for defect in DEFECTS], ids=" ".join
)
def case(request: pytest.FixtureRequest, robot: Robot) -> tuple[str, str, HealthRun]:
    name, defect = request.param
    return (
        name,
        defect,
        HealthRun(robot, duration=DURATION, spoil=between(name, defect, START, END)),
    )


@pytest.mark.slow
def test_a_defect_is_seen_soon_named_and_over_when_it_is_over(
    case: tuple[str, str, HealthRun],
) -> None:
    name, _, run = case
    assert (run.of(name)[run.t < START] == Trust.GOOD).all()
    assert run.first_bad(name, START) <= SEEN[name]
    assert run.last_bad(name) <= END + PERIODS[name] + OVER
    texts = [text for t, text in run.guard.monitor.alarms if t >= START]
    assert texts[0].startswith(f"{name} suspect: ") or texts[0].startswith(f"{name} lost: ")
    assert any(text.startswith(f"{name} good again") for text in texts)


@pytest.mark.slow
def test_a_defect_leaves_the_estimate_finite_and_the_others_flowing(
    case: tuple[str, str, HealthRun],
) -> None:
    name, _, run = case
    assert np.isfinite(run.q_estimated).all()
    assert np.isfinite(run.v_estimated).all()
    for channel in set(STEPS) - {name}:
        assert (run.of(channel) != Trust.LOST).all(), channel
    settled = run.t >= END + OVER
    assert np.abs(run.q_estimated[settled, :3] - run.q[settled, :3]).max() < 0.1
    assert np.abs(run.v_estimated - run.v)[settled].max() < 0.2


@pytest.mark.sampled
@pytest.mark.parametrize("name", STEPS)
def test_one_value_that_is_no_number_is_named_and_forgotten(robot: Robot, name: str) -> None:
    run = HealthRun(
        robot, duration=6.0, spoil=between(name, "nan", 3.0, 3.0 + 1.01 * PERIODS[name])
    )
    assert np.isfinite(run.q_estimated).all()
    assert run.age[run.t > 0.5].max() <= 0.45
    assert run.of(name)[-1] == Trust.GOOD
    assert (run.of(name) != Trust.LOST).all()


@pytest.mark.sampled
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_spikes_of_fifty_metres_leave_five_centimetres(robot: Robot, sign: float) -> None:
    run = HealthRun(
        robot, duration=10.0, spoil=between("position", "spikes", 3.0, 8.0), seed=int(sign > 0)
    )
    assert np.linalg.norm(run.q_estimated[:, :3] - run.q[:, :3], axis=1)[run.t > 3.0].max() < 0.05


def test_spikes_of_the_dvl_hardly_move_the_velocity(robot: Robot) -> None:
    plain = HealthRun(robot, duration=8.0)
    run = HealthRun(robot, duration=8.0, spoil=between("linear_velocity", "spikes", 3.0, 6.0))
    assert np.abs(run.v_estimated[:, :3] - plain.v_estimated[:, :3]).max() < 0.1


def test_ages_count_what_nothing_stands_in_for(robot: Robot) -> None:
    dvl, fixes, encoders, altimeter = (
        HealthRun(robot, duration=7.0, spoil=between(name, "lost", 3.0, math.inf))
        for name in ("linear_velocity", "position", "joint_positions", "altimeter_range")
    )
    for run in (dvl, fixes, altimeter):
        assert run.age[run.t > 1.0].max() < 0.3
    assert encoders.age[-1] == pytest.approx(4.0, abs=0.1)
    assert encoders.joint_age[-1] == pytest.approx(4.0, abs=0.1)
    assert math.isnan(altimeter.range[-1])

"""Laws of actuator health: what is faulty is named, what is sound is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from actuators.hovering import Hover, run

from uvms_ocp.control.actuator_health.authority import authority_of
from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.joint_monitor import JointMonitor
from uvms_ocp.control.actuator_health.probe import wave_of
from uvms_ocp.control.actuator_health.thresholds import HealthTuning
from uvms_ocp.control.actuator_health.verdicts import FaultKind
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.thrusters import thrust_limits, thruster_matrix

FULL = "girona_maris7_full"
RIGHTING = np.array([0.0, 0.0, 0.0, 30.0, 30.0, 0.0])


def without(*thrusters: int) -> Effect:
    share = np.ones(8)
    share[list(thrusters)] = 0.0
    return Effect(share=share, constant=np.zeros(8))


@pytest.mark.parametrize("thruster", range(8))
@pytest.mark.parametrize("robot", [FULL, "bluerov2_alpha5"])
def test_a_wave_moves_its_thruster_and_cancels(robot: str, thruster: int) -> None:
    matrix = thruster_matrix(load_robot(robot))
    wave = wave_of(matrix, thruster)
    assert wave is not None
    assert abs(wave[thruster]) > 0.5
    np.testing.assert_allclose(matrix @ wave, 0.0, atol=1e-9)


def test_no_wave_cancels_where_the_other_thrusters_are_needed() -> None:
    matrix = thruster_matrix(load_robot(FULL)) * without(0).works
    assert wave_of(matrix, 1) is None
    assert wave_of(matrix, 4) is not None


@pytest.mark.parametrize("dead", [(0,), (5,), (0, 4), (4, 7)])
def test_a_mission_goes_on_without_one_thruster_or_two(dead: tuple[int, ...]) -> None:
    robot = load_robot(FULL)
    left = authority_of(thruster_matrix(robot), *thrust_limits(robot), without(*dead), np.zeros(6), RIGHTING)
    assert left.can_go_on
    assert (left.reach <= left.sound + 1e-6).all()


def test_a_mission_ends_where_no_thruster_drives_an_axis() -> None:
    robot = load_robot(FULL)
    left = authority_of(thruster_matrix(robot), *thrust_limits(robot), without(0, 1, 2), np.zeros(6), RIGHTING)
    assert not left.can_go_on
    assert "yaw" in (*left.lost, *left.one_sided)
    assert "yaw" in str(left)


def test_what_sound_thrusters_reach_is_all_there() -> None:
    robot = load_robot(FULL)
    left = authority_of(thruster_matrix(robot), *thrust_limits(robot), without(), np.zeros(6), RIGHTING)
    assert str(left) == "nothing is out of reach"


def test_a_joint_that_is_asked_pushed_and_stands_is_jammed_and_one_that_follows_is_not() -> None:
    monitor = JointMonitor(np.array([10.0, 10.0]), tuning=HealthTuning(), dt=0.01)
    for k in range(300):
        reference = np.array([0.2, 0.2])
        monitor.update(reference, np.array([0.0, 0.2]), np.array([-5.0, -5.0]), 0.01 * k)
    assert [verdict.kind for verdict in monitor.verdicts] == [FaultKind.JAMMED, None]


def test_a_joint_that_stands_because_nothing_pushes_it_is_not_jammed() -> None:
    monitor = JointMonitor(np.array([10.0]), tuning=HealthTuning(), dt=0.01)
    for k in range(300):
        monitor.update(np.array([0.2]), np.zeros(1), np.zeros(1), 0.01 * k)
    assert not monitor.jammed.any()


def test_impossible_tunings_are_refused() -> None:
    with pytest.raises(InvalidInput, match="sound_share"):
        HealthTuning(sound_share=1.0)
    with pytest.raises(InvalidInput, match="rest"):
        HealthTuning(rest=0.0)


def test_commands_are_the_same_to_the_last_bit_while_nothing_is_suspect() -> None:
    hover = Hover(duration=4.0, seed=2)
    watched, alone = run(hover), run(Hover(duration=4.0, seed=2, watched=False))
    first = watched.probed.index(True) if any(watched.probed) else len(watched.probed)
    assert first > 200
    np.testing.assert_array_equal(watched.commands[:first], alone.commands[:first])
    assert watched.alarms == []

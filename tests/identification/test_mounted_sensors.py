"""How a sensor of velocity is mounted is estimated with its errors: scale, turn and place come back,
what is sound is not doubted, and what is said is true.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from motions import changed, recorded

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.mounting_checks import estimated_mounting
from uvms_ocp.identification.recording import Recording

NOISE = 0.02  # [m, m/s]


def measured(
    *,
    scale: float = 1.0,
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    heading: float = 0.0,
    seed: int = 0,
) -> Recording:
    """Draw a noisy recording of a sensor that is mounted so. rpy, heading: [deg]; place: [m] in B."""
    recording = recorded(seed=seed)
    rng = np.random.default_rng(seed)
    channels = recording.channels
    turning = np.cross(channels["angular_velocity"].values, place)
    R = pin.rpy.rpyToMatrix(*np.deg2rad(rpy))
    velocities = scale * (channels["linear_velocity"].values + turning) @ R
    velocities = velocities + NOISE * rng.normal(size=velocities.shape)
    positions = channels["position"].values
    positions = positions + NOISE * rng.normal(size=positions.shape)
    about_z = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, np.deg2rad(heading)))
    attitudes = [(about_z * pin.Quaternion(x)).coeffs() for x in channels["attitude"].values]
    recording = changed(recording, "linear_velocity", values=velocities)
    recording = changed(recording, "position", values=positions)
    return changed(recording, "attitude", values=np.array(attitudes))


def doubts(recording: Recording) -> str:
    """Join all doubts about a recording."""
    return "; ".join(map(str, check_data_quality(recording)))


@pytest.mark.sampled
@pytest.mark.parametrize("scale", [0.9, 1.05, 1.15])
def test_a_scale_comes_back_within_three_standard_errors(scale: float) -> None:
    recording = measured(scale=scale)
    mounting = estimated_mounting(recording)
    assert mounting is not None
    assert abs(mounting.scale - scale) < 3.0 * mounting.scale_sigma + 0.003
    text = doubts(recording)
    assert "times the way that the position goes: give it scale: " in text
    cured = float(text.partition("give it scale: ")[2].partition(",")[0])
    values = cured * recording.channels["linear_velocity"].values
    assert doubts(changed(recording, "linear_velocity", values=values)) == ""


def test_a_place_comes_back_within_three_standard_errors() -> None:
    place = (0.1, -0.05, 0.08)
    recording = measured(place=place)
    mounting = estimated_mounting(recording)
    assert mounting is not None
    assert (np.abs(mounting.place - place) < 3.0 * mounting.place_sigma + 0.005).all()
    assert "measured elsewhere than the position, by x 0.10" in doubts(recording)


def test_turned_axes_come_back_with_their_sign() -> None:
    rpy = (3.0, -6.0, 10.0)
    mounting = estimated_mounting(measured(rpy=rpy))
    assert mounting is not None
    expected = pin.log3(pin.rpy.rpyToMatrix(*np.deg2rad(rpy)))
    assert np.abs(mounting.turn - expected).max() < np.deg2rad(1.0)
    assert "how is it mounted" in doubts(measured(rpy=rpy))


@pytest.mark.sampled
@pytest.mark.parametrize("heading", [-5.0, 8.0])
def test_a_heading_that_is_a_little_off_is_told_with_its_sign(heading: float) -> None:
    text = doubts(measured(heading=heading))
    assert "attitude: with it the velocity points beside the way of the position, by " in text
    told = float(text.partition("of the position, by ")[2].partition(" ")[0])
    assert abs(told - heading) < 1.0


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(4))
def test_a_sensor_that_is_mounted_as_it_should_be_is_not_doubted(seed: int) -> None:
    assert doubts(measured(seed=seed)) == ""


def test_what_is_wrong_jointly_is_told_jointly() -> None:
    mounting = estimated_mounting(measured(scale=1.1, rpy=(0.0, 8.0, 0.0), place=(0.3, 0.0, 0.0)))
    assert mounting is not None
    assert abs(mounting.scale - 1.1) < 0.01
    assert abs(mounting.turn[1] - np.deg2rad(8.0)) < np.deg2rad(1.0)
    assert abs(mounting.place[0] - 0.3) < 0.02

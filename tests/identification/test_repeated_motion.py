"""Offsets of clocks in a motion that repeats: all that are as good are told, and the true one is among
them.
"""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.series_agreement import Offset, describe_delay, offset

T = np.arange(0.0, 60.0, 0.05)
NOISE = 0.02
STEP = 0.05  # [s] in which offsets are searched


def swings(t: np.ndarray, period: float, *, wander: float = 0.0) -> np.ndarray:
    """Swings (n, 3) of three axes; wander: [rad] by which they come earlier and later, slowly."""
    phase = 2.0 * np.pi * t[:, None] / period + np.array([0.0, 1.9, 1.0])
    return np.sin(phase + wander * np.sin(0.15 * t)[:, None]) * [1.0, 0.5, 0.2]


def found_offset(period: float, late: float, wander: float = 0.0) -> Offset:
    rng = np.random.default_rng(3)
    expected = swings(T, period, wander=wander) + NOISE * rng.normal(size=(len(T), 3))
    measured = swings(T - late, period, wander=wander) + NOISE * rng.normal(size=(len(T), 3))
    return offset(T, expected, T, measured)


# Half a period late is as good as axes that are turned round, which is said of it.
@pytest.mark.parametrize(
    ("period", "late"),
    [
        (1.7, 0.4),
        (1.7, 2.0),
        (2.75, -0.6),
        (2.75, 2.0),
        (2.75, 5.0),
        (4.3, -2.8),
        (4.3, 5.0),
        (4.3, 12.3),
        (7.0, 2.0),
        (7.0, -2.6),
        (7.0, 5.0),
        (7.0, 12.0),
    ],
)
def test_the_true_offset_is_among_those_that_are_told(period: float, late: float) -> None:
    found = found_offset(period, late)
    told = np.array([found.delay, *found.others])
    assert np.abs(told - late).min() < 1.5 * STEP
    # Each is a whole number of periods from it: half a period later other axes would agree.
    periods = (told - late) / period
    assert np.abs(periods - periods.round()).max() * period < 3.0 * STEP
    assert len(told) > 3
    assert list(np.abs(told)) == sorted(np.abs(told))


def test_several_offsets_are_told_as_such() -> None:
    text = describe_delay(found_offset(2.75, 2.0))
    assert text.startswith(
        "0.75 s early against the rate of the {}, or 2.00 s late or 3.50 s early or "
    )
    assert text.endswith(" others: the motion repeats")


@pytest.mark.parametrize("late", [0.4, -0.75, 2.0, 5.0])
def test_swings_that_wander_tell_one_offset(late: float) -> None:
    found = found_offset(9.0, late, wander=1.5)
    assert found.others == ()
    assert abs(found.delay - late) < 1.5 * STEP


def test_a_channel_of_swings_is_told_with_all_of_its_delays() -> None:
    position = swings(T, 2.75) * 0.4 * 2.75 / 2.0 / np.pi
    quarter = 2.75 / 4.0
    velocity = 0.4 * swings(T - 2.0 + quarter, 2.75)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1))
    channels = {
        "position": Channel(t=T, values=position - [0.0, 0.0, 3.0]),
        "attitude": Channel(t=T, values=level),
        "linear_velocity": Channel(t=T, values=velocity),
    }
    text = "; ".join(map(str, check_data_quality(Recording(name="swings", channels=channels))))
    assert "0.75 s early against the rate of the position, or 2.00 s late" in text
    assert "axes" not in text

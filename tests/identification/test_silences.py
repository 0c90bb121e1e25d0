"""Recordings are cut where nothing is recorded, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motions import changed, recorded

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.recording_gaps import (
    LONGEST_GAP,
    SHORTEST,
    split_at_gaps,
)

GOOD = recorded(t_end=30.0)


def later(one: Recording, at: float, by: float) -> Recording:
    """With a clock that was moved by some time [s] at another [s]."""
    moved = {
        name: replace(each, t=each.t + by * (each.t > at)) for name, each in one.channels.items()
    }
    return replace(one, channels=moved)


def test_a_recording_without_silence_stays_whole() -> None:
    assert split_at_gaps([GOOD]) == (GOOD,)
    assert split_at_gaps([later(GOOD, 10.0, 0.9 * LONGEST_GAP)])[0].name == GOOD.name


def test_a_channel_that_is_silent_while_others_are_not_cuts_nothing() -> None:
    velocity = GOOD.channels["linear_velocity"]
    there = (velocity.t < 10.0) | (velocity.t > 20.0)
    lost = changed(GOOD, "linear_velocity", t=velocity.t[there], values=velocity.values[there])
    assert split_at_gaps([lost]) == (lost,)


@pytest.mark.sampled
@pytest.mark.parametrize("by", [5.0, 3600.0])
def test_parts_have_every_sample_and_no_silence_and_the_first_says_what_was_cut(by: float) -> None:
    parts = split_at_gaps([later(GOOD, 10.0, by)])
    assert [part.name for part in parts] == ["made part 1", "made part 2"]
    for name, channel in GOOD.channels.items():
        joined = np.vstack([part.channels[name].values for part in parts])
        np.testing.assert_array_equal(joined, channel.values)
        assert all(np.diff(part.channels[name].t).max() < LONGEST_GAP for part in parts)
    assert f"nothing is recorded for {by + 0.05:.3g} s at 10 s" in "; ".join(
        map(str, check_data_quality(parts[0]))
    )
    assert check_data_quality(parts[1]) == ()
    assert split_at_gaps(parts) == parts


def test_a_part_that_is_too_short_is_left_out() -> None:
    (part,) = split_at_gaps([later(GOOD, 0.8 * SHORTEST, 60.0)])
    assert part.span[0] > 60.0


def test_samples_that_are_all_far_apart_are_refused() -> None:
    sparse = {
        name: Channel(t=10.0 * np.arange(5), values=channel.values[:5])
        for name, channel in GOOD.channels.items()
    }
    with pytest.raises(InvalidInput, match="nothing is recorded for up to 10 s, again and again"):
        split_at_gaps([replace(GOOD, channels=sparse)])

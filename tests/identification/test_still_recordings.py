"""Recordings in which channels keep their values, as those of simulators at rest, are checked to the
end.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pytest
from motions import recorded

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.recording import Recording

MOVING = recorded()
"""A sound recording, in which all moves."""


def held(recording: Recording, names: Collection[str]) -> Recording:
    """Return the recording with channels that keep their first values."""
    channels = {}
    for name, channel in recording.channels.items():
        values = channel.values
        if name in names:
            values = np.repeat(values[:1], len(values), axis=0)
        channels[name] = replace(channel, values=values)
    return replace(recording, channels=channels)


@pytest.mark.sampled
@pytest.mark.parametrize("name", MOVING.channels)
def test_a_channel_that_stands_still_is_named_and_nothing_breaks(name: str) -> None:
    issues = check_data_quality(held(MOVING, {name}))
    assert name in {issue.channel for issue in issues}


@pytest.mark.parametrize("name", MOVING.channels)
def test_all_but_one_channel_may_stand_still(name: str) -> None:
    check_data_quality(held(MOVING, set(MOVING.channels) - {name}))


def test_a_vehicle_at_rest_is_no_error() -> None:
    resting = held(MOVING, set(MOVING.channels))
    channels = dict(resting.channels)
    for name in ("linear_velocity", "angular_velocity"):
        channels[name] = replace(channels[name], values=np.zeros_like(channels[name].values))
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(channels["attitude"].t), 1))
    channels["attitude"] = replace(channels["attitude"], values=level)
    check_data_quality(replace(resting, channels=channels))

"""A column that stops while its axis moves is doubted for itself, however the others go on."""

from __future__ import annotations

import re

import numpy as np
import pytest
from motions import changed, recorded

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.recording import CHANNEL_KINDS, Recording


def doubts(recording: Recording) -> str:
    """Join all doubts about a recording."""
    return "; ".join(map(str, check_data_quality(recording)))


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["position", "linear_velocity", "angular_velocity"])
@pytest.mark.parametrize("columns", [[0], [1], [2], [0, 2]])
def test_columns_that_stop_alone_are_named(name: str, columns: list[int]) -> None:
    recording = recorded()
    values = recording.channels[name].values.copy()
    values[300:600, columns] = values[300, columns]  # from 15 to 30 s
    stopped = changed(recording, name, values=values)
    labels = CHANNEL_KINDS[name].columns
    for k, label in enumerate(labels):
        text = f"{name}: {label} alone stays exactly as it is from 15.0 to "
        assert (text in doubts(stopped)) == (k in columns)


def test_a_whole_recording_of_sound_columns_is_not_doubted() -> None:
    assert "alone stays" not in doubts(recorded())


def test_a_coarse_depth_that_rests_between_its_steps_is_not_doubted() -> None:
    recording = recorded()
    values = recording.channels["position"].values.copy()
    values[:, 2] = np.round(values[:, 2], 1)
    assert "alone stays" not in doubts(changed(recording, "position", values=values))


def test_a_channel_that_stops_as_a_whole_is_said_once() -> None:
    recording = recorded()
    values = recording.channels["position"].values.copy()
    values[300:600] = values[300]
    found = doubts(changed(recording, "position", values=values))
    assert len(re.findall("stays exactly as it is", found)) == 1

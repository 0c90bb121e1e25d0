"""What the reading of each channel rests on: a mapping states it, other channels show it, or it is
assumed; what is doubted is never shown.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from motions import changed, recorded

from uvms_ocp.identification.channel_evidence import channel_evidence
from uvms_ocp.identification.channel_mapping import (
    ChannelMapping,
    RecordingMapping,
    stated_aspects,
)
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.reading import read_recording
from uvms_ocp.identification.recording import ASPECTS, Recording
from uvms_ocp.identification.tables import write_columns, write_recording


def statuses(recording: Recording) -> dict[tuple[str, str], str]:
    """Return the status of each aspect of each channel."""
    return {(entry.channel, entry.aspect): entry.status for entry in channel_evidence(recording)}


def test_every_aspect_of_every_channel_has_one_status() -> None:
    recording = recorded()
    assert set(statuses(recording)) == {
        (name, aspect) for name in recording.channels for aspect in ASPECTS
    }


def test_channels_that_agree_show_units_axes_and_clocks() -> None:
    status = statuses(recorded())
    for name in ("position", "linear_velocity", "angular_velocity"):
        for aspect in ("unit", "axes", "time"):
            assert status[name, aspect] == "shown"
    assert status["angular_velocity", "delay"] == "shown"
    assert status["position", "source"] == "assumed"


def test_a_channel_alone_shows_nothing() -> None:
    recording = recorded()
    alone = Recording(name="alone", channels={"position": recording.channels["position"]})
    assert set(statuses(alone).values()) == {"assumed"}


def test_what_is_doubted_is_not_shown() -> None:
    recording = recorded()
    values = 1.2 * recording.channels["linear_velocity"].values
    entries = channel_evidence(changed(recording, "linear_velocity", values=values))
    of_velocity = [entry for entry in entries if entry.channel == "linear_velocity"]
    assert {entry.status for entry in of_velocity} == {"assumed"}
    assert all("doubted" in entry.evidence for entry in of_velocity)
    of_position = [entry.status for entry in entries if entry.channel == "position"]
    assert set(of_position) == {"assumed"}


def test_a_mapping_and_a_header_state_what_they_say(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    columns = {"t [s]": np.arange(0.0, 30.0, 0.1)}
    for name in ("roll [deg]", "pitch [deg]", "yaw [deg]"):
        columns[name] = 10.0 * np.sin(columns["t [s]"])
    write_columns(path, columns)
    keys = {"time": "t [s]", "columns": list(columns)[1:], "format": "rpy", "delay": 0.1}
    mapping = RecordingMapping.model_validate({"channels": {"attitude": keys}})
    recording = mapped_recording(path, mapping)
    by_aspect = {entry.aspect: entry for entry in channel_evidence(recording)}
    assert by_aspect["unit"].status == "known"
    assert by_aspect["unit"].evidence == "deg, as the file says"
    assert by_aspect["axes"].status == "assumed"  # of W and B nothing is said
    assert by_aspect["delay"].evidence == "delay: 0.1 of the mapping"
    assert by_aspect["offset"].status == "assumed"


@pytest.mark.parametrize(
    ("key", "keys", "is_stated"),
    [
        ("attitude", {"format": "rpy"}, False),
        ("attitude", {"format": "rpy", "world": "NED"}, False),
        ("attitude", {"format": "rpy", "world": "NED", "body": "FRD"}, True),
        ("position", {}, False),
        ("position", {"world": "z up"}, True),
        ("linear_velocity", {"frame": "B"}, False),
        ("linear_velocity", {"body": "FLU"}, True),
        ("linear_velocity", {"frame": "W"}, False),
        ("linear_velocity", {"frame": "W", "world": "NED"}, True),
        ("linear_velocity", {"rows": {"valid": 1}}, False),
    ],
)
def test_axes_are_known_where_all_are_stated_that_they_depend_on(
    key: str, keys: dict[str, object], is_stated: bool
) -> None:
    mapping = ChannelMapping.model_validate({"columns": ["a", "b", "c"], **keys})
    stated = stated_aspects(key, mapping)
    assert ("axes" in stated) == is_stated
    assert "source" not in stated  # which rows are taken does not say of what they are


def test_a_written_recording_states_units_and_axes_alone(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    write_recording(recorded(), path)
    recording = read_recording(path)
    for name in recording.channels:
        assert set(recording.stated[name]) == {"unit", "axes"}


def test_evidence_names_the_channels_that_it_compares() -> None:
    recording = recorded()
    values = 1.01 * recording.channels["linear_velocity"].values
    entries = channel_evidence(changed(recording, "linear_velocity", values=values))
    for name in ("position", "linear_velocity"):
        text = next(
            entry.evidence for entry in entries if (entry.channel, entry.aspect) == (name, "unit")
        )
        assert text.startswith("the velocity reads 1.01")
        assert "times the way of the position" in text


def test_check_recording_gives_them_as_data(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from uvms_ocp.cli.commands import app

    path = tmp_path / "own.csv"
    write_recording(recorded(), path)
    result = CliRunner().invoke(app, ["check-recording", str(path), "--json"])
    data = json.loads(result.stdout)["own"]["evidence"]
    assert {entry["status"] for entry in data if entry["aspect"] == "axes"} == {"known"}
    assert {entry["aspect"] for entry in data} == set(ASPECTS)

"""What can be known before a search is said before it: it takes long, and what it has found would
be lost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from driven import drive
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import UvmsError
from uvms_ocp.identification import calibration as fitting
from uvms_ocp.identification.calibration_robot import calibrated_robot
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.tables import write_recording
from uvms_ocp.robot.loading import robot_folder

SETTINGS = """
robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
commands: wrench
learn: {volume: {}}
"""


class Searched(Exception):
    """What must not be reached."""


@pytest.fixture(autouse=True)
def _no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    def searched(*_: object, **__: object) -> None:
        raise Searched

    monkeypatch.setattr(fitting.FitContext, "searched", searched)
    monkeypatch.setattr(fitting, "Rollout", lambda stage: stage)


@cache
def recording() -> Recording:
    auv = calibrated_robot(
        CalibrationSettings.model_validate(yaml.safe_load(SETTINGS)), Path()
    ).vehicle
    return drive(stage_of(auv), auv.shared.start, seed=2, t_end=8.0)


def identify(
    folder: Path, settings: str, given: Recording, *words: str
) -> tuple[str, BaseException | None]:
    """What is told, and what stops the command."""
    (folder / "my.yaml").write_text(settings)
    write_recording(given, folder / "drive.csv")
    words = (
        "identify",
        str(folder / "my.yaml"),
        str(folder / "drive.csv"),
        "--out",
        str(folder / "out"),
        *words,
    )
    result = CliRunner().invoke(app, words, env={"COLUMNS": "200"})
    return result.output, result.exception


def with_channel(name: str, channel: Channel) -> Recording:
    return replace(recording(), channels={**recording().channels, name: channel})


def later(by: float) -> Recording:
    channel = recording().channel("linear_velocity")
    return with_channel("linear_velocity", replace(channel, t=channel.t + by))


def pose() -> Recording:
    kept = {name: recording().channels[name] for name in ("attitude", "wrench")}
    return replace(recording(), channels=kept)


def with_arm() -> Recording:
    t = recording().channel("attitude").t
    return with_channel("joint_positions", Channel(t=t, values=np.zeros((len(t), 4))))


REFUSED: dict[str, tuple[str, Callable[[], Recording], tuple[str, ...], str]] = {
    "one recording to be left out": (SETTINGS, recording, ("--leave-one-out",), "at least 2"),
    "a step longer than the recording": (
        SETTINGS + "step: 9",
        recording,
        (),
        "a step takes 9 s: record more",
    ),
    "a step longer than a stretch": (
        SETTINGS + "stretch: 0.01",
        recording,
        (),
        "or give longer stretches",
    ),
    "nothing to be learnt": (
        SETTINGS.replace("{}", "{free: []}"),
        recording,
        (),
        "nothing in it is free",
    ),
    "a delay beyond the longest": (
        SETTINGS + "delay: 2",
        recording,
        (),
        "delay: given 2; allowed: less than 1",
    ),
    "channels of other times": (SETTINGS, lambda: later(90.0), (), "give channels of one clock"),
    "an arm that was taken off": (
        SETTINGS,
        with_arm,
        (),
        "joint_positions has 4 columns; the vehicle has joints of no arm",
    ),
    "commands that are not there": (
        SETTINGS.replace("wrench", "thrust"),
        recording,
        (),
        "no thrust is recorded, only ",
    ),
    "a pose alone": (SETTINGS, pose, (), "no linear_velocity is recorded, only attitude, wrench"),
}


@pytest.mark.parametrize(("settings", "given", "words", "text"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_identified_is_refused(
    settings: str, given: Callable[[], Recording], words: tuple[str, ...], text: str, tmp_path: Path
) -> None:
    _, stopped = identify(tmp_path, settings, given(), *words)
    assert isinstance(stopped, UvmsError)
    assert text in str(stopped)


SHAPES = {
    "a shape that is turned": {"box": {"size": [0.4, 0.3, 0.2], "pose": {"rpy": [0.0, 0.0, 0.1]}}},
    "coefficients along axes of theirs": {"coefficients": {"pose": {"rpy": [0.0, 0.0, 0.1]}}},
}


@pytest.mark.parametrize("link", SHAPES.values(), ids=SHAPES)
def test_a_robot_without_coefficients_to_be_replaced_is_refused(
    link: dict[str, object], tmp_path: Path
) -> None:
    content = yaml.safe_load((robot_folder("bluerov2_alpha5") / "hydrodynamics.yaml").read_text())
    coefficients = content["links"]["base_link"]["coefficients"]
    merged = (
        {"coefficients": {**coefficients, **one}}
        if isinstance(one := link.get("coefficients"), dict)
        else link
    )
    content["links"]["base_link"] = merged
    (tmp_path / "water.yaml").write_text(yaml.safe_dump(content))
    _, stopped = identify(tmp_path, SETTINGS + "hydrodynamics: water.yaml", recording())
    assert isinstance(stopped, UvmsError)
    assert "base_link: give it coefficients along the axes of its link" in str(stopped)


def test_a_robot_whose_vehicle_is_in_no_water_is_refused(tmp_path: Path) -> None:
    content = yaml.safe_load((robot_folder("bluerov2_alpha5") / "hydrodynamics.yaml").read_text())
    content["trim"] = []
    for name in ("base_link", "arm_base"):
        del content["links"][name]
    (tmp_path / "water.yaml").write_text(yaml.safe_dump(content))
    settings = SETTINGS.replace("taken off", "as it is") + "hydrodynamics: water.yaml"
    _, stopped = identify(tmp_path, settings, recording())
    assert isinstance(stopped, UvmsError)
    assert "give it some of the vehicle's own link" in str(stopped)


def test_the_vehicle_is_its_largest_link_in_whatever_order_a_file_has_them(tmp_path: Path) -> None:
    content = yaml.safe_load((robot_folder("bluerov2_alpha5") / "hydrodynamics.yaml").read_text())
    settings = CalibrationSettings.model_validate(
        yaml.safe_load(SETTINGS.replace("taken off", "as it is"))
    )
    for name, links in (
        ("first", content["links"]),
        ("last", dict(reversed(content["links"].items()))),
    ):
        (tmp_path / name).write_text(yaml.safe_dump({**content, "links": links}, sort_keys=False))
        assert (
            calibrated_robot(settings.model_copy(update={"hydrodynamics": name}), tmp_path).frame
            == "base_link"
        )


def test_doubts_are_told_before_the_search(tmp_path: Path) -> None:
    turning = recording().channel("angular_velocity")
    told, stopped = identify(
        tmp_path,
        SETTINGS,
        with_channel("angular_velocity", replace(turning, values=np.rad2deg(turning.values))),
    )
    assert isinstance(stopped, Searched)
    assert "doubtful: drive: angular_velocity: " in told

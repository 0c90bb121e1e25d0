"""By how much motion comes after its commands is measured, and said where it comes before them."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import ACTUATORS, drive, known, vehicle_of

from uvms_ocp.identification.channel_evidence import channel_evidence
from uvms_ocp.identification.command_lags import CommandLag, measured_lag
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.explained_motion import motion_of
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import ZeroOrderHold

LAG = ACTUATORS.delay + ACTUATORS.lag  # [s]


@cache
def recording() -> Recording:
    """A drive whose commands stand in every row."""
    auv = vehicle_of(known())
    p = np.concatenate([auv.shared.start, auv.per_recording.start])
    driven = drive(stage_of(auv), p, seed=0, noise=0.005, t_end=60.0)
    t = np.arange(0.0, 60.0, 0.1)
    wrench = Channel(t=t, values=ZeroOrderHold(driven.channels["wrench"]).at(t))
    return replace(driven, channels={**driven.channels, "wrench": wrench})


def later(by: float) -> Recording:
    """The same with commands that were logged later [s]."""
    wrench = recording().channels["wrench"]
    moved = replace(wrench, t=wrench.t + by)
    return replace(recording(), channels={**recording().channels, "wrench": moved})


def lag_of(moved: Recording, *, signed: bool = True) -> CommandLag:
    motion = motion_of(moved)
    assert motion is not None
    measured = measured_lag(ZeroOrderHold(moved.channels["wrench"]), motion, signed=signed)
    assert measured is not None
    return measured


@pytest.mark.sampled
@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.parametrize("by", [0.0, 0.3, -0.4, 0.9])
def test_the_lag_behind_a_command_is_measured_with_its_error(by: float, signed: bool) -> None:
    measured = lag_of(later(by), signed=signed)
    assert measured.lag == pytest.approx(LAG - by, abs=0.06)
    assert 0.0 < measured.sigma < 0.02
    assert measured.share > 0.5


@pytest.mark.sampled
@pytest.mark.parametrize("by", [0.5, 0.8])
def test_commands_that_were_logged_late_are_said_with_the_delay_that_cures_it(by: float) -> None:
    doubts = [issue.problem for issue in check_data_quality(later(by)) if issue.channel == "wrench"]
    (text,) = [doubt for doubt in doubts if "before what it says: its times are late" in doubt]
    (delay,) = re.findall(r"give delay: (\S+) at least", text)
    assert float(delay) == pytest.approx(by - LAG, abs=0.06)
    cured = replace(later(by).channels["wrench"], delay=float(delay) + LAG)
    cured_recording = replace(recording(), channels={**recording().channels, "wrench": cured})
    assert not [issue for issue in check_data_quality(cured_recording) if issue.channel == "wrench"]


def test_commands_that_come_before_their_motion_are_not_doubted_and_show_by_how_much() -> None:
    assert check_data_quality(recording()) == ()
    (row,) = [
        row
        for row in channel_evidence(recording())
        if row.channel == "wrench" and row.aspect == "delay"
    ]
    assert row.status == "shown"
    assert re.search(r"accelerates 0\.\d+ \+- 0\.\d+ s after it", row.evidence)


def test_commands_that_have_nothing_to_do_with_the_motion_have_no_lag() -> None:
    motion = motion_of(recording())
    assert motion is not None
    rng = np.random.default_rng(7)
    other = Channel(t=np.arange(0.0, 60.0, 2.0), values=rng.normal(size=(30, 6)))
    assert measured_lag(ZeroOrderHold(other), motion, signed=True) is None

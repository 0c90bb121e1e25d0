"""What was commanded before the first row is unknown: a fit begins where all commands that act are
recorded.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import drive, known, vehicle_of

from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.model import PAST, PAST_STEP, Vehicle, stage_of
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Prior
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import ZeroOrderHold
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording

NOISE = Noise(velocity=0.01, rate=0.01, vertical=0.01)
CUT = 4.25  # [s], a step of the commands and 0.05 s more than their delay before


@cache
def vehicle() -> tuple[Vehicle, Rollout]:
    auv = vehicle_of(known().with_status(mass=Prior(sigma=0.1)))
    return auv, Rollout(stage_of(auv))


@cache
def driven() -> Recording:
    """An exact drive with commands in every row."""
    auv, rollout = vehicle()
    p = np.concatenate([auv.shared.start, auv.per_recording.start])
    recording = drive(rollout.stage, p, seed=1, t_end=30.0)
    t = np.arange(0.0, 30.0, 0.05)
    wrench = Channel(t=t, values=ZeroOrderHold(recording.channels["wrench"]).at(t))
    return replace(recording, channels={**recording.channels, "wrench": wrench})


def cut(recording: Recording, begin: float) -> Recording:
    channels = {}
    for name, channel in recording.channels.items():
        is_later = channel.t >= begin
        channels[name] = replace(channel, t=channel.t[is_later], values=channel.values[is_later])
    return replace(recording, channels=channels)


def largest_residual(prepared: PreparedRecording) -> float:
    """[NOISE] by the true vehicle, its starts fitted."""
    auv, rollout = vehicle()
    problem = OutputErrorProblem(auv, prepared.segments(0.01, 5.0), NOISE, rollout)
    estimate = problem.solve(problem.start(), iterations=10, frozen=10)
    n = sum(len(segment.t[0]) for segment in prepared.segments(0.01, 5.0))
    return float(np.sqrt(2.0 * estimate.cost / n))


def test_a_recording_that_begins_in_motion_is_explained_by_the_true_vehicle() -> None:
    prepared = PreparedRecording.of(cut(driven(), CUT), vehicle()[0])
    begin, end = prepared.recording.span
    unaware = replace(prepared, span=(begin, end))
    assert largest_residual(prepared) < 0.1
    assert largest_residual(unaware) > 3.0 * largest_residual(prepared)


def test_a_fit_begins_after_the_commands_that_act_at_its_beginning() -> None:
    auv = vehicle()[0]
    delay = auv.shared.declaration.quantities["delay"].value.item()
    prepared = PreparedRecording.of(cut(driven(), CUT), auv)
    first_command = prepared.recording.channels["wrench"].t[0]
    assert prepared.span[0] == pytest.approx(first_command + PAST * PAST_STEP + delay)
    (segment,) = prepared.segments(0.05)
    assert segment.edges[0] == prepared.span[0]


def test_a_recording_whose_first_row_commands_nothing_begins_there() -> None:
    recording = cut(driven(), CUT)
    wrench = recording.channels["wrench"]
    values = wrench.values.copy()
    values[0] = 0.0
    still = replace(
        recording, channels={**recording.channels, "wrench": replace(wrench, values=values)}
    )
    assert PreparedRecording.of(still, vehicle()[0]).span == still.span


def test_of_a_short_recording_little_is_left_out() -> None:
    recording = cut(driven(), 27.0)
    assert PreparedRecording.of(recording, vehicle()[0]).span == recording.span

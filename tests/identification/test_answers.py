"""Predictions use nothing but commands; what a recording does not determine is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import SIZE, drive, known, vehicle_of

from uvms_ocp.identification.estimates import Estimate, Noise
from uvms_ocp.identification.identified_numbers import numbers
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Free, Prior
from uvms_ocp.identification.predictor import (
    Predicted,
    Predictor,
    fit_percent,
)
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.uncertainty import (
    DETERMINED,
    standard_errors,
    unidentifiable_directions,
)
from uvms_ocp.identification.whiteness import bartlett, variance_inflation

LEARNT = {
    "mass": Free(),
    "added_mass": Free(only=("surge", "sway")),
    "linear_drag": Prior(sigma=0.5, only=("surge", "sway")),
    "gain": Free(only=("surge", "sway")),
}
NOISE = Noise(velocity=0.02, rate=0.02, vertical=0.02)


@cache
def problem() -> tuple[Vehicle, Rollout]:
    auv = vehicle_of(known().with_status(**LEARNT))
    return auv, Rollout(stage_of(auv))


def recording(seed: int = 0, noise: float = 0.0, size: Sequence[float] = SIZE) -> Recording:
    auv, rollout = problem()
    p = np.concatenate([auv.shared.start, auv.per_recording.start])
    return drive(rollout.stage, p, seed=seed, noise=noise, t_end=20.0, size=size)


def predictor() -> Predictor:
    auv, rollout = problem()
    return Predictor(vehicle=auv, rollout=rollout, shared=auv.shared.start, noise=NOISE)


def estimate(*given: Recording) -> Estimate:
    auv, rollout = problem()
    stretches = [
        stretch for each in given for stretch in PreparedRecording.of(each, auv).segments(0.1, 10.0)
    ]
    error = OutputErrorProblem(auv, stretches, NOISE, rollout)
    return error.solve(error.start())


def test_the_true_vehicle_predicts_nearly_all() -> None:
    (whole,) = PreparedRecording.of(recording(), problem()[0]).segments(0.05)
    predicted = predictor().of(whole)
    for axis in range(3):
        assert fit_percent(predicted.measured[0][:, axis], predicted.rows[0][:, axis]) > 90.0


def test_what_is_seen_later_changes_no_prediction() -> None:
    honest = recording()
    auv = problem()[0]
    velocity = honest.channels["linear_velocity"]
    begin, _ = PreparedRecording.of(honest, auv).span
    values = np.where((velocity.t > begin + 2.5)[:, None], 7.0, velocity.values)
    lying = replace(
        honest,
        channels={**honest.channels, "linear_velocity": Channel(t=velocity.t, values=values)},
    )
    rows = [
        predictor().of(PreparedRecording.of(each, auv).segments(0.1)[0]).rows[0]
        for each in (honest, lying)
    ]
    np.testing.assert_array_equal(*rows)


@pytest.mark.sampled
@pytest.mark.parametrize(("own", "least", "most"), [(True, 90.0, 100.0), (False, -1e3, 60.0)])
def test_a_force_of_one_recording_is_found_at_its_beginning_where_that_is_asked(
    own: bool, least: float, most: float
) -> None:
    auv = vehicle_of(known().with_status(wrench_offset=Prior(sigma=10.0, only=("heave",))))
    rollout = Rollout(stage_of(auv))
    drifting = drive(rollout.stage, np.array([8.0]), seed=0, t_end=20.0, size=(0.0,) * 6)
    found = Predictor(
        vehicle=auv, rollout=rollout, shared=auv.shared.start, noise=NOISE, fits_per_recording=own
    )
    predicted = found.of(PreparedRecording.of(drifting, auv).segments(0.05)[0])
    assert least < fit_percent(predicted.measured[0][:, 2], predicted.rows[0][:, 2]) < most


def test_horizons_follow_each_other() -> None:
    prepared = PreparedRecording.of(recording(), problem()[0])
    predicted = predictor().over(prepared, 0.1, 5.0)
    t = predicted.t[0]
    assert (np.diff(t) > 0.0).all()
    assert np.diff(t).max() < 0.11
    assert t[0] == pytest.approx(prepared.span[0] + 2.0, abs=0.11)


def test_a_fit_is_a_hundred_where_all_is_right_and_zero_at_the_mean() -> None:
    seen = np.array([1.0, 2.0, 4.0])
    assert fit_percent(seen, seen) == 100.0
    assert fit_percent(seen, np.full(3, seen.mean())) == pytest.approx(0.0)


def test_an_actuator_that_was_never_asked_is_left_open_and_the_others_are_determined() -> None:
    auv = problem()[0]
    fitted = estimate(recording(0, 0.02, size=(12.0, 0.0, 10.0, 0.8, 0.8, 3.0)))
    sigma = dict(zip(auv.shared.names, standard_errors(auv, fitted), strict=True))
    assert sigma["gain surge"] < DETERMINED
    assert sigma["added_mass surge"] < DETERMINED
    assert not sigma["gain sway"] < DETERMINED
    (opened,) = unidentifiable_directions(auv, fitted)
    assert [name for name, _ in opened.shares] == ["gain sway"]


def test_a_prior_is_not_taken_for_knowledge_of_the_recordings() -> None:
    auv = problem()[0]
    fitted = estimate(recording(0, 0.02))
    nothing = replace(fitted, information=np.diag(1.0 / auv.shared.sigma**2))
    sigma = dict(zip(auv.shared.names, standard_errors(auv, nothing), strict=True))
    assert not any(number.informed or number.determined for number in numbers(auv, nothing))
    assert sigma["linear_drag surge"] == pytest.approx(0.5)


def test_samples_that_miss_alike_count_for_fewer() -> None:
    rng = np.random.default_rng(3)
    white = rng.normal(size=4000)
    assert bartlett(white) == pytest.approx(1.0, abs=0.2)
    assert bartlett(np.repeat(white[:400], 10)) == pytest.approx(10.0, rel=0.3)
    rows = tuple(np.zeros((4000, 3)) for _ in range(3))
    seen = tuple(sigma * rng.normal(size=(4000, 3)) for sigma in (0.02, 0.02, 0.02))
    t = tuple(np.arange(4000.0) for _ in range(3))
    assert variance_inflation(Predicted(t=t, rows=rows, measured=seen), NOISE) == pytest.approx(
        1.0, abs=0.2
    )

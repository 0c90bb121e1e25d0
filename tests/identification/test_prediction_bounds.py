"""Predictions say how good they could be, what differs between recordings, and where a vehicle that
stands still predicts better.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import drive, known, vehicle_of

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.estimates import FitStatus, Noise
from uvms_ocp.identification.fit import (
    FitContext,
    Search,
    search_fit,
)
from uvms_ocp.identification.identified_numbers import IdentifiedNumber, numbers
from uvms_ocp.identification.jackknife import disagreed_numbers
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.parameters import Free, Prior
from uvms_ocp.identification.prediction_bounds import ALONE, TOGETHER, PredictionBounds, fit_bounds
from uvms_ocp.identification.prediction_text import prediction_data, prediction_lines, verdict_words
from uvms_ocp.identification.prediction_verdict import (
    FitShares,
    MissCause,
    PredictionJudgement,
    PredictionVerdict,
    judge_predictions,
)
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.still_comparison import MEAN, NOTHING_MOVES, worse_than_still
from uvms_ocp.identification.validation import (
    OTHERS,
    STATIC,
    HeldOutRecording,
    leave_one_out,
    predict_others,
)
from uvms_ocp.identification.whiteness import variance_inflation

NOISE = Noise(velocity=0.01, rate=0.01, vertical=0.01)
SEARCH = Search(step=0.05, segment_length=10.0)
BALLAST = np.array([0.02, 0.0, 0.0, 0.0])
"""Change of the unknowns that a lead of 0.4 kg makes: of the volume, relative."""


@cache
def problem() -> tuple[Vehicle, Rollout]:
    auv = vehicle_of(
        known().with_status(
            added_mass=Free(only=("surge",)),
            quadratic_drag=Free(only=("surge", "heave")),
            volume=Prior(sigma=0.1),
        )
    )
    assert auv.shared.names[0] == "volume"
    return auv, Rollout(stage_of(auv))


def truth() -> np.ndarray:
    return problem()[0].shared.start + np.array([0.0, 0.1, 0.3, -0.2])


def driven(seed: int, unknowns: np.ndarray, t_end: float = 12.0) -> PreparedRecording:
    auv, rollout = problem()
    recording = drive(rollout.stage, unknowns, seed=seed, noise=0.01, t_end=t_end)
    return PreparedRecording.of(recording, auv)


@cache
def identified() -> FitContext:
    """The vehicle, identified on two recordings of it."""
    auv, rollout = problem()
    prepared = tuple(driven(seed, truth()) for seed in range(2))
    return FitContext.searched(
        vehicle=auv, rollout=rollout, prepared=prepared, noise=NOISE, search=SEARCH
    )


@cache
def same_vehicle() -> tuple[PredictionBounds, tuple[HeldOutRecording, ...]]:
    """Two more recordings of the vehicle that was identified."""
    return bounded(tuple(driven(seed, truth()) for seed in (2, 3)))


@cache
def other_ballast() -> tuple[PredictionBounds, tuple[HeldOutRecording, ...]]:
    """Two recordings, one with a lead more and one with a lead less."""
    return bounded((driven(2, truth() + BALLAST), driven(3, truth() - BALLAST)))


def bounded(
    prepared: tuple[PreparedRecording, ...],
) -> tuple[PredictionBounds, tuple[HeldOutRecording, ...]]:
    bounds = fit_bounds(identified(), prepared)
    return bounds, tuple(
        predict_others(identified(), prepared, horizons=(3.0, 60.0), bounds=bounds)
    )


def shares(found: tuple[PredictionBounds, tuple[HeldOutRecording, ...]]) -> dict[str, FitShares]:
    return {each.channel: each for each in judge_predictions(found[1]).shares}


def text(found: tuple[PredictionBounds, tuple[HeldOutRecording, ...]]) -> str:
    bounds, recordings = found
    return "\n".join(prediction_lines(recordings, bounds))


@pytest.mark.slow
def test_of_one_vehicle_all_is_predicted_that_one_vehicle_could_explain() -> None:
    by_kind = shares(same_vehicle())
    assert {"surge", "sway", "heave", "yaw rate"} <= by_kind.keys()
    for each in by_kind.values():
        assert each.share == pytest.approx(100.0, abs=3.0), each
        assert abs(each.missed[MissCause.RECORDINGS]) < 3.0, each
        assert not each.recordings_differ
    judgement = judge_predictions(same_vehicle()[1])
    assert judgement.verdict is PredictionVerdict.AS_GOOD_AS_ONE_VEHICLE
    assert "Recordings differ" not in text(same_vehicle())


@pytest.mark.slow
def test_of_two_ballasts_one_vehicle_falls_short_of_each_alone_and_the_report_says_so() -> None:
    heave = shares(other_ballast())["heave"]
    assert heave.alone > heave.together + 10.0
    assert heave.alone == pytest.approx(shares(same_vehicle())["heave"].alone, abs=5.0)
    assert heave.cause is MissCause.RECORDINGS
    said = text(other_ballast())
    assert "**Recordings differ** in heave" in said
    assert str(heave) in said
    assert MissCause.RECORDINGS.advice in said
    assert "recordings differ in heave" in verdict_words("predicted", other_ballast()[1])
    assert not shares(other_ballast())["surge"].recordings_differ


@pytest.mark.slow
def test_vehicles_of_their_own_find_the_ballast_that_each_recording_had() -> None:
    bounds, recordings = other_ballast()
    volumes = [
        bounds.alone[recording.name].estimate.shared[0] - truth()[0] for recording in recordings
    ]
    np.testing.assert_allclose(volumes, [BALLAST[0], -BALLAST[0]], atol=2e-3)
    assert abs(bounds.together.estimate.shared[0] - truth()[0]) < 0.9 * BALLAST[0]


@pytest.mark.slow
def test_what_one_vehicle_of_another_ballast_misses_is_the_fits() -> None:
    prepared = (driven(2, truth() + BALLAST), driven(3, truth() + BALLAST))
    heave = shares(bounded(prepared))["heave"]
    assert heave.cause is MissCause.FIT
    assert heave.share < 90.0
    assert not heave.recordings_differ
    judgement = judge_predictions(bounded(prepared)[1])
    assert judgement.verdict is not PredictionVerdict.AS_GOOD_AS_ONE_VEHICLE


@pytest.mark.slow
def test_bounds_predict_the_same_samples_in_the_same_way() -> None:
    for recording in same_vehicle()[1]:
        for horizon in recording.horizons:
            assert list(horizon.bounds) == [TOGETHER, ALONE]
            for bound in horizon.bounds.values():
                for sensor in range(3):
                    np.testing.assert_array_equal(bound.t[sensor], horizon.by[OTHERS].t[sensor])


@pytest.mark.slow
def test_the_bound_of_leave_one_out_is_the_vehicle_of_all_itself() -> None:
    fitted = identified()
    bounds = fit_bounds(fitted, fitted.prepared)
    assert bounds.together is fitted
    assert list(bounds.alone) == ["drive0", "drive1"]
    for recording in leave_one_out(fitted, horizons=(60.0,), bounds=bounds):
        assert list(recording.horizons[0].bounds) == [TOGETHER, ALONE]


def test_fits_beside_bounds_cost_little_where_the_vehicle_is_known() -> None:
    bounds = same_vehicle()[0]
    assert bounds.together.estimate.status is FitStatus.CONVERGED
    assert bounds.together.estimate.iterations <= 6
    assert bounds.seconds > 0.0
    assert f"These bounds took {bounds.seconds:.3g} s." in text(same_vehicle()).replace("\n", " ")


def test_without_bounds_nothing_is_said_of_them() -> None:
    fitted = identified()
    prepared = (driven(2, truth()),)
    recordings = tuple(predict_others(fitted, prepared, horizons=(60.0,)))
    assert not recordings[0].horizons[0].bounds
    judgement = judge_predictions(recordings)
    assert judgement.shares == ()
    assert judgement.verdict is PredictionVerdict.BETTER_THAN_STILL
    said = "\n".join(prediction_lines(recordings, None))
    assert "How good these predictions could be" not in said
    assert "bounds" not in prediction_data(recordings, None)


def test_a_search_that_has_not_converged_is_no_bound() -> None:
    bounds, recordings = same_vehicle()
    stopped = replace(bounds.together.estimate, status=FitStatus.ITERATION_LIMIT)
    lost = replace(bounds, together=replace(bounds.together, estimate=stopped))
    said = "\n".join(prediction_lines(recordings, lost))
    assert "the search has ended by iteration limit. Its figures are no bound." in said
    assert prediction_data(recordings, lost)["bounds"]["unfinished"]


def test_a_recording_that_the_vehicle_was_identified_on_is_not_predicted() -> None:
    with pytest.raises(InvalidInput, match="drive0: the vehicle was identified on it"):
        list(predict_others(identified(), identified().prepared))


@pytest.mark.slow
def test_a_vehicle_that_weighs_another_is_worse_than_standing_still_and_named() -> None:
    auv, rollout = problem()
    heavy = truth() - 5.0 * BALLAST
    level = drive(
        rollout.stage, truth(), seed=5, noise=0.01, t_end=12.0, size=(12.0, 0, 0, 0, 0, 0)
    )
    prepared = PreparedRecording.of(level, auv)
    wrong = replace(identified(), estimate=replace(identified().estimate, shared=heavy))
    recordings = tuple(predict_others(wrong, (prepared,), horizons=(3.0, 60.0)))
    judgement = judge_predictions(recordings)
    named = {(each.recording, each.channel, each.horizon) for each in judgement.worse}
    assert ("drive5", "heave", 60.0) in named
    assert not any(channel == "surge" for _, channel, _ in named)
    assert judgement.verdict is PredictionVerdict.WORSE_THAN_STILL
    said = "\n".join(prediction_lines(recordings, None))
    assert "drive5: heave over 60 s is predicted worse than by" in said
    assert f"**Predictions are {PredictionVerdict.WORSE_THAN_STILL.value}.**" in said
    assert "worse than standing still in" in verdict_words("predicted", recordings)
    data = prediction_data(recordings, None)
    assert data["verdict"] == PredictionVerdict.WORSE_THAN_STILL.value
    assert any("drive5: heave over 60 s" in each["sentence"] for each in data["worse_than_still"])


def made(rows: np.ndarray, measured: np.ndarray) -> Predicted:
    """Velocities that are predicted in surge alone, (m,) [m/s], of a vehicle that stays level."""
    t = np.arange(float(len(rows)))
    zeros = np.zeros((len(rows), 3))
    level = np.tile([0.0, 0.0, 1.0], (len(rows), 1))
    return Predicted(
        t=(t, t, t),
        rows=(np.column_stack([rows, zeros[:, :2]]), zeros, level),
        measured=(np.column_stack([measured, zeros[:, :2]]), zeros, level),
    )


def test_both_vehicles_that_stand_still_are_asked() -> None:
    measured = 0.5 + 0.1 * np.sin(np.arange(50.0))
    still = made(np.zeros(50), measured)
    good = made(measured + 0.05, measured)
    assert list(worse_than_still("dive", good, still)) == []
    beside_the_mean = made(np.full(50, 0.3), measured)
    (shortfall,) = worse_than_still("dive", beside_the_mean, still)
    assert (shortfall.channel, shortfall.baseline) == ("surge", MEAN)
    away = made(np.full(50, 1.2), measured)
    (shortfall,) = worse_than_still("dive", away, still)
    assert shortfall.baseline == NOTHING_MOVES
    assert shortfall.baseline_error == pytest.approx(float(np.sqrt((measured**2).mean())))
    assert str(shortfall).startswith('dive: surge is predicted worse than by "nothing moves"')
    lost = made(np.full(50, np.nan), measured)
    assert [each.channel for each in worse_than_still("dive", lost, still)] == ["surge"]


def test_pitch_is_judged_apart_from_roll() -> None:
    """Where roll is predicted so well that the tilt as a whole is better than at rest."""
    t = np.arange(100.0)
    roll, pitch = np.radians(20.0 * np.sin(0.1 * t)), np.radians(0.9 * np.sin(0.13 * t))

    def vertical(roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        across = np.cos(pitch)
        return np.column_stack([-np.sin(pitch), across * np.sin(roll), across * np.cos(roll)])

    zeros = np.zeros((100, 3))
    seen = (zeros, zeros, vertical(roll, pitch))
    still = Predicted(
        t=(t, t, t), rows=(zeros, zeros, vertical(0 * roll, 0 * pitch)), measured=seen
    )
    predicted = Predicted(
        t=(t, t, t), rows=(zeros, zeros, vertical(roll, 2.5 * pitch)), measured=seen
    )
    (shortfall,) = worse_than_still("traj", predicted, still)
    assert (shortfall.channel, shortfall.unit) == ("pitch", "deg")
    assert shortfall.error == pytest.approx(1.5 * shortfall.baseline_error, rel=1e-3)


def test_what_is_missed_is_shared_out_whole() -> None:
    """The reference of six recordings that a vehicle of ten others predicts."""
    for predicted, together, alone in ((53, 56, 85), (57, 63, 70), (70, 76, 47), (49, 57, 69)):
        each = FitShares(channel="surge", predicted=predicted, together=together, alone=alone)
        assert sum(each.missed.values()) == pytest.approx(100.0 - predicted)
        assert min(each.missed.values()) >= 0.0
        assert each.share == pytest.approx(100.0 * predicted / together)
    assert not FitShares(channel="heave", predicted=70, together=76, alone=47).recordings_differ


def test_what_predicts_better_than_the_bound_is_one_vehicle_itself() -> None:
    each = FitShares(channel="heave", predicted=60.0, together=55.0, alone=70.0)
    assert each.share == 100.0
    assert list(each.missed.values()) == [0.0, 10.0, 30.0]


def test_where_one_vehicle_explains_nothing_there_is_no_share() -> None:
    nothing = FitShares(channel="surge", predicted=-5.0, together=-1.0, alone=20.0)
    assert np.isnan(nothing.share)
    judgement = PredictionJudgement(worse=(), shares=(nothing,), unpredicted=(), compared=8)
    assert judgement.verdict is PredictionVerdict.BELOW_THE_BOUND


def test_what_is_not_predicted_at_all_is_no_good_prediction() -> None:
    lost = replace(same_vehicle()[1][0], horizons=())
    assert judge_predictions([lost]).verdict is PredictionVerdict.NOTHING_PREDICTED
    some = judge_predictions([lost, same_vehicle()[1][1]])
    assert some.unpredicted == (lost.name,)
    assert some.verdict is PredictionVerdict.WORSE_THAN_STILL


def test_static_predictions_themselves_are_not_called_worse() -> None:
    for recording in same_vehicle()[1]:
        for horizon in recording.horizons:
            still = horizon.by[STATIC]
            named = worse_than_still(recording.name, still, still)
            assert all(each.baseline == MEAN for each in named)


@cache
def left_out_of(*ballasts: float) -> tuple[tuple[IdentifiedNumber, ...], list[HeldOutRecording]]:
    """Numbers of a vehicle from recordings with other ballasts, each then left out."""
    auv, rollout = problem()
    prepared = tuple(
        driven(10 + k, truth() + ballast * BALLAST) for k, ballast in enumerate(ballasts)
    )
    estimate = search_fit(auv, prepared, NOISE, rollout, SEARCH)
    fitted = replace(identified(), prepared=prepared, estimate=estimate)
    left = Predicted.joined(list(fitted.residuals().values()))
    all_numbers = numbers(auv, estimate, variance_inflation(left, NOISE))
    return all_numbers, list(leave_one_out(fitted, horizons=(60.0,)))


@pytest.mark.slow
def test_numbers_of_one_vehicle_move_by_their_standard_errors() -> None:
    all_numbers, left_out = left_out_of(0.0, 0.0, 0.0)
    assert any(number.determined for number in all_numbers)
    assert list(disagreed_numbers(problem()[0], all_numbers, left_out)) == []


@pytest.mark.slow
def test_a_number_called_determined_on_which_recordings_disagree_is_named() -> None:
    all_numbers, left_out = left_out_of(1.0, 0.0, -1.0)
    volume = next(number for number in all_numbers if number.name == "volume")
    # As a fit that takes recordings for those of one vehicle, with white residuals, would have it.
    certain = tuple(
        replace(number, sigma=min(number.sigma, 1e-4 * number.value)) for number in all_numbers
    )
    named = {each.number.name: each for each in disagreed_numbers(problem()[0], certain, left_out)}
    assert "volume" in named
    assert named["volume"].scatter > 0.003 * volume.value
    assert str(named["volume"]).startswith("volume is called determined to")
    assert list(disagreed_numbers(problem()[0], certain, left_out[:1])) == []

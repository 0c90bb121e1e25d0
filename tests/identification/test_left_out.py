"""A recording that is left out is never seen, and what predicts it is told beside what knows
less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import drive, known, vehicle_of
from vehicles import vehicle as with_arm

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.fit import FitContext, Search
from uvms_ocp.identification.fit_tables import left_out_tables
from uvms_ocp.identification.model import PAST, PAST_STEP, Vehicle, stage_of
from uvms_ocp.identification.parameters import Free
from uvms_ocp.identification.prediction_errors import SCORED, errors
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.static_baselines import StaticBalance, static_baseline
from uvms_ocp.identification.validation import (
    BALANCE,
    BEFORE,
    OTHERS,
    STATIC,
    HeldOutRecording,
    leave_one_out,
    without,
)
from uvms_ocp.viz.identification_figures import figure_left_out

DELAY = 0.2  # [s] of the commands, which is known
NOISE = Noise(velocity=0.02, rate=0.02, vertical=0.02)
SEARCH = Search(step=0.05, segment_length=10.0)
UPRIGHT = 998.0 * 0.0205 * np.array([0.01, 0.0, 0.05]) - 20.0 * np.array([0.02, -0.01, -0.03])
"""[kg m] of what the vehicle of the tests displaces, less that of its mass."""


@cache
def problem() -> tuple[Vehicle, Rollout]:
    auv = vehicle_of(
        known().with_status(
            added_mass=Free(only=("surge",)), quadratic_drag=Free(only=("surge", "yaw"))
        )
    )
    return auv, Rollout(stage_of(auv))


@cache
def recordings() -> tuple[Recording, ...]:
    auv, rollout = problem()
    truth = auv.shared.start + np.array([0.1, 0.3, -0.2])
    return tuple(
        drive(rollout.stage, truth, seed=seed, noise=0.02, t_end=14.0) for seed in range(3)
    )


def solved(given: Sequence[Recording]) -> FitContext:
    auv, rollout = problem()
    prepared = tuple(PreparedRecording.of(each, auv) for each in given)
    return FitContext.searched(
        vehicle=auv, rollout=rollout, prepared=prepared, noise=NOISE, search=SEARCH
    )


@cache
def fitted() -> FitContext:
    return solved(recordings())


@cache
def found() -> tuple[HeldOutRecording, ...]:
    return tuple(leave_one_out(fitted(), horizons=(3.0, 60.0, 90.0)))


def lying(one: Recording) -> Recording:
    velocity = one.channels["linear_velocity"]
    return replace(
        one,
        channels={
            **one.channels,
            "linear_velocity": Channel(t=velocity.t, values=-3.0 * velocity.values),
        },
    )


@pytest.mark.slow
def test_what_is_judged_does_not_change_what_the_others_tell() -> None:
    honest = fitted()
    other = solved([*recordings()[:2], lying(recordings()[2])])
    assert (honest.estimate.shared != other.estimate.shared).all()
    one, two = (without(each, each.prepared[2]).estimate for each in (honest, other))
    np.testing.assert_array_equal(one.shared, two.shared)
    np.testing.assert_array_equal(one.information, two.information)
    assert one.cost == two.cost
    one, two = (without(each, each.prepared[0]).estimate for each in (honest, other))
    assert (one.shared != two.shared).all()


@pytest.mark.slow
def test_horizons_are_cut_where_recordings_are_too_short_and_longer_ones_left_out() -> None:
    for one in found():
        assert [each.asked for each in one.horizons] == [3.0, 60.0]
        begin, end = next(each for each in recordings() if each.name == one.name).span
        # What was commanded before the first row acts until then.
        begin += PAST * PAST_STEP + DELAY
        assert one.horizons[1].length == pytest.approx(
            end - begin - one.predictor.start_window, abs=2 * SEARCH.step
        )


@pytest.mark.slow
def test_all_predict_the_same_samples_after_what_was_known() -> None:
    for one in found():
        begin = next(each for each in recordings() if each.name == one.name).span[0]
        for horizon in one.horizons:
            assert list(horizon.by) == [OTHERS, BEFORE, STATIC, BALANCE]
            first = horizon.by[OTHERS]
            assert min(t[0] for t in first.t) > begin + one.predictor.start_window
            for other in horizon.by.values():
                for pair in zip(
                    (*first.t, *first.measured), (*other.t, *other.measured), strict=True
                ):
                    np.testing.assert_array_equal(*pair)


@pytest.mark.slow
def test_what_was_identified_predicts_best() -> None:
    for one in found():
        for horizon in one.horizons:
            of_others, before, resting, _ = (errors(each)[0] for each in horizon.by.values())
            assert of_others < before < resting


@pytest.mark.slow
def test_predictions_err_by_what_is_expected_of_them() -> None:
    ratios = []
    for one in found():
        for horizon in one.horizons:
            ratios.append(errors(horizon.by[OTHERS])[:6] / horizon.expected_error[:6])
            assert "surge" not in horizon.extrapolated + horizon.uninformative
    # Of one recording, with few independent errors, half as much again is no rarity.
    assert (np.array(ratios) < 1.8).all()
    of_all = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert (of_all > 0.7).all()
    assert (of_all < 1.3).all()


@pytest.mark.slow
def test_what_the_others_never_did_is_extrapolated() -> None:
    auv, rollout = problem()
    truth = auv.shared.start + np.array([0.1, 0.3, -0.2])
    still = (0.0,) * 6
    turning = (0.0, 0.0, 0.0, 0.0, 0.0, 12.0)
    given = [
        drive(
            rollout.stage, truth, seed=k, noise=0.02, t_end=12.0, size=still if k < 2 else turning
        )
        for k in range(3)
    ]
    first, _, last = leave_one_out(solved(given), horizons=(5.0,))
    assert "yaw" in last.horizons[0].extrapolated
    assert f"{last.name}: {', '.join(last.horizons[0].extrapolated)} rest on" in "\n".join(
        left_out_tables([last])
    )
    assert "yaw" in first.horizons[0].uninformative  # nothing turned it


def test_a_recording_alone_cannot_be_left_out() -> None:
    alone = replace(fitted(), prepared=fitted().prepared[:1])
    with pytest.raises(InvalidInput, match="at least 2"):
        list(leave_one_out(alone))


def test_nothing_moves_says_zero_and_the_vertical_that_was_seen_last() -> None:
    (whole,) = fitted().prepared[0].segments(0.05)
    resting = static_baseline(whole, 2.0)
    assert not resting.rows[0].any()
    assert not resting.rows[1].any()
    last = np.flatnonzero(whole.t[2] <= whole.edges[0] + 2.0)[-1]
    assert (resting.rows[2] == whole.measured[2][last]).all()
    np.testing.assert_allclose(errors(resting)[:3], np.sqrt((whole.measured[0] ** 2).mean(axis=0)))


def test_errors_are_root_mean_squares_and_angles() -> None:
    seen = (np.zeros((2, 3)), np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]))
    tilted = np.array([[0.0, np.sin(0.1), np.cos(0.1)], [np.sin(0.3), 0.0, np.cos(0.3)]])
    rows = (np.array([[3.0, 0.0, 1.0], [4.0, 0.0, -1.0]]), np.full((2, 3), 2.0), tilted)
    wanted = [np.sqrt(12.5), 0.0, 1.0, 2.0, 2.0, 2.0, np.rad2deg(np.sqrt((0.1**2 + 0.3**2) / 2))]
    told = errors(Predicted(t=(np.arange(2.0),) * 3, rows=rows, measured=seen))
    assert len(told) == len(SCORED)
    np.testing.assert_allclose(told, wanted, atol=1e-12)


def test_a_vehicle_in_balance_is_turned_by_nothing() -> None:
    auv = fitted().vehicle
    moment = UPRIGHT
    told = StaticBalance(auv).vertical(np.zeros((0, 1)), auv.shared.start)[:, 0]
    np.testing.assert_allclose(told, moment / np.linalg.norm(moment), atol=1e-9)


def test_an_arm_that_moves_changes_the_balance_as_its_weight_does() -> None:
    auv = replace(fitted().vehicle, dynamics=with_arm(n_joints=1))
    told = StaticBalance(auv).vertical(np.array([[0.0, np.pi]]), auv.shared.start)
    for k, way in enumerate((1.0, -1.0)):
        x = 0.3 + way * 0.15 - 998.0 * 8e-4 * 0.3
        moment = UPRIGHT - np.array([x, 0.0, 0.0])
        np.testing.assert_allclose(told[:, k], moment / np.linalg.norm(moment), atol=1e-6)


def test_where_the_others_determine_too_little_the_tables_say_so_and_go_on() -> None:
    lost = replace(found()[0], horizons=())
    text = "\n".join(left_out_tables([lost, *found()[1:]]))
    assert f"{lost.name}: the others determine too little" in text
    assert f"| {found()[1].name} |" in text
    figure_left_out([lost, *found()[1:]])
    figure_left_out([lost])

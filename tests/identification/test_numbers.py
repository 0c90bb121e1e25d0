"""What is learnt is told in numbers of the vehicle: with units, intervals and what is not
determined.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import drive, known, vehicle_of

from uvms_ocp.identification.identified_numbers import (
    IdentifiedNumber,
    numbers,
    values_of,
)
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import Estimate, FitStatus, Noise, OutputErrorProblem
from uvms_ocp.identification.parameters import Free, Prior
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording

LEARNT = {
    "mass": Prior(sigma=0.3),
    "volume": Prior(sigma=0.3),
    "added_mass": Free(only=("surge",)),
    "centre_of_buoyancy": Prior(sigma=0.2),
}


@cache
def found() -> tuple[Vehicle, Estimate]:
    auv = vehicle_of(known().with_status(**LEARNT))
    rollout = Rollout(stage_of(auv))
    recording = drive(
        rollout.stage,
        np.concatenate([auv.shared.start, auv.per_recording.start]),
        seed=1,
        noise=0.02,
    )
    error = OutputErrorProblem(
        auv, PreparedRecording.of(recording, auv).segments(0.1, 10.0), Noise(), rollout
    )
    return auv, error.solve(error.start())


def told(inflation: float = 1.0) -> dict[str, IdentifiedNumber]:
    return {each.name: each for each in numbers(*found(), inflation)}


@pytest.mark.slow
def test_errors_of_numbers_are_those_of_a_change_of_the_unknowns() -> None:
    auv, estimate = found()
    eps = 1e-6 * np.eye(len(estimate.shared))
    slopes = [
        (values_of(auv, estimate.shared + e) - values_of(auv, estimate.shared - e)) / 2e-6
        for e in eps
    ]
    C = np.linalg.inv(estimate.information)
    wanted = np.sqrt(np.diag(np.array(slopes).T @ C @ np.array(slopes)))
    np.testing.assert_allclose([each.sigma for each in told().values()], wanted, rtol=1e-5)


def test_what_an_axis_has_to_move_is_the_sum_of_both_masses() -> None:
    each = told()
    total = each["mass and added mass surge"]
    assert total.value == pytest.approx(each["mass"].value + each["added_mass surge"].value)
    apart = np.hypot(each["mass"].sigma, each["added_mass surge"].sigma)
    assert total.sigma < 0.9 * apart


def test_lengths_are_compared_with_five_centimetres() -> None:
    assert told()["centre_of_buoyancy x"].size == 0.05


def test_samples_that_miss_alike_widen_intervals() -> None:
    wide = told(25.0)["added_mass surge"]
    narrow = told()["added_mass surge"]
    assert wide.sigma > 2.0 * narrow.sigma
    assert (
        wide.interval[0] < narrow.interval[0] < narrow.value < narrow.interval[1] < wide.interval[1]
    )
    assert wide.interval[0] > 0.0


def test_what_priors_say_alone_is_not_determined() -> None:
    auv, estimate = found()
    nothing = replace(estimate, information=np.diag(1.0 / auv.shared.sigma**2))
    assert not any(each.determined for each in numbers(auv, nothing))


def test_a_number_determined_to_a_tenth_of_its_size_is_called_so() -> None:
    number = IdentifiedNumber(
        quantity="lag",
        entry="",
        unit="s",
        value=0.1,
        sigma=0.004,
        size=0.05,
        informed=True,
        positive=True,
    )
    assert number.determined
    assert not replace(number, sigma=0.006).determined
    assert not replace(number, informed=False).determined


def test_nothing_is_determined_where_the_search_has_not_converged() -> None:
    auv, estimate = found()
    assert any(each.determined for each in numbers(auv, estimate))
    for each in numbers(auv, replace(estimate, status=FitStatus.ITERATION_LIMIT)):
        assert not each.determined
        assert each.interval == (0.0 if each.positive else -np.inf, np.inf)

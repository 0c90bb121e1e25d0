"""Results of a fit are reported as numbers of the vehicle: with units, intervals, and which of them
are determined.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import drive, known, vehicle_of

from uvms_ocp.identification.estimates import Estimate, FitStatus, Noise
from uvms_ocp.identification.identified_numbers import (
    IdentifiedNumber,
    numbers,
    values_of,
)
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import OutputErrorProblem
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
def fitted() -> tuple[Vehicle, Estimate]:
    """Fit a vehicle to one simulated recording."""
    auv = vehicle_of(known().with_status(**LEARNT))
    rollout = Rollout(stage_of(auv))
    recording = drive(
        rollout.stage,
        np.concatenate([auv.shared.start, auv.per_recording.start]),
        seed=1,
        noise=0.02,
    )
    problem = OutputErrorProblem(
        auv, PreparedRecording.of(recording, auv).segments(0.1, 10.0), Noise(), rollout
    )
    return auv, problem.solve(problem.start())


def numbers_by_name(inflation: float = 1.0) -> dict[str, IdentifiedNumber]:
    return {number.name: number for number in numbers(*fitted(), inflation)}


@pytest.mark.slow
def test_errors_of_numbers_are_those_of_a_change_of_the_unknowns() -> None:
    auv, estimate = fitted()
    slopes = []
    for step in 1e-6 * np.eye(len(estimate.shared)):
        change = values_of(auv, estimate.shared + step) - values_of(auv, estimate.shared - step)
        slopes.append(change / 2e-6)
    C = np.linalg.inv(estimate.information)
    expected = np.sqrt(np.diag(np.array(slopes).T @ C @ np.array(slopes)))
    sigmas = [number.sigma for number in numbers_by_name().values()]
    np.testing.assert_allclose(sigmas, expected, rtol=1e-5)


def test_what_an_axis_has_to_move_is_the_sum_of_both_masses() -> None:
    by_name = numbers_by_name()
    mass = by_name["mass"]
    added_mass = by_name["added_mass surge"]
    total = by_name["mass and added mass surge"]
    assert total.value == pytest.approx(mass.value + added_mass.value)
    assert total.sigma < 0.9 * np.hypot(mass.sigma, added_mass.sigma)


def test_lengths_are_compared_with_five_centimetres() -> None:
    assert numbers_by_name()["centre_of_buoyancy x"].size == 0.05


def test_samples_that_miss_alike_widen_intervals() -> None:
    wide = numbers_by_name(25.0)["added_mass surge"]
    narrow = numbers_by_name()["added_mass surge"]
    assert wide.sigma > 2.0 * narrow.sigma
    assert 0.0 < wide.interval[0] < narrow.interval[0]
    assert narrow.interval[0] < narrow.value < narrow.interval[1] < wide.interval[1]


def test_what_priors_say_alone_is_not_determined() -> None:
    auv, estimate = fitted()
    by_priors = replace(estimate, information=np.diag(1.0 / auv.shared.sigma**2))
    assert not any(number.determined for number in numbers(auv, by_priors))


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
    auv, estimate = fitted()
    assert any(number.determined for number in numbers(auv, estimate))
    for number in numbers(auv, replace(estimate, status=FitStatus.ITERATION_LIMIT)):
        assert not number.determined
        assert number.interval == (0.0 if number.positive else -np.inf, np.inf)

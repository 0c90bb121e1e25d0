"""What a file says of a search: what stays open is as it was declared, where the recordings allow
it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import ACTUATORS, drive, known, vehicle_of

from uvms_ocp.identification.estimates import FitStatus, Noise
from uvms_ocp.identification.exported_estimate import exported_estimate
from uvms_ocp.identification.fit import FitContext, Search, search_fit
from uvms_ocp.identification.held_constants import constant_slopes
from uvms_ocp.identification.identified_numbers import IdentifiedNumber, numbers
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.parameters import Free, Prior, Unknowns
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.uncertainty import DETERMINED, standard_errors

NOISE = Noise(velocity=0.02, rate=0.02, vertical=0.02)
SEARCH = Search(step=0.05, segment_length=10.0)


@cache
def fitted() -> FitContext:
    auv = vehicle_of(
        known().with_status(
            added_mass=Free(only=("surge",)), quadratic_drag=Free(only=("surge", "yaw"))
        )
    )
    rollout = Rollout(stage_of(auv))
    recording = drive(
        rollout.stage, auv.shared.start + np.array([0.1, 0.3, -0.2]), seed=0, noise=0.02, t_end=12.0
    )
    prepared = (PreparedRecording.of(recording, auv),)
    found = FitContext.searched(
        vehicle=auv, rollout=rollout, prepared=prepared, noise=NOISE, search=SEARCH
    )
    return replace(
        found, estimate=replace(found.estimate, assumed=0.0)
    )  # what recordings tell alone


def identified() -> tuple[IdentifiedNumber, ...]:
    """Return the numbers of the fit."""
    return numbers(fitted().vehicle, fitted().estimate)


def test_where_all_is_determined_a_file_has_what_the_search_has_found() -> None:
    estimate = exported_estimate(fitted(), 1.0, identified())
    assert estimate.usable
    assert estimate.kept == ()
    assert estimate.estimate is fitted().estimate


def test_what_stays_open_is_as_declared_and_the_others_are_best_beside_it() -> None:
    unknowns = fitted().vehicle.shared
    left = fitted().estimate
    sigma = standard_errors(fitted().vehicle, left)
    inflation = (1.1 * DETERMINED / sigma.max()) ** 2
    still_open = standard_errors(fitted().vehicle, left, inflation) > DETERMINED
    assert 0 < still_open.sum() < len(sigma)
    estimate = exported_estimate(fitted(), inflation, identified())
    assert estimate.kept == tuple(np.array(unknowns.names)[still_open])
    np.testing.assert_array_equal(estimate.estimate.shared[still_open], unknowns.start[still_open])
    beside = replace(left, shared=np.where(still_open, unknowns.start, left.shared))
    costs = [
        fitted().problem().solve(fitted().problem().resumed(one), frozen=20).cost
        for one in (left, beside)
    ]
    assert costs[0] < estimate.estimate.cost <= costs[1]


def test_of_a_search_that_has_not_converged_no_file_is_made() -> None:
    one = fitted()
    assert not exported_estimate(
        replace(one, estimate=replace(one.estimate, status=FitStatus.STALLED)), 1e6, identified()
    ).usable


def test_where_nothing_is_determined_there_is_no_answer() -> None:
    vague = tuple(replace(number, informed=False) for number in identified())
    estimate = exported_estimate(fitted(), 1.0, vague)
    assert estimate.estimate.status is FitStatus.NO_ANSWER
    assert not estimate.usable


def test_a_mass_of_next_to_nothing_that_nothing_determines_is_never_exported() -> None:
    name = "added_mass surge"
    unknowns = fitted().vehicle.shared
    place = unknowns.names.index(name)
    vague = tuple(
        replace(number, informed=number.informed and number.name != name) for number in identified()
    )
    shared = fitted().estimate.shared.copy()
    shared[place] = -20.0
    strayed = replace(fitted(), estimate=replace(fitted().estimate, shared=shared))
    estimate = exported_estimate(strayed, 1.0, vague)
    if estimate.usable:
        assert estimate.estimate.shared[place] == unknowns.start[place]
        assert name in estimate.kept
    else:
        assert estimate.estimate.status is FitStatus.NO_ANSWER


def test_a_mass_in_the_file_that_recordings_contradict_gives_no_answer() -> None:
    """The vehicle of the file is heavier than the one recorded with all of its added mass."""
    vehicle = fitted().vehicle
    quantities = vehicle.shared.declaration.quantities
    mass = quantities["mass"].value.ravel()
    added = quantities["added_mass"].value[0, 0]
    heavier = vehicle.shared.declaration.with_start(mass=mass + 1.5 * added)
    wrong = replace(
        vehicle, shared=Unknowns(heavier), per_recording=Unknowns(heavier, per_recording=True)
    )
    rollout = Rollout(stage_of(wrong))
    found = FitContext.searched(
        vehicle=wrong, rollout=rollout, prepared=fitted().prepared, noise=NOISE, search=SEARCH
    )
    found = replace(found, estimate=replace(found.estimate, assumed=0.0))
    estimate = exported_estimate(found, 1.0, numbers(wrong, found.estimate))
    assert not estimate.usable
    if found.estimate.status is FitStatus.CONVERGED:
        assert estimate.estimate.status is FitStatus.NO_ANSWER
        assert estimate.contradicted == ("added_mass surge",)
        assert "look at mass" in estimate.advice


def test_what_is_believed_of_a_delay_is_as_wide_in_seconds_wherever_it_is_found() -> None:
    auv = vehicle_of(known().with_status(velocity_delay=Prior(sigma=2.0)))
    nothing = replace(
        fitted().estimate, information=np.diag(1.0 / auv.shared.sigma**2), shared=auv.shared.start
    )
    found = [
        numbers(auv, replace(nothing, shared=auv.shared.start + by))[0].sigma
        for by in (0.0, -1.0, -4.0)
    ]
    np.testing.assert_allclose(found, found[0], rtol=0.03)


@pytest.mark.slow
def test_what_a_constant_would_change_is_what_a_fit_with_another_one_changes() -> None:
    one = fitted()
    longer = 0.02
    names, slopes = constant_slopes(one, ["lag", "gain"])
    known = one.vehicle.shared.declaration.with_start(
        lag=np.array([ACTUATORS.lag * np.exp(longer)])
    )
    rollout = Rollout(stage_of(auv := vehicle_of(known), sharp=True))
    found = search_fit(auv, one.prepared, NOISE, rollout, SEARCH)
    sharp = search_fit(
        one.vehicle, one.prepared, NOISE, Rollout(stage_of(one.vehicle, sharp=True)), SEARCH
    )
    expected = slopes[:, names.index("lag")] * longer
    np.testing.assert_allclose(
        found.shared - sharp.shared, expected, atol=0.15 * np.abs(expected).max()
    )


def test_what_a_long_step_does_to_numbers_is_in_their_standard_errors() -> None:
    one = fitted()
    truth = fitted().vehicle.shared.start + np.array([0.1, 0.3, -0.2])
    exact = (
        PreparedRecording.of(
            drive(one.rollout.stage, truth, seed=0, noise=1e-4, t_end=12.0), one.vehicle
        ),
    )
    fine = Noise(velocity=2e-4, rate=2e-4, vertical=2e-4, process=1e-3, start=1e-3)
    exact_fit = search_fit(
        one.vehicle, exact, fine, one.rollout, Search(step=0.2, segment_length=6.0)
    )
    off = np.abs(exact_fit.shared - truth)
    assert (off / standard_errors(one.vehicle, replace(exact_fit, assumed=0.0))).max() > 10.0
    assert (off / standard_errors(one.vehicle, exact_fit)).max() < 3.0

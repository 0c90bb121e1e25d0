"""A profile is the interval of standard errors where all is linear, and another where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_problem import NOISE, problem

from uvms_ocp.identification.estimates import ProfilePenalty
from uvms_ocp.identification.identified_numbers import (
    INTERVAL,
    IdentifiedNumber,
    number_of,
    numbers,
)
from uvms_ocp.identification.profiles import profiles


def told(inflation: float) -> list[IdentifiedNumber]:
    fitted = problem()
    return [
        replace(number, size=1e3) for number in numbers(fitted.vehicle, fitted.estimate, inflation)
    ]


@pytest.mark.parametrize("inflation", [1.0, 7.0])
def test_of_a_linear_problem_with_gaussian_noise_it_is_the_interval_of_standard_errors(
    inflation: float,
) -> None:
    scanned = list(profiles(problem(), told(inflation), inflation))
    assert [profile.number.name for profile in scanned] == ["bias surge", "bias sway", "bias heave"]
    for profile in scanned:
        width = profile.number.interval[1] - profile.number.interval[0]
        np.testing.assert_allclose(profile.interval, profile.number.interval, atol=1e-3 * width)
        np.testing.assert_allclose(
            profile.roots, (profile.values - profile.number.value) / profile.number.sigma, atol=2e-3
        )
        assert not profile.differs


def test_a_number_that_is_held_is_fitted_around_as_algebra_says() -> None:
    fitted, (_, sway, _) = problem(), told(1.0)
    number = number_of(fitted.vehicle, sway)
    target = sway.value + 2.0 * sway.sigma
    error = fitted.problem(ProfilePenalty(number=number, target=target, sigma=1e-3 * sway.sigma))
    refitted = error.solve(error.resumed(fitted.estimate), tolerance=1e-13, damping=1e-12)
    C = np.linalg.inv(fitted.estimate.information)
    wanted = fitted.estimate.shared + C[:, 1] / C[1, 1] * (target - sway.value)
    np.testing.assert_allclose(refitted.shared, wanted, atol=1e-5)


def test_numbers_that_are_not_determined_have_none() -> None:
    nothing = [replace(number, informed=False) for number in told(1.0)]
    assert not list(profiles(problem(), nothing))


@pytest.mark.parametrize("bend", [0.0, 2.0])
def test_of_a_problem_that_bends_it_is_where_the_bend_has_it(bend: float) -> None:
    fitted = problem(n=4, bend=bend)
    (number,) = (each for each in numbers(fitted.vehicle, fitted.estimate) if each.entry == "sway")
    (profile,) = profiles(fitted, [replace(number, size=1e3)])
    G = np.concatenate(fitted.rollout.G).reshape(-1, 3)  # type: ignore[attr-defined]
    sigma = np.sqrt(np.linalg.inv(G.T @ G)[1, 1]) * NOISE.velocity
    for end, root in zip(profile.interval, (-INTERVAL, INTERVAL), strict=True):
        bent = (number.value + bend * number.value**2) + root * sigma
        wanted = bent if not bend else (np.sqrt(1.0 + 4.0 * bend * bent) - 1.0) / (2.0 * bend)
        assert end == pytest.approx(wanted, abs=0.03 * number.sigma)
    assert profile.differs == (bend > 0.0)

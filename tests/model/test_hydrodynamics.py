"""Coefficients of one link: what is accepted, what is refused, and where drag points."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from wet_machines import random_link

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.water.hydrodynamics import LinkHydrodynamics, added_mass_wrench, drag_wrench

RNG = np.random.default_rng(6)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("added_mass", np.zeros(3), r"fin: added_mass of shape \(3,\) given; allowed: \(6, 6\)"),
        ("linear_drag", np.full(6, np.nan), r"fin: linear_drag of shape \(6, 6\) given; .* finite numbers"),
        ("centre_of_buoyancy", np.zeros(2), r"fin: centre_of_buoyancy of shape \(2,\) given"),
        ("added_mass", np.triu(np.ones((6, 6))), "fin: added_mass is not symmetric"),
        ("added_mass", -np.ones(6), r"fin: added_mass has the eigenvalue -1; allowed: 0 or more"),
        (
            "linear_drag",
            np.array([1, 1, -2, 0, 0, 0]),
            r"fin: linear_drag generates energy \(eigenvalue -2\)",
        ),
        ("quadratic_drag", np.array([0, -1, 0, 0, 0, 0]), "fin: quadratic_drag has a negative diagonal"),
        ("volume", -0.1, r"fin: volume -0\.1 m3 given; allowed: 0 or more"),
        ("volume", np.inf, "fin: volume inf m3 given"),
    ],
)
def test_coefficients_that_cannot_be_are_refused(field: str, value: object, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        LinkHydrodynamics(frame="fin", **{field: value})


def test_a_diagonal_is_a_matrix() -> None:
    link = LinkHydrodynamics(frame="fin", added_mass=np.arange(6.0))
    np.testing.assert_array_equal(link.added_mass, np.diag(np.arange(6.0)))


def test_coefficients_cannot_be_changed() -> None:
    link = LinkHydrodynamics(frame="fin", added_mass=np.ones(6))
    with pytest.raises(ValueError, match="read-only"):
        link.added_mass[0, 0] = 2.0


@pytest.mark.parametrize("nu", RNG.normal(size=(10, 6)))
def test_drag_takes_energy_and_turns_with_the_velocity(nu: np.ndarray) -> None:
    link = random_link("fin", RNG)
    wrench = drag_wrench(link.linear_drag, np.diag(np.diag(link.quadratic_drag)), nu)
    assert wrench @ nu > 0.0
    opposite = drag_wrench(link.linear_drag, np.diag(np.diag(link.quadratic_drag)), -nu)
    np.testing.assert_allclose(opposite, -wrench)


@pytest.mark.parametrize("nu", RNG.normal(size=(10, 6)))
def test_the_water_carried_along_does_no_work_by_coriolis_forces(nu: np.ndarray) -> None:
    link = random_link("fin", RNG)
    assert added_mass_wrench(link.added_mass, nu, np.zeros(6)) @ nu == pytest.approx(0.0, abs=1e-10)


def test_the_centre_of_buoyancy_is_given_in_the_link_s_frame() -> None:
    X_FL = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([1.0, 2.0, 3.0]))
    link = LinkHydrodynamics(frame="fin", X_FL=X_FL, volume=1.0, centre_of_buoyancy=np.array([1.0, 2.0, 3.5]))
    np.testing.assert_allclose(X_FL.rotation @ link.p_LB, [0.0, 0.0, 0.5], atol=1e-15)

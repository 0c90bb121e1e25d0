"""Coefficients of one link: what is accepted, what is refused, and where drag points."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize
from wet_machines import random_link

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.drag_passivity import overload
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics, added_mass_wrench, drag_wrench

RNG = np.random.default_rng(6)


def coupled(above: float, below: float) -> np.ndarray:
    """Quadratic drag of 1 on every axis, with two couplings of the first two."""
    Q = np.eye(6)
    Q[0, 1] = above
    Q[1, 0] = below
    return Q


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("added_mass", np.zeros(3), r"fin: added_mass has shape \(3,\); allowed: \(6, 6\)"),
        ("linear_drag", np.full(6, np.nan), "fin: linear_drag has NaN .*; allowed: finite numbers"),
        (
            "centre_of_buoyancy",
            np.zeros(2),
            r"fin: centre_of_buoyancy has shape \(2,\); allowed: \(3,\)",
        ),
        ("added_mass", np.triu(np.ones((6, 6))), "fin: added_mass is not symmetric"),
        ("added_mass", -np.ones(6), r"fin: added_mass has the eigenvalue -1; allowed: 0 or more"),
        (
            "linear_drag",
            np.array([1, 1, -2, 0, 0, 0]),
            (
                r"fin: linear_drag feeds 2 W at nu = \(0, 0, 1, 0, 0, 0\) m/s, rad/s; allowed: no"
                r" eigenvalue below 0"
            ),
        ),
        (
            "quadratic_drag",
            np.array([0, -1, 0, 0, 0, 0]),
            (
                r"fin: quadratic_drag feeds 1 W at nu = \(0, 1, 0, 0, 0, 0\) m/s, rad/s; allowed: a"
                r" diagonal of 0 or more"
            ),
        ),
        (
            "quadratic_drag",
            coupled(10.0, 10.0),
            (
                r"fin: quadratic_drag feeds 18 W at nu = \(1, -1, 0, 0, 0, 0\) .*; allowed:"
                r" couplings at most 0\.1 times as large"
            ),
        ),
        (
            "quadratic_drag",
            coupled(2.5, -2.5),
            (
                "fin: quadratic_drag may feed energy: its diagonal does not outweigh its couplings;"
                " allowed: couplings at most 0.4"
            ),
        ),
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
    link = LinkHydrodynamics(
        frame="fin", X_FL=X_FL, volume=1.0, centre_of_buoyancy=np.array([1.0, 2.0, 3.5])
    )
    np.testing.assert_allclose(X_FL.rotation @ link.p_LB, [0.0, 0.0, 0.5], atol=1e-15)


def random_couplings(seed: int, *, adverse: bool) -> tuple[np.ndarray, np.ndarray]:
    """A diagonal (6, 6) in units of any size, and couplings (6, 6); adverse ones can all act
    against it at once.
    """
    rng = np.random.default_rng(seed)
    units = 10 ** rng.uniform(-1, 1, 6)
    signs = rng.choice([-1.0, 1.0], 6)
    Q = (
        rng.normal(size=(6, 6))
        * (rng.random((6, 6)) < rng.choice([0.1, 0.3, 1.0]))
        * (1 - np.eye(6))
    )
    Q[4, 1] = 1.0
    Q = -np.abs(Q) * np.outer(signs, signs) if adverse else Q
    scale = np.outer(units, units**2)
    return np.diag(rng.uniform(0.2, 3.0, 6)) * scale, Q * scale


def largest(diagonal: np.ndarray, couplings: np.ndarray) -> float:
    """The factor of the couplings up to which drag is accepted."""
    return 1e3 / overload(diagonal + 1e3 * couplings)[0]


def power(link: LinkHydrodynamics, nu: np.ndarray) -> float:
    return float(nu @ drag_wrench(link.linear_drag, link.quadratic_drag, nu))


@pytest.mark.parametrize("adverse", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_drag_that_is_accepted_feeds_no_velocity_that_a_search_finds(
    seed: int, adverse: bool
) -> None:
    diagonal, couplings = random_couplings(seed, adverse=adverse)
    link = LinkHydrodynamics(
        frame="fin", quadratic_drag=diagonal + 0.999 * largest(diagonal, couplings) * couplings
    )
    root = np.cbrt(np.diag(diagonal))

    def normed(x: np.ndarray) -> float:
        return power(link, x / root) / max(np.linalg.norm(x) ** 3, 1e-30)

    starts = np.random.default_rng(seed).normal(size=(3000, 6)) ** 3
    starts = sorted((x / np.linalg.norm(x) for x in starts), key=normed)[:4]
    smallest = min(
        minimize(normed, x, method="Nelder-Mead", options={"maxfev": 800}).fun for x in starts
    )
    assert smallest > 0.0


@pytest.mark.parametrize("seed", range(12))
def test_couplings_that_all_act_against_the_diagonal_are_refused_from_where_they_feed_a_velocity(
    seed: int,
) -> None:
    diagonal, couplings = random_couplings(seed, adverse=True)
    couplings *= largest(diagonal, couplings)
    LinkHydrodynamics(frame="fin", quadratic_drag=diagonal + 0.999 * couplings)
    linear = np.eye(6)
    quadratic = diagonal + 1.05 * couplings
    with pytest.raises(InvalidInput, match=r"quadratic_drag feeds .* times as large") as error:
        LinkHydrodynamics(frame="fin", linear_drag=linear, quadratic_drag=quadratic)
    assert "\n" not in str(error.value)
    watts, nu = re.search(r"feeds (\S+) W at nu = \((.*)\) m/s", str(error.value)).groups()
    nu = np.array([float(entry) for entry in nu.split(",")])
    assert nu @ drag_wrench(linear, quadratic, nu) == pytest.approx(-float(watts), rel=5e-3)


def test_the_largest_couplings_that_are_accepted_are_those_that_feed_nothing() -> None:
    LinkHydrodynamics(frame="fin", quadratic_drag=coupled(1.0, 1.0))
    for above, below in ((1.01, 1.0), (-1.0, -1.01)):
        with pytest.raises(InvalidInput, match="feeds"):
            LinkHydrodynamics(frame="fin", quadratic_drag=coupled(above, below))
    assert np.array([1, -0.5, 0, 0, 0, 0]) @ drag_wrench(
        np.zeros((6, 6)), coupled(10.0, 10.0), np.array([1, -0.5, 0, 0, 0, 0])
    ) == pytest.approx(-6.375)


def test_an_axis_without_drag_of_its_own_bears_no_couplings() -> None:
    for i, j, coupling in product((0, 5), (0, 5), (1e-2, 1e-3, 1e-6)):
        Q = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
        if i == j:
            continue
        Q[i, j] = coupling
        with pytest.raises(InvalidInput, match="feeds"):
            LinkHydrodynamics(frame="fin", quadratic_drag=Q)


@pytest.mark.parametrize("largest", [1.0, 1e3, 1e9, 1e30])
@pytest.mark.parametrize("name", ["linear_drag", "quadratic_drag"])
def test_a_small_axis_may_feed_nothing_however_large_the_others_are(
    name: str, largest: float
) -> None:
    for smallest in (0.9, 1e-9, 1e-30):
        LinkHydrodynamics(frame="fin", **{name: np.array([largest, smallest, 0, 0, 0, 0])})
        with pytest.raises(InvalidInput, match=f"{name} feeds {smallest:.3g} W at nu = \\(0, 1, 0"):
            LinkHydrodynamics(frame="fin", **{name: np.array([largest, -smallest, 0, 0, 0, 0])})


@pytest.mark.parametrize("seed", range(8))
def test_linear_couplings_are_judged_in_the_units_of_their_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    units = 10 ** rng.uniform(-8, 8, 6)
    root = rng.normal(size=(6, 4))
    definite = root @ root.T  # of rank 4: on the edge of what is allowed
    LinkHydrodynamics(frame="fin", linear_drag=units[:, None] * definite * units)
    indefinite = definite - 1e-6 * np.diag(np.diag(definite))
    with pytest.raises(InvalidInput, match="linear_drag feeds") as error:
        LinkHydrodynamics(frame="fin", linear_drag=units[:, None] * indefinite * units)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("axis_drag", "coupling"), [(0.0, 1e-9), (1e-320, 1.0), (1e-12, 1e-5), (0.0, 1e30)]
)
def test_an_axis_with_hardly_any_linear_drag_bears_hardly_any_couplings(
    axis_drag: float, coupling: float
) -> None:
    for i, j in ((0, 1), (4, 2)):
        D = np.eye(6)
        D[i, i] = axis_drag
        D[i, j] = coupling
        with pytest.raises(InvalidInput, match="linear_drag feeds"):
            LinkHydrodynamics(frame="fin", linear_drag=D)
